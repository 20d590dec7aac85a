"""Methods that solve a window: the monolithic problem, or a decomposition with a certificate."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vppres.errors import InputError, Problem
from vppres.model.data import Dispatch, Site, Terms, WindowData, evaluate
from vppres.model.window import Form
from vppres.solve.result import Outcome, SolveLimits, Status, WindowSolution
from vppres.solve.solvers import SolverSpec, find_solver, run
from vppres.solve.stages import POLYGON_SIDES, ModelCache, polish, solve_cost

METHODS = ("decomposed", "monolithic")
Served = NDArray[np.bool_]


@dataclass
class _Progress:
    """What is known about a window while it is being solved."""

    limits: SolveLimits
    begin: float = field(default_factory=time.perf_counter)
    bound: float = np.inf
    value: float = -np.inf
    dispatch: Dispatch | None = None
    terms: Terms | None = None
    cost: Outcome | None = None
    worst: Outcome | None = None
    stages: list[str] = field(default_factory=list)
    solver_s: float = 0.0

    @property
    def left_s(self) -> float:
        return self.limits.time_s - (time.perf_counter() - self.begin)

    def note(self, stage: str, outcome: Outcome) -> None:
        """Record that a stage ran."""
        self.stages.append(stage if outcome.status == "optimal" else f"{stage}:{outcome.status}")
        self.solver_s += outcome.solve_s
        if not outcome.status.has_answer:
            self.worst = outcome


class WindowSolver:
    """Solves windows of one site by one method and solver; problems are compiled once.

    Parameters
    ----------
    site : Site
        Fixed data.
    method : {"decomposed", "monolithic"}
        How the served set is found.
    solver : str
        Name in the table of solvers.
    limits : SolveLimits, optional
        Gaps and time limit of a window.
    polygon_sides : int, optional
        Sides of an inverter's polygon for solvers that take no cones with binaries.

    Examples
    --------
    >>> from vppres.solve.solvers import find_solver
    >>> WindowSolver.method_names()
    ('decomposed', 'monolithic')
    """

    def __init__(self, site: Site, method: str = "decomposed", solver: str = "highs",
                 limits: SolveLimits | None = None, polygon_sides: int = POLYGON_SIDES) -> None:
        if method not in METHODS:
            raise InputError(Problem("options", "is not a known method",
                                     f"Use one of: {', '.join(METHODS)}.", field="method",
                                     value=method))
        self.method, self.limits = method, limits or SolveLimits()
        self.spec: SolverSpec = find_solver(solver)
        self.sides = 0 if self.spec.mip_cones else polygon_sides
        self.cache = ModelCache(site)

    @staticmethod
    def method_names() -> tuple[str, ...]:
        """Names of the methods."""
        return METHODS

    @property
    def site(self) -> Site:
        """Fixed data."""
        return self.cache.site

    def solve(self, data: WindowData) -> WindowSolution:
        """Solve a window.

        Raises
        ------
        SolveError
            If no dispatch was found: infeasible, unbounded, numerical or out of time.
        """
        progress = _Progress(self.limits)
        gap = self.limits.absolute(self.site.customers.weight.sum() * self.site.dt_h * data.n_steps)
        masters = (self._aggregate, self._per_battery) if self.method == "decomposed" else ()
        for master in (*masters, self._full):
            served = master(data, gap, progress)
            if served is not None:
                self._recover(data, served, progress)
            if progress.bound - progress.value <= gap or progress.left_s <= 0:
                break
        return self._finish(data, gap, progress)

    def _aggregate(self, data: WindowData, gap: float, progress: _Progress) -> Served | None:
        """Served set and bound of the lumped relaxation."""
        model = self.cache.aggregate(data.n_steps)
        model.fill(data)
        outcome = run(model.problem, self.spec, 0.3 * gap, progress.left_s)
        return _take("aggregate", outcome, model.x.value, progress)

    def _per_battery(self, data: WindowData, gap: float, progress: _Progress) -> Served | None:
        """Served set and bound of the relaxation with every battery but without the network."""
        form = Form("service", "integer", "integer", 0, network=False)
        return self._window(form, "per_battery", data, 0.5 * gap, progress)

    def _full(self, data: WindowData, gap: float, progress: _Progress) -> Served | None:
        """Served set and bound of the whole problem."""
        form = Form("service", "integer", "integer", self.sides)
        return self._window(form, "full", data, gap, progress)

    def _window(self, form: Form, name: str, data: WindowData, gap: float,
                progress: _Progress) -> Served | None:
        model = self.cache.window(form, data.n_steps)
        model.fill(data)
        outcome = run(model.problem, self.spec, gap, progress.left_s)
        return _take(name, outcome, model.v.x_served.value, progress)

    def _recover(self, data: WindowData, served: Served, progress: _Progress) -> None:
        """Cheapest true dispatch of a served set; kept if it is the best so far."""
        # A started answer is always finished: recovery gets a moment even when time is up.
        stage = solve_cost(self.cache, data, served, self.spec, self.sides,
                           max(progress.left_s, 5.0))
        progress.note("cost", stage.outcome)
        if stage.dispatch is None:
            return
        terms = evaluate(self.site, data, stage.dispatch)
        value = terms.upper_levels(self.site.weights)
        if value > progress.value:
            progress.value, progress.dispatch, progress.terms = value, stage.dispatch, terms
            progress.cost = stage.outcome

    def _finish(self, data: WindowData, gap: float, progress: _Progress) -> WindowSolution:
        """Tie-breakers, and the certificate."""
        if progress.dispatch is None or progress.terms is None or progress.cost is None:
            assert progress.worst is not None
            progress.worst.require_answer(f"The window of {data.n_steps} steps")
            raise AssertionError("an outcome without answer always raises")
        dispatch, terms = progress.dispatch, progress.terms
        stage = polish(self.cache, data, dispatch, max(progress.left_s, 5.0))
        progress.note("tie_breakers", stage.outcome)
        if stage.dispatch is not None:
            dispatch, terms = stage.dispatch, evaluate(self.site, data, stage.dispatch)
        certified = progress.bound - progress.value <= gap
        return WindowSolution(
            dispatch=dispatch, terms=terms, objective=terms.total(self.site.weights),
            bound=progress.bound, status=Status.OPTIMAL if certified else Status.TIME_LIMIT,
            cost_gap_gbp=abs(progress.cost.value - progress.cost.bound),
            solve_s=time.perf_counter() - progress.begin, solver_s=progress.solver_s,
            stages=tuple(progress.stages))


def _take(name: str, outcome: Outcome, x: np.ndarray | None, progress: _Progress) -> Served | None:
    """Record a master's outcome and bound; its served set if it has one."""
    progress.note(name, outcome)
    if not outcome.status.has_answer or x is None:
        return None
    progress.bound = min(progress.bound, outcome.bound)
    return np.asarray(x) > 0.5
