"""The rule in an island of a phased feeder: a customer is served if every phase carries it.

Customers' batteries supply what is on their own coils, PV systems what is behind their meters, and
the battery or generating set that forms the island the rest of each phase. Where capacitors give a
phase more reactive power than its third of the former takes, batteries on that phase alone take it,
and what a set gives at least and no customer takes charges batteries. So no set-point burdens a
phase that it does not relieve, and a power flow by phase says of every set whether it is carried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.control.carried import Carried, dispatch_of, in_proportion, with_more
from vppres.control.step_state import StepState
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.phases import PhasedModel, phased_model
from vppres.physics.phases import NoPhasedSolutionError, PhasedResult
from vppres.scenario.phases import PHASES, PhaseConnection

MOST_FLOWS = 4
"""Power flows in which batteries take what is beyond a phase of the former, or what its set gives
at least, for one schedule."""

AIM = 0.95
"""Share of its rating that is left of the power of a phase that was beyond it."""

TOLERANCE_KVA = 1e-3
"""By how much a phase of the former may be beyond its rating: a watt, as in the power flow."""

REST_PU = 1e-3
"""By how much a voltage that is outside its limits at rest may be further outside: what loads on
other phases and magnetising currents move it by."""


def served_by_phase(state: StepState, blocks: Sequence[Wholes]) -> Carried:
    """Customers block by block, each if all phases carry it beside those before.

    The first block is the most important; the step has no grid.
    """
    nobody = np.zeros(len(state.site.customers), dtype=bool)
    former = Former.of(state)
    best = None if former is None else former.carried(nobody, None)
    if former is None or best is None:
        pv, battery = (np.zeros(len(each)) for each in (state.site.pv, state.site.batteries))
        return dispatch_of(state, nobody, (pv, pv, pv), battery, battery, 0.0, {})
    # Customers that are carried together are carried one by one: most of them take no flow each.
    return former.dispatch(with_more(nobody, best, blocks, former.carried))


def capacity_by_phase_kw(state: StepState) -> float:
    """Demand that the former of an island, and what is behind customers' meters, may carry."""
    former = Former.of(state)
    if former is None:
        return 0.0
    everyone = np.ones(len(state.site.customers), dtype=bool)
    own = state.own_kw(everyone)
    given_kw, _ = former.behind_meters(everyone, own)
    taken_kw = sum(kw.sum() for kind, kw in state.taken_kw.items() if kind not in state.formers)
    return former.most_kw + float(own.sum() + given_kw.sum() - taken_kw)


def carried_by_phase(state: StepState, dispatch: Dispatch) -> bool:
    """Whether a power flow by phase carries a dispatch of one step, its former's own part apart."""
    former = Former.of(state)
    if former is None:
        return False
    drawn = former.model.powers(
        former.source,
        state.load_kw * dispatch.supplied[0],
        (dispatch.pv_self_kw[0] + dispatch.pv_export_kw[0], dispatch.pv_q_kvar[0]),
        (dispatch.discharge_kw[0] - dispatch.charge_kw[0], dispatch.batt_q_kvar[0]),
        {kind: kw[0] for kind, kw in dispatch.taken_kw.items()},
        {kind: kvar[0] for kind, kvar in dispatch.given_kvar.items()},
    )
    found = former.flow(*drawn)
    return found is not None and former.fits(found) and former.surplus_kw(found) == 0.0


def supply_of(state: StepState) -> int:
    """Supply of a step, or of the part that it is, in the model of its site."""
    model = phased_model(state.site)
    if state.now.parts.whole:
        return int(model.sources_of(np.array(state.island), state.formers))
    return model.source_in(state.now.parts, state.island, state.inside)


