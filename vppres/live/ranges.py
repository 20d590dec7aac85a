"""The numbers that a quantity can have: one table, for whatever lets numbers in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from vppres.core.arrays import Floats
from vppres.io.schema import MAX_KW, limits, row_of
from vppres.kinds.table import SERIES, parts
from vppres.live.range import (
    CORRECT,
    EFFICIENCY,
    FINITE,
    LIMIT,
    NUMBER,
    POWER,
    PRICE,
    RATED_SHARE,
    UNIT,
    Range,
    flag,
    rated,
)
from vppres.scenario.scenario import Scenario

NIGHT_SHARE = 0.01
"""Share of its rating that an inverter takes from the feeder at night, at most."""

Ranges = Mapping[tuple[str, str], Range]  # by quantity and asset, where an asset has its own


def series_range(name: str) -> Range:
    """The numbers of a series of a kind."""
    lowest, highest = limits(row_of(name).model_fields[name])
    return Range(lowest, highest, f"must lie between {lowest:g} and {highest:g}", CORRECT)


RANGES: Mapping[str, Range] = {
    "soc": Range(0.0, 1.0, "must lie between 0 and 1", "Give a share, for example 0.5."),
    "load_kw": POWER,
    "pv_kw": POWER,
    "price_gbp_per_kwh": PRICE,
    "grid_limit_kw": LIMIT,
    "announced_limit_kw": LIMIT,
    "export_limit_kw": LIMIT,
    "export_price_gbp_per_kwh": PRICE,
    "temperature_c": Range(-50.0, 60.0, "must lie between -50 and 60", CORRECT),
    "eta_charge": EFFICIENCY,
    "eta_discharge": EFFICIENCY,
    "battery_kw": Range(-MAX_KW, MAX_KW, FINITE, CORRECT, UNIT),
    "ordered_kw": Range(-MAX_KW, MAX_KW, FINITE, CORRECT, UNIT),
    "source_kva": POWER,
    "v_pu": Range(0.0, 2.0, "must lie between 0 and 2", "Give a share of the nominal voltage."),
    "import_kw": Range(-10.0 * MAX_KW, 10.0 * MAX_KW, FINITE, CORRECT, UNIT),
    "online": flag("it is there and can work"),
    "grid_on": flag("there is grid"),
    "closed": flag("it is closed"),
    **{name: each for part in parts("live").values() for name, each in part.RANGES.items()},
    **{name: series_range(name) for name in SERIES},
}


def ranges_of(scenario: Scenario) -> Ranges:
    """Ranges of a site's inverters, sets, rooms and tanks, by quantity and asset.

    Examples
    --------
    >>> import vppres
    >>> ranges_of(vppres.load_scenario("uk-heatwave-2022"))["battery_kw", "b02"].highest
    67.5
    """
    b, pv = scenario.batteries, scenario.pv
    own: tuple[tuple[str, Any, Floats, Callable[[float], Range]], ...] = (
        ("battery_kw", b, b.s_max_kva, lambda kva: rated(-RATED_SHARE, "inverter", kva, FINITE)),
        ("pv_kw", pv, pv.p_max_kw, _of_pv),
        *(row for part in parts("live").values() for row in part.own_ranges(scenario)),
    )
    return {
        (quantity, str(name)): range_of(value)
        for quantity, devices, values, range_of in own
        for name, value in zip(devices.id, values.tolist(), strict=True)
    }


def _of_pv(kw: float) -> Range:
    """Down to what an inverter takes for itself at night, which counts as nothing."""
    return replace(rated(0.0, "system", kw, NUMBER), lowest=-NIGHT_SHARE * kw)
