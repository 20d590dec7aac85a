"""Sites of live services by the names that sequences give them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from tests.support.live_service import site, with_units
from tests.support.tiny_day import tiny_scenario
from vppres.scenario.scenario import Scenario


def tiny() -> Scenario:
    """A day of the tiny feeder in hours, without outage."""
    return site(tiny_scenario())


def units() -> Scenario:
    """With a van, a home that is cooled, and a set that runs in an outage."""
    return with_units(tiny_scenario())


SITES: Mapping[str, Callable[[], Scenario]] = MappingProxyType({"tiny": tiny, "units": units})
