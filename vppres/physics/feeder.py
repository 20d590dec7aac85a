"""The power flow of a feeder, by phase where it has phases, for powers at its places."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from vppres.core.arrays import Complexes, Flags, Floats, Wholes
from vppres.physics.phased_loading import Loadings
from vppres.physics.phased_sources import (
    assets_of,
    farthest,
    flow_of_parts,
    labels_by_source,
    measured_at,
)
from vppres.physics.phases import PhasedFlow, PhasedResult
from vppres.physics.places import Places
from vppres.physics.powerflow import ACPowerFlow, ACResult
from vppres.scenario.network import Network
from vppres.scenario.phases import PHASES, Phases
from vppres.scenario.scenario import Scenario

TOLERANCE_KVA = 1e-3
"""Residual of a solved flow: a tenth of a billionth of a volt is a watt on a stiff feeder."""


class FlowByPhase:
    """Power flow of a feeder with phases.

    Beyond the ``buses`` of a part of the feeder, (N,), nothing draws or gives.
    """

    def __init__(self, scenario: Scenario, phases: Phases, buses: Flags | None = None) -> None:
        self._scenario = scenario
        self._buses = np.ones(scenario.network.n_buses, dtype=bool) if buses is None else buses
        at = scenario.network.bus_index
        self._of_bus = {row.bus: int(self._buses[at[row.at]]) for row in phases.buses}
        self._phases = phases
        self._network = scenario.network
        self._assets = assets_of(scenario)
        self._sources: dict[int, PhasedFlow] = {}
        self._places = Places.of(scenario)
        self._at_bus = measured_at(phases, self._network)
        self._loadings: dict[int, Loadings] = {}

    @property
    def tolerance_kva(self) -> float:
        """Power that a solved flow may miss."""
        return TOLERANCE_KVA

    @property
    def found(self) -> dict[int, Complexes]:
        """None: every solve starts at no load."""
        return {}

    def go_on_from(self, found: Mapping[int, Complexes]) -> None:
        """Every solve starts at no load."""

    def solve(self, p_kw: ArrayLike, q_kvar: ArrayLike, reference: int = 0) -> ACResult:
        """The flow of net injections at the places, generation positive.

        Loads draw this at their rated voltage. ``reference`` is the place of the source, 0 for the
        grid.

        Raises
        ------
        NoSolutionError
            If there is no solution.
        """
        flow = self._source(reference)
        inside = self._buses[self._places.bus]
        p, q = (np.where(inside, -np.asarray(each, float), 0.0) for each in (p_kw, q_kvar))
        own = -complex(p[reference], q[reference])
        p[reference] = q[reference] = 0.0
        if reference not in self._loadings:
            self._loadings[reference] = Loadings.of(flow.phases)
        found = flow.solve(p[1:], q[1:])
        return self._read(flow, self._loadings[reference], found, p, q, own)

    def dead(self) -> ACResult:
        """The result without any source: NaN, and no flow."""
        net, labels = self._network, labels_by_source(self._scenario)[1]
        none, v_pu = np.zeros(net.n_lines), np.full(net.n_buses, np.nan)
        source = np.full(len(PHASES), np.nan, dtype=complex)
        v_node_pu = np.full(len(labels), np.nan)
        flows = none, none, none, none, 0.0, 0.0, 0.0
        return ACResult(v_pu, *flows, v_node_pu, source, labels, PHASES)

    def on_phase(self, places: Wholes) -> Flags:
        """Phases on which devices at these places have a coil, (3, n)."""
        words = [self._phases.connection(self._assets[place - 1]).coils for place in places]
        return np.array([[phase in each for each in words] for phase in PHASES])

    def _source(self, reference: int) -> PhasedFlow:
        """The flow whose source is the device at a place, or the grid."""
        if reference not in self._sources:
            net, assets = self._network, self._assets
            voltages = net.v_slack_pu, net.v_min_pu, net.v_max_pu
            former = assets[reference - 1] if reference else ""
            self._sources[reference] = flow_of_parts(
                self._phases, assets, self._of_bus, ((1, former),), voltages
            )
        return self._sources[reference]

    def _read(
        self,
        flow: PhasedFlow,
        loadings: Loadings,
        found: PhasedResult,
        p: Floats,
        q: Floats,
        own: complex,
    ) -> ACResult:
        """Voltages by bus, flows of the tree without losses, and what the source gives."""
        net = self._network
        v_node = flow.v_pu(found.v)
        p_flow, q_flow = (net.downstream @ self._places.at_buses(power) for power in (p, q))
        total = found.source_kva.sum()
        loading = loadings.at(found.v)
        fullest = int(loading.argmax()) if len(loading) else None
        return ACResult(
            v_pu=farthest(v_node, self._at_bus, net.n_buses),
            p_from_kw=p_flow,
            q_from_kvar=q_flow,
            p_to_kw=p_flow,
            q_to_kvar=q_flow,
            losses_kw=found.losses_kw,
            p_slack_kw=float(total.real - own.real),
            q_slack_kvar=float(total.imag - own.imag),
            v_node_pu=v_node,
            nodes=flow.phases.measured,
            source_kva=found.source_kva,
            phases=PHASES,
            unbalance=float(flow.unbalance(found.v).max(initial=0.0)),
            loading=np.nan if fullest is None else float(loading[fullest]),
            loading_at="" if fullest is None else loadings.names[fullest],
        )


class FlowOfPart(ACPowerFlow):
    """Power flow of a part of a balanced feeder."""

    def __init__(self, network: Network, buses: Flags, lines: Flags) -> None:
        super().__init__(network.drawing_inside(buses, lines))
        self.buses = buses
        self.lines = lines

    def solve(self, p_kw: ArrayLike, q_kvar: ArrayLike, reference: int = 0) -> ACResult:
        """Power flow of the injections inside the part."""
        p, q = (np.where(self.buses, np.asarray(each, float), 0.0) for each in (p_kw, q_kvar))
        return super().solve(p, q, reference)


PowerFlow = ACPowerFlow | FlowByPhase
"""AC power flow for powers at a feeder's places (:class:`vppres.physics.places.Places`)."""


def power_flows(scenario: Scenario) -> tuple[PowerFlow, PowerFlow]:
    """The flow of a scenario's feeder with grid, and with what islands have of it.

    It is the same one where no shunt opens in islands and no tap is another there.
    """
    net, phases = scenario.network, scenario.phases
    if phases:
        by_phase = FlowByPhase(scenario, phases)
        islanded = phases.islanded
        return by_phase, by_phase if islanded is phases else FlowByPhase(scenario, islanded)
    balanced = ACPowerFlow(net)
    return balanced, balanced if net.islanded is net else ACPowerFlow(net.islanded)


def flow_of_part(scenario: Scenario, buses: Flags, lines: Flags, island: bool) -> PowerFlow:
    """Power flow of a part: of the whole feeder, where nothing outside the part draws or gives.

    The grid does not reach an ``island``.
    """
    if scenario.phases:
        phases = scenario.phases.islanded if island else scenario.phases
        return FlowByPhase(scenario, phases, buses)
    network = scenario.network.islanded if island else scenario.network
    return FlowOfPart(network, buses, lines)
