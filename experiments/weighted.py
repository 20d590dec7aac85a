"""One mixed-integer solve of the objective as it is printed, all five terms in one sum.

No levels and no polish: what the gap leaves open stays open.
``docs/decisions/weighted-objective.md`` has the arithmetic, and why vppres solves otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import numpy as np

from experiments.units import dispatch_in_kw, site_in_unit, window_in_unit
from experiments.weighted_model import Squares, WeightedModel, largest_flow
from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.cache import shared_cache
from vppres.solve.certificate import Candidate
from vppres.solve.dispatch import as_it_is, carried
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, Status, WindowSolution
from vppres.solve.solvers import Interface, SolverSpec, run_by_cvxpy
from vppres.solve.task import WindowTask
from vppres.solve.turns import one_at_a_time

ANY_GAP = float(np.finfo(float).max)
"""A weighted solve stops at its relative gap alone, as solvers do by default."""


@dataclass(frozen=True)
class WeightedChoices:
    """What a user of a solver chooses besides gap and time limit."""

    #: Unit of power in the model in kW: 1, 1000 for MW, the base power for per unit.
    unit_kw: float = 1.0
    tolerance: float = 1e-7  #: optimality tolerance: reduced costs below it count as zero
    seed: int = 0  #: seed of the solver's own random choices


def _highs(gap: float, choices: WeightedChoices, time_s: float) -> Mapping[str, Any]:
    return {
        "mip_rel_gap": gap,
        "dual_feasibility_tolerance": choices.tolerance,
        "random_seed": choices.seed,
        "time_limit": time_s,
        "threads": 1,
    }


def _scip(gap: float, choices: WeightedChoices, time_s: float) -> Mapping[str, Any]:
    parameters = {
        "limits/gap": gap,
        "limits/time": time_s,
        "numerics/dualfeastol": choices.tolerance,
        "numerics/feastol": 1e-7,
        "randomization/randomseedshift": choices.seed,
    }
    return {"scip_params": parameters}


def _highs_slack(solved: cp.Problem) -> float:
    stats = solved.solver_stats.extra_stats
    return float(stats.objective_function_value - stats.mip_dual_bound)


def _highs_ended(solved: cp.Problem) -> Status:
    feasible = getattr(solved.solver_stats.extra_stats, "primal_solution_status", 0) == 2
    return Status.TIME_LIMIT if feasible else Status.NO_ANSWER


OPTIONS: dict[str, Callable[[float, WeightedChoices, float], Mapping[str, Any]]] = {
    "highs": _highs,
    "scip": _scip,
}
"""How each solver is told the choices."""


def _asked(task: WindowTask, choices: WeightedChoices) -> SolverSpec:
    """The solver with the choices; cvxpy asks HiGHS too, since five terms are no selection."""
    spec = task.spec

    def options(gap: float, time_s: float) -> Mapping[str, Any]:
        return OPTIONS[spec.name](gap, choices, time_s)

    if spec.interface is None:
        return replace(spec, interface=Interface(options, _highs_slack, _highs_ended))
    return replace(spec, interface=spec.interface._replace(options=options))


class WeightedSolver(WindowSolver):
    """Solves each window by one mixed-integer solve of all five terms.

    Parameters
    ----------
    site : Site
        Fixed data.
    solver : {"highs", "scip"}
        Name in the table of solvers.
    limits : SolveLimits, optional
        Relative gap and time limit of a window; its absolute gap does not apply.
    choices : WeightedChoices, optional
        Unit, tolerance and seed.
    """

    def __init__(
        self,
        site: Site,
        solver: str = "highs",
        limits: SolveLimits | None = None,
        choices: WeightedChoices | None = None,
    ) -> None:
        one_gap = replace(limits or SolveLimits(), gap_abs=ANY_GAP)
        super().__init__(site, solver=solver, limits=one_gap)
        self.choices = choices or WeightedChoices()

    @one_at_a_time
    def solve(self, data: WindowData, within_s: float = math.inf) -> WindowSolution:
        """The answer of one mixed-integer solve, as it comes.

        Raises
        ------
        SolveError
            If there is none: infeasible, or not found in time.
        """
        limits = self.limits.at_most(within_s)
        task = WindowTask(data, self.cache, limits, self.spec, self.sides)
        return solve_weighted(task, self.choices)


def solve_weighted(task: WindowTask, choices: WeightedChoices) -> WindowSolution:
    """One solve of a window, in the unit of the choices."""
    known = task.certificate
    site = task.site if choices.unit_kw == 1.0 else site_in_unit(task.site, choices.unit_kw)
    data = window_in_unit(task.data, choices.unit_kw)
    model = shared_cache(site).problem(
        WeightedModel,
        n_steps=data.n_steps,
        beyond=beyond_paper(site, data),
        polygon_sides=task.sides,
        squares=squares_of(site, data, task.spec.mip_cones, choices.tolerance),
    )
    model.fill(data)
    outcome = run_by_cvxpy(
        model.problem, _asked(task, choices), task.limits.gap_rel, task.deadline.left_s
    )
    known.note("weighted", outcome)
    if not outcome.status.has_answer:
        known.prove(outcome)
        return task.solution()
    dispatch = dispatch_in_kw(model.dispatch(), choices.unit_kw)
    served = task.data.for_service(dispatch.served)
    known.bound_by(outcome.bound)
    found = Candidate.of(task.site, served, dispatch, np.inf, in_network=False)
    known.keep(carried(task, found, as_it_is))
    return replace(_with_cost_gap(task.solution(), site.weights.lambda_grid), status=outcome.status)


def _with_cost_gap(solution: WindowSolution, lambda_grid: float) -> WindowSolution:
    """The cost falls by no more than the whole gap, all other terms held."""
    if lambda_grid <= 0.0:
        return solution
    open_gbp = solution.gap_abs / lambda_grid
    return replace(solution, cost_gap_gbp=min(solution.cost_gap_gbp, open_gbp))


def squares_of(site: Site, data: WindowData, cones: bool, tolerance: float) -> Squares:
    """What stands for f4 and f5: squares where they can be had, nothing where nobody sees them.

    The worth of one more unit of flow or reactive power is at most its derivative at the largest
    flow and at full use. Below the optimality tolerance no solver tells it from zero.
    """
    if cones:
        return "exact"
    w = site.weights
    ratings = np.concatenate([site.pv.s_max_kva, site.batteries.s_max_kva])
    steepest_flow = 2.0 * w.lambda_l * (site.network.r_ohm * largest_flow(site, data)).max()
    steepest_use = 2.0 * w.lambda_q / ratings.min() if len(ratings) else 0.0
    return "none" if max(steepest_flow, steepest_use) < tolerance else "tangents"
