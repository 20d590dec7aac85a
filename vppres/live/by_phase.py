"""Power flow of set-points on each phase of a phased feeder, and what is nearest its limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from vppres.day.recorder import StepRecord
from vppres.scenario.formers import former_kva
from vppres.scenario.phases import PHASES
from vppres.scenario.scenario import Scenario

GRID = "grid"


@dataclass(frozen=True)
class Nearest:
    """Quantity nearest to its limit: a phase of the former, or the voltage of a bus."""

    phase: str  #: a phase, or a pair of phases
    at: str  #: the device, or the bus
    share: float  #: of its limit; a voltage's is 0 in the middle of its limits and 1 at one of them


@dataclass(frozen=True, eq=False)
class ByPhase:
    """Result of an AC power flow of the set-points on each phase."""

    nodes: pd.Series[float]  #: voltages in pu by bus and phase, of pairs of phases on three wires
    source: str  #: ``grid``, or the battery or generating set that holds the island
    source_kva: pd.Series[float]  #: what it gives on each phase
    rating_kva: float | None  #: what that device can give on each phase; None of the grid
    unbalance_max: float  #: largest unbalance factor of any bus with three phases
    nearest: Nearest  #: what is nearest its limit

    @classmethod
    def of(cls, scenario: Scenario, step: StepRecord) -> ByPhase | None:
        """Power flow of a step that was decided; None without phases, and without power."""
        if not scenario.phases or np.isnan(step.nodes["v_ac_pu"]).all():
            return None
        labels = [step.nodes["bus"], step.nodes["phase"]]
        index = pd.MultiIndex.from_arrays(labels, names=["bus", "phase"])
        nodes = pd.Series(step.nodes["v_ac_pu"], index, name="v_ac_pu").dropna()
        former = str(step.steps["former"])
        column = "former" if former else "import"
        kva = pd.Series({phase: float(step.steps[f"{column}_{phase}_kva"]) for phase in PHASES})
        source, rating_kva = former or GRID, None
        if former:
            rating_kva = former_kva(scenario, former) / len(PHASES)
        nearest = _nearest(scenario, nodes)
        if rating_kva and kva.max() / rating_kva > nearest.share:
            nearest = Nearest(str(kva.idxmax()), source, float(kva.max() / rating_kva))
        unbalance = float(step.steps["unbalance_max"])
        return cls(nodes, source, kva, rating_kva, unbalance, nearest)

    @property
    def v_pu(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest voltage of each phase, then of each pair of phases."""
        by_phase = self.nodes.groupby(level="phase")
        limits = {str(phase): (float(v_pu.min()), float(v_pu.max())) for phase, v_pu in by_phase}
        return dict(sorted(limits.items(), key=lambda each: (len(each[0]), each[0])))


def _nearest(scenario: Scenario, nodes: pd.Series[float]) -> Nearest:
    """The voltage that is nearest a limit; the grid's own bus has none."""
    net, phases = scenario.network, scenario.phases
    middle = (net.v_max_ac_pu + net.v_min_ac_pu) / 2.0
    half = (net.v_max_ac_pu - net.v_min_ac_pu) / 2.0
    shares = (nodes - middle).abs() / half
    shares = shares[shares.index.get_level_values("bus") != phases.buses[0].bus]
    worst = int(shares.argmax())
    bus, phase = shares.index[worst]
    return Nearest(str(phase), str(bus), float(shares.iloc[worst]))
