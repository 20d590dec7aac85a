"""A window on its way through the stages: its data, its time, its problems, what is proven."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from vppres.model.beyond_paper.at_end import kept_range
from vppres.model.beyond_paper.ratings import has_ratings
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.cache import ModelCache
from vppres.solve.certificate import Certificate, CostRange
from vppres.solve.deadline import Deadline
from vppres.solve.forms import sheet_of
from vppres.solve.result import SolveLimits, WindowSolution
from vppres.solve.selection import Sheet
from vppres.solve.sizes import is_huge, is_large, is_wide
from vppres.solve.solvers import SolverSpec

NETWORK_RESERVE = 0.2
"""Share of the time limit that is kept for the network: a search without it that took all the time
would find or prove what then could not be reported."""

COST_SHARE = 0.1
"""Share of the time left for a cheaper set, or a better bound on cost, where the plan is certified
without: far less is at stake than the gap, and most such searches find nothing."""

GRACE_S = 0.3
GRACE_S_PER_BUS = 1.4e-3
"""What the way to the first answer may take beyond the time limit, all of its steps together:
0.35 s at 33 buses, 1.7 s at 1,000. A linear problem and the tie-breakers fit in it, so that a
window in which time ran out during the search still gets the dispatch of the set that was found."""


class WindowTask:
    """Shared state of the stages of a window, whose time begins now.

    ``spec`` is the solver of the problems that follow the choice of a solver, and ``sides`` are
    those of the inverters' polygons in problems with binaries, 0 for cones.
    """

    def __init__(
        self, data: WindowData, cache: ModelCache, limits: SolveLimits, spec: SolverSpec, sides: int
    ) -> None:
        self.data = data
        self.cache = cache
        self.limits = limits
        self.spec = spec
        self.sides = sides
        cost = CostRange.of(cache.site, data)
        self.certificate = Certificate(limits, cache.site.weights.lambda_grid, cost)
        self.deadline = Deadline(limits.time_s)
        #: Those without the network by whether they lump the fleet, each made once.
        self.masters: dict[bool, Any] = {}

    @property
    def site(self) -> Site:
        """Fixed data."""
        return self.cache.site

    @cached_property
    def sheet(self) -> Sheet:
        """The compiled statement of the window."""
        return sheet_of(self.cache, self.data)

    @cached_property
    def own(self) -> tuple[str, ...]:
        """How the page differs from the paper's: families by name, ``own`` for a term of F."""
        return self.sheet.statement.differs

    @property
    def by_phase(self) -> bool:
        """Whether dispatches in the network come from rows of phases."""
        return bool(self.data.phased) and not self.own

    @property
    def by_rows(self) -> bool:
        """Whether limits of dispatches in the network are rows of a linear problem.

        So are phases, and ratings of lines.
        """
        return self.by_phase or (has_ratings(self.data) and not self.own)

    @cached_property
    def everyone(self) -> float:
        """Service of all customers, in weighted customer hours, and the most of later."""
        now = float(self.site.customers.weight.sum() * self.site.dt_h * self.data.n_steps)
        return now + kept_range(self.site, self.data)[1] if self.data.keeps_service else now

    @property
    def gap(self) -> float:
        """Absolute gap of the searches for a schedule, before it is known what can be served."""
        return self.limits.absolute(self.everyone)

    @property
    def gap_to_best(self) -> float:
        """Absolute gap that certifies the best dispatch, the searches' gap where there is none."""
        best = self.certificate.best
        return self.gap if best is None else self.limits.gap_at(best.value)

    @property
    def is_large(self) -> bool:
        """Whether the window is large."""
        return is_large(self.site, self.data.n_steps)

    @property
    def is_wide(self) -> bool:
        """Whether the window is large by its buses, not by its steps."""
        return self.is_large and is_wide(self.site)

    @property
    def is_huge(self) -> bool:
        """Whether the network is too large for anything to be compiled of it."""
        return is_huge(self.site)

    # Time.

    @cached_property
    def search(self) -> Deadline:
        """When the searches without the network end, so that there is time to enter it."""
        return self.deadline.later(-NETWORK_RESERVE * self.limits.time_s)

    @property
    def grace_s(self) -> float:
        """Time beyond the limit for the way to the first answer, in seconds."""
        return GRACE_S + GRACE_S_PER_BUS * self.site.network.n_buses

    @property
    def latest(self) -> Deadline:
        """When the way to the first answer ends at the latest."""
        return self.deadline.later(self.grace_s)

    def answer_by(self, share: float = 1.0) -> Deadline:
        """The deadline of a step on the way to an answer.

        A started answer is finished even when time is up, in the grace that there is for it.
        """
        grace_s = min(self.grace_s, self.latest.left_s)
        return Deadline(max(share * self.deadline.left_s, grace_s))

    @property
    def goes_on(self) -> bool:
        """Whether there is something left to find or prove and time for it."""
        known = self.certificate
        return not (known.certified or known.nothing_to_find or self.deadline.passed)

    def search_to_its_gap(self, share: float, search: Callable[[float], bool]) -> bool:
        """Search to a share of the gap, and again if the answer asks for a smaller one.

        Solvers stop at an absolute gap, and how large the objective is may not be known before:
        service and curtailment may cancel. The rest of the gap is left to the tie-breakers. Returns
        whether the last search ended.
        """
        known = self.certificate
        # Without a plan the bound says how much there may be: a small part of all service.
        by_bound = known.best is None and np.isfinite(known.bound)
        gap = self.limits.gap_at(known.bound) if by_bound else self.gap_to_best
        ended = search(share * gap)
        if not ended or known.best is None or self.deadline.passed:
            return ended
        smaller = self.gap_to_best
        if smaller < gap and known.bound - known.best.value > share * smaller:
            return search(share * smaller)
        return ended

    # The end.

    def solution(self) -> WindowSolution:
        """The best dispatch and what is proven about it.

        Raises
        ------
        SolveError
            If there is no dispatch that the network carries.
        """
        known = self.certificate
        best = known.best
        late = self.deadline.passed
        if best is None or not best.in_network:
            known.no_answer(late).require_answer(f"The window of {self.data.n_steps} steps")
            raise AssertionError("an outcome without answer always raises")
        objective = best.terms.total(self.site.weights)
        return WindowSolution(
            dispatch=best.dispatch,
            terms=best.terms,
            objective=objective,
            bound=known.bound,
            status=known.status(objective, late),
            service_gap=known.service_gap(),
            cost_gap_gbp=known.cost_gap_gbp(),
            solve_s=self.deadline.spent_s,
            solver_s=known.solver_s,
            stages=tuple(known.stages),
            loss_kw=self.data.network_kw if self.data.physics or self.data.drawn else None,
        )
