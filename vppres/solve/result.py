"""Outcomes of solves, with statuses that hide nothing."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

from vppres.contract.decision import LEAST_OBJECTIVE, SolveInfo
from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.core.errors import (
    InfeasibleError,
    LimitError,
    NumericalError,
    SolveError,
    UnboundedError,
)
from vppres.model.terms import Terms
from vppres.scenario.option_table import check_group
from vppres.solve.deadline import LEAST_S


class Status(enum.StrEnum):
    """Status of a solver's answer."""

    OPTIMAL = "optimal"
    """Within the gap that was asked for."""
    TIME_LIMIT = "time_limit"
    """The best answer when time ran out, with a bound."""
    GAP_OPEN = "gap_open"
    """The best answer of all stages, with a bound, but a gap above what was asked for."""
    BLACKED_OUT = "blacked_out"
    """No answer serves the window's first step: nothing can form or hold its island."""
    INACCURATE = "inaccurate"
    """An answer whose accuracy the solver does not vouch for."""
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    NUMERICAL = "numerical"
    """The solver gave up."""
    NO_ANSWER = "no_answer"
    """Time ran out before the first answer."""

    @property
    def has_answer(self) -> bool:
        """Whether values came with it that the solver vouches for."""
        return self in (Status.OPTIMAL, Status.TIME_LIMIT, Status.GAP_OPEN, Status.BLACKED_OUT)


_GAVE_UP = (
    NumericalError,
    "made the solver give up for numerical reasons. Try another "
    "--solver, or check the data for extreme values",
)
_ERRORS: dict[Status, tuple[type[SolveError], str]] = {
    Status.INFEASIBLE: (
        InfeasibleError,
        "has no feasible dispatch. The voltage limits or the "
        "PV owners' self-consumption leave nothing; widen the limits or check the "
        "PV inverters' ratings",
    ),
    Status.UNBOUNDED: (UnboundedError, "is unbounded. A price, weight or limit is not finite"),
    Status.NUMERICAL: _GAVE_UP,
    Status.INACCURATE: _GAVE_UP,
    Status.NO_ANSWER: (
        LimitError,
        "was not solved before the time limit. Raise --time-limit, or use --method decomposed",
    ),
}


@dataclass(frozen=True)
class Outcome:
    """Status, value and bound of one solve, in the problem's own sense.

    ``solve_s`` are the seconds in the solver, ``solver`` its name.
    """

    status: Status
    value: float
    bound: float
    solve_s: float
    solver: str = "none"

    def require_answer(self, what: str) -> None:
        """Raise the typed error of an outcome without values."""
        if not self.status.has_answer:
            error, text = _ERRORS[self.status]
            raise error(f"{what} {text}.")


@dataclass(frozen=True)
class SolveLimits:
    """When a solve may stop."""

    #: Gaps on the objective; both must hold.
    gap_rel: float = 1e-4
    gap_abs: float = 5e-3
    time_s: float = 60.0  #: time limit of one window in seconds

    def __post_init__(self) -> None:
        check_group("limits", self)

    def within(self, share: float) -> SolveLimits:
        """Limits with the same gaps in a share of the time."""
        return replace(self, time_s=share * self.time_s)

    def at_most(self, time_s: float) -> SolveLimits:
        """Limits with the same gaps in at most the seconds that are left."""
        return replace(self, time_s=min(self.time_s, max(time_s, LEAST_S)))

    def absolute(self, scale: float) -> float:
        """The absolute gap that meets both, for an objective of size ``scale``."""
        return min(self.gap_abs, self.gap_rel * scale)

    def gap_at(self, objective: float) -> float:
        """The absolute gap that certifies an objective."""
        return self.absolute(max(abs(objective), LEAST_OBJECTIVE))

    def met(self, bound: float, objective: float) -> bool:
        """Whether an objective is within both gaps of a bound.

        Examples
        --------
        >>> SolveLimits().met(bound=10.0009, objective=10.0)
        True
        >>> SolveLimits().met(bound=1.0009, objective=1.0)
        False
        """
        return bound - objective <= self.gap_at(objective)


@dataclass(frozen=True, eq=False, kw_only=True)
class WindowSolution(SolveInfo):
    """A window's dispatch and what is proven about it."""

    dispatch: Dispatch  #: feasible for the true problem within solver tolerances
    terms: Terms  #: objective terms of the dispatch
    #: ``OPTIMAL`` if the gap is within the limits, otherwise ``TIME_LIMIT`` or ``GAP_OPEN``.
    status: Status
    #: Losses that the dispatch pays for, (W,); None in the paper's mode, which has none.
    loss_kw: Floats | None = None

    def after(self, before: WindowSolution) -> WindowSolution:
        """Copy with the seconds of a solution before it added."""
        return replace(
            self, solve_s=before.solve_s + self.solve_s, solver_s=before.solver_s + self.solver_s
        )

    def carried_by(self, found: WindowSolution, *stages: str) -> WindowSolution:
        """Copy with another dispatch of the same set, the seconds and further stages until then."""
        return replace(
            self,
            dispatch=found.dispatch,
            terms=found.terms,
            loss_kw=found.loss_kw,
            solve_s=found.solve_s,
            solver_s=found.solver_s,
            stages=(*self.stages, *stages),
        )
