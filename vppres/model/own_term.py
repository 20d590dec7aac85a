"""What the page's objective has besides the paper's terms."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
from cvxpy.atoms.affine.add_expr import AddExpression

from vppres.core.arrays import Floats
from vppres.core.errors import ModelError
from vppres.model import objective
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

SAME = 1e-12
"""Share by which two values of one term may differ: rounding."""


def own_term(F: cp.Expression, site: Site, v: Variables, p: Parameters) -> cp.Expression | None:
    """What F has besides the paper's terms as weighted, None for the paper's F.

    Terms are told by their values at a random point, so that F may be written in any order.

    Raises
    ------
    ModelError
        If it is not linear.
    """
    w = site.weights
    paper = [
        objective.f1_service(site, v, p),
        -w.lambda_grid * objective.f2_cost(site, v, p),
        -w.lambda_curt * objective.f3_curtailment(site, v, p),
        -w.lambda_l * objective.f4_flows(site, v, p),
        -w.lambda_q * objective.f5_reactive(site, v, p),
    ]
    left = list(F.args) if isinstance(F, AddExpression) else [F]
    values = _at_random([*left, *paper])
    own = values[: len(left)]
    for term, value in zip(paper, values[len(left) :], strict=True):
        same = [k for k, other in enumerate(own) if abs(other - value) <= SAME * abs(value)]
        if same:
            del left[same[0]], own[same[0]]
        else:
            left.append(-term)
            own.append(-value)
    found = [each for each, value in zip(left, own, strict=True) if value != 0.0]
    if not found:
        return None
    term = cp.sum(cp.hstack([cp.vec(each, order="F") for each in found]))
    if not term.is_affine():
        raise ModelError(
            f"paper_objective has a term that is not linear: {found[0]}. State it by linear rows "
            "with a variable of its own, and maximise that."
        )
    return term


def _at_random(terms: list[cp.Expression]) -> list[float]:
    """Values of terms at one random point of their letters and parameters."""
    leaves = {x.id: x for term in terms for x in (*term.variables(), *term.parameters())}
    before = {number: leaf.value for number, leaf in leaves.items()}
    rng = np.random.default_rng(0)
    for leaf in leaves.values():
        value: Floats = rng.uniform(0.5, 1.5, leaf.shape)
        leaf.save_value(value)
    values = [float(np.sum(term.value)) for term in terms]
    for number, leaf in leaves.items():
        leaf.save_value(before[number])
    return values
