"""State of charge to hold where the known steps end, so that the next ones find charged batteries.

A window that ends with the run, or where a live controller knows no more, sees no use for energy
beyond. What is missing there to a state of charge costs more than any import of the window does:
it is bought or kept where that is possible, but no service is given up for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.contract.forecast import Forecast
from vppres.core.arrays import Floats
from vppres.scenario.assets import Batteries

OVER_IMPORT = 2.0
"""Price of a missing kWh as a multiple of the dearest of the window: more than what is lost by
storing it and taking it out again, which is less than half."""

LEAST_PRICE_GBP_PER_KWH = 0.01
"""Price of the missing energy where energy is free, or pays."""


@dataclass(frozen=True)
class Terminal:
    """State of charge at the end of a window, and what a missing kWh costs.

    Examples
    --------
    >>> Terminal(0.5, 0.8).price_gbp_per_kwh
    0.8
    """

    soc: float  #: share of each battery's capacity, or its own limit where that is nearer
    price_gbp_per_kwh: float  #: price of each kWh that is missing

    @classmethod
    def of(cls, soc: float | None, forecast: Forecast, ends: bool) -> Terminal | None:
        """The end of a window of which a forecast is known.

        The end holds ``soc``, if any; with ``ends`` nothing is known of the steps behind it.
        """
        return cls(soc, _missing_price(forecast)) if soc is not None and ends else None

    def target_kwh(self, batteries: Batteries) -> Floats:
        """Energy that each battery is to hold, (B,)."""
        soc = np.clip(self.soc, batteries.soc_min, batteries.soc_max)
        return np.asarray(soc * batteries.energy_kwh)

    def cost_gbp(self, batteries: Batteries, soc_end: Floats) -> float:
        """Price of the energy that is missing at the end to the target, in GBP."""
        missing = np.maximum(self.target_kwh(batteries) - soc_end * batteries.energy_kwh, 0.0)
        return self.price_gbp_per_kwh * float(missing.sum())


def _missing_price(forecast: Forecast) -> float:
    """Price of a kWh that is missing at the end of a window, in GBP."""
    dearest = float(np.max(forecast.price_gbp_per_kwh))
    if forecast.export is not None:
        dearest = max(dearest, float(np.max(forecast.export.price_gbp_per_kwh)))
    return max(OVER_IMPORT * dearest, LEAST_PRICE_GBP_PER_KWH)
