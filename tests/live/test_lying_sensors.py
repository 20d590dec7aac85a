"""Sensors that lie: with grid nobody of the first tier is off for it. The rest is for the night."""

from __future__ import annotations

import pytest

from tests.support.lying_sensors import (
    Begun,
    Lie,
    begun,
    lies_of,
    low_voltage_site,
    off_with_grid,
    pairs_of,
    place_of,
)

STEPS = 3


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Begun:
    """Three hours of the street with grid."""
    place = place_of(low_voltage_site(), 9, STEPS + 1, dark=STEPS)
    return begun(place, 0, tmp_path_factory.mktemp("street"))


def told(street: Begun, *named: str) -> list[Lie]:
    """The lies of these names."""
    return [one for one in lies_of(street.place.site) if str(one) in named]


@pytest.mark.parametrize("named", [
    ("grid_on of grid: lost",),
    ("grid_on of grid: lost once",),
    ("load_kw of H1: nine times",),
    ("load_kw of all: nine times", "import_kw of grid: in W"),
    ("load_kw of H1: in W", "import_kw of grid: in W"),
])  # fmt: skip
def test_nobody_of_the_first_tier_is_off_for_a_lie(street: Begun, named: tuple[str, ...]) -> None:
    lies = told(street, *named)
    assert len(lies) == len(named)
    assert off_with_grid(street, lies) == []


def test_there_are_enough_lies_and_pairs_come_again_from_their_seed(street: Begun) -> None:
    lies = lies_of(street.place.site)
    assert len({str(one) for one in lies}) == len(lies) >= 67
    assert pairs_of(lies, 20, 1) == pairs_of(lies, 20, 1) != pairs_of(lies, 20, 2)


def test_two_that_agree_on_a_loss_are_acted_on(street: Begun) -> None:
    """As a true loss is, since nothing tells them apart: no such pair is drawn."""
    lost, zero = told(street, "grid_on of grid: lost", "import_kw of grid: zero")
    assert off_with_grid(street, [lost, zero]) != []
    drawn = pairs_of(lies_of(street.place.site), 10**6, 0)
    assert len(drawn) > 2000
    assert {lost, zero} not in [{*pair} for pair in drawn]
