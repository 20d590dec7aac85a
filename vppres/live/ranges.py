"""The numbers that a quantity can have: one table, for whatever lets numbers in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.io.schema import MAX_KW, MAX_PRICE
from vppres.scenario.scenario import Scenario

RATED_SHARE = 1.5
"""A reading above this share of an inverter's rating is in another unit, or a spike."""

ABOVE_BAND_C = 40.0
"""A temperature so far above its comfort band is in another unit, or a spike."""


@dataclass(frozen=True)
class Range:
    """The numbers that a quantity can have.

    Parameters
    ----------
    lowest, highest : float
        Ends, included.
    message, cure : str
        What to say of a number outside.
    beyond : str
        What to say of a number above, if it is not the same.
    infinite : bool
        Whether it may be infinite.
    whole : bool
        Whether it lies at one of the ends, and not between.
    """

    lowest: float
    highest: float
    message: str
    cure: str
    beyond: str = ""
    infinite: bool = False
    whole: bool = False

    def holds(self, value: float) -> bool:
        """Whether a number is in the range."""
        if self.whole:
            return value in (self.lowest, self.highest)
        return self.lowest <= value <= self.highest or (self.infinite and value == np.inf)

    def text(self, value: float) -> str:
        """What to say of a number that is not."""
        above = np.isfinite(value) and value > self.highest and self.beyond != ""
        return self.beyond if above else self.message


NIGHT_SHARE = 0.01
"""Share of its rating that an inverter takes from the feeder at night, at most."""

Ranges = Mapping[tuple[str, str], Range]  # by quantity and asset, where an asset has its own

_FINITE = "must be a finite number"
_NUMBER = "must be a number not below 0"
_CORRECT = "Correct the measurement."
_UNIT = "is more than any feeder has: check the unit"
_POWER = Range(0.0, MAX_KW, _NUMBER, _CORRECT, _UNIT)
_LIMIT = Range(0.0, 1e9, _NUMBER, _CORRECT, _UNIT, infinite=True)
_PRICE = Range(-MAX_PRICE, MAX_PRICE, _FINITE, _CORRECT, "is more than any price")
# No cell loses nine tenths one way; smaller shares would only spoil the numbers.
_EFFICIENCY = Range(0.1, 1.0, "must lie between 0.1 and 1", "Give a share, for example 0.95.")
_OR = "must be 0 or 1"
_FLAG = Range(0.0, 1.0, _OR, "Give 1 where it is there and can work, else 0.", whole=True)
_DEGREES = "Give degrees Celsius."
_LITRES = "Give what is in the tank, in l."
RANGES: Mapping[str, Range] = {
    "soc": Range(0.0, 1.0, "must lie between 0 and 1", "Give a share, for example 0.5."),
    "load_kw": _POWER,
    "pv_kw": _POWER,
    "price_gbp_per_kwh": _PRICE,
    "grid_limit_kw": _LIMIT,
    "announced_limit_kw": _LIMIT,
    "export_limit_kw": _LIMIT,
    "export_price_gbp_per_kwh": _PRICE,
    "temperature_c": Range(-50.0, 60.0, "must lie between -50 and 60", _CORRECT),
    "eta_charge": _EFFICIENCY,
    "eta_discharge": _EFFICIENCY,
    "battery_kw": Range(-MAX_KW, MAX_KW, _FINITE, _CORRECT, _UNIT),
    "ordered_kw": Range(-MAX_KW, MAX_KW, _FINITE, _CORRECT, _UNIT),
    "source_kva": _POWER,
    "v_pu": Range(0.0, 2.0, "must lie between 0 and 2", "Give a share of the nominal voltage."),
    "import_kw": Range(-10.0 * MAX_KW, 10.0 * MAX_KW, _FINITE, _CORRECT, _UNIT),
    "online": _FLAG,
    "plugged": _FLAG,
    "ev_soc": Range(0.0, 1.0, "must lie between 0 and 1", "Give a share, for example 0.5."),
    "energy_needed_kwh": _POWER,
    "departure": Range(0.0, 7.3e9, "must be seconds since 1970", "Give a time of this century."),
    "indoor_c": Range(-50.0, 100.0, "must lie between -50 and 100", _DEGREES),
    "running": _FLAG,
    "genset_kw": _POWER,
    "genset_ordered_kw": _POWER,
    "fuel_litres": Range(0.0, 1e7, _NUMBER, _LITRES, "is more than any tank: check the unit"),
    "start_fault": Range(0.0, 1.0, _OR, "Give 1 if it failed to start, else 0.", whole=True),
    "grid_on": _FLAG,
}


def ranges_of(scenario: Scenario) -> Ranges:
    """What inverters and sets of a site can give, rooms become and tanks hold, by asset.

    Examples
    --------
    >>> import vppres
    >>> ranges_of(vppres.load_scenario("uk-heatwave-2022"))["battery_kw", "b02"].highest
    67.5
    """
    b, pv, sets = scenario.batteries, scenario.pv, scenario.gensets
    loads = scenario.thermal_loads
    own: tuple[tuple[str, Any, Floats, Callable[[float], Range]], ...] = (
        ("battery_kw", b, b.s_max_kva, lambda kva: _rated(-RATED_SHARE, "inverter", kva, _FINITE)),
        ("pv_kw", pv, pv.p_max_kw, _of_pv),
        ("indoor_c", loads, loads.t_max_c, _temperature),
        ("genset_kw", sets, sets.p_max_kw, lambda kw: _rated(0.0, "set", kw, _NUMBER)),
        ("fuel_litres", sets, sets.tank_litres, _in_tank),
    )
    return {
        (quantity, str(name)): range_of(value)
        for quantity, devices, values, range_of in own
        for name, value in zip(devices.id, values.tolist(), strict=True)
    }


def _of_pv(kw: float) -> Range:
    """Down to what an inverter takes for itself at night, which counts as nothing."""
    return replace(_rated(0.0, "system", kw, _NUMBER), lowest=-NIGHT_SHARE * kw)


def _in_tank(litres: float) -> Range:
    """Up to more than what a tank holds."""
    beyond = f"is more than its tank of {litres:g} l holds"
    return replace(RANGES["fuel_litres"], highest=RATED_SHARE * litres, beyond=beyond)


def _temperature(t_max_c: float) -> Range:
    """Up to what no room or tank of this comfort band becomes."""
    beyond = f"is more than {ABOVE_BAND_C:g} K above its comfort band: check the unit"
    every = RANGES["indoor_c"]
    return replace(every, highest=min(t_max_c + ABOVE_BAND_C, every.highest), beyond=beyond)


def _rated(lowest_share: float, what: str, rating: float, no_number: str) -> Range:
    """Up to a share of a rating, and at most what any feeder has."""
    unit = "kVA" if what == "inverter" else "kW"
    beyond = f"is beyond the {what}'s rating of {rating:g} {unit}"
    below = beyond if lowest_share else no_number
    return Range(
        lowest_share * rating, RATED_SHARE * rating, below, "Give the power in kW.", beyond
    )
