"""A phased feeder as it really is: power flow by phase, and an island whose former is unbalanced.

The former takes what each phase lacks. Where one of its phases is beyond its rating, customers on
that phase are shed, those whose service is worth least for what they take off it first.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vppres.core.arrays import Complexes, Flags, Floats
from vppres.kinds.table import units_of
from vppres.physics.phased_loading import Loadings
from vppres.physics.phased_sources import (
    assets_of,
    buses_of,
    farthest,
    flow_of_former,
    flow_of_grid,
    measured_at,
)
from vppres.physics.phases import NoPhasedSolutionError, PhasedFlow, PhasedResult
from vppres.physics.powerflow import ACPowerFlow, ACResult, NoSolutionError
from vppres.plant.formers import Former, FormingBatteries
from vppres.plant.island import CUT_MARGIN_KW, Balance, IslandPlant, Settled, part_of
from vppres.plant.plant import BatteryState, Plant, Powers, Realised
from vppres.scenario.scenario import Scenario

TOLERANCE_KVA = 1e-3
"""Residual of a solved flow: a tenth of a billionth of a volt is a watt on a stiff feeder."""


@dataclass(frozen=True, eq=False)
class PhasedACResult(ACResult):
    """A flow with what it says of phases.

    Parameters
    ----------
    v_node_pu : array, shape (m,)
        Voltages that have limits, of nodes or between them.
    former_kva : array of complex, shape (3,)
        What the source gives on each phase, its own set-point included.
    unbalance : float
        Largest unbalance factor of any bus with three phases.
    loading, loading_at : float and str
        Largest current of a phase as a share of the rating of its line or transformer, and where.
    """

    v_node_pu: Floats = field(default_factory=lambda: np.zeros(0))
    former_kva: Complexes = field(default_factory=lambda: np.zeros(3, dtype=complex))
    unbalance: float = np.nan
    loading: float = np.nan
    loading_at: str = ""


class PhasedPlant(Plant):
    """The actual day of a phased scenario: injections are those of its assets, (D,), not of buses.

    Customers come first, then PV systems, then batteries.
    """

    def __init__(self, *args: object, **options: object) -> None:
        super().__init__(*args, **options)  # type: ignore[arg-type]
        s = self.scenario
        C, P, B = len(s.customers), len(s.pv), len(s.batteries)
        self._place = _place(s)
        self._customer_bus = np.arange(C)
        self._pv_bus = C + np.arange(P)
        self.battery_bus = C + P + np.arange(B)
        first = self.n_places = C + P + B
        for kind, units in units_of(s).items():
            self.unit_bus[kind] = first + np.arange(len(units))
            first = self.n_places = first + len(units)

    def at_buses(self, realised: Realised) -> tuple[Floats, Floats]:
        """Net injections of the network's buses, (N,) each."""
        return self._place @ realised.p_injection_kw, self._place @ realised.q_injection_kvar


def _place(scenario: Scenario) -> Any:
    """Powers of the network's buses of those of the assets, (N, D)."""
    return scenario.network.place(buses_of(scenario))


