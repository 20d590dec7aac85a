"""Random days with outages and warnings: what is announced is as likely as it says."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from experiments.studies.outage_days import (
    OutageClimate,
    OutageDay,
    biased,
    draw_outage_day,
    with_outage_day,
)
from experiments.studies.uncertain import heatwave, known_path, sampled
from vppres.outlook.belief import OutageBelief
from vppres.outlook.outlook import OutageOutlook

MIDNIGHT = pd.Timestamp("2022-07-19", tz="UTC")
HOUR = pd.Timedelta(hours=1)


@pytest.fixture(scope="module")
def days() -> list[OutageDay]:
    return [draw_outage_day(seed, MIDNIGHT) for seed in range(2000)]


@pytest.mark.nightly
def test_a_seed_makes_the_same_day_again(days: list[OutageDay]) -> None:
    assert draw_outage_day(7, MIDNIGHT) == days[7]
    assert len({day.warnings for day in days}) > 0.85 * len(days)


def test_kinds_come_as_often_as_the_climate_says(days: list[OutageDay]) -> None:
    climate = OutageClimate()
    warned = [day for day in days if day.expected is not None]
    assert len(warned) / len(days) == pytest.approx(climate.warned, abs=0.02)
    assert np.mean([day.comes for day in warned]) == pytest.approx(climate.comes, abs=0.03)
    surprised = np.mean([day.surprise is not None for day in days if not day.comes])
    assert surprised == pytest.approx(1.0 - np.exp(-23.0 * climate.hazard_per_h), abs=0.025)


def test_outages_come_as_often_as_their_last_warning_says(days: list[OutageDay]) -> None:
    last = [
        (warnings[-1].probability, day.comes)
        for day in days
        if (warnings := [w for w in day.warnings if w.probability not in (0.0, 1.0)])
    ]
    said, came = np.array(last, dtype=float).T
    for low, high in ((0.0, 0.6), (0.6, 0.8), (0.8, 1.0)):
        inside = (said >= low) & (said < high)
        error = 3.0 * np.sqrt(0.25 / inside.sum())
        assert inside.sum() > 200
        assert came[inside].mean() == pytest.approx(said[inside].mean(), abs=error)


@pytest.mark.parametrize(("quantile", "share"), [("p10", 0.1), ("p50", 0.5), ("p90", 0.9)])
def test_durations_lie_below_their_quantiles_as_often_as_said(
    days: list[OutageDay], quantile: str, share: float
) -> None:
    """At the first message: later ones are more where outages are long."""
    first = [
        (day.expected.duration_h, getattr(day.warnings[0], f"duration_{quantile}_h"))
        for day in days
        if day.expected is not None and day.warnings[0].outage == "announced"
    ]
    below = [truth <= said for truth, said in first]
    assert np.mean(below) == pytest.approx(share, abs=0.03)


def test_onsets_lie_within_the_announced_times(days: list[OutageDay]) -> None:
    """A triangle as wide as a normal distribution holds all but one in a hundred."""
    inside = [
        warning.onset_earliest - HOUR / 2
        <= MIDNIGHT + day.expected.onset_h * HOUR
        <= warning.onset_latest + HOUR / 2
        for day in days
        if day.expected is not None
        for warning in day.warnings
        if warning.onset_earliest is not None and warning.onset_latest is not None
    ]
    assert np.mean(inside) > 0.98


def test_nothing_is_said_before_it_is_known(days: list[OutageDay]) -> None:
    for day in days:
        times = [warning.issued_at for warning in day.warnings]
        assert times == sorted(times)
        sure = [warning.issued_at for warning in day.warnings if warning.probability == 1.0]
        hours = [hour for outage in day.outages for hour in outage.steps]
        assert sure == [MIDNIGHT + hour * HOUR for hour in sorted(hours)]


def test_a_scenario_gets_the_outages_of_the_day_and_no_other(days: list[OutageDay]) -> None:
    base = heatwave()
    for day in days[:40]:
        scenario = with_outage_day(base, day)
        hours = {hour for outage in day.outages for hour in outage.steps if hour < 24}
        assert set(np.flatnonzero(scenario.outage)) == hours
        assert np.array_equal(scenario.load_kw, base.load_kw)


def test_biased_warnings_are_wrong_about_durations_only(days: list[OutageDay]) -> None:
    warnings = next(day.warnings for day in days if len(day.warnings) > 3)
    for was, believed in zip(warnings, biased(warnings, 2.0, 0.5), strict=True):
        assert believed.probability == was.probability
        assert believed.onset_likely == was.onset_likely
        if was.duration_p50_h is not None:
            assert believed.duration_p50_h == pytest.approx(0.5 * was.duration_p50_h + 2.0)


def uncertain_belief() -> OutageBelief:
    onset = np.zeros((1, 12))
    onset[0, 3:6] = (0.2, 0.3, 0.1)
    return OutageBelief(onset, [[0.5, 0.5, 0, 0], [0, 0.4, 0.4, 0.2]], hazard=0.05)


def test_sampled_futures_are_those_of_the_belief() -> None:
    belief = uncertain_belief()
    rng = np.random.default_rng(0)
    share = np.mean([sampled(belief, rng) for _ in range(4000)], axis=0)
    np.testing.assert_allclose(share, belief.out_probability, atol=0.03)


@pytest.mark.parametrize("out", ["000111000", "111000110", "000000000", "111111111"])
def test_a_known_future_is_a_belief_of_zeros_and_ones(out: str) -> None:
    flags = np.array([letter == "1" for letter in out])
    path = known_path(flags)
    assert path.certain
    assert path.likely.tolist() == flags.tolist()
    assert path.out_probability.tolist() == flags.astype(float).tolist()


def test_what_was_said_makes_beliefs_that_hold_the_truth(days: list[OutageDay]) -> None:
    """At the last step before an announced onset, that step is the likeliest or next to it."""
    statistics = OutageClimate().statistics
    near = []
    for day in [day for day in days if day.comes and day.surprise is None][:200]:
        begin = day.expected.steps.start
        outlook = OutageOutlook(day.warnings, statistics, 1.0)
        belief = outlook.at(MIDNIGHT + (begin - 1) * HOUR, 24 - begin, [])
        near.append(abs(int(np.argmax(belief.onset[0])) - 1) <= 1)
    assert np.mean(near) > 0.9
