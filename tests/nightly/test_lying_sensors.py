"""Every lie of every sensor on three sites, alone and in pairs: nobody of the first tier is off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import vppres
from tests.support.lying_sensors import (
    Begun,
    begun,
    lies_of,
    low_voltage_site,
    off_with_grid,
    pairs_of,
    place_of,
)
from tests.support.phased_feeder import CIRCUIT, day_of

PAIRS, SEED = 60, 57
FIRST, STEPS, DARK = 9, 6, 3
STARTS = (0, 2)
SITES = ("street", "uk-heatwave-2022", "phased")


@pytest.fixture(scope="module", params=SITES)
def places(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> dict[int, Begun]:
    """Six hours of a site, of which the fourth is an outage, by the step from which sensors lie."""
    folder: Path = tmp_path_factory.mktemp("lies")
    if request.param == "phased":
        pytest.importorskip("opendssdirect")
        site = day_of(CIRCUIT, folder)
    else:
        packaged = request.param != "street"
        site = vppres.load_scenario(request.param) if packaged else low_voltage_site()
    place = place_of(site, FIRST, STEPS, DARK)
    return {since: begun(place, since, folder / str(since)) for since in STARTS}


@pytest.mark.parametrize("since", STARTS)
def test_one_sensor_that_lies(places: dict[int, Begun], since: int) -> None:
    start = places[since]
    lies = [replace(lie, since=since) for lie in lies_of(start.place.site)]
    found = {str(lie): off_with_grid(start, [lie]) for lie in lies}
    assert {lie: off for lie, off in found.items() if off} == {}


def test_two_sensors_that_lie(places: dict[int, Begun]) -> None:
    lies = lies_of(places[0].place.site)
    found = {}
    for one, other in pairs_of(lies, PAIRS, SEED, STARTS):
        first = min(one.since, other.since)
        off = off_with_grid(places[first], [one, other])
        found[f"{one} from {one.since}, {other} from {other.since}"] = off
    assert {lies: off for lies, off in found.items() if off} == {}
