"""Simulation of the real day. Written apart from the model, in plain numpy.

The plant knows the actual demand, PV power and battery state. It carries out a decision as far as
physics lets it and says where it did not; it shares data with the optimiser, never functions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

import numpy as np

from vppres.contract.decision import Decision
from vppres.core.arrays import Flags, Floats
from vppres.kinds.batteries.physics import BatteriesAhead
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import Owed, SwitchingState
from vppres.kinds.kind import Followers
from vppres.kinds.table import parts, units_of
from vppres.physics.places import Places
from vppres.physics.thermal import Power, ThermalScheme, advance, initial_state
from vppres.scenario.scenario import Scenario

F = TypeVar("F", bound=Followers)

NOBODY = "nobody"
"""Word of the record for no customer shed, where a power flow was not found."""

CLIP_TOLERANCE_KW = 1e-3
"""Set-points that the plant had to move by more than this are named in the record."""


@dataclass(frozen=True, eq=False)
class BatteryState:
    """State of the fleet, (B,) each."""

    soc: Floats
    eta_charge: Floats
    eta_discharge: Floats
    t_cell_c: Floats


@dataclass(frozen=True)
class SetForms:
    """The generating set that forms the grid of an island, by its position, and its kvar."""

    genset: int
    q_kvar: float = 0.0


@dataclass(frozen=True, eq=False)
class Powers:
    """Powers of one step that all devices can deliver; a charging battery is positive.

    ``served`` has the shape (C,), the ``pv`` fields (P,), the batteries' (B,); kW and kvar.
    ``share`` is the part of its demand that each customer gets if it is served. ``taken_kw`` and
    ``running`` are those of a :class:`vppres.contract.dispatch.Dispatch`, (n,) by kind.
    """

    served: Flags
    pv_self_kw: Floats
    pv_export_kw: Floats
    pv_curtailed_kw: Floats
    pv_q_kvar: Floats
    battery_kw: Floats
    batt_q_kvar: Floats
    share: Floats | float = 1.0
    taken_kw: Mapping[str, Floats] = field(default_factory=dict)
    running: Mapping[str, Flags] = field(default_factory=dict)
    #: Generating sets that form the grids of islands: one at most in each part of the feeder.
    forming: tuple[SetForms, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Realised(Powers):
    """One step as it happened: its powers, and what followed from them."""

    load_kw: Floats  #: demand, served or not, (C,)
    soc_end: Floats  #: states of charge at the end of the step, (B,)
    #: Net injections at the places (``Plant.places``), positive as generation.
    p_injection_kw: Floats
    q_injection_kvar: Floats
    clipped_kw: float  #: largest power by which devices could not follow their set-points

    @property
    def charge_kw(self) -> Floats:
        """Power that batteries took, (B,)."""
        return np.maximum(self.battery_kw, 0.0)

    @property
    def discharge_kw(self) -> Floats:
        """Power that batteries gave, (B,)."""
        return np.maximum(-self.battery_kw, 0.0)

    @property
    def flexible_kw(self) -> float:
        """Power of vehicles and machines, less that of generating sets."""
        return sum((float(np.sum(taken_kw)) for taken_kw in self.taken_kw.values()), start=0.0)


class Plant:
    """The actual day of a scenario.

    Of the switching rules it has how demand behaves after a restoration.
    """

    def __init__(
        self,
        scenario: Scenario,
        thermal: ThermalScheme = "off",
        rules: SwitchingRules | None = None,
    ) -> None:
        self.scenario = scenario
        self.thermal = thermal
        self.switching = SwitchingState.of(
            rules or SwitchingRules(), scenario.customers, scenario.grid.dt_h
        )
        self.owed = Owed.of(scenario.customers, scenario.grid.dt_h)
        self.places = Places.of(scenario)
        self._every: dict[str, Followers] = {
            kind: part.PLANT(scenario) for kind, part in parts("physics").items()
        }
        self.units = {kind: self._every[kind] for kind in units_of(scenario)}
        self.owner = scenario.pv.owner(scenario.customers)
        self._alone = scenario.pv.alone

    def of(self, units: type[F]) -> F:
        """The units of a kind, by their class."""
        return next(each for each in self._every.values() if isinstance(each, units))

    def states_at(self, t: int) -> dict[str, Any]:
        """State at the beginning of a step of each kind that the site has."""
        return {kind: units.at(t) for kind, units in self.units.items()}

    def state_of(self, kind: str) -> Any:
        """State of the units of a kind now."""
        return self.units[kind].state

    def begin_with(self, states: Mapping[str, Any]) -> None:
        """Begin a step with these states by kind."""
        for kind, state in states.items():
            self.units[kind].state = state

    def go_on_from(self, other: Plant) -> None:
        """Begin a step in the state of another plant with the same devices."""
        self.switching, self.owed = other.switching, other.owed
        self.begin_with({kind: units.state for kind, units in other.units.items()})

    def initial_state(self) -> BatteryState:
        """State before the first step."""
        b = self.scenario.batteries
        thermal = initial_state(b, float(self.scenario.temperature_c[0]))
        return BatteryState(
            b.soc_initial, thermal.eta_charge, thermal.eta_discharge, thermal.t_cell_c
        )

    def advance(self, t: int, state: BatteryState, realised: Realised) -> BatteryState:
        """State before the step after ``t``."""
        self.switching = self.switching.advance(realised.served)
        self.owed = self.owed.after(
            realised.load_kw, np.asarray(realised.served * realised.share, dtype=float)
        )
        for kind, units in self.units.items():
            units.advance(t, realised.taken_kw[kind], realised.running[kind])
        power = Power(realised.charge_kw, realised.discharge_kw)
        thermal = advance(
            self.scenario.batteries,
            self.thermal,
            state,
            power,
            float(self.scenario.temperature_c[t]),
            self.scenario.grid.dt_h,
        )
        return BatteryState(
            realised.soc_end, thermal.eta_charge, thermal.eta_discharge, thermal.t_cell_c
        )

    def apply(self, t: int, decision: Decision, state: BatteryState) -> Realised:
        """Carry out a decision at step ``t``."""
        plan = decision.dispatch
        row = decision.row
        served = np.asarray(plan.served[row], dtype=bool)
        share = 1.0 if plan.share is None else np.asarray(plan.share[row], dtype=float)
        served = served & (share > 0.0)
        demand_kw = self.load_kw(t, served) * served * share
        own, export, curtailed = self._split_pv(t, demand_kw, plan.pv_curtailed_kw[row])
        charge, discharge = self._battery_power(plan.charge_kw[row], plan.discharge_kw[row], state)
        pv = self.scenario.pv
        b = self.scenario.batteries
        pv_q = _limit_q(plan.pv_q_kvar[row], own + export, pv.s_max_kva)
        batt_q = _limit_q(plan.batt_q_kvar[row], charge - discharge, b.s_max_kva)
        clipped = max(
            np.abs(charge - plan.charge_kw[row]).max(initial=0.0),
            np.abs(discharge - plan.discharge_kw[row]).max(initial=0.0),
            np.abs(curtailed - plan.pv_curtailed_kw[row]).max(initial=0.0),
        )
        followed = {
            kind: self.units[kind].follow(
                t, plan.taken_by(kind, units)[row], plan.running_of(kind, units)[row], served
            )
            for kind, units in units_of(self.scenario).items()
        }
        powers = Powers(
            served,
            own,
            export,
            curtailed,
            pv_q,
            charge - discharge,
            batt_q,
            share,
            {kind: taken_kw for kind, (taken_kw, _) in followed.items()},
            {kind: running for kind, (_, running) in followed.items()},
        )
        return self.realise(t, powers, state, float(clipped))

    def load_kw(self, t: int, served: Flags) -> Floats:
        """Demand of each customer in step ``t``, (C,): higher for those who were just restored."""
        return np.asarray(self.scenario.load_kw[t] * self.switching.demand_factor(served))

    def realise(
        self, t: int, powers: Powers, state: BatteryState, clipped_kw: float = 0.0
    ) -> Realised:
        """Injections at places and batteries' states after powers that are within all limits."""
        b = self.scenario.batteries
        load_kw = self.load_kw(t, powers.served)
        p, q = self._injections(
            load_kw * powers.served * powers.share,
            powers.pv_self_kw,
            powers.pv_export_kw,
            powers.battery_kw,
        )
        taken_kw = self.connected_kw(powers.taken_kw, powers.served)
        for kind, each_kw in taken_kw.items():
            np.add.at(p, self.places.units[kind], -each_kw)
        np.add.at(q, self.places.pv, powers.pv_q_kvar)
        np.add.at(q, self.places.batteries, powers.batt_q_kvar)
        for one in powers.forming:
            q[self.places.units["gensets"][one.genset]] += one.q_kvar
        soc = self.batteries_ahead(state).after(powers.battery_kw)
        soc_end = np.clip(soc, b.soc_min, b.soc_max)
        of_units = {
            "taken_kw": taken_kw,
            "running": {
                kind: np.asarray(powers.running.get(kind, np.zeros(len(each_kw), dtype=bool)))
                for kind, each_kw in taken_kw.items()
            },
        }
        return Realised(
            **{f.name: getattr(powers, f.name) for f in fields(Powers)} | of_units,
            load_kw=load_kw,
            soc_end=soc_end,
            p_injection_kw=p,
            q_injection_kvar=q,
            clipped_kw=clipped_kw,
        )

    def connected_kw(self, taken_kw: Mapping[str, Floats], served: Flags) -> dict[str, Floats]:
        """Power of the units of each kind, none of those whose customer is off, (n,) each."""
        return {
            kind: np.where(units.on(served), taken_kw.get(kind, 0.0), 0.0)
            for kind, units in self.units.items()
        }

    def _split_pv(
        self, t: int, demand_kw: Floats, curtailment_kw: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Self-consumption, export and curtailment of the actual PV power."""
        available = self.scenario.pv_kw[t]
        # No customer is behind the meter of a system that stands alone: all of it is exported.
        demand = np.where(self._alone, 0.0, demand_kw[self.owner])
        rating = self.scenario.pv.s_max_kva
        own = np.minimum(np.minimum(available, demand), rating)
        # The inverter cannot pass more than its rating, whatever was asked for.
        forced = np.maximum(available - rating, 0.0)
        curtailed = np.clip(curtailment_kw, forced, np.maximum(available - own, forced))
        return own, np.maximum(available - own - curtailed, 0.0), curtailed

    def _battery_power(
        self, charge_kw: Floats, discharge_kw: Floats, state: BatteryState
    ) -> tuple[Floats, Floats]:
        """Set-points as far as power rating and state of charge allow."""
        most_charge, most_discharge = self.batteries_ahead(state).most_kw()
        net = charge_kw - discharge_kw
        return np.clip(net, 0.0, most_charge), np.clip(-net, 0.0, most_discharge)

    def batteries_ahead(self, state: BatteryState) -> BatteriesAhead:
        """The batteries from a state on."""
        return BatteriesAhead.of(self.scenario.batteries, state, self.scenario.grid.dt_h)

    def _injections(
        self, demand_kw: Floats, own: Floats, export: Floats, battery_kw: Floats
    ) -> tuple[Floats, Floats]:
        """Net injection at every place: generation less served demand; kvar of the demand only."""
        p = np.zeros(len(self.places))
        q = np.zeros_like(p)
        np.add.at(p, self.places.customers, -demand_kw)
        np.add.at(q, self.places.customers, -demand_kw * self.scenario.customers.q_per_p)
        np.add.at(p, self.places.pv, own + export)
        np.add.at(p, self.places.batteries, -battery_kw)
        return p, q


def _limit_q(q_kvar: Floats, p_kw: Floats, s_max_kva: Floats) -> Floats:
    """Reactive set-point inside the inverter's disc, active power first."""
    limit = np.sqrt(np.maximum(s_max_kva**2 - p_kw**2, 0.0))
    return np.clip(q_kvar, -limit, limit)
