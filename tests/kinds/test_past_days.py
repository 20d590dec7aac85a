"""Vehicles that are expected as on a past day: draws, windows solved by hand, days, live."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import date

import numpy as np
import pandas as pd
import pytest

from tests.support.small_windows import DARK, OPEN, battery, two_buses, window
from tests.support.vans import chargers, plugged_in
from vppres import Controller, InputError, Measurement, RunOptions, explain_day, run_day
from vppres.contract.ahead import KindsAhead
from vppres.day.assembly import make_controller
from vppres.kinds.vehicles.past_days import PastDays
from vppres.kinds.vehicles.physics import Plugged
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.report.assumptions import simplifications
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written
from vppres.service.of_kind import told_by_plans
from vppres.solve.ladder import METHODS, WindowSolver

MONDAY = date(2022, 7, 18).toordinal()  # the day before that of the small windows


def history(day: Scenario, **more: object) -> Scenario:
    """Three past days: both chargers in use, nobody, the second one alone; then one car a day."""
    past = [(-71, -65), (-70, -50), (-20, -10), (30, 34)]
    names = ["k0", "k1", "k1", "k0"]
    day = replace(day, chargers=chargers(2))
    return plugged_in(day, *past, charger=names, vehicle=names, announced=False, **more)


def expecting(day: Scenario, now_kwh: float = 0.0) -> WindowData:
    """All steps as one window, with vehicles that are expected too."""
    held_kwh = np.full(len(day.chargers), now_kwh)
    steps = range(day.grid.n_steps)
    plugged = Plugged.of(day, steps, held_kwh, PastDays.of(day, 0))
    return replace(window(day), ahead=KindsAhead({"chargers": plugged}))


# Draws.


def test_each_day_is_like_a_whole_past_day() -> None:
    day = history(two_buses([[1.0]] * 24 * 60, [1.0], [OPEN] * 24 * 60))
    past = PastDays.of(day, seed=3)
    assert past is not None
    assert past.days.tolist() == [MONDAY - 2, MONDAY - 1, MONDAY]
    midnight = day.grid.start.normalize()
    came = {MONDAY - 2: {("k0", 1, 7), ("k1", 2, 22)}, MONDAY - 1: set(), MONDAY: {("k1", 4, 14)}}
    drawn = []
    for d in range(60):
        start = midnight + pd.Timedelta(days=d)
        found = past.expected(day.grid, range(24 * d, 24 * d + 24))
        hours = (
            [(time - start) / pd.Timedelta(hours=1) for time in times]
            for times in (found.plug_in, found.plug_out)
        )
        drawn.append(past.drawn_for(start.toordinal()))
        assert {*zip(found.charger, *hours, strict=True)} == came[drawn[-1]]
    assert {*drawn} == {*past.days}
    same, other = (PastDays.of(day, seed) for seed in (3, 4))
    assert same is not None and other is not None
    days = range(MONDAY + 1, MONDAY + 61)
    assert [same.drawn_for(d) for d in days] == drawn != [other.drawn_for(d) for d in days]


def test_a_replay_of_stored_plans_keeps_past_days() -> None:
    """Beside the vehicle that a plan tells of."""
    day = history(two_buses([[1.0]] * 6, [1.0], [OPEN] * 6))
    told = {"vehicle": "car9", "leaves": written(day.grid.times[2])}
    plan = {"expected": {"vehicles": {"k0": {**told, "energy_kwh": 5.0, "needed_kwh": 9.0}}}}
    replayed = told_by_plans(day, [plan, *[None] * 5])
    assert "car9" in replayed.sessions.vehicle
    kept, past = PastDays.of(replayed, 0), PastDays.of(day, 0)
    assert kept is not None and past is not None
    assert kept.days.tolist() == past.days.tolist()


def test_days_that_go_on_in_the_run_are_not_past() -> None:
    """Neither the day on which the run begins, nor one whose vehicle is still there."""
    late = replace(two_buses([[1.0]] * 6, [1.0], [OPEN] * 6), chargers=chargers())
    late = replace(late, grid=replace(late.grid, start=late.grid.start + pd.Timedelta(hours=12)))
    times = [(-40, -30), (-20, -18), (-16, 3), (-6, -2)]
    still_there = plugged_in(late, *times, charger="k0", announced=False)
    found = PastDays.of(still_there, 0)
    assert found is not None and found.days.tolist() == [MONDAY - 1]
    assert found.begun.tolist() == [MONDAY - 1, MONDAY, MONDAY + 1]
    assert PastDays.of(plugged_in(late, (-6, -2)), 0) is None  # this morning alone
    assert PastDays.of(plugged_in(late, (-16, 3)), 0) is None


# Windows.


def test_vehicles_are_expected_later_and_where_chargers_are_free() -> None:
    """As on the day before: k0 from 02:00 to 05:00, k1 from 03:00 to 08:00; k1 is taken at 06:00."""
    day = replace(two_buses([[1.0]] * 8, [1.0], [OPEN] * 8), chargers=chargers(2))
    times = [(-22, -19), (-21, -16), (6, 8)]
    told = {"charger": ["k0", "k1", "k1"], "announced": [False, False, True]}
    day = plugged_in(day, *times, **told)
    past = PastDays.of(day, 0)

    def seen(begin: int, stop: int) -> Plugged:
        found = Plugged.of(day, range(begin, stop), np.zeros(2), past)
        assert found is not None
        return found

    first = seen(0, 8)
    assert np.flatnonzero(first.here[:, 0]).tolist() == [2, 3, 4]
    assert np.flatnonzero(first.here[:, 1]).tolist() == [6, 7]  # 03:00 to 08:00 is not free
    assert not first.known[:, 0].any() and first.known[6:, 1].all()
    assert first.needed_kwh[4, 0] == pytest.approx(48.0)  # as ever
    assert first.held_kwh[2, 0] == pytest.approx(18.0)
    assert seen(2, 8).here[:, 0].sum() == 0  # it should be here by now, and is not
    assert seen(1, 3).here[:, 0].tolist() == [False, True]
    assert seen(1, 4).needed_kwh[2, 0] == pytest.approx(18.0 + 30.0 * 2 / 3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("grid", [DARK, OPEN])
def test_none_that_may_not_come_gives_anything_back(method: str, grid: float) -> None:
    """A full car with nothing to do supplies a home for 6 h, or sells: if it is known to come."""
    price = [0.6] * 4 + [0.1] * 4
    day = two_buses([[6.0]] * 8, [1.0], [grid] * 8, price)
    day = replace(day, chargers=chargers(p_charge_kw=10.0, p_discharge_kw=10.0))
    full = {"soc_at_plug_in": 1.0, "soc_needed": 0.2, "v2g_soc_floor": 0.0}
    expected = expecting(plugged_in(day, (-23, -17), announced=False, **full))
    announced = expecting(plugged_in(day, (1, 7), announced=True, **full))
    powers = []
    for data in (announced, expected):
        answer = WindowSolver(Site.of(day), method).solve(data)
        assert answer.status == "optimal"
        assert not broken(Site.of(day), data, answer.dispatch)
        powers.append(answer.dispatch.taken_kw["chargers"][:, 0])
        served = answer.dispatch.served[:, 0]
        assert served.sum() == (8 if grid else 6 if data is announced else 0)
    assert powers[0].min() < -5.9
    assert powers[1].min() == 0.0
    ahead = expected.ahead.find(Plugged)
    assert ahead is not None
    beyond_kw = ahead.power_beyond_kw(
        day.chargers,
        np.ones((8, 1), dtype=bool),
        powers[0][:, None],
        np.ones((8, 1), dtype=bool),
        1.0,
    )
    assert beyond_kw.max() == pytest.approx(-powers[0].min())  # which is refused


def test_expected_vehicles_that_come_are_as_if_announced() -> None:
    """One-way cars, the same as on the day before: the plan is the same to the last bit."""
    price = [0.1, 0.14, 0.02, 0.06, 0.1, 0.14, 0.19, 0.03]
    day = two_buses([[6.0, 3.0]] * 8, [1.0, 2.0], [12.0] * 5 + [DARK] * 3, price)
    stored = battery(energy_kwh=40.0, p_max_kw=9.0, s_max_kva=1e3)
    day = replace(day, batteries=stored, chargers=chargers(2))
    plans = [
        WindowSolver(Site.of(day)).solve(data).dispatch
        for data in (
            expecting(plugged_in(day, (1, 6), (2, 7), announced=True)),
            expecting(plugged_in(day, (-23, -18), (-22, -17), announced=False)),
        )
    ]
    for name in ("served", "soc", "p_grid_kw"):
        assert (getattr(plans[0], name) == getattr(plans[1], name)).all()
    assert (plans[0].taken_kw["chargers"] == plans[1].taken_kw["chargers"]).all()
    assert plans[0].taken_kw["chargers"].any()


# Days.


def evening() -> Scenario:
    """At 01:00 comes a car that leaves in the outage from 02:00 on, as it did yesterday."""
    day = two_buses([[1.0]] * 4, [1.0], [8.0, 8.0, DARK, DARK], [0.3, 0.2, 0.2, 0.2])
    day = replace(day, batteries=battery(energy_kwh=40.0, p_max_kw=20.0), chargers=chargers())
    return plugged_in(day, (-23, -20), (1, 4), charger="k0", vehicle="van", announced=False)


def surprised(day: Scenario) -> Scenario:
    """The same without the past."""
    return replace(day, sessions=day.sessions.rows(~day.sessions.over(day.grid.start)))


SHORT_KWH = {
    # 7 kW beside the home in each hour with grid; what is stored has losses, and 2 kWh go home.
    "expected": 30.0 - 0.92 * (7.0 + (7.0 * 0.95 * 0.95 - 2.0)),
    # Nothing is stored at 00:00, when energy is dear; then the home's 2 kWh come first.
    "a surprise": 30.0 - 0.92 * (7.0 - 2.0 / (0.95 * 0.95)),
}


@pytest.mark.parametrize("what", [*SHORT_KWH])
def test_a_day_leaves_room_for_whom_it_expects(what: str) -> None:
    day = evening() if what == "expected" else surprised(evening())
    run = explain_day(run_day(day, RunOptions(isolate=False)))
    assert run.vehicles is not None and run.explanations is not None
    assert run.customers["served"].all()
    assert run.vehicles["short_kwh"].sum() == pytest.approx(SHORT_KWH[what], abs=1e-3)
    told = run.explanations[run.explanations["action"] == "expected"]
    assert told["words"].tolist() == (
        ["Expected as on 2022-07-18: up to 04:00, to need 30.0 kWh."] if what == "expected" else []
    )
    assert ("as on one of 1 past days" in " ".join(simplifications(run))) == (what == "expected")


def test_who_does_not_come_is_dropped() -> None:
    """At 01:00 nobody is there: what was stored for the car is left, and no step is worse."""
    day = evening()
    day = replace(day, sessions=day.sessions.rows(day.sessions.over(day.grid.start)))
    run = run_day(day, RunOptions(isolate=False))
    assert run.batteries["charge_kw"].iloc[0] == pytest.approx(7.0, abs=1e-4)
    assert run.vehicles is not None and not run.vehicles["p_kw"].any()
    assert run.customers["served"].all() and (run.steps["fallback"] == "none").all()


def test_a_live_controller_expects_the_same_after_a_restart_too() -> None:
    """7 kW are stored for the car, and the same is decided when it does not come."""
    for day, charged_kw in ((evening(), 7.0), (surprised(evening()), 0.0)):
        options = RunOptions(mode="paper", isolate=False)
        controller = Controller.of(day, options)
        step = controller.step(Measurement(day.grid.times[0], soc={"b0": 0.15}))
        assert step.batteries["p_kw"].iloc[0] == pytest.approx(charged_kw, abs=1e-4)
        state = json.loads(json.dumps(controller.state(), allow_nan=False))
        again = Controller.of(day, options, state=state)
        now = Measurement(day.grid.times[1], soc={"b0": 0.2}, plugged={"k0": 0.0})
        powers = [one.step(now).batteries["p_kw"].iloc[0] for one in (controller, again)]
        assert powers[0] == powers[1]


# Prices.


def test_a_long_past_makes_no_missed_energy_cheaper() -> None:
    """A hundred past days are no more sessions than one; those that are expected count."""
    day = replace(two_buses([[1.0]] * 8, [1.0], [OPEN] * 8), chargers=chargers())
    past = [(-24 * d + 1, -24 * d + 4) for d in range(1, 101)]
    day = plugged_in(day, *past, (1, 4), charger="k0", announced=False)
    options = RunOptions(isolate=False)
    dearest = 0.5 / 120.0 * 0.92 / 2.0 / day.objective.lambda_grid  # of two cars of 60 kWh
    make_controller(replace(day, price_gbp_per_kwh=np.full(8, 0.99 * dearest)), options)
    dear = replace(day, price_gbp_per_kwh=np.full(8, 1.01 * dearest))
    with pytest.raises(InputError, match=r"dearer than what 2 sessions of vehicles may count"):
        make_controller(dear, options)
    make_controller(surprised(dear), options)
