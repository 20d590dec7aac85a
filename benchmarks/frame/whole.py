"""A window's whole problem at once, as a yardstick: its answer and its time of the processor."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.frame.store import Row
from vppres.model.data import WindowData
from vppres.model.numerics import objective_scale
from vppres.model.site import Site
from vppres.solve.cache import ModelCache
from vppres.solve.forms import Form, window_problem
from vppres.solve.result import SolveLimits, Status
from vppres.solve.solvers import SolverSpec, run

SIDES = 16
BUSY = 4.0
"""Times that solvers get on the clock on the wall, of a busy machine: they know no other clock."""


def monolith(
    site: Site, data: WindowData, spec: SolverSpec, limit_s: float, busy: float = BUSY
) -> Row:
    """One solve of the whole problem with polygons, to the same gap."""
    problem = window_problem(ModelCache(site), data, Form(polygon_sides=SIDES))
    problem.fill(data)
    problem.compile()
    everyone = site.customers.weight.sum() * site.dt_h * data.n_steps
    gap = SolveLimits().absolute(float(everyone))
    begin_s = time.process_time()
    outcome = run(problem, spec, gap, busy * limit_s, objective_scale(site))
    spent_s = time.process_time() - begin_s
    late = outcome.status != Status.OPTIMAL or spent_s > limit_s
    return {
        "s": np.inf if late else spent_s,
        "limit_s": limit_s,
        "value": outcome.value,
        "status": str(outcome.status),
    }
