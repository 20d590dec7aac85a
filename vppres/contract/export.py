"""Limit and price of the export over a window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats, Wholes, freeze_arrays
from vppres.core.by_step import ByStep
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Export(ByStep):
    """Export over a window of W steps; a connection that imports only has none.

    Parameters
    ----------
    limit_kw : array, shape (W,)
        Largest export, 0 in an outage, may be infinite.
    price_gbp_per_kwh : array, shape (W,)
        What exported energy earns, negative where it costs.

    Examples
    --------
    >>> Export([50.0, 0.0], [0.1, 0.1]).part(slice(1)).limit_kw
    array([50.])
    """

    limit_kw: Floats
    price_gbp_per_kwh: Floats

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @classmethod
    def of(cls, scenario: Scenario, rows: Wholes | slice) -> Export | None:
        """Export of some steps of a scenario, None where its connection imports only.

        A scenario that exports in any step has one in every window, so that all its windows are of
        one kind and a problem is compiled once.
        """
        if not scenario.exports:
            return None
        return cls(scenario.export_max_kw[rows], scenario.export_price[rows])

    @classmethod
    def believed(
        cls, scenario: Scenario, rows: Wholes | slice, grid_limit_kw: Floats
    ) -> Export | None:
        """Export under believed import limits, (W,), whatever outages come."""
        if not scenario.exports:
            return None
        limit_kw = np.broadcast_to(scenario.export_limit_kw, scenario.price_gbp_per_kwh.shape)
        return cls(limit_kw[rows], scenario.export_price[rows]).within(grid_limit_kw)

    def within(self, grid_limit_kw: Floats) -> Export:
        """Export with limits of 0 in an outage, where the grid gives nothing."""
        return Export(np.where(grid_limit_kw > 0.0, self.limit_kw, 0.0), self.price_gbp_per_kwh)