@dataclass(frozen=True, eq=False)
class Former:
    """Device that holds an island in a step: a battery, or a unit of a kind.

    ``source`` is its number among the sources of the model; its powers are those of all phases.
    """

    state: StepState
    model: PhasedModel
    source: int
    least_kw: float
    most_kw: float
    most_kvar: float
    battery: int | None = None

    @classmethod
    def of(cls, state: StepState) -> Former | None:
        """The device that forms the island of a step; None if none can."""
        model = phased_model(state.site)
        source = supply_of(state)
        for kind, forms in state.formers.items():
            units, known = state.site.kinds[kind], state.now.ahead.by_kind[kind]
            taken_kw, on = zip(
                *(
                    known.beside(np.where(forms, kw, 0.0), state.island)
                    for kw in (0.0, units.largest_kw)
                ),
                strict=True,
            )
            least_kw, most_kw = (-float(kw[forms].sum()) for kw in taken_kw)
            most_kvar = float(known.q_most_kvar()[0][forms].sum())
            runs = bool((on[0] & forms).any())
            return cls(state, model, source, least_kw, most_kw, most_kvar) if runs else None
        battery = state.forming_battery
        if battery is None or not state.online[battery]:
            return None
        least_kw = -float(state.charge_max_kw[battery])
        most_kw = float(state.discharge_max_kw[battery])
        most_kvar = float(state.site.batteries.s_max_kva[battery])
        return cls(state, model, source, least_kw, most_kw, most_kvar, battery)

    @cached_property
    def phase_kva(self) -> float:
        """Rating of each of its phases."""
        return float(self.model.supplies[self.source].ratings_kva[0]) / len(PHASES)

    @cached_property
    def others(self) -> Flags:
        """Batteries beside it that can be used, (B,)."""
        former = np.arange(len(self.state.online)) == self.battery
        return np.asarray(self.state.online & ~former)

    def flow(self, p_kw: Floats, q_kvar: Floats) -> PhasedResult | None:
        """The power flow of what assets draw, None without a solution."""
        try:
            return self.model.solved(self.source, p_kw, q_kvar)
        except NoPhasedSolutionError:
            return None

    def surplus_kw(self, found: PhasedResult) -> float:
        """Power that it gives at least and a power flow does not take."""
        return max(self.least_kw - float(found.source_kva.sum().real), 0.0)

    def fits(self, found: PhasedResult) -> bool:
        """Whether it and all voltages allow a power flow."""
        net = self.state.site.feeder
        total = found.source_kva.sum()
        supply = self.model.supplies[self.source]
        limited = self.model.limited & supply.flow.measured_lit
        v_pu = supply.flow.v_pu(found.v)[limited]
        # Limits give way to the voltages at rest, as those of plans do.
        at_rest_pu = np.sqrt(supply.slopes.u_0)[limited]
        return bool(
            total.real <= self.most_kw
            and abs(total.imag) <= self.most_kvar
            and np.abs(found.source_kva).max() <= self.phase_kva + TOLERANCE_KVA
            and (v_pu >= np.minimum(net.v_min_ac_pu, at_rest_pu) - REST_PU).all()
            and (v_pu <= np.maximum(net.v_max_ac_pu, at_rest_pu) + REST_PU).all()
        )

    def carried(self, served: Flags, before: Schedule | None) -> Schedule | None:
        """A supply schedule with power of batteries, None if a phase does not carry it.

        What batteries took before for the feeder is where the search for what they take begins. No
        power flow is needed where half of what is drawn more than before is beyond it already.
        """
        state, batteries = self.state, self.state.site.batteries
        own = state.own_kw(served)
        given_kw, wanted_kvar = self.behind_meters(served, own)
        taken_kvar = np.zeros(len(batteries)) if before is None else before.taken_kvar
        found: PhasedResult | None = None
        for _ in range(MOST_FLOWS):
            most_kvar = np.sqrt(np.maximum(batteries.s_max_kva**2 - given_kw**2, 0.0))
            given_kvar = np.clip(wanted_kvar - taken_kvar, -most_kvar, most_kvar)
            load_kw, pv, given = state.load_kw * served, (own, 0.0 * own), (given_kw, given_kvar)
            drawn = self.model.powers(self.source, load_kw, pv, given, state.taken_kw)
            if before is not None and self._far_beyond(before, drawn[0]):
                return None
            found = self.flow(*drawn)
            if found is None:
                return None
            more_kvar = self._taken_kvar(found, given_kvar + most_kvar)
            room_kw = np.where(self.others, state.charge_max_kw + given_kw, 0.0)
            more_kw = in_proportion(self.surplus_kw(found) / AIM, room_kw)
            if not (more_kvar.any() or more_kw.any()):
                break
            taken_kvar = wanted_kvar - given_kvar + more_kvar
            given_kw = given_kw - more_kw
        if found is None or not self.fits(found):
            return None
        return Schedule(served, own, given, taken_kvar, drawn[0], found)

    def _far_beyond(self, before: Schedule, drawn_kw: Floats) -> bool:
        """Whether half of what is drawn more than before is beyond its active power."""
        more_kw = self.model.supplies[self.source].slopes.former_p.real @ (
            drawn_kw - before.drawn_kw
        )
        half_kw = before.found.source_kva.real + 0.5 * more_kw
        most_kw = self.phase_kva + TOLERANCE_KVA
        return bool(half_kw.sum() > self.most_kw or half_kw.max() > most_kw)

    def _taken_kvar(self, found: PhasedResult, room_kvar: Floats) -> Floats:
        """Reactive power that batteries on one phase take of it, as they have room, (B,).

        It is what the feeder gives it on that phase beyond its rating, and a little more.
        """
        beyond = np.abs(found.source_kva) > self.phase_kva + TOLERANCE_KVA
        least = np.sqrt(np.maximum((AIM * self.phase_kva) ** 2 - found.source_kva.real**2, 0.0))
        surplus_kvar = np.where(beyond, -found.source_kva.imag - least, 0.0)
        coils = np.array([row.coils for row in self._connections(self.state.site.batteries)])
        taken = np.zeros(len(coils))
        for phase, kvar in zip(PHASES, surplus_kvar, strict=True):
            taken += in_proportion(kvar, np.where((coils == phase) & self.others, room_kvar, 0.0))
        return taken

    def behind_meters(self, served: Flags, own: Floats) -> Floats:
        """Power that other batteries give to what is served on their own coils, (2, B)."""
        state, site = self.state, self.state.site
        load_kw = state.load_kw * served
        own_kw = np.bincount(site.owner, own, len(load_kw))
        kw = np.stack([load_kw - own_kw, load_kw * site.customers.q_per_p], axis=1)
        rows = self._connections(site.batteries)
        left = {(row.bus, row.coils): np.zeros(2) for row in rows}
        for at, power in zip(self._connections(site.customers), kw, strict=True):
            if (at.bus, at.coils) in left:
                left[at.bus, at.coils] = left[at.bus, at.coils] + power
        given = np.zeros((2, len(rows)))
        for b in np.flatnonzero(self.others):
            row, s_max_kva = rows[b], float(site.batteries.s_max_kva[b])
            need = left[row.bus, row.coils]
            active_kw = min(max(float(need[0]), 0.0), float(state.discharge_max_kw[b]))
            room = np.sqrt(max(s_max_kva**2 - active_kw**2, 0.0))
            given[:, b] = active_kw, np.clip(need[1], -room, room)
            left[row.bus, row.coils] = need - given[:, b]
        return given

    def _connections(self, table: Any) -> list[PhaseConnection]:
        """Phases of the items of a table."""
        phases = self.state.site.phases
        return [phases.connection(str(name)) for name in table.id]

    def dispatch(self, schedule: Schedule) -> Carried:
        """The dispatch of a schedule, with what it gives itself."""
        state, total = self.state, schedule.found.source_kva.sum()
        kw = float(np.clip(total.real, self.least_kw, self.most_kw))
        given = np.array(schedule.given)
        kvar = {}
        if self.battery is not None:
            given[:, self.battery] = kw, total.imag
        for kind, forms in state.formers.items():
            taken_kw = np.where(forms, -kw, state.taken_kw[kind])
            state = replace(state, taken_kw=state.taken_kw | {kind: taken_kw})
            kvar[kind] = np.where(forms, total.imag, 0.0)
        own = schedule.own
        pv = own, 0.0 * own, 0.0 * own
        found = dispatch_of(state, schedule.served, pv, -given[0], given[1], 0.0, kvar)
        return replace(found, surplus_kw=self.surplus_kw(schedule.found))


@dataclass(frozen=True, eq=False)
class Schedule:
    """A supply schedule that is carried, with its power flow.

    Own use of PV systems (P,), power of batteries (B,) twice, what they take for the feeder (B,),
    and what assets draw (D,).
    """

    served: Flags
    own: Floats
    given: tuple[Floats, Floats]
    taken_kvar: Floats
    drawn_kw: Floats
    found: PhasedResult
