"""Sites of live services by the names that sequences give them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from tests.support.homes import homes
from tests.support.live_service import NOON, site, with_units
from tests.support.sets import gensets
from tests.support.switching_service import switched
from tests.support.three_phases import three_phases
from tests.support.tiny_day import tiny_scenario
from tests.support.vans import van
from vppres.scenario.outage_warnings import OutageStatistics
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches


def tiny() -> Scenario:
    """A day of the tiny feeder in hours, without outage."""
    return site(tiny_scenario())


def units() -> Scenario:
    """With a van, a home that is cooled, and a set that runs in an outage."""
    return with_units(tiny_scenario())


def genset() -> Scenario:
    """With a set that all of its demand can be served by."""
    return replace(tiny(), gensets=gensets(bus=[4], p_min_kw=10.0))


def cooled() -> Scenario:
    """With a home that its shop cools and a tank of the hospital that is heated."""
    tank: dict[str, Any] = {
        "heats": [False, True],
        "r_c_per_kw": [5.0, 50.0],
        "c_kwh_per_c": [8.0, 0.3],
        "t_min_c": [20.0, 50.0],
        "t_max_c": [26.0, 60.0],
        "t_initial_c": [24.0, 55.0],
        "gain_kw": [0.5, -0.1],
    }
    return replace(tiny(), thermal_loads=homes("shop", "hospital", **tank))


def equipped() -> Scenario:
    """With these, a charger whose vehicle leaves at 14:00, and homes that may be dimmed."""
    day, midnight = cooled(), NOON.normalize()
    charger, vehicle = van(midnight, midnight + pd.Timedelta("14h"))
    dimmable = replace(day.customers, share_min=[1.0, 1.0, 0.5])
    return replace(day, customers=dimmable, chargers=charger, sessions=vehicle)


def charger(leaves: str = "12:00", comes: str = "00:00") -> Scenario:
    """With a charger, at which a van is from midnight on; by default it has left before noon."""
    midnight = NOON.normalize()
    there, vehicle = van(*(midnight + pd.Timedelta(f"{time}:00") for time in (comes, leaves)))
    return replace(tiny(), chargers=there, sessions=vehicle)


def dimming_shop() -> Scenario:
    """A shop of 40 kW that may have a quarter of it, and homes of 5 kW, without PV power."""
    day = tiny()
    dimmable = replace(day.customers, share_min=[1.0, 0.25, 1.0])
    load_kw = np.tile([0.0, 40.0, 5.0], (len(day.load_kw), 1))
    return replace(day, customers=dimmable, load_kw=load_kw, pv_kw=0.0 * day.pv_kw)


def quiet() -> Scenario:
    """Every outage is announced."""
    return replace(tiny(), outage_statistics=OutageStatistics("none"))


def no_pv() -> Scenario:
    """Without PV power."""
    return replace(tiny(), pv_kw=0.0 * tiny().pv_kw)


def last_former() -> Scenario:
    """With a diesel that forms the grid where the battery, nearly empty, does not."""
    forms = replace(tiny().batteries, grid_forming=[True, False])
    sets = gensets(bus=[4], p_min_kw=10.0, grid_forming=True)
    return replace(tiny(), batteries=forms, gensets=sets)


def three_switches() -> Scenario:
    """The tie from 3 to 4, and a switch on each of the lines from 2."""
    none = np.nan
    kinds = ["tie", "sectionaliser", "sectionaliser"]
    line = {"r_ohm": [0.5, none, none], "x_ohm": [0.4, none, none]}
    switches = Switches(["t", "s", "u"], [3, 2, 2], [4, 3, 4], kinds, [False, True, True], **line)
    return replace(tiny(), switches=switches)


SITES: Mapping[str, Callable[[], Scenario]] = MappingProxyType(
    {
        "tiny": tiny,
        "units": units,
        "genset": genset,
        "cooled": cooled,
        "equipped": equipped,
        "charger": charger,
        "van": lambda: charger("24:00"),
        "van at one": lambda: charger("20:00", "13:00"),
        "dimming shop": dimming_shop,
        "quiet": quiet,
        "no pv": no_pv,
        "last former": last_former,
        "switched": switched,
        "switched by phase": lambda: three_phases(switched()),
        "three switches": three_switches,
        "three switches by phase": lambda: three_phases(three_switches()),
    }
)
