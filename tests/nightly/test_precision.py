"""Rows at the precision of a weighted solve, and the arithmetic of its gap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments import ideal
from experiments.config import read_config
from experiments.jobs import Job
from experiments.results import DayResult
from experiments.studies import precision
from experiments.studies.settings import At, Setting
from experiments.studies.weighted_gap import service_of, terms_beside_gap
from experiments.weighted import WeightedChoices
from tests.support.small_windows import OPEN, battery, two_buses, with_pv
from vppres.day.options import RunOptions
from vppres.scenario.scenario import ObjectiveWeights, Scenario

CONFIG = read_config("precision", folder=precision.FOLDER)


def test_a_setting_changes_how_a_day_is_solved_and_nothing_else() -> None:
    job = Job(options=RunOptions(controller="full-horizon", thermal="euler", seed=3))
    setting = Setting(unit_kw=1000.0, gap=1e-6, seed=4)
    changed = setting.of(job)
    assert changed.day == job.day
    restored = replace(
        changed.options,
        limits=job.options.limits,
    )
    assert restored == job.options
    assert changed.options.limits.gap_rel == 1e-6
    assert changed.weighted == WeightedChoices(unit_kw=1000.0, seed=4)
    assert changed.digest() != replace(changed, weighted=None).digest()
    assert str(setting) == "MW, gap 1e-06, HiGHS, seed 4"


def test_results_at_a_setting_are_those_of_its_days() -> None:
    setting = precision.named(CONFIG)
    plain = DayResult({"resilience": 0.9}, {}, {})
    weighted = DayResult({"resilience": 0.8}, {}, {})
    results = {ideal.FULL_HORIZON: plain, setting.of(ideal.FULL_HORIZON): weighted}
    assert At(setting, results)[ideal.FULL_HORIZON] is weighted
    assert At(None, results)[ideal.FULL_HORIZON] is plain


def test_the_study_has_the_named_setting_first_and_each_once() -> None:
    found = precision.settings(precision.study_config())
    assert found[0] == precision.named(CONFIG)
    assert len(found) == len(set(found)) == 10
    assert {setting.gap for setting in found} == {1e-4}


def test_smaller_gaps_are_seen_beside_the_named_one_in_each_unit() -> None:
    config = precision.study_config()
    found = [(one.unit_kw, one.gap) for one in precision.sharp_settings(config)]
    assert found == [(1.0, 1e-4), (1.0, 1e-6), (1000.0, 1e-4), (1000.0, 1e-6)]
    days = precision.sharp_days(config)
    plain = DayResult({"resilience": 0.9, "cost_gbp": 1.0, "import_kwh": 2000.0}, {}, {})
    late = replace(plain, steps={"status": ["optimal", "time_limit"]})
    results = {day: plain for day in days}
    results |= {one.of(day): late for one in precision.sharp_settings(config) for day in days}
    text = precision.sharp_text(config, results)
    assert "| term by term | 0.9000; GBP 1; 2,000 kWh |" in text
    assert text.count(f"| {len(days)} |") == len(found)


def test_the_range_is_that_of_numbers() -> None:
    assert precision._range(["0.92", "0.9", "0.91"]) == "0.9 to 0.92"
    assert precision._range(["3", "3"]) == "3"
    assert precision._range(["hour 2, 4,718 kW"]) == ""


# The arithmetic of the gap.


def small_day(weights: ObjectiveWeights) -> Scenario:
    """Two hours of 30 and 40 kW behind 0.01 ohm, 100 kWh of batteries, prices 0.2 and 0.3."""
    day = two_buses([[30.0, 40.0]] * 2, [0.1, 1.0], [OPEN, OPEN], price=[0.2, 0.3])
    sunny = with_pv(day, [20.0, 25.0])
    return replace(sunny, batteries=battery(), objective=weights)


def test_what_a_gap_leaves_open_by_hand() -> None:
    day = small_day(ObjectiveWeights())
    assert service_of(day, 2) == pytest.approx(2.2)
    cost, curtailed, losses, reactive = terms_beside_gap(day, 2)
    # 2.2e-4 weighted customer hours over 1e-6 per GBP; 70 kWh usable, 0.1 GBP/kWh apart.
    assert (cost.left_open, cost.whole) == pytest.approx((220.0, 7.0))
    assert cost.lost
    # Over 0.1 per kWh it is next to nothing of 45 kWh.
    assert (curtailed.left_open, curtailed.whole) == pytest.approx((2.2e-3, 45.0))
    assert not curtailed.lost
    # 70 kW through 0.01 ohm at 11 kV in both hours: 2 * 0.01 * 70**2 / 121 W.
    assert losses.whole == pytest.approx(2 * 0.01 * 70.0**2 / 121.0 / 1000.0)
    assert losses.left_open == pytest.approx(2.2e-4 / 1e-14 / 121.0 / 1000.0)
    # A battery and a PV system for two hours.
    assert reactive.whole == 4.0
    assert losses.lost and reactive.lost


def test_nothing_is_lost_where_every_term_weighs_more_than_the_gap() -> None:
    heavy = ObjectiveWeights(lambda_grid=0.1, lambda_curt=0.1, lambda_l=1.0, lambda_q=1.0)
    assert not any(term.lost for term in terms_beside_gap(small_day(heavy), 2))
    # A term without weight is not wanted, so nothing of it is lost.
    unwanted = replace(heavy, lambda_l=0.0, lambda_q=0.0)
    terms = terms_beside_gap(small_day(unwanted), 2)
    assert not any(term.lost for term in terms)
    assert np.isinf(terms[2].left_open)
