"""The terms of the objective (paper, Section 3.3), recomputed from a dispatch's arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.scenario import ObjectiveWeights


@dataclass(frozen=True)
class Terms:
    """The terms of the objective (paper, Section 3.3), summed over a window.

    ``f6`` is the price of switching actions and of hours beyond longest times off, ``f7`` the later
    service that stored energy is worth, both in weighted customer hours; the paper has neither.
    ``own`` is what the page's objective has besides.
    """

    f1: float
    f2: float
    f3: float
    f4: float
    f5: float
    f6: float = 0.0
    f7: float = 0.0
    own: float = 0.0

    def total(self, weights: ObjectiveWeights) -> float:
        """The objective F."""
        return self.upper_levels(weights) - weights.lambda_l * self.f4 - weights.lambda_q * self.f5

    def upper_levels(self, weights: ObjectiveWeights) -> float:
        """F without the two tie-breakers; never below F, since f4 and f5 are not negative."""
        now = self.f1 - weights.lambda_grid * self.f2 - weights.lambda_curt * self.f3 - self.f6
        return now + self.f7 + self.own


def evaluate(site: Site, data: WindowData, dispatch: Dispatch, own: float | None = None) -> Terms:
    """Objective terms of a dispatch, recomputed from its arrays, ``own`` if it is not given."""
    flow2 = dispatch.p_flow_kw**2 + dispatch.q_flow_kvar**2
    use = np.square(dispatch.pv_q_kvar / site.pv.s_max_kva).sum()
    use += np.square(dispatch.batt_q_kvar / site.batteries.s_max_kva).sum()
    terms = {
        "f1": float((dispatch.served @ site.customers.weight).sum() * site.dt_h),
        "f2": float(data.price_gbp_per_kwh @ dispatch.p_grid_kw * site.dt_h),
        "f3": float(dispatch.pv_curtailed_kw.sum() * site.dt_h),
        "f4": float((flow2 @ site.network.r_ohm).sum()),
        "f5": float(use),
        "f6": data.switching.price(dispatch.served) if data.switching else 0.0,
        "f7": 0.0,
        "own": 0.0,
    }
    for addition, _ in beyond_paper(site, data):
        for name, value in addition.worth(site, data, dispatch).items():
            terms[name] += value
    return Terms(**(terms if own is None else terms | {"own": own}))
