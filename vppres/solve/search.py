"""What is known about a window while it is being solved."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.model.terms import Terms
from vppres.solve.result import Outcome, SolveLimits, Status

GRACE_S = 5.0
"""What each step on the way to the first answer may take when time is up."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A dispatch with its objective terms; ``service`` is f1 and f3 as weighted.

    ``in_network`` says whether flows, reactive power and voltages have been found too.
    """

    dispatch: Dispatch
    terms: Terms
    service: float
    value: float
    cost_bound_gbp: float
    in_network: bool


@dataclass
class Search:
    """What is known about a window while it is being solved."""

    limits: SolveLimits
    gap: float
    begin: float = field(default_factory=time.perf_counter)
    bound: float = np.inf
    best: Candidate | None = None
    service_bound: float = np.inf
    cost_bound_gbp: float = -np.inf
    proof: Outcome | None = None
    stages: list[str] = field(default_factory=list)
    solver_s: float = 0.0

    @property
    def left_s(self) -> float:
        """Seconds until the window's time limit."""
        return self.limits.time_s - (time.perf_counter() - self.begin)

    @property
    def certified(self) -> bool:
        """Whether the best dispatch is within the gap of the bound."""
        return self.best is not None and self.bound - self.best.value <= self.gap

    @property
    def answered(self) -> bool:
        """Whether there is a dispatch that the network carries."""
        return self.best is not None and self.best.in_network

    @property
    def status(self) -> Status:
        """What the best dispatch is worth."""
        if self.certified:
            return Status.OPTIMAL
        return Status.TIME_LIMIT if self.left_s <= 0 else Status.GAP_OPEN

    def note(self, stage: str, outcome: Outcome) -> None:
        """Record that a stage ran."""
        self.stages.append(stage if outcome.status == "optimal" else f"{stage}:{outcome.status}")
        self.solver_s += outcome.solve_s

    def prove(self, outcome: Outcome) -> None:
        """Keep a relaxation's proof that there is nothing to find."""
        if outcome.status in (Status.INFEASIBLE, Status.UNBOUNDED):
            self.proof = outcome

    def no_answer(self) -> Outcome:
        """Why there is no dispatch: a master's proof if there is one, otherwise the time."""
        out_of_time = Status.NO_ANSWER if self.left_s <= 0 else Status.NUMERICAL
        return self.proof or Outcome(out_of_time, np.nan, np.nan, 0.0)
