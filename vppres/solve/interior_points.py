"""Clarabel for cvxpy, with problems of cones compiled in time proportional to their entries.

cvxpy puts a cone's rows beside each other by a product of sparse matrices that have a column for
each pair of a variable and a parameter: millions of empty ones, seconds and gigabytes. The same
rows are renumbered here where they stand. The compiled problem is the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.constraints import SOC, NonNeg, Zero
from cvxpy.reductions.dcp2cone.cone_matrix_stuffing import ReducedMat
from cvxpy.reductions.solvers.conic_solvers.clarabel_conif import CLARABEL

from vppres.core.arrays import Floats, Wholes


class RenumberedClarabel(CLARABEL):  # type: ignore[misc]
    """cvxpy's interface of Clarabel but for the order of the rows."""

    def name(self) -> str:
        """Of this interface: cvxpy's own keep theirs."""
        return "RENUMBERED_CLARABEL"

    @classmethod
    def format_constraints(cls, problem: Any, exp_cone_order: Sequence[int]) -> Any:
        """The problem with its rows in Clarabel's order and signs.

        ``problem.A`` has a row for each row and column of the constraints' matrix, column by
        column, and a column for each parameter.
        """
        kinds = {type(constraint) for constraint in problem.constraints}
        if not kinds or not kinds <= {Zero, NonNeg, SOC}:
            return super().format_constraints(problem, exp_cone_order)
        place = places(problem.constraints)
        sign = signs(problem.constraints)
        tensor = problem.A.tocoo()
        column, row = np.divmod(tensor.row.astype(np.int64), len(place))
        entries = (sign[row] * tensor.data, (place[row] + column * len(place), tensor.col))
        formatted = copy(problem)
        formatted.A = sp.coo_array(entries, shape=tensor.shape)
        formatted.reduced_A = ReducedMat(formatted.A, problem.x.size)
        formatted.formatted = True
        return formatted


def places(constraints: Sequence[cp.Constraint]) -> Wholes:
    """Where every row goes: cvxpy gives all radii of a constraint's cones, then all vectors."""
    found = []
    first = 0
    for constraint in constraints:
        count = sum(arg.size for arg in constraint.args)
        order = np.arange(count)
        if isinstance(constraint, SOC):
            order = order.reshape(constraint.args[0].size, -1)
            order = np.concatenate([order[:, 0], order[:, 1:].ravel()])
        found.append(first + order)
        first += count
    return np.concatenate(found)


def signs(constraints: Sequence[cp.Constraint]) -> Floats:
    """-1 for the rows of equalities, which Clarabel gets as ``-A x = b``."""
    return np.concatenate(
        [
            np.full(sum(arg.size for arg in c.args), -1.0 if isinstance(c, Zero) else 1.0)
            for c in constraints
        ]
    )


CLARABEL_INTERFACE = RenumberedClarabel()
"""The one that is used: cvxpy keeps what it compiled by its interface."""
