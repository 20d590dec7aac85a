"""Baselines: batteries left alone, a reserve by rule, and perfect information; solved by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.made_up_runs import small_scenario
from tests.support.refusals import refusal
from vppres.contract.forecast import ForecastErrors
from vppres.control.baselines import ReserveRule
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.scenario.scenario import Scenario


def served(run: Trajectory) -> list[list[bool]]:
    return run.customers["served"].to_numpy(bool).reshape(len(run.steps), -1).tolist()


def soc_end(run: Trajectory) -> list[float]:
    return run.batteries["soc_end"].tolist()


def longer(grid_limit_kw: list[float]) -> Scenario:
    """The small day with more steps: loads of 10, 20 and 40 kW, 12 kW of sun, 100 kWh."""
    day, steps = small_scenario(), len(grid_limit_kw)
    return replace(
        day,
        grid=replace(day.grid, n_steps=steps),
        load_kw=np.tile(day.load_kw[0], (steps, 1)),
        pv_kw=np.full((steps, 1), 12.0),
        price_gbp_per_kwh=np.full(steps, 0.3),
        temperature_c=np.full(steps, 25.0),
        grid_limit_kw=grid_limit_kw,
    )


OPEN, DARK = np.inf, 0.0


def test_idle_serves_in_an_island_what_the_sun_carries() -> None:
    run = run_day(small_scenario(), RunOptions(controller="idle"))
    everyone, first = [True] * 3, [True, False, False]
    assert served(run) == [everyone, first, first, everyone]
    assert soc_end(run) == [0.15] * 4
    assert run.batteries["q_kvar"].tolist() == [0.0] * 4
    assert run.steps["status"].tolist() == ["idle"] * 4
    assert run.pv["curtailed_kw"].tolist() == pytest.approx([0.0, 2.0, 2.0, 0.0])


def test_reserve_charges_from_the_announcement_on() -> None:
    # Half-hour steps, the outage begins at step 4: with 1 h of notice it is seen from step 2 on.
    day = longer([OPEN] * 4 + [DARK] * 2)
    run = run_day(day, RunOptions(controller="reserve", reserve=ReserveRule(0.6, 1.0)))
    # 50 kW for half an hour store 23.75 kWh: 0.15, then 0.3875, then as much as 0.6 needs.
    assert soc_end(run)[:4] == pytest.approx([0.15, 0.15, 0.3875, 0.6])
    # In the island 70 kW less 12 kW of sun are wanted and 50 kW is the battery's most: c is out.
    assert served(run)[4:] == [[True, True, False]] * 2
    used_kwh = 2 * (30.0 - 12.0) / 0.95 * 0.5
    assert soc_end(run)[-1] == pytest.approx(0.6 - used_kwh / 100.0)


def test_reserve_without_a_level_goes_to_the_highest() -> None:
    run = run_day(longer([OPEN] * 6 + [DARK]), RunOptions(controller="reserve"))
    assert max(soc_end(run)) == pytest.approx(0.85)


def test_reserve_rests_without_an_announcement() -> None:
    run = run_day(longer([OPEN] * 5), RunOptions(controller="reserve"))
    assert soc_end(run) == [0.15] * 5


def test_no_customer_is_let_go_to_charge_a_reserve() -> None:
    # 58 kW are needed; of the grid's 60 kW 2 kW are left to charge.
    run = run_day(longer([60.0, 60.0, DARK]), RunOptions(controller="reserve"))
    assert served(run)[:2] == [[True] * 3] * 2
    assert run.batteries["charge_kw"].tolist()[:2] == pytest.approx([2.0, 2.0])


def test_perfect_information_ignores_the_forecast_errors(tiny: Scenario) -> None:
    errors = ForecastErrors(0.2, 0.1, -0.3, 0.1)
    perfect = run_day(tiny, RunOptions(controller="perfect", errors=errors))
    ideal = run_day(tiny, RunOptions(controller="full-horizon"))
    for name in ("customers", "batteries"):
        assert perfect.tables[name].equals(ideal.tables[name])
    summary = summarise(perfect)
    assert summary["resilience"] == summary["resilience_planned"]
    assert (summary["corrections"], summary["horizon_h"]) == (0, None)


def test_perfect_information_is_the_best(tiny: Scenario) -> None:
    errors = ForecastErrors(0.1, 0.05, -0.1, 0.05)
    best, *others = (
        summarise(run_day(tiny, RunOptions(controller=name, errors=errors, horizon_h=3.0)))
        for name in ("perfect", "mpc", "full-horizon", "idle", "reserve")
    )
    assert max(other["resilience"] for other in others) <= best["resilience"] + 1e-9


@pytest.mark.parametrize(("rule", "text"), [
    ({"soc": 1.2},
        "options, reserve.soc = 1.2: must lie between 0 and 1. Give a share, for example 0.8."),
    ({"notice_h": -1.0}, "options, reserve.notice_h = -1.0: must be zero or positive. Give hours."),
])  # fmt: skip
def test_wrong_reserve_is_named(rule: dict[str, float], text: str) -> None:
    assert refusal(ReserveRule, **rule) == text


@pytest.mark.parametrize(("given", "words"), [
    ({}, []),
    ({"reserve.soc": 0.5, "reserve.notice_h": 2.0, "horizon_h": 1.0}, [
        "--reserve-soc 0.5 has no effect: the controller is idle, and it is for reserve.",
        "--notice 2.0 has no effect: the controller is idle, and it is for reserve.",
        "--horizon 1.0 has no effect: the controller is idle, and it is for mpc."]),
    ({"pv_check": "literal"}, ["pv_check literal has no effect: the controller is idle, and it is "
        "for full-horizon and perfect."]),
    ({"turn_h": 2.0}, ["--turn-h 2.0 has no effect without --rotation."]),
    ({"soc_end": 0.95, "switching.stay_restored": True, "errors.load_bias": 0.1}, [
        f"--{given} has no effect: the controller is idle, and it is for mpc{more}."
        for given, more in (("soc-end 0.95", " and full-horizon and perfect"), ("load-bias 0.1",
        " and full-horizon"), ("stay-restored", " and full-horizon and perfect"))]),
    ({"headroom": 0.3, "switching.cold_load_h": 2.0, "guard": False, "protect_critical": True}, [
        "--headroom 0.3 has no effect: the mode is paper, and it is for physical.",
        "--cold-load-h 2.0 has no effect without --cold-load-factor.",
        "--protect-critical has no effect without --guard."]),
    ({"controller": "mpc", "horizon_h": 1.0, "move_switches": True}, [
        "--move-switches has no effect: the site has no switch that can be moved."]),
    ({"controller": "reserve", "reserve.soc": 0.5, "reserve.notice_h": 2.0}, []),
    ({"controller": "mpc", "horizon_h": 1.0, "rotation": 0.5, "turn_h": 2.0}, []),
])  # fmt: skip
def test_an_option_without_effect_is_named(
    tiny: Scenario, given: dict[str, Any], words: list[str]
) -> None:
    options = RunOptions(controller="idle").having(given)
    found = summarise(run_day(tiny, options))["cautions"]
    assert sorted(w for w in found if "no effect" in w) == sorted(words)


@pytest.mark.parametrize(("given", "words"), [
    ({"controller": "mpc", "horizon_h": 1.0, "soc_end": 0.84}, []),
    ({"controller": "mpc", "horizon_h": 1.0, "soc_end": 0.95}, ["--soc-end 0.95 is outside the limits "
        "of 2 of 2 batteries (soc_min, soc_max): the nearest limit counts there, 0.85 to 0.9."]),
    ({"controller": "reserve", "reserve.soc": 0.87}, ["--reserve-soc 0.87 is outside the limits "
        "of 1 of 2 batteries (soc_min, soc_max): the nearest limit counts there, 0.85."]),
])  # fmt: skip
def test_a_state_of_charge_beyond_a_batterys_limits_is_named(
    tiny: Scenario, given: dict[str, Any], words: list[str]
) -> None:
    day = replace(tiny, batteries=replace(tiny.batteries, soc_max=[0.9, 0.85]))
    found = summarise(run_day(day, RunOptions().having(given)))["cautions"]
    assert [w for w in found if "limits of" in w] == words
