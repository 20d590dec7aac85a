"""One step as it is known, and what devices can do in it: plain numpy, no solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.core.arrays import Flags, Floats
from vppres.kinds.batteries.physics import BatteriesAhead
from vppres.model.data import WindowData
from vppres.model.formulas import bus_injections, curtailed_kw, lossless_flows, squared_voltages
from vppres.model.own_state import voltages_without_control, with_own_state
from vppres.model.parts import at_items, parts_of
from vppres.model.phases import phased_model
from vppres.model.site import Site
from vppres.scenario.formers import largest_forming_battery


@dataclass(frozen=True, eq=False)
class StepState:
    """The step to decide on."""

    site: Site  #: fixed data
    now: WindowData  #: what is known of it, a window of one step
    online: Flags  #: batteries that can be used, (B,)
    #: Voltages that the feeder has without control, where limits give way to them; none if not
    #: given, (k, N).
    own_v_pu: Floats = field(default_factory=lambda: np.empty((0, 1)))
    #: Whether it is an island that no battery can form; ``now.ahead`` has the set that can, if any.
    dark: bool = False
    dead: bool = False  #: whether it is a part that nothing forms, or whose bus is out
    due: Flags = field(kw_only=True)  #: customers whose longest time off has ended, (C,)
    inside: Flags | None = None  #: buses of the part that it is the step of; all if not given, (N,)
    #: Flexible power that a dispatch by rule goes by, as a :class:`Dispatch` has it, one step.
    taken_kw: dict[str, Floats] = field(default_factory=dict)
    running: dict[str, Flags] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        site: Site,
        seen: Observation,
        centre: Centre = "lossless",
        needs_former: bool = False,
    ) -> StepState:
        """The first step of an observation.

        ``needs_former`` is as for :func:`~vppres.model.parts.parts_of`.
        """
        held = np.where(seen.online, seen.soc, site.batteries.soc_min)
        island = seen.forecast.grid_limit_kw[:1] <= 0.0
        parts = parts_of(site, seen.forecast.out.part(slice(1)), held, island, needs_former)
        everyone = np.ones((1, len(site.customers)), dtype=bool)
        # Demand is higher for those who would be restored now.
        now = with_own_state(site, WindowData.of(seen, site, centre).first(1))
        own_v_pu = voltages_without_control(site, now)
        now = replace(now.for_service(everyone), parts=parts)
        return cls(site, now, seen.online, own_v_pu, due=seen.switching.due)

    @property
    def load_kw(self) -> Floats:
        """Demand, (C,)."""
        return np.asarray(self.now.load_kw[0])

    @property
    def pv_kw(self) -> Floats:
        """Available PV power, (P,)."""
        return np.asarray(self.now.pv_kw[0])

    @property
    def soc(self) -> Floats:
        """State of charge, (B,)."""
        return np.asarray(self.now.soc)

    @property
    def grid_limit_kw(self) -> float:
        """Largest import, 0 in an outage."""
        return float(self.now.grid_limit_kw[0])

    @property
    def export_limit_kw(self) -> float:
        """Largest export, 0 in an outage and where the connection imports only."""
        return float(self.now.export.limit_kw[0]) if self.now.export else 0.0

    def items(self, place: Any) -> Flags:
        """Which of the items that are placed on buses are inside, (n,)."""
        everywhere = np.ones(self.site.network.n_buses, dtype=bool)
        inside = everywhere if self.inside is None else self.inside
        return np.asarray(at_items(inside[np.newaxis], place)[0])

    @property
    def worth(self) -> Floats:
        """Worth of serving each customer in the step, per hour, (C,)."""
        beyond = np.where(self.due, self.site.hour_beyond, 0.0)
        return np.asarray(self.site.customers.weight + beyond)

    @property
    def formers(self) -> dict[str, Flags]:
        """Units that form the grid, (n,), by kind; none where none has to, or can."""
        return {kind: forms[0] for kind, forms in self.now.ahead.formers().items()}

    @property
    def holders(self) -> dict[str, Flags]:
        """Units that hold a part if they run, (n,), by kind; none where no part needs them."""
        return {kind: holds[0] for kind, holds in self.now.ahead.holders().items()}

    def acting(self, acts: Mapping[str, tuple[Floats, Flags]]) -> StepState:
        """Step state with these powers of kinds, and which units run of those that are switched."""
        taken_kw = {kind: kw for kind, (kw, _) in acts.items()}
        switched = (kind for kind in acts if self.now.ahead.by_kind[kind].switched)
        running = {kind: acts[kind][1] for kind in switched}
        return replace(self, taken_kw=self.taken_kw | taken_kw, running=self.running | running)

    @property
    def island(self) -> bool:
        """Whether the grid gives nothing."""
        return self.grid_limit_kw <= 0.0

    @property
    def forming_battery(self) -> int | None:
        """The battery that holds an island, or the part that it is; None if none can."""
        if self.now.parts.whole:
            return largest_forming_battery(self.site)
        able = self.now.parts.forms[0] & self.online
        kva = np.where(able, self.site.batteries.s_max_kva, -1.0)
        return int(np.argmax(kva)) if able.any() else None

    @cached_property
    def drawn_kw(self) -> Floats:
        """Active power that the network itself draws, (N,)."""
        drawn = self.now.drawn
        return drawn.kw[0] if drawn else np.zeros(self.site.network.n_buses)

    @cached_property
    def drawn_kvar(self) -> Floats:
        """Reactive power that the network itself draws, (N,)."""
        drawn = self.now.drawn
        return drawn.kvar[0] if drawn else np.zeros(self.site.network.n_buses)

    @cached_property
    def usable_pv_kw(self) -> Floats:
        """PV power that the inverters can pass, (P,)."""
        return np.minimum(self.pv_kw, self.site.pv.s_max_kva)

    @cached_property
    def batteries_ahead(self) -> BatteriesAhead:
        """The batteries from this step on."""
        return BatteriesAhead.of(self.site.batteries, self.now, self.site.dt_h)

    @cached_property
    def charge_max_kw(self) -> Floats:
        """Largest charging power by rating and room, (B,)."""
        return np.where(self.online, self.batteries_ahead.most_kw()[0], 0.0)

    @cached_property
    def discharge_max_kw(self) -> Floats:
        """Largest discharging power by rating and stored energy, (B,)."""
        return np.where(self.online, self.batteries_ahead.most_kw()[1], 0.0)

    @property
    def network_to_grid_kw(self) -> float:
        """Power that the network gives on balance, and that nothing keeps from the grid."""
        return 0.0 if self.island else max(-float(self.drawn_kw.sum()), 0.0)

    @property
    def flexible_kw(self) -> float:
        """Power that flexible units take, less what they give."""
        return float(sum(kw.sum() for kw in self.taken_kw.values()))

    @property
    def capacity_kw(self) -> float:
        """Demand that PV, batteries, flexible power and grid can carry together."""
        given_kw = self.usable_pv_kw.sum() + self.discharge_max_kw.sum() + self.grid_limit_kw
        return float(given_kw - self.drawn_kw.sum() - self.flexible_kw)

    def v_limits_pu(self, lowest: float, highest: float) -> tuple[Floats, Floats]:
        """Limits of the voltages that give way to those without control, (N,) each."""
        given = (np.full((1, self.site.network.n_buses), limit) for limit in (lowest, highest))
        low, high = (np.vstack([limit, *self.own_v_pu]) for limit in given)
        return np.fmin.reduce(low), np.fmax.reduce(high)

    def idle(self) -> StepState:
        """Step state with every battery off."""
        return replace(self, online=np.zeros_like(self.online))

    def own_part(self, step: Dispatch) -> Dispatch:
        """A planned step whose devices outside of the part do nothing."""
        site = self.site
        on, pv, batteries = map(self.items, (site.customer_bus, site.pv_bus, site.battery_bus))
        units = {kind: self.items(place) for kind, place in site.unit_bus.items()}
        inside = {"pv_curtailed_kw": pv, "pv_q_kvar": pv, "served": on}
        inside |= dict.fromkeys(("charge_kw", "discharge_kw", "batt_q_kvar"), batteries)
        inside |= {} if step.share is None else {"share": on}
        rows: dict[str, Any] = {name: getattr(step, name) * own for name, own in inside.items()}
        for name in ("taken_kw", "given_kvar"):
            rows[name] = {kind: kw * units[kind] for kind, kw in getattr(step, name).items()}
        return replace(step, **rows)

    def sun_kw(self, step: Dispatch) -> Floats:
        """PV power that a planned step uses or exports, (P,)."""
        wanted_kw, served_kw = step.pv_curtailed_kw[0], self.load_kw * step.supplied[0]
        return self.pv_kw - curtailed_kw(self.site, wanted_kw, self.pv_kw, served_kw)

    def injections(self, step: Dispatch) -> tuple[Floats, Floats]:
        """Injections of a planned step at all buses in kW and kvar, (N,) each."""
        site, load_kw = self.site, self.load_kw * step.supplied[0]
        battery_kw = step.discharge_kw[0] - step.charge_kw[0]
        p_kw = {"pv": self.sun_kw(step), "batteries": battery_kw, "customers": -load_kw}
        p_kw |= {kind: -step.taken_by(kind, units)[0] for kind, units in site.kinds.items()}
        q_kvar = {"pv": step.pv_q_kvar[0], "batteries": step.batt_q_kvar[0]}
        q_kvar |= {"customers": -load_kw * site.customers.q_per_p, **_given_kvar(step)}
        return bus_injections(site, p_kw), bus_injections(site, q_kvar)

    def powers(self, step: Dispatch, source: int) -> tuple[Floats, Floats]:
        """Power that devices of a phased feeder draw in a step beside a source, (D,) each."""
        kinds = self.site.kinds.items()
        return phased_model(self.site).powers(
            source,
            load_kw=self.load_kw * step.supplied[0],
            pv=(self.sun_kw(step), step.pv_q_kvar[0]),
            batteries=(step.discharge_kw[0] - step.charge_kw[0], step.batt_q_kvar[0]),
            taken_kw={kind: step.taken_by(kind, units)[0] for kind, units in kinds},
            given_kvar=_given_kvar(step),
        )

    def own_kw(self, served: Flags) -> Floats:
        """Self-consumption of each PV system for a supply schedule, (P,)."""
        return np.minimum(self.site.behind_meter(self.load_kw * served), self.usable_pv_kw)


def _given_kvar(step: Dispatch) -> dict[str, Floats]:
    """Reactive power of units by kind in a step; none where it is not known."""
    return {kind: np.nan_to_num(kvar[0]) for kind, kvar in step.given_kvar.items()}


def network_state(state: StepState, p_kw: Floats, q_kvar: Floats) -> tuple[Floats, Floats, Floats]:
    """Lossless flows (L,) twice, and voltages (N,) in pu, for the injections of all buses (N,)."""
    net = state.site.network
    p_flow = lossless_flows(net, p_kw - state.drawn_kw)
    q_flow = lossless_flows(net, q_kvar - state.drawn_kvar)
    u = squared_voltages(net, p_flow, q_flow, state.now.delta_pu2[0])
    return p_flow, q_flow, net.v_pu(np.maximum(u, 0.0))
