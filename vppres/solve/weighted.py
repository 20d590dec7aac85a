"""The problem as it is printed: all five terms in one objective, one mixed-integer solve.

No levels and no polish: what the gap leaves open stays open.
``docs/decisions/weighted-objective.md`` has the arithmetic, and why the default does otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.core.errors import InputError, Problem
from vppres.model.data import WindowData
from vppres.model.forms import Form
from vppres.model.site import Site
from vppres.model.squares import Squares, largest_flow
from vppres.model.units import dispatch_in_kw, site_in_unit, window_in_unit
from vppres.solve.cache import shared_cache
from vppres.solve.certificate import Candidate
from vppres.solve.dispatch import carried, window_model
from vppres.solve.result import WindowSolution
from vppres.solve.solvers import run_with
from vppres.solve.task import WindowTask

ANY_GAP = float(np.finfo(float).max)
"""A weighted solve stops at its relative gap alone, as solvers do by default."""


@dataclass(frozen=True)
class WeightedChoices:
    """What a user of a solver chooses besides gap and time limit.

    Parameters
    ----------
    unit_kw : float
        Unit of power in the model in kW: 1, 1000 for MW, the base power for per unit.
    tolerance : float
        Optimality tolerance: reduced costs below it count as zero.
    seed : int
        Seed of the solver's own random choices.
    """

    unit_kw: float = 1.0
    tolerance: float = 1e-7
    seed: int = 0


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


def _gurobi(gap: float, choices: WeightedChoices, time_s: float) -> Mapping[str, Any]:
    return {
        "MIPGap": gap,
        "OptimalityTol": choices.tolerance,
        "Seed": choices.seed,
        "TimeLimit": time_s,
    }


OPTIONS: dict[str, Callable[[float, WeightedChoices, float], Mapping[str, Any]]] = {
    "highs": _highs,
    "scip": _scip,
    "gurobi": _gurobi,
}
"""How each solver is told the choices."""


def require_choices(solver: str) -> None:
    """Refuse solvers that cannot be told the choices of a weighted solve.

    Raises
    ------
    InputError
        If the solver is none of those in ``OPTIONS``.
    """
    if solver not in OPTIONS:
        raise InputError(
            Problem(
                "options",
                "solves no weighted objective here",
                f"Use one of: {', '.join(OPTIONS)}; or --method decomposed.",
                field="solver",
                value=solver,
            )
        )


def solve_weighted(task: WindowTask, choices: WeightedChoices) -> WindowSolution:
    """The answer of one mixed-integer solve of the weighted objective, as it comes.

    Raises
    ------
    SolveError
        If there is none: infeasible, or not found in time.
    """
    known = task.certificate
    site = task.site if choices.unit_kw == 1.0 else site_in_unit(task.site, choices.unit_kw)
    data = window_in_unit(task.data, choices.unit_kw)
    squares = squares_of(site, data, task.spec.mip_cones, choices.tolerance)
    form = Form("weighted", polygon_sides=task.sides, squares=squares)
    model = window_model(shared_cache(site), data, form)
    model.fill(data)
    ask = OPTIONS[task.spec.name]
    outcome = run_with(
        model.problem,
        task.spec,
        lambda left_s: ask(task.limits.gap_rel, choices, left_s),
        task.deadline.left_s,
    )
    known.note("weighted", outcome)
    if not outcome.status.has_answer:
        known.prove(outcome)
        return task.solution()
    dispatch = dispatch_in_kw(model.dispatch(), choices.unit_kw)
    served = task.data.for_service(dispatch.served)
    known.bound_by(outcome.bound)
    found = Candidate.of(task.site, served, dispatch, np.inf, in_network=False)
    known.keep(carried(task, served, found, dispatch))
    return replace(_with_gaps(task, task.solution()), status=outcome.status)


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


def _with_gaps(task: WindowTask, solution: WindowSolution) -> WindowSolution:
    """The solution with what its one gap leaves open in the unit of each term.

    The terms other than the one that is asked about are held: none falls by more than the whole gap
    divided by its weight, nor below the least that it can be.
    """
    w = task.site.weights
    open_ = solution.gap_abs
    terms = solution.terms
    least_gbp = task.certificate.cost.least_gbp
    # f4 over the squared voltage is the loss in W of each kVA² in a step.
    kwh_per_f4 = task.site.dt_h / (1000.0 * task.site.network.base_kv**2)
    return replace(
        solution,
        cost_gap_gbp=_part(open_, w.lambda_grid, terms.f2 - least_gbp),
        curtailment_gap_kwh=_part(open_, w.lambda_curt, terms.f3),
        loss_gap_kwh=kwh_per_f4 * _part(open_, w.lambda_l, terms.f4),
    )


def _part(open_: float, weight: float, whole: float) -> float:
    """How far a term can fall for what is open, at most all of it."""
    return max(min(open_ / weight, whole), 0.0) if weight > 0.0 else max(whole, 0.0)
