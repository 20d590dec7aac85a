"""With the grid on no customer is switched off for a voltage that the feeder has by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.phased_feeder import STREET
from vppres.cli.tables import content_of
from vppres.day.assembly import make_controller
from vppres.day.metrics import cautions
from vppres.day.options import RunOptions
from vppres.day.priority import site_of
from vppres.day.simulate import Day, run_day
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day
from vppres.feeders import import_network
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario
from vppres.model.data import WindowData
from vppres.model.own_state import with_own_state
from vppres.scenario.scenario import HARD, LIMIT, REPORT, SOFT, Scenario

STEPS = slice(3, 5)
OUTAGE = (pd.Timestamp("2025-07-01T00:00Z"), pd.Timestamp("2025-07-01T04:00Z"))


@cache
def weak_feeder(batteries: bool = False, sun: float = 0.0) -> Scenario:
    """Two steps of 33 buses, whose far end is at 0.913 pu by itself; of those with sun, two."""
    rules = NewScenarioOptions(
        step_minutes=240.0,
        outages=(OUTAGE,),
        add_batteries=batteries,
        pv="sized" if sun else "none",
        pv_share_of_peak=sun or None,
    )
    return new_scenario(import_network("case33bw"), rules).between(STEPS.start, STEPS.stop)


def ran(day: Scenario, limits: str, mode: str = "physical", **options: str) -> Trajectory:
    return run_day(day, RunOptions(horizon_h=4.0, voltage_limits=limits, mode=mode, **options))


@cache
def without_control(mode: str) -> Trajectory:
    """The weak feeder by itself."""
    return ran(weak_feeder(), SOFT, mode, controller="idle")


@pytest.mark.parametrize("mode", ["physical", "paper"])
@pytest.mark.parametrize("method", ["decomposed", "monolithic"])
def test_limits_give_way_to_the_feeder_itself(mode: str, method: str) -> None:
    day = weak_feeder()
    soft = ran(day, SOFT, mode, method=method)
    assert soft.customers["served"].all()
    assert cautions(soft) == []
    assert (soft.steps["fallback"] == "none").all()
    idle = without_control(mode)
    np.testing.assert_allclose(soft.buses["v_ac_pu"], idle.buses["v_ac_pu"], atol=1e-6)
    assert idle.buses["v_ac_pu"].min() < day.network.v_min_ac_pu


@pytest.mark.daily
def test_no_customer_is_dimmed_for_the_feeder_itself() -> None:
    day = weak_feeder()
    half = np.full(len(day.customers), 0.5)
    later = np.where(np.arange(len(half)) == 0, 4.0, np.nan)
    dimmable = replace(day.customers, share_min=half, recover_h=later)
    soft = ran(replace(day, customers=dimmable), SOFT)
    np.testing.assert_allclose(soft.customers["share"], 1.0, atol=1e-4)


@pytest.mark.parametrize("times", [2.0, 3.0])
def test_a_weaker_feeder_is_held_by_its_plan(times: float) -> None:
    """The guard refuses no plan for what losses take of the voltages that the feeder has anyway."""
    day = weak_feeder()
    soft = ran(replace(day, load_kw=times * day.load_kw), SOFT)
    assert set(soft.steps["fallback"]) == {"none"}
    assert soft.customers["served"].all()


@pytest.mark.daily
@pytest.mark.parametrize("times", [4.0, 20.0])
def test_a_feeder_that_cannot_carry_its_demand_serves_what_it_can(times: float) -> None:
    """Without control it has no power flow: to no such state do its limits give way."""
    day = weak_feeder()
    soft = ran(replace(day, load_kw=times * day.load_kw), SOFT)
    assert set(soft.steps["fallback"]) == {"none"} and set(soft.steps["ac_failed"]) == {""}
    last = soft.customers[soft.customers["time"] == soft.steps["time"].iloc[-1]]
    assert 0 < last["served"].sum() < len(day.customers)
    assert soft.steps["v_min_ac_pu"].iloc[-1] > day.network.v_min_ac_pu - 1e-3
    told = explain_day(soft).explanations
    assert "not_served" in set(told["action"])


def test_limits_give_way_to_no_voltage_that_a_feeder_cannot_have() -> None:
    """At twenty times its demand the feeder has no power flow."""
    day = weak_feeder()
    day = replace(day, load_kw=20.0 * day.load_kw)
    options = RunOptions(horizon_h=0.0, voltage_limits=SOFT).on(day)
    seen = Day(day, options).observe(make_controller(day, options), 0)
    site = site_of(day, options.as_record())
    data = with_own_state(site, WindowData.of(seen, site, "none"))
    least_pu2 = data.u_limits_pu2(site.network)[0].min()
    assert least_pu2 == pytest.approx(site.network.v_min_ac_pu**2)


def test_hard_limits_switch_off_and_the_first_line_says_whom() -> None:
    day = weak_feeder()
    hard = ran(day, HARD)
    off = hard.customers[~hard.customers["served"].astype(bool)]
    assert hard.buses["v_ac_pu"].min() > day.network.v_min_pu - 1e-4
    (caution,) = cautions(hard)
    assert caution.startswith(
        f"Off with the grid on: {off['id'].nunique()} of 32 customers, {len(off) * 4} customer hours."
    )
    (told,) = cautions(explain_day(hard))
    assert f" Reasons: voltage {len(off)}." in told


def test_limits_give_way_no_further_than_they_must() -> None:
    day = weak_feeder(batteries=True)
    full = replace(
        day,
        load_kw=0.75 * day.load_kw,
        batteries=replace(day.batteries, soc_initial=day.batteries.soc_max),
    )
    alone = ran(full, SOFT, controller="idle")
    assert alone.buses["v_ac_pu"].min() < day.network.v_min_ac_pu
    held = ran(full, SOFT)
    assert held.customers["served"].all()
    assert held.buses["v_ac_pu"].min() > day.network.v_min_pu - 1e-4


def test_pv_power_does_not_raise_the_highest_voltage() -> None:
    day = weak_feeder(sun=4.0)
    alone = ran(day, SOFT, controller="idle")
    assert alone.buses["v_ac_pu"].max() > day.network.v_max_ac_pu
    run = ran(day, SOFT)
    assert run.customers["served"].all()
    assert run.buses["v_ac_pu"].max() < day.network.v_max_pu + 1e-4


def test_validate_says_where_the_feeder_leaves_its_limits() -> None:
    words = content_of(weak_feeder())["remarks"][0]
    assert words.startswith("Without control the voltage falls to 0.91")
    assert "at bus 18" in words
    assert words.endswith("no customer is switched off for it.")
    hard = replace(weak_feeder().controller, voltage_limits=HARD)
    day = replace(weak_feeder(), controller=hard)
    assert "customers may be switched off" in content_of(day)["remarks"][0]


def narrow_street(folder: Path) -> Scenario:
    """Evening hours of three phases, of which one carries more than the rating of its line."""
    file = folder / "street.dss"
    file.write_text(STREET.replace("units=km\nnew load.a", "units=km normamps=14\nnew load.a"))
    rules = NewScenarioOptions(pv="none", draw_tiers=True)
    return new_scenario(import_network(file), rules).between(18, 20)


def narrow_line(_: Path) -> Scenario:
    """Two steps of 33 buses, the last of whose lines carries more than its rating."""
    day = weak_feeder()
    i_max_a = np.full(day.network.n_lines, np.inf)
    i_max_a[day.network.bus_index[18] - 1] = 1.0
    return replace(day, network=replace(day.network, i_max_a=i_max_a))


@pytest.mark.parametrize(
    ("made", "where"),
    [
        (narrow_street, "line from m to n, phase b"),
        pytest.param(narrow_line, "line from 17 to 18", marks=pytest.mark.daily),
    ],
)
def test_a_rating_that_is_exceeded_without_control_is_told_before_customers_are_off_for_it(
    made: Callable[[Path], Scenario], where: str, tmp_path: Path
) -> None:
    """Batteries and PV power cannot help; the grid is on, and customers are off for it alone."""
    day = made(tmp_path)
    said = [words for words in content_of(day)["remarks"] if "of its rating" in words]
    assert len(said) == 1 and said[0].startswith(f"Without control {where} carries ")
    assert "exceeded in 2 of 2 steps with grid" in said[0]
    assert said[0].endswith("and no customer is switched off for it.")
    options = RunOptions(horizon_h=0.0, mode="physical")
    limited, imported, reported = (
        run_day(day, replace(options, ratings=ratings)) for ratings in (LIMIT, None, REPORT)
    )
    assert not limited.customers["served"].all()
    for run in (imported, reported):
        assert run.customers["served"].all()
        assert set(run.steps["fallback"]) == {"none"}
    rated = replace(day, controller=replace(day.controller, ratings=REPORT))
    assert not [words for words in content_of(rated)["remarks"] if "of its rating" in words]