class PhasedACFlow(ACPowerFlow):
    """Power flow of a phased scenario for injections of its assets.

    Parameters
    ----------
    scenario : Scenario
        Its phases, and where its assets are connected.
    """

    def __init__(self, scenario: Scenario) -> None:
        phases = scenario.phases
        assert phases is not None
        self.network = scenario.network
        self._last = {}
        b = scenario.batteries
        assets = assets_of(scenario)
        net = scenario.network
        self.grid = flow_of_grid(phases, assets, net.v_slack_pu)
        self.before_batteries = len(scenario.customers) + len(scenario.pv)
        limits = net.v_min_pu, net.v_max_pu
        self.islands = {
            self.before_batteries + int(i): flow_of_former(phases, assets, b, int(i), *limits)
            for i in np.flatnonzero(scenario.formers)
        }
        self._place = _place(scenario)
        self._at_bus = measured_at(phases, net)
        self.loadings = Loadings.of(phases)

    @property
    def tolerance_kva(self) -> float:
        """Power that a solved flow may miss."""
        return TOLERANCE_KVA

    def solve(self, p_kw: ArrayLike, q_kvar: ArrayLike, reference: int = 0) -> PhasedACResult:
        """The flow of injections of the assets, (D,) each.

        Parameters
        ----------
        p_kw, q_kvar : array
            Generation is positive.
        reference : int, optional
            0 for the grid, else the place of the battery that holds the island.

        Raises
        ------
        NoSolutionError
            If there is no solution.
        """
        flow = self.grid if reference == 0 else self.islands[reference]
        p, q = -np.asarray(p_kw, float), -np.asarray(q_kvar, float)
        own = 0.0j
        if reference:
            own = -complex(p[reference], q[reference])
            p[reference] = q[reference] = 0.0
        try:
            found = flow.solve(p, q)
        except NoPhasedSolutionError as error:
            raise NoSolutionError(str(error), error.share) from None
        return self._read(flow, found, p, q, own)

    def _read(
        self, flow: PhasedFlow, found: PhasedResult, p: Floats, q: Floats, own: complex
    ) -> PhasedACResult:
        """Voltages by bus, flows of the tree without losses, and what the source gives."""
        net = self.network
        v_node = flow.v_pu(found.v)
        p_flow, q_flow = (net.downstream @ (self._place @ power) for power in (p, q))
        total = found.source_kva.sum()
        loading = self.loadings.at(found.v)
        fullest = int(loading.argmax()) if len(loading) else None
        return PhasedACResult(
            v_pu=farthest(v_node, self._at_bus, net.n_buses),
            p_from_kw=p_flow,
            q_from_kvar=q_flow,
            p_to_kw=p_flow,
            q_to_kvar=q_flow,
            losses_kw=found.losses_kw,
            p_slack_kw=float(total.real - own.real),
            q_slack_kvar=float(total.imag - own.imag),
            v_node_pu=v_node,
            former_kva=found.source_kva,
            unbalance=float(flow.unbalance(found.v).max(initial=0.0)),
            loading=np.nan if fullest is None else float(loading[fullest]),
            loading_at="" if fullest is None else self.loadings.names[fullest],
        )


