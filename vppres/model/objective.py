"""The five terms of the objective (paper, Section 3.3).

For steps other than 1 h, ``f1`` and ``f3`` are multiplied by the step length in hours, so that the
objective of an interval does not depend on how finely it is cut.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


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


def f5_reactive(site: Site, v: Variables, p: Parameters) -> cp.Expression:
    """Squared utilisation of the inverters by reactive power, without unit."""
    return cp.sum_squares(cp.multiply(1 / site.pv.s_max_kva[None, :], v.Q_pv)) + cp.sum_squares(
        cp.multiply(1 / site.batteries.s_max_kva[None, :], v.Q_batt)
    )
