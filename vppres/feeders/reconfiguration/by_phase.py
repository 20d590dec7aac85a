"""Power flow by phase of a feeder in any state of its branches: closed loops, parts, islands."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from vppres.core.arrays import Complexes, Flags, Floats
from vppres.feeders.reconfiguration.meshed import PartFlow
from vppres.physics.phased_loading import Loadings
from vppres.physics.phased_sources import assets_of, farthest, flow_of_parts, measured_at
from vppres.physics.phases import NoPhasedSolutionError, PhasedFlow
from vppres.scenario.configuration import Branches
from vppres.scenario.phases import PHASES, PhaseLine, PhaseTransformer
from vppres.scenario.scenario import Scenario


class FlowInStates:
    """Solver of the parts of a feeder with phases in any state of its branches.

    A branch has all of its phases. Its current is that of the fullest; of a transformer it is a
    share of its rating.

    ``formers`` are devices that can hold an island.
    """

    def __init__(self, day: Scenario, formers: Iterable[str], p_kw: Floats, q_kvar: Floats) -> None:
        self.day = day
        self.branches = Branches.of(day)
        self.start, self.end = self.branches.ends.T
        self.assets = assets_of(day)
        self.p_kw, self.q_kvar = p_kw, q_kvar
        phases, index = day.phases, day.network.bus_index
        self._bus = {row.bus: index[row.at] for row in phases.buses}
        self._former = {self._bus[phases.connection(one).bus]: one for one in formers}
        self._at_bus = measured_at(phases, day.network)
        self._branch = {
            frozenset(ends): branch for branch, ends in enumerate(self.branches.ends.tolist())
        }
        self._flows: dict[tuple[bytes, bytes, int], PhasedFlow] = {}
        most_a = np.append(self.branches.rating_a, np.inf)
        for unit in phases.transformers:
            most_a[self._of(unit)] = 1.0
        for line in phases.lines:
            most_a[self._of(line)] = line.i_max_a if np.isfinite(line.i_max_a) else np.inf
        self.i_max_a = most_a[:-1]

    def solve(
        self, inside: Flags, closed: Flags, reference: int, p_kw: Floats, q_kvar: Floats
    ) -> PartFlow | None:
        """Flow of a part, None if none is found; parameters as those of ``MeshedFlow.solve``.

        Powers are those of devices: what buses are given besides is not looked at.
        """
        former = self._former[reference] if reference else ""
        flow = self._flow(inside, closed, reference, former)
        p, q = self.p_kw.copy(), self.q_kvar.copy()
        own_kva = 0j
        if former:
            device = self.assets.index(former)
            own_kva = complex(p[device], q[device])
            p[device] = q[device] = 0.0
        try:
            found = flow.solve(p, q)
        except NoPhasedSolutionError:
            return None
        v_pu = farthest(flow.v_pu(found.v), self._at_bus, self.day.network.n_buses)
        fullest_kva = float(len(PHASES) * np.abs(found.source_kva).max())
        return PartFlow(
            np.where(inside, v_pu, np.nan),
            self._currents(flow, found.v),
            complex(found.source_kva.sum()) + own_kva,
            fullest_kva,
        )

    def _flow(self, inside: Flags, closed: Flags, reference: int, former: str) -> PhasedFlow:
        """The flow of a part in a state, made once."""
        key = inside.tobytes(), closed.tobytes(), reference
        if key not in self._flows:
            net = self.day.network
            of_bus = {bus: int(inside[at]) for bus, at in self._bus.items()}
            voltages = net.v_slack_pu, net.v_min_pu, net.v_max_pu
            tables = self.branches.phases_with(closed)
            self._flows[key] = flow_of_parts(tables, self.assets, of_bus, ((1, former),), voltages)
        return self._flows[key]

    def _of(self, row: PhaseLine | PhaseTransformer) -> int:
        """Branch of a line or transformer; the one behind all for one within a bus."""
        ends = frozenset((self._bus[row.from_bus], self._bus[row.to_bus]))
        return self._branch.get(ends, -1)

    def _currents(self, flow: PhasedFlow, v: Complexes) -> Floats:
        """Currents of the branches, (E,)."""
        found = np.zeros(len(self.branches) + 1)
        at = flow.phases.node_index
        for line in flow.phases.lines:
            above, below = (
                v[[at[bus, phase] for phase in line.phases]] for bus in (line.from_bus, line.to_bus)
            )
            own = np.ix_(line.phases, line.phases)
            largest = float(np.abs(np.linalg.solve(line.z_ohm[own], above - below)).max())
            found[self._of(line)] = max(found[self._of(line)], largest)
        shares = iter(Loadings.of(flow.phases).at(v)[::-1])
        for unit in flow.phases.transformers[::-1]:
            for _ in unit.to_coils.split():
                found[self._of(unit)] = max(found[self._of(unit)], float(next(shares)))
        return found[:-1]
