"""Vehicles: windows solved by hand, plant, live; and vehicles that are expected as on a past day."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.builders import known, live, planned_kw, solved
from tests.support.live_service import HERE, NOON, client, decided, readings, said, site
from tests.support.small_windows import (
    DARK,
    OPEN,
    battery,
    two_buses,
    window,
    with_pv,
)
from tests.support.vans import chargers, plugged_in
from vppres import Controller, InputError, Measurement, RunOptions, explain_day, run_day
from vppres.contract.ahead import KindsAhead
from vppres.day.assembly import make_controller
from vppres.kinds.kind import UnitPlan
from vppres.kinds.vehicles.physics import Garage, PastDays, Plugged
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.plant.plant import Plant
from vppres.report.assumptions import simplifications
from vppres.scenario.remarks import remarks
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.of_kind import told_by_plans
from vppres.service.operation.site import Service
from vppres.solve.ladder import METHODS, WindowSolver

HOUR = pd.Timedelta("1h")


def evening(limit_kw: float, steps: int = 14, **more: Any) -> Scenario:
    """A car from 18:00 to 07:00, in a day whose first step is at 18:00."""
    day = two_buses([[1.0]] * steps, [1.0], [limit_kw] * steps)
    return plugged_in(replace(day, chargers=chargers(**more)), (0, 13))


# Hand-solved windows.


@pytest.mark.parametrize("method", METHODS)
def test_a_car_charges_at_once_what_it_needs(method: str) -> None:
    """32.61 kWh in 4.41 h, in the first hours since all cost the same."""
    day = evening(OPEN)
    power_kw = planned_kw(day, method)[:, 0]
    assert power_kw.sum() == pytest.approx(30.0 / 0.92, abs=1e-4)
    assert power_kw[:4] == pytest.approx(7.4)
    assert power_kw.sum() / 7.4 == pytest.approx(4.41, abs=5e-3)
    assert power_kw[5:].max() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_departure_in_an_outage_is_short_and_feasible(method: str) -> None:
    day = evening(DARK)
    answer = solved(day, method)
    plugged = known(day).ahead.known("chargers")
    energy_kwh = plugged.energy_kwh(answer.dispatch.taken_kw["chargers"])
    assert plugged.short_kwh(energy_kwh).sum() == pytest.approx(30.0)
    assert answer.objective == pytest.approx(-0.5 * 30.0 / 60.0)  # half a step for 60 kWh


def test_a_car_charges_in_the_cheap_hours() -> None:
    day = evening(OPEN)
    price = np.where(np.arange(14) >= 8, 0.1, 0.3)
    day = replace(day, price_gbp_per_kwh=price)
    assert planned_kw(day)[8:13].sum() == pytest.approx(30.0 / 0.92, abs=1e-4)


def test_a_charger_of_a_customer_that_is_off_does_not_charge() -> None:
    """20 kWh for a home of 10 kW in two of three hours; the third leaves nothing for its car."""
    day = two_buses([[10.0]] * 3, [1.0], [12.0, DARK, 5.0])
    own = chargers(customer="c0", bus=None)
    day = plugged_in(replace(day, chargers=own), (0, 3))
    answer = solved(day)
    assert answer.dispatch.served[:, 0].tolist() == [True, False, False]
    assert answer.dispatch.taken_kw["chargers"][:, 0] == pytest.approx([2.0, 0.0, 0.0], abs=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_a_charger_does_not_burn_sun_by_charging_and_discharging_at_once(method: str) -> None:
    """A car of 57 of 60 kWh gives a home 1 kWh; then 19 kW of sun are too much in the dark."""
    day = with_pv(two_buses([[1.0]] * 3, [1.0], [OPEN, DARK, OPEN]), [0, 20, 0])
    day = replace(day, chargers=chargers(p_discharge_kw=7.4))
    session = {"soc_at_plug_in": 0.95, "soc_needed": 0.5, "v2g_soc_floor": 0.0}
    day = plugged_in(day, (0, 3), **session)
    answer = solved(day, method)
    charged_kw = (3.0 + 1.0 / 0.92) / 0.92
    taken_kw = answer.dispatch.taken_kw["chargers"][:, 0]
    assert taken_kw == pytest.approx([-1.0, charged_kw, -1.0], abs=1e-4)
    assert answer.terms.f3 == pytest.approx(19.0 - charged_kw, abs=1e-4)


def test_the_floor_holds_what_a_car_keeps() -> None:
    """FlexMeasures' tutorial: 60 kWh, never below 25 %, 95 % at 08:00; it supplies a dark evening.

    It comes with 51 kWh, and may give 36 of them: 33.12 kWh for a home of 6 kW.
    """
    day = two_buses([[6.0]] * 14, [1.0], [DARK] * 6 + [OPEN] * 8)
    two_way = chargers(p_discharge_kw=7.4)
    session = {"soc_at_plug_in": 0.85, "soc_needed": 0.95, "v2g_soc_floor": 0.25}
    day = plugged_in(replace(day, chargers=two_way), (0, 14), **session)
    answer, plugged = solved(day), known(day).ahead.known("chargers")
    energy_kwh = plugged.energy_kwh(answer.dispatch.taken_kw["chargers"])[:, 0]
    assert energy_kwh.min() >= 15.0 - 1e-6
    assert energy_kwh[-1] == pytest.approx(57.0, abs=1e-4)
    assert answer.dispatch.served[:6].sum() == 5


@pytest.mark.parametrize("tiers", [("critical", "low"), ("low", "critical")])
def test_the_tier_says_which_car_goes_first(tiers: tuple[str, str]) -> None:
    day = replace(two_buses([[1.0]] * 2, [1.0], [6.0] * 2), chargers=chargers(2))
    weight = [5.0 if tier == "critical" else 1.0 for tier in tiers]
    day = plugged_in(day, (0, 2), (0, 2), tier=tiers, weight=weight)
    power_kw = planned_kw(day)
    first = tiers.index("critical")
    assert power_kw.sum(axis=0)[first] == pytest.approx(10.0, abs=1e-4)


def test_what_is_known_of_sessions() -> None:
    """Plugged-in and announced vehicles; a need behind the window is on the line to departure."""
    day = two_buses([[1.0]] * 8, [1.0], [OPEN] * 8)
    day = replace(day, chargers=chargers(3))
    day = plugged_in(day, (1.5, 5.0), (0.0, 12.0), (2.0, 5.0), announced=[True, False, False])
    seen = Plugged.of(day, range(1, 7), np.array([0, 19.0, 0]))
    assert seen.here.sum(axis=0).tolist() == [3, 6, 0]  # whole hours from 02:00 on
    assert seen.held_kwh.sum(axis=0) == pytest.approx([18.0, 19.0, 0.0])
    assert seen.needed_kwh[3, 0] == pytest.approx(48.0)
    assert seen.needed_kwh[5, 1] == pytest.approx(18.0 + 30.0 * 7 / 12)
    assert seen.part(slice(2)).needed_kwh[1, 1] == pytest.approx(18.0 + 30.0 * 3 / 12)


def test_a_vehicle_within_a_step_is_named_and_leaves_plans_as_they_are() -> None:
    """It has no whole step: its charger is empty, not one that holds energy without a vehicle."""
    day = two_buses([[1.0]] * 8, [1.0], [OPEN] * 8)
    day = plugged_in(replace(day, chargers=chargers()), (2.4, 2.9))
    plugged = known(day).ahead.known("chargers")
    assert not plugged.held_kwh.any()
    assert solved(day).dispatch.served.all()
    assert "no whole step of 60 min" in " ".join(remarks(day))


# The step: plant and guard.


def test_the_plant_is_exact_and_knows_what_chargers_cannot_do() -> None:
    day = evening(OPEN, p_charge_min_kw=1.4, p_discharge_kw=5.0)
    dark = replace(day, grid_limit_kw=[DARK] * 14)
    on = np.ones(1, dtype=bool)
    for each, wanted, done in (
        (day, 20.0, 7.4),
        (day, 1.0, 1.4),  # less is not to be had
        (dark, 1.0, 0.0),
        (day, -3.0, 0.0),  # below its floor
    ):
        garage = Plant(each).of(Garage)
        power_kw = garage.possible_kw(0, np.array([wanted]), on)
        assert power_kw == pytest.approx([done])
        expected = 18.0 + 0.92 * done
        assert garage.after_kwh(0, power_kw)[0] == pytest.approx(expected, abs=1e-12)
    garage = Plant(day).of(Garage)
    for t in range(13):
        garage.state = garage.after_kwh(t, garage.possible_kw(t, np.array([7.4]), on))
    assert garage.state == pytest.approx([60.0], abs=1e-9)  # full, and no more
    assert garage.at(13) == pytest.approx([0.0])  # gone
    assert garage.possible_kw(13, np.array([7.4]), on) == pytest.approx([0.0])


# Live.


def test_a_car_that_leaves_early_is_named_and_a_restart_keeps_energy() -> None:
    """What it was to get goes to nobody else, and the home stays on in all steps."""
    day = two_buses([[2.0]] * 6, [1.0], [OPEN] * 6)
    day = replace(day, chargers=chargers(p_discharge_kw=7.4))
    day = plugged_in(day, (0, 6), soc_needed=0.9)
    steps = live(day, [{}] * 3 + [{"plugged": {"k0": 0.0}}] * 3)
    left = ["vehicle car0 is not at k0" in s.solve["estimated"] for s in steps]
    assert left == [False] * 3 + [True] * 3
    assert all(step.customers["served"].all() for step in steps)
    limits, energies = ([s.chargers[n]["k0"] for s in steps] for n in ("p_limit_kw", "energy_kwh"))
    assert limits == pytest.approx([7.4] * 3 + [0.0] * 3)
    assert energies == pytest.approx([18.0, 18.0 + 6.808, 18.0 + 2 * 6.808, 0.0, 0.0, 0.0])


def test_what_a_vehicle_tells_holds() -> None:
    day = two_buses([[2.0]] * 6, [1.0], [OPEN] * 6)
    day = plugged_in(replace(day, chargers=chargers(2)), (0, 6))
    needs = {"plugged": {"k1": 1.0}, "energy_needed_kwh": {"k1": 3.0}}
    told = needs | {"ev_soc": {"k0": 0.79}}
    options = replace(HERE, horizon_h=6.0)
    (unknown,) = live(day, [told], options)
    assert "vehicle k1 at k1 is here and its departure is not known" in unknown.solve["estimated"]
    assert unknown.chargers["p_kw"]["k1"] == pytest.approx(3.0 / 0.92, abs=1e-4)
    (step,) = live(day, [told | {"departure": {"k1": day.grid.times[2]}}], options)
    assert step.chargers["p_kw"].tolist() == pytest.approx([0.6 / 0.92, 3.0 / 0.92], abs=1e-4)
    assert step.chargers["vehicle"].tolist() == ["car0", "k1"]


def test_a_service_says_the_limit_of_a_charger(tiny: Scenario, tmp_path: Path) -> None:
    """5 kWh within the hour."""
    day = replace(site(tiny), chargers=chargers(1, bus=4))
    clock = SetClock(NOON)
    leaves = (NOON + pd.Timedelta(hours=1)).timestamp()
    with client(Service(day, HERE), tmp_path, clock) as http:
        series = [
            one
            for name, value in (("plugged", 1), ("energy_needed_kwh", 5), ("departure", leaves))
            for one in readings(NOON, name, {"k0": float(value)})
        ]
        assert http.post("/v1/telemetry", {"series": series}).status == 200
        point = said(decided(http, clock, NOON), "chargers")["k0"]
        until = written(NOON + pd.Timedelta(hours=2))
        hold = {"mode": "hold", "until": until, "reason": "a test"}
        assert http.put("/v1/mode", hold).status == 200
        held = said(decided(http, clock, NOON + pd.Timedelta(hours=1)), "chargers")["k0"]
    assert point["p_limit_kw"] == point["p_kw"] == pytest.approx(5.0 / 0.92, abs=1e-4)
    assert point["default"] == {"p_kw": 7.4, "p_limit_kw": 7.4}
    assert held["p_limit_kw"] == point["p_limit_kw"]


SAID: dict[str, list[dict[str, float]]] = {
    # Of each hour: whether it is plugged in, what it needs, and in how many hours of the first it leaves.
    "departure passed": [{"plugged": 1, "need": 20, "leaves": 1}] + [{"plugged": 1, "leaves": 1}] * 3,
    "departure never said": [{"plugged": 1, "need": 20}] + [{"plugged": 1}] * 3,
    "said once": [{"plugged": 1, "need": 20, "leaves": 4}, {}, {}, {}],
    "need said once": [{"plugged": 1, "need": 20, "leaves": 4}] + [{"plugged": 1}] * 3,
    "departure moved": [{"plugged": 1, "need": 20, "leaves": 4}, {"leaves": 2}] + [{"plugged": 1}] * 2,
    "departure put off": [{"plugged": 1, "need": 20, "leaves": 1}, {"plugged": 1, "leaves": 4}, {}, {}],
    "need said again": [{"plugged": 1, "need": need, "leaves": 1} for need in (20, 13.192, 6.384, 0.0)],
}  # fmt: skip


QUANTITIES = {"plugged": "plugged", "need": "energy_needed_kwh", "leaves": "departure"}


def charged_kw(hour: int) -> float:
    """What a charger of 7.4 kW and 0.92 gives in an hour, of 20 kWh."""
    return min((20.0 - min(7.4 * 0.92 * hour, 20.0)) / 0.92, 7.4)


@pytest.mark.parametrize("name", SAID)
def test_a_vehicle_that_is_here_is_charged_whatever_it_says(name: str) -> None:
    """By Python: 20 kWh in three hours, whether or not it says so again; and it is named late."""
    day = replace(two_buses([[2.0]] * 4, [1.0], [OPEN] * 4), chargers=chargers(1))
    start = day.grid.start
    measured = [
        {
            QUANTITIES[key]: {"k0": start + value * HOUR if key == "leaves" else value}
            for key, value in told.items()
        }
        for told in SAID[name]
    ]
    leaves = 0.0
    steps = live(day, measured, replace(HERE, horizon_h=1.0))
    for hour, (step, told) in enumerate(zip(steps, SAID[name], strict=True)):
        leaves = told.get("leaves", leaves)
        assert step.customers["served"].all()
        assert step.chargers["p_kw"]["k0"] == pytest.approx(charged_kw(hour), abs=1e-3), hour
        late = "vehicle k0 at k0 is here" in step.solve["estimated"]
        assert late == (told.get("plugged") == 1 and leaves <= hour), hour


@pytest.mark.parametrize("name", SAID)
def test_a_service_charges_a_vehicle_that_is_here_whatever_it_says(
    name: str, tiny: Scenario, tmp_path: Path
) -> None:
    """The same by HTTP, with readings that hold for a minute; the page names it too."""
    day = replace(site(tiny), chargers=chargers(1, bus=4))
    clock = SetClock(NOON)
    leaves = 0.0
    with client(Service(day, HERE), tmp_path, clock) as http:
        for hour, said_now in enumerate(SAID[name]):
            clock.set(NOON + hour * HOUR)
            leaves = said_now.get("leaves", leaves)
            values = {
                QUANTITIES[key]: (NOON + value * HOUR).timestamp() if key == "leaves" else value
                for key, value in said_now.items()
            }
            series = [
                {**one, "resolution": "PT1M"}
                for quantity, value in values.items()
                for one in readings(clock.now(), quantity, {"k0": float(value)})
            ]
            if series:
                assert http.post("/v1/telemetry", {"series": series}).json()["refused"] == []
            plan = decided(http, clock, clock.now())
            assert plan["status"] == "ok"
            power_kw = said(plan, "chargers")["k0"]["p_kw"]
            assert power_kw == pytest.approx(charged_kw(hour), abs=1e-3), hour
            late = [one for one in plan["estimated"] if one.startswith("vehicle k0 at k0 is here")]
            assert len(late) == (said_now.get("plugged") == 1 and leaves <= hour), hour
            shown = http.get("/v1/overview").json()["plan"]
            assert set(late) <= set(shown["estimated"])
            assert "k0" in shown["expected"]["vehicles"]


def test_what_is_odd_of_a_vehicle_is_named(tiny: Scenario) -> None:
    day = plugged_in(replace(tiny, chargers=chargers(2)), (0, 2))
    soon = day.grid.times[0] + pd.Timedelta("20min")
    for told, words in (
        ({"energy_needed_kwh": {"k0": 90.0}}, "car0 at k0 needs 90 kWh, and holds 60 kWh"),
        ({"plugged": {"k1": 1.0}}, "at k1 is here and what it needs is not known"),
        (
            {"plugged": {"k0": 1.0}, "departure": {"k0": soon}},
            "car0 at k0 leaves within this step and is not charged in it",
        ),
        ({}, ""),
    ):
        (step,) = live(day, [told], replace(HERE, horizon_h=1.0))
        assert step.solve["estimated"] == (f"vehicle {words}" if words else "")


def test_a_vehicle_that_stays_leaves_no_time_for_the_next_one(tiny: Scenario) -> None:
    """It was to leave at one, and stays until three: the next one, announced for two, comes then."""
    day = plugged_in(replace(tiny, chargers=chargers(1)), (0, 1), (2, 4), charger="k0")
    leaves = {"k0": day.grid.start + 3 * HOUR}
    told = [{"plugged": {"k0": 1.0}, "departure": leaves}, {}, {}, {}]
    steps = live(day, told, replace(HERE, horizon_h=4.0))
    assert [step.chargers["vehicle"]["k0"] for step in steps] == ["car0"] * 3 + ["car1"]


# Vehicles that are expected as on a past day.

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
    days = range(MONDAY + 1, MONDAY + 61)
    assert [same.drawn_for(d) for d in days] == drawn != [other.drawn_for(d) for d in days]


def test_a_replay_of_stored_plans_keeps_past_days() -> None:
    """Beside the vehicle that a plan tells of."""
    day = history(two_buses([[1.0]] * 6, [1.0], [OPEN] * 6))
    told = {"vehicle": "car9", "leaves": written(day.grid.times[2])}
    plan = {"expected": {"vehicles": {"k0": {**told, "energy_kwh": 5.0, "needed_kwh": 9.0}}}}
    replayed = told_by_plans(day, [plan, *[{}] * 5])
    assert "car9" in replayed.sessions.vehicle
    kept, past = PastDays.of(replayed, 0), PastDays.of(day, 0)
    assert kept.days.tolist() == past.days.tolist()


def test_days_that_go_on_in_the_run_are_not_past() -> None:
    """Neither the day on which the run begins, nor one whose vehicle is still there."""
    late = replace(two_buses([[1.0]] * 6, [1.0], [OPEN] * 6), chargers=chargers())
    late = replace(late, grid=replace(late.grid, start=late.grid.start + pd.Timedelta(hours=12)))
    times = [(-40, -30), (-20, -18), (-16, 3), (-6, -2)]
    still_there = plugged_in(late, *times, charger="k0", announced=False)
    found = PastDays.of(still_there, 0)
    assert found.days.tolist() == [MONDAY - 1]
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
    ahead = expected.ahead.known("chargers")
    on = np.ones((8, 1), dtype=bool)
    beyond_kw = ahead.power_beyond_kw(UnitPlan(powers[0][:, None], on, on))
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


def expected_evening() -> Scenario:
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
    day = expected_evening() if what == "expected" else surprised(expected_evening())
    run = explain_day(run_day(day, RunOptions(isolate=False)))
    assert run.customers["served"].all()
    assert run.vehicles["short_kwh"].sum() == pytest.approx(SHORT_KWH[what], abs=1e-3)
    told = run.explanations[run.explanations["action"] == "expected"]
    assert told["words"].tolist() == (
        ["Expected as on 2022-07-18: up to 04:00, to need 30.0 kWh."] if what == "expected" else []
    )
    assert ("as on one of 1 past days" in " ".join(simplifications(run))) == (what == "expected")


def test_who_does_not_come_is_dropped() -> None:
    """At 01:00 nobody is there: what was stored for the car is left, and no step is worse."""
    day = expected_evening()
    day = replace(day, sessions=day.sessions.rows(day.sessions.over(day.grid.start)))
    run = run_day(day, RunOptions(isolate=False))
    assert run.batteries["charge_kw"].iloc[0] == pytest.approx(7.0, abs=1e-4)
    assert not run.vehicles["p_kw"].any()
    assert run.customers["served"].all() and (run.steps["fallback"] == "none").all()


def test_a_live_controller_expects_the_same_after_a_restart_too() -> None:
    """7 kW are stored for the car, and the same is decided when it does not come."""
    for day, charged_kw in ((expected_evening(), 7.0), (surprised(expected_evening()), 0.0)):
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
