"""How the page differs from the paper's: its objective, and families of the paper.

Both show in values at a random point of letters and parameters.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np
from cvxpy.atoms.affine.add_expr import AddExpression

from vppres.core.arrays import Floats
from vppres.core.errors import ModelError
from vppres.model import constraints, objective
from vppres.model.constraints import Named
from vppres.model.numerics import SAME
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


def own_term(F: cp.Expression, site: Site, v: Variables, p: Parameters) -> cp.Expression | None:
    """Terms of F besides the paper's as weighted, None for the paper's F.

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
    values = [float(value) for value in at_random([*left, *paper])]
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


def at_random(terms: list[cp.Expression]) -> list[Floats]:
    """Values of expressions at one random point of their letters and parameters."""
    leaves = {x.id: x for term in terms for x in (*term.variables(), *term.parameters())}
    before = {number: leaf.value for number, leaf in leaves.items()}
    rng = np.random.default_rng(0)
    for leaf in leaves.values():
        leaf.save_value(rng.uniform(0.5, 1.5, leaf.shape))
    values = [np.asarray(term.value) for term in terms]
    for number, leaf in leaves.items():
        leaf.save_value(before[number])
    return values


def changed_families(page: Named, site: Site, v: Variables, p: Parameters) -> tuple[str, ...]:
    """Families of the paper that the page lacks, or states in another way."""
    paper = {name: c for name, (_, c) in constraints.made_by(site, v, p).items()}
    shapes = {name: [type(c), *(side.shape for side in c.args)] for name, c in page.items()}
    there = {
        name: c
        for name, c in paper.items()
        if shapes.get(name) == [type(c), *(side.shape for side in c.args)]
    }
    sides = [side for n in there for side in (*paper[n].args, *page[n].args)]
    values = iter(at_random(sides))
    same = set()
    for name, constraint in there.items():
        one, other = ([next(values) for _ in constraint.args] for _ in range(2))
        if all(np.allclose(x, y, rtol=SAME, atol=0.0) for x, y in zip(one, other, strict=True)):
            same.add(name)
    return tuple(name for name in paper if name not in same)
