"""The state of a phased feeder with the grid and without control: voltages, loadings, unbalance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Complexes, Floats
from vppres.core.errors import VerificationError
from vppres.core.units import VA_PER_KVA
from vppres.feeders.closeness import extreme_steps_by_phase
from vppres.physics.phased_loading import Loadings
from vppres.physics.phased_sources import assets_of, flow_of_grid
from vppres.physics.phases import PhasedFlow
from vppres.scenario.phases import Phases
from vppres.scenario.scenario import Scenario

AGREEMENT_KVA = 1e-3
"""Power of a node that currents may leave open: the watt that a plan's check allows."""


@dataclass(frozen=True)
class Extreme:
    """A largest or smallest value, and where and when it is."""

    value: float
    at: str
    time: str


@dataclass(frozen=True)
class PhasedCheck:
    """Power flow of the three phases without control, and whether currents add up."""

    #: Steps of extreme demand and generation, and those of them without a solution.
    steps: int
    unsolved: int
    #: Largest power that the currents of all devices leave open at a node; None without a step.
    mismatch_kva: float | None
    #: Voltages with limits, and those of them that are outside the AC limits in any step.
    nodes: int
    nodes_outside: int
    #: Extremes of voltages, of loadings as shares of the ratings, and of the unbalance factor.
    v_min_pu: Extreme | None
    v_max_pu: Extreme | None
    loading: Extreme | None
    unbalance: Extreme | None

    @property
    def agrees(self) -> bool:
        """Whether no node has more power left open than the tolerance explains."""
        return self.mismatch_kva is None or self.mismatch_kva <= AGREEMENT_KVA

    def __str__(self) -> str:
        if self.mismatch_kva is None:
            return "No power flow by phase: with all customers served there is no solution."
        words = "balances" if self.agrees else "does not balance"
        found = [
            f"The power flow by phase {words} all nodes within {self.mismatch_kva:.1g} kVA in "
            f"{self.steps - self.unsolved} steps of extreme demand and generation, with the grid "
            "and without control.",
            f"Voltages outside the AC limits: {self.nodes_outside} of {self.nodes} nodes.",
        ]
        if self.unsolved:
            found.append(f"Steps without a solution: {self.unsolved} of {self.steps}.")
        for name, extreme, form in (
            ("Lowest voltage", self.v_min_pu, "{:.4f} pu"),
            ("Highest voltage", self.v_max_pu, "{:.4f} pu"),
            ("Largest loading of a phase", self.loading, "{:.0%}"),
            ("Largest unbalance factor", self.unbalance, "{:.2%}"),
        ):
            if extreme is not None:
                value = form.format(extreme.value)
                found.append(f"{name}: {value}, {extreme.at}, {extreme.time}.")
        return "\n- ".join(found)


def phased_check(scenario: Scenario, phases: Phases) -> PhasedCheck:
    """Solve the steps of largest and least demand and generation by phase."""
    net = scenario.network
    flow = flow_of_grid(phases, assets_of(scenario), net.v_slack_pu)
    loadings = Loadings.of(phases)
    steps = [*extreme_steps_by_phase(scenario)]
    names = [f"phase {phase} of bus {bus}" for bus, phase in flow.measured[0]]
    complete = [f"bus {bus}" for bus in flow.complete[0]]
    mismatch, v_pu, loading, unbalance = [], [], [], []
    solved = []
    for t, p_kw, q_kvar in steps:
        try:
            v = flow.solve(p_kw, q_kvar).v
        except VerificationError:
            continue
        solved.append(scenario.grid.times[t].tz_convert(scenario.grid.zone))
        mismatch.append(_mismatch_kva(flow, p_kw, q_kvar, v))
        v_pu.append(flow.v_pu(v))
        loading.append(loadings.at(v))
        unbalance.append(flow.unbalance(v))
    outside = np.zeros(len(names), dtype=bool)
    for each in v_pu:
        outside |= (each < net.v_min_ac_pu) | (each > net.v_max_ac_pu)

    def extreme(values: list[Floats], sign: float, at: list[str]) -> Extreme | None:
        if not values or not at:
            return None
        table = np.stack(values)
        row, place = np.unravel_index(int((sign * table).argmax()), table.shape)
        when = f"{solved[int(row)]:%Y-%m-%d %H:%M}"
        return Extreme(float(table[row, place]), at[int(place)], when)

    return PhasedCheck(
        steps=len(steps),
        unsolved=len(steps) - len(solved),
        mismatch_kva=max(mismatch, default=None),
        nodes=len(names),
        nodes_outside=int(outside.sum()),
        v_min_pu=extreme(v_pu, -1.0, names),
        v_max_pu=extreme(v_pu, 1.0, names),
        loading=extreme(loading, 1.0, list(loadings.names)),
        unbalance=extreme(unbalance, 1.0, complete),
    )


def _mismatch_kva(flow: PhasedFlow, p_kw: Floats, q_kvar: Floats, v: Complexes) -> float:
    """Largest power that currents of lines, transformers, shunts and assets leave at a node."""
    across = flow.coils @ v
    drawn = np.conj(flow.drawn_va(p_kw, q_kvar, across) / across)
    left = (flow.y @ v + flow.coils.T @ drawn)[flow.free]
    return float((np.abs(v[flow.free] * left) / VA_PER_KVA).max(initial=0.0))
