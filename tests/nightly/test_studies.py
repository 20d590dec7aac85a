"""The studies: days drawn from seeds, a judge that finds what was done wrong, honest intervals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.frame.paired import Estimate
from experiments.studies import campaign
from experiments.studies.baselines import CONTROLLERS, Run, column, figure, write_report
from experiments.studies.campaign import StepToJudge, judge, run_one
from experiments.studies.faults import drawn_faults
from experiments.studies.random_days import RandomDay, random_day, small_day
from tests.support.mutations import refuted
from vppres.contract.forecast import ForecastErrors
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.simulate import Day, run_day
from vppres.io.digest import scenario_digest


def small(seed: int) -> RandomDay:
    return RandomDay(seed, small_day(np.random.default_rng(seed), seed), ForecastErrors())


def test_a_seed_makes_the_same_day_again() -> None:
    one, same, other = random_day(1), random_day(1), random_day(2)
    assert scenario_digest(one.scenario) == scenario_digest(same.scenario)
    assert (one.errors, drawn_faults(one.scenario, 1)) == (
        same.errors,
        drawn_faults(same.scenario, 1),
    )
    assert scenario_digest(one.scenario) != scenario_digest(other.scenario)
    sizes = {random_day(seed).scenario.network.n_buses for seed in range(12)}
    assert 33 in sizes and len(sizes) > 3
    assert all(random_day(seed).scenario.outage.any() for seed in range(12))


def test_judge_finds_a_critical_customer_that_was_shed_without_need() -> None:
    drawn = small(0)
    first = drawn.scenario.customers.tier == "critical"
    assert first.any()
    options = RunOptions(horizon_h=1.0)
    guard, day = make_controller(drawn.scenario, options), Day(drawn.scenario, options)
    known = guard.decide(day.observe(guard, 0)).seen
    assert not drawn.scenario.outage[0]
    nobody = np.zeros(len(first), dtype=bool)
    whole = drawn.scenario.customers.weight[first].sum()
    assert judge(drawn, [StepToJudge(0, known, nobody)]) == [
        f"step 0: 0 of the critical weight served, {whole:g} possible; all measured"
    ]
    assert judge(drawn, [StepToJudge(0, known, first)]) == []


def test_campaign_day_is_finished_and_counted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(campaign, "random_day", small)
    outcome = run_one(4)
    assert (outcome.error, outcome.steps, outcome.unnamed) == ("", 12, 0)
    assert sum(outcome.fallbacks.values()) == 12
    ended = replace(outcome, error="ValueError: no", violations=["step 3: 0 of 1"])
    text = campaign.write_report([outcome, ended], 60.0, tmp_path).read_text(encoding="utf-8")
    assert "| days that finished | 1 |" in text
    assert "- day 4: ValueError: no\n- day 4, step 3: 0 of 1" in text
    record = json.loads((tmp_path / "campaign.json").read_text(encoding="utf-8"))
    assert [day["seed"] for day in record["outcomes"]] == [4, 4]
    assert "<td>days that finished</td>" in (tmp_path / "campaign.html").read_text(encoding="utf-8")


def test_day_that_ends_early_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(day: Day, controller: object, t: int) -> None:
        raise RuntimeError("no plant")

    monkeypatch.setattr(campaign, "random_day", small)
    monkeypatch.setattr(Day, "step", broken)
    assert run_one(4).error == "RuntimeError: no plant"


def test_interval_holds_the_mean() -> None:
    values = np.random.default_rng(0).normal(0.9, 0.01, 30)
    found = Estimate.of(values)
    assert found.low < found.mean < found.high
    assert found.mean == values.mean()
    # The bootstrap's interval is near the normal one.
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / np.sqrt(30), rel=0.1)
    assert Estimate.of(np.full(5, 0.5)) == Estimate(0.5, 0.5, 0.5)
    assert Estimate.of(np.array([0.7])).text(".2f") == "0.70 [0.70, 0.70]"


def test_baselines_are_compared_day_by_day(tmp_path: Path) -> None:
    rank = {"perfect": 0.9, "mpc": 0.88, "full-horizon": 0.8, "reserve": 0.7, "idle": 0.5}
    runs = [
        Run(seed, name, rank[name] + 0.01 * seed, 100.0, 1.0, 0.0, 0, 1.0)
        for seed in (2, 0, 1)
        for name in CONTROLLERS
    ]
    assert column(runs, "mpc", lambda run: run.resilience).tolist() == [0.88, 0.89, 0.9]
    text = write_report(runs, 1.0, tmp_path).read_text(encoding="utf-8")
    # The regret is the same on all three days, whatever the days are like.
    assert "| MPC, H = 5 h | 0.8900 [0.8800, 0.9000] | 0.0200 [0.0200, 0.0200] |" in text
    assert (tmp_path / "baselines.svg").is_file()
    assert len(figure(runs).axes) == 2


def test_voltages_are_missing_in_dark_islands_and_nowhere_else() -> None:
    run = run_day(small(0).scenario, RunOptions(horizon_h=0.0))
    assert refuted(run) == []
    at = run.buses["time"] == run.steps["time"].iloc[0]
    run.steps.loc[0, ["v_min_ac_pu", "v_max_ac_pu"]] = np.nan
    run.steps["v_within_ac"] = False
    run.buses.loc[at, "v_ac_pu"] = np.nan
    assert refuted(run) == [
        f"{name} is not finite"
        for name in ("steps.v_min_ac_pu", "steps.v_max_ac_pu", "buses.v_ac_pu")
    ]
    run.steps.loc[0, "dark"] = 1.0
    assert refuted(run) == ["a dark island has no reason"]
    run.steps["dark_reason"] = run.steps["dark_reason"].astype(object)
    run.steps.loc[0, "dark_reason"] = "no energy"
    assert refuted(run) == []
    run.steps.loc[1, "dark"] = 1.0
    assert "steps.v_min_ac_pu has a value in a dark island" in refuted(run)
