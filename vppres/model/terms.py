"""The terms of the objective (paper, Section 3.3), recomputed from a dispatch's arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.objective import f4_squares, f5_squares
from vppres.model.site import Site
from vppres.model.variables import FIELDS
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
    terms = {
        "f1": float((dispatch.served @ site.customers.weight).sum() * site.dt_h),
        "f2": float(data.price_gbp_per_kwh @ dispatch.p_grid_kw * site.dt_h),
        "f3": float(dispatch.pv_curtailed_kw.sum() * site.dt_h),
        "f4": _sum_of(f4_squares(site), dispatch),
        "f5": _sum_of(f5_squares(site), dispatch),
        "f6": data.switching.price(dispatch.served) if data.switching else 0.0,
        "f7": 0.0,
        "own": 0.0,
    }
    for addition, _ in beyond_paper(site, data):
        for name, value in addition.worth(site, data, dispatch).items():
            terms[name] += value
    return Terms(**(terms if own is None else terms | {"own": own}))


def _sum_of(squares: dict[str, Floats], dispatch: Dispatch) -> float:
    """Weighted squares of what a dispatch has for letters."""
    found = (np.square(getattr(dispatch, FIELDS[n])) @ weight for n, weight in squares.items())
    return float(sum(each.sum() for each in found))