class PhasedIslandPlant(IslandPlant):
    """An island whose former carries each phase's own rest."""

    flow: PhasedACFlow

    def __init__(self, plant: Plant, flow: PhasedACFlow) -> None:
        super().__init__(plant, flow)
        self.formers = plant.scenario.formers
        self._others_help = True

    def _with_former(
        self, t: int, planned: Realised, state: BatteryState, former: Former
    ) -> Settled:
        """The step with other batteries discharging beyond their set-points, or without them.

        What relieves one phase may overload another, and then more customers are shed for it.
        """
        helped = super()._with_former(t, planned, state, former)
        if not (helped.dark or helped.shed.any()):
            return helped
        self._others_help = False
        try:
            alone = super()._with_former(t, planned, state, former)
        finally:
            self._others_help = True
        return max(helped, alone, key=self._supplied)

    def _supplied(self, settled: Settled) -> tuple[int, ...]:
        """How many customers of each tier are on, those of the first tier first."""
        s = self.plant.scenario
        on = s.customers.tier[settled.realised.served]
        return (int(not settled.dark), *(int((on == tier).sum()) for tier in s.tiers))

    def _excess_kva(self, former: Former, powers: Powers, ac: ACResult) -> float:
        """Power of the former's worst phase beyond a third of its rating, times three.

        What is cut on a phase comes off that phase alone, so its excess counts for all three.
        """
        assert isinstance(former, FormingBatteries)
        rating = float(self.plant.scenario.batteries.s_max_kva[former.reference])
        return float(3.0 * np.abs(_former_kva(ac)).max() - rating)

    def _on_phase(self, phase: int) -> Flags:
        """Whether each asset has a coil on a phase, (D,)."""
        flow = self.flow.grid
        nodes = [i for i, (_, each) in enumerate(flow.phases.nodes) if each == phase]
        coils = np.abs(flow.coils[:, nodes]).sum(axis=1) > 0
        return np.isin(np.arange(len(flow.assets)), flow.asset[coils])

    def _order(self, t: int, powers: Powers, ac: ACResult) -> list[int]:
        """Customers in the order in which they are shed; others than those on the phase last."""
        on_phase = self._on_phase(_worst_phase(ac))
        return sorted(super()._order(t, powers, ac), key=lambda c: not on_phase[c])

    def _protective_action(
        self, t: int, powers: Powers, found: Balance, state: BatteryState
    ) -> Powers | None:
        """Relieve an overloaded phase: less of what feeds it, or other batteries on it.

        Then customers on it are shed. Where none is left, everything but the former stops.
        """
        if abs(found.left_kw) > self.tolerance_kw:
            return super()._protective_action(t, powers, found, state)
        worst = _worst_phase(found.ac)
        on_phase = self._on_phase(worst)
        if _former_kva(found.ac)[worst].real < 0.0:
            less = self._without(powers, on_phase)
            if less is not None:
                return less
        elif found.excess_kvar > 0.0:
            room_kw = self._others_room_kw(powers, state, ~found.former.batteries, found.ac)
            there_kw = self._by_phase_kw(room_kw)[worst]
            if there_kw.sum() > self.tolerance_kw:
                need_kw = found.excess_kvar / 3.0 + CUT_MARGIN_KW
                given_kw = room_kw * (there_kw > 0.0) * min(1.0, need_kw / there_kw.sum())
                return replace(powers, battery_kw=powers.battery_kw - given_kw)
        everything = np.ones(len(self.flow.grid.assets), dtype=bool)
        return super()._protective_action(t, powers, found, state) or self._without(
            powers, everything
        )

    def _others_room_kw(
        self, powers: Powers, state: BatteryState, others: Flags, ac: ACResult
    ) -> Floats:
        """Further discharge of others, at most what the former gives on a phase and in all."""
        if not self._others_help:
            return np.zeros(len(others))
        room_kw = super()._others_room_kw(powers, state, others, ac)
        each_kw = self._by_phase_kw(room_kw)
        former_kw = _former_kva(ac).real
        given_kw = np.maximum(former_kw, 0.0)
        share = np.divide(given_kw, each_kw.sum(axis=1), where=each_kw.any(axis=1), out=np.ones(3))
        least = np.where(each_kw > 0.0, np.minimum(share, 1.0)[:, None], 1.0).min(axis=0)
        room_kw = room_kw * least
        return np.asarray(part_of(room_kw, max(float(former_kw.sum()), 0.0)))

    def _by_phase_kw(self, battery_kw: Floats) -> Floats:
        """Powers of batteries on each of their phases, in equal parts, (3, B)."""
        first = self.flow.before_batteries
        of_batteries = slice(first, first + len(battery_kw))
        on = np.array([self._on_phase(phase)[of_batteries] for phase in range(3)])
        return np.asarray(on * battery_kw / np.maximum(on.sum(axis=0), 1))

    def _without(self, powers: Powers, which: Flags) -> Powers | None:
        """Powers without PV export and discharge of some assets; None if they have neither."""
        s = self.plant.scenario
        first = len(s.customers)
        ends = first + len(s.pv), first + len(s.pv) + len(s.batteries)
        pv, batteries = which[first : ends[0]], which[ends[0] : ends[1]] & ~self.formers
        export = np.where(pv, powers.pv_export_kw, 0.0)
        feeding = np.where(batteries, np.minimum(powers.battery_kw, 0.0), 0.0)
        if not (export.any() or feeding.any()):
            return None
        return replace(
            powers,
            pv_export_kw=powers.pv_export_kw - export,
            pv_curtailed_kw=powers.pv_curtailed_kw + export,
            pv_q_kvar=np.where(pv, 0.0, powers.pv_q_kvar),
            battery_kw=powers.battery_kw - feeding,
            batt_q_kvar=np.where(batteries, 0.0, powers.batt_q_kvar),
        )


def _former_kva(ac: ACResult) -> Complexes:
    """Complex power of the former on each phase, (3,)."""
    assert isinstance(ac, PhasedACResult)
    return ac.former_kva


def _worst_phase(ac: ACResult) -> int:
    """The phase of the former with most power."""
    return int(np.argmax(np.abs(_former_kva(ac))))
