"""Switching rules as rows of arrays: compiled once from the constraints that every form has."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.contract.switching import RuleSteps
from vppres.model.beyond_paper.switching import SwitchingModel
from vppres.model.data import WindowData
from vppres.model.numerics import require_dpp
from vppres.model.site import Site
from vppres.solve.network.rows import Rows
from vppres.solve.programs import compiled
from vppres.solve.task import WindowTask


class RuleModel:
    """The rules of a window, and nothing else of it.

    Parameters
    ----------
    site : Site
        Fixed data.
    n_steps : int
        Steps W of the window.
    steps : RuleSteps
        Shape of the rules.
    """

    def __init__(self, site: Site, n_steps: int, steps: RuleSteps) -> None:
        x = cp.Variable((n_steps, len(site.customers)), name="x_served")
        self.rules = SwitchingModel(site, x, steps)
        self.variables = [x, *self.rules.follow]
        self.problem = cp.Problem(cp.Minimize(0), list(self.rules.constraints.values()))
        require_dpp(self.problem, f"rules of {n_steps} steps")

    def rows(self, data: WindowData) -> Rows:
        """Rows on x, on, off and cold side by side, the steps of a customer in turn."""
        self.rules.fill(data)
        program, first = compiled(self.problem)
        places = [first[v.name()] + np.arange(v.size) for v in self.variables]
        return Rows(
            sp.csr_array(program.rows[:, np.concatenate(places)]), program.lower, program.upper
        )


def rows_of_rules(task: WindowTask) -> Rows | None:
    """Rows of a window's switching rules, None where it has none."""
    data = task.data
    if data.switching is None:
        return None
    rules = task.cache.problem(RuleModel, n_steps=data.n_steps, steps=data.switching.steps)
    return rules.rows(data)
