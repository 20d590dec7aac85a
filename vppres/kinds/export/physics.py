"""Limit and price of the export over a window, and what plans may do with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import ByStep, Floats, Wholes, freeze_arrays
from vppres.scenario.scenario import Scenario

CIRCLE_KW = 1e-4
"""By how much charging may exceed import and PV export after import and export were netted."""

EXPLOITED_GBP = 1e-5
"""Earnings of exchange in both directions above which it counts as exploited."""


@dataclass(frozen=True, eq=False)
class Export(ByStep):
    """Export over a window of W steps; a connection that imports only has none.

    Examples
    --------
    >>> Export([50.0, 0.0], [0.1, 0.1]).part(slice(1)).limit_kw
    array([50.])
    """

    limit_kw: Floats  #: largest export, 0 in an outage, may be infinite, (W,)
    price_gbp_per_kwh: Floats  #: what exported energy earns, negative where it costs, (W,)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @classmethod
    def of(
        cls, scenario: Scenario, rows: Wholes | slice, believed_kw: Floats | None = None
    ) -> Export | None:
        """Export of some steps of a scenario, None where its connection imports only.

        ``believed_kw``, (W,), are limits of import that are believed, whatever outages come. A
        scenario that exports in any step has one in every window, so that all its windows are of
        one kind and a problem is compiled once.
        """
        if not scenario.exports:
            return None
        grid_limit_kw = scenario.grid_limit_kw[rows] if believed_kw is None else believed_kw
        limit_kw = np.broadcast_to(scenario.export_limit_kw, scenario.outage.shape)
        return cls(limit_kw[rows], scenario.export_price[rows]).within(grid_limit_kw)

    def within(self, grid_limit_kw: Floats) -> Export:
        """Export with limits of 0 in an outage, where the grid gives nothing."""
        return Export(np.where(grid_limit_kw > 0.0, self.limit_kw, 0.0), self.price_gbp_per_kwh)

    def earns_both_ways(self, price_gbp_per_kwh: Floats, grid_limit_kw: Floats) -> bool:
        """Whether importing and exporting at once would earn in a step with grid."""
        both = (grid_limit_kw > 0.0) & (self.limit_kw > 0.0)
        return bool((both & (self.price_gbp_per_kwh > price_gbp_per_kwh)).any())

    def stands_netted(
        self, price_gbp_per_kwh: Floats, dispatch: Dispatch, both_kw: Floats, dt_h: float
    ) -> bool:
        """Whether a dispatch stands whose import and export of the same step were netted.

        ``both_kw``, (W,), is what was imported and exported at the same time.
        """
        margin = np.maximum(self.price_gbp_per_kwh - price_gbp_per_kwh, 0.0)
        fed = np.maximum(dispatch.p_grid_kw, 0.0) + dispatch.pv_export_kw.sum(axis=1)
        circle = dispatch.charge_kw.sum(axis=1) - fed
        exploited = float(margin @ both_kw) * dt_h
        return exploited <= EXPLOITED_GBP and bool((circle <= CIRCLE_KW).all())
