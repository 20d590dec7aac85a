"""Sites of live services by the names that sequences give them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from tests.support.live_service import site, with_units
from tests.support.switching_service import switched
from tests.support.three_phases import three_phases
from tests.support.tiny_day import tiny_scenario
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches


def tiny() -> Scenario:
    """A day of the tiny feeder in hours, without outage."""
    return site(tiny_scenario())


def units() -> Scenario:
    """With a van, a home that is cooled, and a set that runs in an outage."""
    return with_units(tiny_scenario())


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
        "switched": switched,
        "switched by phase": lambda: three_phases(switched()),
        "three switches": three_switches,
        "three switches by phase": lambda: three_phases(three_switches()),
    }
)
