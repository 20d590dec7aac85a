"""A window's whole problem as the page states it, by cvxpy and SCIP: nothing of ``vppres.solve``.

Ratings of lines are cones of all lines in all steps here, which plans make row by row, and so are
limits of phases.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import cvxpy as cp
import numpy as np

from experiments.studies.phased_feeders import phase_rows
from vppres.model.beyond_paper.ratings import LineRatings
from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.model.violations import POWER_TOLERANCE_KW

FACTORS = {"f1": 1.0, "f6": -1.0, "f7": 1.0, "own": 1.0}


class Whole(NamedTuple):
    """The best schedule that was found and what none exceeds, without tie-breakers; -inf: none."""

    value: float
    bound: float


def whole_problem(site: Site, data: WindowData, time_s: float = 60.0) -> Whole:
    """The optimum of a window, as near as the time allows."""
    rated = LineRatings.shape(site, data)
    beyond = (*beyond_paper(site, data), *(((LineRatings, rated),) if rated else ()))
    statement = Statement(site, data.n_steps, beyond)
    statement.write(data)
    w = site.weights
    factors = FACTORS | {"f2": -w.lambda_grid, "f3": -w.lambda_curt}
    F = sum(factors[name] * term for name, term in statement.terms.items())
    # Cost weighs so little that SCIP would stop before it counts.
    scale = 1e3 / float(site.customers.weight.max())
    rows = list(statement.families.values())
    if data.phased:
        rows += phase_rows(site, data, *_drawn(site, data, statement))
    problem = cp.Problem(cp.Maximize(scale * F), rows)
    limits = {"limits/time": time_s, "limits/absgap": 1e-5 * scale, "limits/gap": 0.0}
    try:
        with warnings.catch_warnings():
            # cvxpy calls each end at a limit inaccurate, that at the gap asked for too.
            warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
            problem.solve(solver=cp.SCIP, scip_params=limits)
    except cp.SolverError:
        return Whole(-np.inf, np.inf)
    if problem.value is None or not np.isfinite(problem.value):
        return Whole(-np.inf, -np.inf if problem.status == cp.INFEASIBLE else np.inf)
    with np.errstate(
        divide="ignore", invalid="ignore"
    ):  # cvxpy looks at cones' points of no length
        over = [np.max(row.violation(), initial=0.0) for row in rows if _has_rows(row)]
    assert np.max(over) <= POWER_TOLERANCE_KW, "the reference is outside of its own rows"
    model = problem.solver_stats.extra_stats["model"]
    gap = float(model.getPrimalbound() - model.getDualbound())
    value = float(problem.value)
    return Whole(value / scale, (value + gap) / scale)


def _has_rows(row: cp.Constraint) -> bool:
    return all(part.size for part in row.args)


def _drawn(
    site: Site, data: WindowData, statement: Statement
) -> tuple[cp.Expression, cp.Expression]:
    """Power of the assets of a feeder with phases, by the letters of their kinds."""
    v, letters = statement.v, statement.letters
    customers = data.load_kw * site.customers.q_per_p
    parts = [
        (cp.multiply(data.load_kw, v.x_served), cp.multiply(customers, v.x_served)),
        (-(v.P_self + v.P_exp), -v.Q_pv),
        (v.P_ch - v.P_dch, -v.Q_batt),
    ]
    dimmed = np.flatnonzero(site.customers.dimmable)
    if len(dimmed):
        lost = letters["dimmed"] @ np.eye(len(site.customers))[dimmed]
        kw, kvar = parts[0]
        parts[0] = kw - cp.multiply(data.load_kw, lost), kvar - cp.multiply(customers, lost)
    for kind, units in site.kinds.items():
        taken: cp.Expression = np.zeros((data.n_steps, len(units)))
        if kind == "chargers" and "ev_charge" in letters:
            taken = letters["ev_charge"]
            if "ev_discharge" in letters:
                two_way = np.eye(len(units))[np.flatnonzero(units.p_discharge_kw > 0.0)]
                taken = taken - letters["ev_discharge"] @ two_way
        elif kind == "thermal_loads":
            taken = letters["th_power"]
        elif kind == "gensets":
            taken = -letters["gs_power"]
        parts.append((taken, np.zeros((data.n_steps, len(units)))))
    there = [part for part in parts if part[0].shape[1]]
    kw, kvar = (cp.hstack(each) for each in zip(*there, strict=True))
    return kw, kvar
