"""The five terms of the objective (paper, Section 3.3).

For steps other than 1 h, ``f1`` and ``f3`` are multiplied by the step length in hours, so that the
objective of an interval does not depend on how finely it is cut.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Floats
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

MOST_SQUARES = 1_000
"""Squares that cvxpy is to hand on as they are: for 6,000 it fills a matrix in 20 s."""


def f1_service(site: Site, v: Variables, p: Parameters) -> cp.Expression:
    """Weighted service, in weighted customer hours."""
    return site.dt_h * cp.sum(v.x_served @ site.customers.weight)


def f2_cost(site: Site, v: Variables, p: Parameters) -> cp.Expression:
    """Cost of the import, in GBP."""
    return p.rho_dt @ v.P_grid


def f3_curtailment(site: Site, v: Variables, p: Parameters) -> cp.Expression:
    """Curtailed PV energy, in kWh."""
    return site.dt_h * cp.sum(v.P_curt)


def f4_flows(site: Site, v: Variables, p: Parameters) -> cp.Expression:
    """Proxy of the ohmic losses: r (P² + Q²), in ohm kVA²."""
    root_r = np.sqrt(site.network.r_ohm)[None, :]
    return cp.sum_squares(cp.multiply(root_r, v.P_flow)) + cp.sum_squares(
        cp.multiply(root_r, v.Q_flow)
    )


def weighted_squares(weight: Floats, x: cp.Variable) -> cp.Expression:
    """``sum(weight * x**2)`` of variables (..., n) with weights (n,), for quadratic objectives.

    cvxpy hands squares of variables on as they are. Of whatever else is squared, weighted variables
    too, it makes variables and equations first, which solvers of cones alone need anyway. Of very
    many squares it is the quicker way all the same.

    Examples
    --------
    >>> x = cp.Variable((2, 2), value=np.array([[1.0, 2.0], [3.0, 4.0]]))
    >>> float(weighted_squares(np.array([1.0, 10.0]), x).value)
    210.0
    """
    if x.size > MOST_SQUARES:
        return cp.sum_squares(cp.multiply(np.broadcast_to(np.sqrt(weight), x.shape), x))
    return cp.sum(cp.multiply(np.broadcast_to(weight, x.shape), cp.square(x)))


def f5_reactive(site: Site, v: Variables, p: Parameters) -> cp.Expression:
    """Squared utilisation of the inverters by reactive power, without unit."""
    return cp.sum_squares(cp.multiply(1 / site.pv.s_max_kva[None, :], v.Q_pv)) + cp.sum_squares(
        cp.multiply(1 / site.batteries.s_max_kva[None, :], v.Q_batt)
    )
