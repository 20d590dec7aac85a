"""The bound of uncertain outages: against full knowledge, by hand, and by its own averages."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
import pytest

from experiments.studies import outage_ceiling
from experiments.studies.outage_ceiling import (
    MEANS,
    POINTS,
    _next_means,
    best_resilience,
    heatwave,
    played,
    rationing,
)
from experiments.studies.outage_days import Outage, OutageClimate, OutageDay, draw_outage_day
from vppres.scenario.outage_warnings import OutageWarning


@pytest.fixture
def sure(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A climate in which every outage lasts four hours."""
    monkeypatch.setattr(outage_ceiling, "CLIMATE", OutageClimate(duration_sigma=1e-3))
    rationing.cache_clear()
    yield
    rationing.cache_clear()


@pytest.mark.usefixtures("sure")
def test_who_is_sure_of_the_length_rations_as_if_it_were_known() -> None:
    scenario, plate = heatwave()
    midnight = scenario.grid.start
    outage = Outage(17.0, 4.0)
    said = tuple(
        OutageWarning(midnight + hour * pd.Timedelta(hours=1), "announced", duration_p50_h=4.0)
        for hour in outage.steps
    )
    best = best_resilience(OutageDay(outage, True, None, said))
    exact = np.zeros(POINTS)
    for t in reversed(outage.steps):
        exact = (plate.out[t] + exact).max(axis=1)
    everyone = 4.0 * scenario.customers.weight.sum()
    assert best == pytest.approx(exact[-1] / everyone, abs=1e-3)


def test_messages_to_come_are_right_on_average() -> None:
    """Before anything is excluded the expected belief is the present one."""
    for precision in (4.0, 9.0):
        chance = _next_means(-1, precision)
        assert chance.sum(axis=1) == pytest.approx(1.0)
        inside = np.abs(MEANS) < 0.5
        assert (chance @ MEANS)[inside] == pytest.approx(MEANS[inside], abs=0.01)


def test_outlasting_a_length_makes_it_longer() -> None:
    middle = int(np.argmin(np.abs(MEANS)))
    expected = [_next_means(j, 5.0)[middle] @ MEANS for j in (-1, 3, 6)]
    assert expected == sorted(expected)
    assert expected[-1] > expected[0] + 0.1


def test_energy_later_is_worth_less_the_more_there_is() -> None:
    behind = rationing(12, 3).behind[2]
    slope = np.diff(behind, axis=1)
    assert (slope >= -1e-9).all()
    assert (rationing(12, 3).behind[-1] == 0.0).all()


def test_who_knows_all_does_better_than_the_bound_and_who_spends_all_at_once_worse() -> None:
    scenario, plate = heatwave()
    everyone = scenario.customers.weight.sum()
    found = []
    for seed in range(20):
        day = draw_outage_day(seed, scenario.grid.start)
        if len(day.outages) != 1:
            continue
        steps = [t for t in day.outages[0].steps if t < plate.ahead.n_steps]
        exact = np.zeros(POINTS)
        for t in reversed(steps):
            exact = (plate.service[t] + exact).max(axis=1)
        energy = POINTS - 1
        spent = 0.0
        for t in steps:
            chosen = int(np.argmax(plate.out[t, energy]))
            spent += plate.service[t, energy, chosen]
            energy = chosen
        found.append(
            [spent / everyone / len(steps), best_resilience(day), exact[-1] / everyone / len(steps)]
        )
    at_once, best, all_known = np.array(found).T
    assert (best <= all_known + 1e-9).all()
    assert best.mean() > at_once.mean() + 0.01


def test_a_day_without_outage_costs_what_is_bought() -> None:
    """Nothing stored, nothing sold: the demand less PV at its price."""
    _, plate = heatwave()
    keep = np.full(POINTS, -1e9)
    keep[0] = 0.0
    share, cost = played(plate, np.zeros(24, dtype=bool), lambda t: (keep, 1.0))
    assert share is None
    net = np.maximum(plate.ahead.total_kw - plate.ahead.pv_kw, 0.0)
    assert cost == pytest.approx(float(net @ plate.ahead.price_gbp_per_kwh))
