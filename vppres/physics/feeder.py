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
    flow_of_former,
    flow_of_grid,
    labels_by_source,
    measured_at,
)
from vppres.physics.phases import PhasedFlow, PhasedResult
from vppres.physics.places import Places
from vppres.physics.powerflow import ACPowerFlow, ACResult
from vppres.scenario.phases import PHASES, Phases
from vppres.scenario.scenario import Scenario

TOLERANCE_KVA = 1e-3
"""Residual of a solved flow: a tenth of a billionth of a volt is a watt on a stiff feeder."""


class FlowByPhase:
    """Power flow of a feeder with phases.

    Parameters
    ----------
    scenario : Scenario
        Its network as a tree of buses, and its devices.
    phases : Phases
        Its phases.
    """

    def __init__(self, scenario: Scenario, phases: Phases) -> None:
        self._scenario = scenario
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

        Parameters
        ----------
        p_kw, q_kvar : array, shape (places,)
            What loads draw at their rated voltage, and what others give.
        reference : int, optional
            Place of the device that is the source, 0 for the grid.

        Raises
        ------
        NoSolutionError
            If there is no solution.
        """
        flow = self._source(reference)
        p, q = -np.asarray(p_kw, float), -np.asarray(q_kvar, float)
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
            net, phases, assets = self._network, self._phases, self._assets
            voltages = net.v_slack_pu, net.v_min_pu, net.v_max_pu
            self._sources[reference] = (
                flow_of_former(phases, assets, assets[reference - 1], *voltages)
                if reference
                else flow_of_grid(phases, assets, net.v_slack_pu)
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
