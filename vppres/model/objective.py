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
    return _sum_of(f4_squares(site), v)


def f5_reactive(site: Site, v: Variables, p: Parameters) -> cp.Expression:
    """Squared utilisation of the inverters by reactive power, without unit: (Q / S)²."""
    return _sum_of(f5_squares(site), v)


def f4_squares(site: Site) -> dict[str, Floats]:
    """Weight of the square of each letter in f4, by its last axis."""
    return {"P_flow": site.network.r_ohm, "Q_flow": site.network.r_ohm}


def f5_squares(site: Site) -> dict[str, Floats]:
    """Weight of the square of each letter in f5, by its last axis."""
    return {"Q_pv": site.pv.s_max_kva**-2.0, "Q_batt": site.batteries.s_max_kva**-2.0}


def _sum_of(squares: dict[str, Floats], v: Variables) -> cp.Expression:
    """Weighted squares of letters."""
    roots = {name: np.sqrt(weight)[None, :] for name, weight in squares.items()}
    return sum(cp.sum_squares(cp.multiply(root, getattr(v, n))) for n, root in roots.items())
