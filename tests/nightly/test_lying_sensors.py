"""Every lie of every sensor on three sites, alone and in pairs: nobody of the first tier is off."""

from __future__ import annotations

from pathlib import Path

import pytest

import vppres
from tests.support.lying_sensors import (
    Place,
    lies_of,
    low_voltage_site,
    off_with_grid,
    pairs_of,
    place_of,
)
from tests.support.phased_feeder import CIRCUIT, phased_day

PAIRS, SEED = 60, 57
FIRST, STEPS, DARK = 9, 6, 3
SITES = ("street", "uk-heatwave-2022", "phased")


@pytest.fixture(scope="module", params=SITES)
def place(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Six hours of a site, of which the fourth is an outage."""
    if request.param == "phased":
        pytest.importorskip("opendssdirect")
        file: Path = tmp_path_factory.mktemp("lies") / "small.dss"
        file.write_text(CIRCUIT)
        site = phased_day(file)
    else:
        packaged = request.param != "street"
        site = vppres.load_scenario(request.param) if packaged else low_voltage_site()
    return place_of(site, FIRST, STEPS, DARK)


@pytest.mark.parametrize("since", [0, 2])
def test_one_sensor_that_lies(place: Place, since: int) -> None:
    found = {str(lie): off_with_grid(place, [lie], since) for lie in lies_of(place.site)}
    assert {lie: off for lie, off in found.items() if off} == {}


@pytest.mark.parametrize("since", [0, 2])
def test_two_sensors_that_lie(place: Place, since: int) -> None:
    pairs = pairs_of(lies_of(place.site), PAIRS, SEED)
    found = {f"{one}, {other}": off_with_grid(place, [one, other], since) for one, other in pairs}
    assert {lies: off for lies, off in found.items() if off} == {}
