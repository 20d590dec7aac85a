"""Electric vehicles: hand-solved windows, methods against each other, plant, days, messages."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from benchmarks.random_feeders import random_window
from tests.support.agreement import assert_methods_agree
from tests.support.live_service import HERE, NOON, client, decided, readings, said, site
from tests.support.small_windows import (
    DARK,
    OPEN,
    battery,
    first_step,
    two_buses,
    window,
    with_pv,
)
from tests.support.vans import chargers, plugged_in, with_random_vehicles
from vppres import (
    Controller,
    InputError,
    Measurement,
    RunOptions,
    explain_day,
    load_scenario,
    run_day,
    summarise,
)
from vppres.contract.ahead import KindsAhead
from vppres.contract.decision import Decision
from vppres.control.guard.check import violations
from vppres.day.metrics import cautions
from vppres.io import read_scenario, write_scenario
from vppres.io.digest import scenario_digest
from vppres.io.python_door import check_scenario
from vppres.kinds.vehicles.physics import Garage, Plugged
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.plant.plant import Plant
from vppres.report.run_folder import render_report
from vppres.scenario.remarks import brief_sessions
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.runner import Service
from vppres.solve.ladder import METHODS, WindowSolver

HOUR = pd.Timedelta("1h")


def known(day: Scenario) -> WindowData:
    """All steps as one window, with the vehicles that are known in the first."""
    steps = range(day.grid.n_steps)
    held_kwh = Plant(day).of(Garage).at(0)
    return replace(window(day), ahead=KindsAhead({"chargers": Plugged.of(day, steps, held_kwh)}))


def evening(limit_kw: float, steps: int = 14, **more: Any) -> Scenario:
    """A car from 18:00 to 07:00, in a day whose first step is at 18:00."""
    day = two_buses([[1.0]] * steps, [1.0], [limit_kw] * steps)
    return plugged_in(replace(day, chargers=chargers(**more)), (0, 13))


# Hand-solved windows.


@pytest.mark.parametrize("method", METHODS)
def test_a_car_charges_at_once_what_it_needs(method: str) -> None:
    """32.61 kWh in 4.41 h, in the first hours since all cost the same."""
    day = evening(OPEN)
    answer = WindowSolver(Site.of(day), method).solve(known(day))
    power_kw = answer.dispatch.taken_kw["chargers"][:, 0]
    assert power_kw.sum() == pytest.approx(30.0 / 0.92, abs=1e-4)
    assert power_kw[:4] == pytest.approx(7.4)
    assert power_kw.sum() / 7.4 == pytest.approx(4.41, abs=5e-3)
    assert power_kw[5:].max() == pytest.approx(0.0, abs=1e-6)
    assert answer.status == "optimal"


@pytest.mark.parametrize("method", METHODS)
def test_a_departure_in_an_outage_is_short_and_feasible(method: str) -> None:
    day = evening(DARK)
    data = known(day)
    answer = WindowSolver(Site.of(day), method).solve(data)
    assert answer.status == "optimal"
    energy_kwh = data.ahead.known(Plugged).energy_kwh(
        answer.dispatch.taken_kw["chargers"], day.chargers, 1.0
    )
    assert data.ahead.known(Plugged).short_kwh(energy_kwh).sum() == pytest.approx(30.0)
    assert answer.objective == pytest.approx(-0.5 * 30.0 / 60.0)  # half a step for 60 kWh


def test_a_car_charges_in_the_cheap_hours() -> None:
    day = evening(OPEN)
    price = np.where(np.arange(14) >= 8, 0.1, 0.3)
    day = replace(day, price_gbp_per_kwh=price)
    power_kw = WindowSolver(Site.of(day)).solve(known(day)).dispatch.taken_kw["chargers"]
    assert power_kw is not None
    assert power_kw[8:13].sum() == pytest.approx(30.0 / 0.92, abs=1e-4)


def test_a_charger_of_a_customer_that_is_off_does_not_charge() -> None:
    """20 kWh for a home of 10 kW in two of three hours; the third leaves nothing for its car."""
    day = two_buses([[10.0]] * 3, [1.0], [12.0, DARK, 5.0])
    own = chargers(customer="c0", bus=None)
    day = plugged_in(replace(day, chargers=own), (0, 3))
    answer = WindowSolver(Site.of(day)).solve(known(day))
    assert answer.dispatch.served[:, 0].tolist() == [True, False, False]
    assert answer.dispatch.taken_kw["chargers"][:, 0] == pytest.approx([2.0, 0.0, 0.0], abs=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_a_car_that_never_leaves_is_a_battery(method: str) -> None:
    """The same service and cost, with a sunny noon, an outage and prices that pay for storing."""
    limits = [OPEN] * 4 + [DARK] * 4
    load = [[6.0, 5.0]] * 8
    day = two_buses(load, [1.0, 2.0], limits, [0.1, 0.3, 0.1, 0.3] + [0.3] * 4)
    day = with_pv(day, [0, 5, 20, 30, 20, 0, 0, 0])
    stored = replace(battery(energy_kwh=40.0, p_max_kw=9.0, s_max_kva=1e3), soc_initial=[0.5])
    one = replace(day, batteries=stored)
    b = one.batteries
    usable = float((b.soc_max - b.soc_min)[0] * 40.0)
    two_way = chargers(
        p_charge_kw=9.0,
        p_discharge_kw=9.0,
        eta_charge=b.eta_charge,
        eta_discharge=b.eta_discharge,
    )
    soc = float((0.5 - b.soc_min[0]) * 40.0 / usable)
    other = plugged_in(
        replace(day, chargers=two_way),
        (-1, 9),
        capacity_kwh=usable,
        soc_at_plug_in=soc,
        soc_needed=0.0,
        v2g_soc_floor=0.0,
    )
    # Without a need, what it lacks at the end of the window counts nothing.
    data = known(other)
    plugged = data.ahead.find(Plugged)
    assert plugged is not None
    data = replace(
        data, ahead=KindsAhead({"chargers": replace(plugged, line_kwh=0.0 * plugged.line_kwh)})
    )
    by_battery = WindowSolver(Site.of(one), method).solve(window(one))
    by_car = WindowSolver(Site.of(other), method).solve(data)
    assert (by_car.dispatch.served == by_battery.dispatch.served).all()
    assert by_car.terms.f1 == by_battery.terms.f1
    assert by_car.terms.f2 == pytest.approx(by_battery.terms.f2, abs=2e-3)
    assert by_car.terms.f3 == pytest.approx(by_battery.terms.f3, abs=1e-4)
    assert by_car.objective == pytest.approx(by_battery.objective, rel=1e-6)
    assert not broken(Site.of(other), data, by_car.dispatch)


@pytest.mark.parametrize("method", METHODS)
def test_a_charger_does_not_burn_sun_by_charging_and_discharging_at_once(method: str) -> None:
    """A car of 57 of 60 kWh gives a home 1 kWh; then 19 kW of sun are too much in the dark."""
    day = with_pv(two_buses([[1.0]] * 3, [1.0], [OPEN, DARK, OPEN]), [0, 20, 0])
    day = replace(day, chargers=chargers(p_discharge_kw=7.4))
    session = {"soc_at_plug_in": 0.95, "soc_needed": 0.5, "v2g_soc_floor": 0.0}
    day = plugged_in(day, (0, 3), **session)
    answer = WindowSolver(Site.of(day), method).solve(known(day))
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
    data = known(day)
    answer = WindowSolver(Site.of(day)).solve(data)
    energy_kwh = data.ahead.known(Plugged).energy_kwh(
        answer.dispatch.taken_kw["chargers"], day.chargers, 1.0
    )[:, 0]
    assert energy_kwh.min() >= 15.0 - 1e-6
    assert energy_kwh[-1] == pytest.approx(57.0, abs=1e-4)
    assert answer.dispatch.served[:6].sum() == 5


def test_two_hundred_cars_never_outweigh_one_customer() -> None:
    """A kW goes to a customer of the least weight, and with grid each car has its energy."""
    count = 200
    for limit_kw, charged in ((20.0, False), (OPEN, True)):
        day = two_buses([[20.0]] * 5, [1.0], [limit_kw] * 5)
        day = replace(day, chargers=chargers(count))
        day = plugged_in(day, *[(0, 5)] * count, weight=1000.0, soc_needed=0.8)
        answer = WindowSolver(Site.of(day)).solve(known(day))
        assert answer.dispatch.served.all()
        charged_kwh = answer.dispatch.taken_kw["chargers"].sum() * 0.92
        assert charged_kwh == pytest.approx(30.0 * count if charged else 0.0, abs=0.1)


@pytest.mark.parametrize("tiers", [("critical", "low"), ("low", "critical")])
def test_the_tier_says_which_car_goes_first(tiers: tuple[str, str]) -> None:
    day = replace(two_buses([[1.0]] * 2, [1.0], [6.0] * 2), chargers=chargers(2))
    weight = [5.0 if tier == "critical" else 1.0 for tier in tiers]
    day = plugged_in(day, (0, 2), (0, 2), tier=tiers, weight=weight)
    power_kw = WindowSolver(Site.of(day)).solve(known(day)).dispatch.taken_kw["chargers"]
    assert power_kw is not None
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
    plugged = known(day).ahead.find(Plugged)
    assert plugged is not None and not plugged.held_kwh.any()
    assert WindowSolver(Site.of(day)).solve(known(day)).status == "optimal"
    assert "no whole step of 60 min" in brief_sessions(day)


@pytest.mark.monolith
@pytest.mark.parametrize("seed", range(60))
def test_methods_agree_on_random_windows(seed: int) -> None:
    scenario, data = random_window(seed, stressed=seed % 2 > 0)
    day = with_random_vehicles(scenario, seed)
    steps = range(day.grid.n_steps)
    plugged = Plugged.of(day, steps, Plant(day).of(Garage).at(0))
    assert plugged is not None
    if seed % 3 == 0:  # those that are yet to come are expected, and not known
        plugged = replace(plugged, known=plugged.here & plugged.here[0])
    data = replace(data, ahead=KindsAhead({"chargers": plugged}))
    assert_methods_agree(Site.of(day), data)


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
        garage.advance(t, garage.possible_kw(t, np.array([7.4]), on))
    assert garage.state == pytest.approx([60.0], abs=1e-9)  # full, and no more
    assert garage.at(13) == pytest.approx([0.0])  # gone
    assert garage.possible_kw(13, np.array([7.4]), on) == pytest.approx([0.0])


def test_the_guard_refuses_power_without_a_vehicle() -> None:
    day = evening(OPEN)
    data = known(day)
    observed = replace(first_step(day, data), ahead=data.ahead)
    plan = WindowSolver(observed.site).solve(data).dispatch
    assert violations(Decision(plan), observed) == []
    more = plan.acting("chargers", plan.taken_kw["chargers"] + 1.0)
    assert "charger power: k0 by 1 kW" in violations(Decision(more), observed)
    away = replace(observed, ahead=KindsAhead({"chargers": Plugged.none(1, 1)}))
    assert "charger power: k0 by 7.4 kW" in violations(Decision(plan), away)


# Days.


@pytest.mark.daily
def test_a_day_says_who_left_short() -> None:
    """14.8 kWh with grid, and of 13.3 stored what the home leaves in its four hours."""
    day = two_buses([[1.0]] * 6, [1.0], [OPEN] * 2 + [DARK] * 4)
    stored = battery(energy_kwh=20.0, p_max_kw=20.0, s_max_kva=100.0)
    day = replace(day, batteries=stored, chargers=chargers())
    day = plugged_in(day, (0, 5), soc_needed=0.8)
    run = explain_day(run_day(day, RunOptions(horizon_h=5.0, isolate=False)))
    summary = summarise(run)
    figures = summary["vehicles"]
    charged_kwh = 2 * 7.4 + 20.0 * 0.7 * 0.95 - 4.0
    assert figures["departures"] == figures["left_short"] == 1
    assert figures["charged_kwh"] == pytest.approx(charged_kwh, abs=1e-3)
    assert figures["missed_kwh"] == pytest.approx(30.0 - charged_kwh * 0.92, abs=1e-3)
    assert figures["missed_kwh_by_tier"] == {"critical": figures["missed_kwh"]}
    assert cautions(run)[0].startswith("1 of 1 vehicles left short of 7.8 kWh in all: car0")
    assert run.vehicles is not None
    end_kwh = run.vehicles["energy_end_kwh"].iloc[4]
    assert end_kwh == pytest.approx(18.0 + charged_kwh * 0.92, abs=1e-3)
    told = run.explanations
    assert told is not None
    words = told[told["item"] == "vehicle"].set_index("action")["words"]
    assert words["charged"].iloc[0] == (
        "Charges 7.4 kW: it leaves at 05:00 and needs 30.0 kWh more."
    )
    assert words["left_short"] == (
        "Leaves 7.8 kWh short: it left inside the outage, and customers come first."
    )
    page = render_report(run, summary)
    assert "1 vehicle leaves short: car0 (critical, 7.8 kWh)." in page
    assert "Vehicles charged" in page


# Live.


def test_a_car_that_leaves_early_is_named_and_a_restart_keeps_energy() -> None:
    """What it was to get goes to nobody else, and the home stays on in all steps."""
    day = two_buses([[2.0]] * 6, [1.0], [OPEN] * 6)
    day = replace(day, chargers=chargers(p_discharge_kw=7.4))
    day = plugged_in(day, (0, 6), soc_needed=0.9)
    options = RunOptions(mode="paper", isolate=False)
    controller = Controller.of(day, options)
    found, energies = [], []
    for t, time in enumerate(day.grid.times):
        if t == 2:
            state = json.loads(json.dumps(controller.state(), allow_nan=False))
            controller = Controller.of(day, options, state=state)
        told: dict[str, Any] = {"plugged": {"k0": 0.0}} if t >= 3 else {}
        step = controller.step(Measurement(time, **told))
        assert step.chargers is not None
        found.append(float(step.chargers.loc["k0", "p_limit_kw"]))
        energies.append(float(step.chargers.loc["k0", "energy_kwh"]))
        named = "vehicle car0 left k0 before its departure" in step.solve["estimated"]
        assert named == (t >= 3)
        assert step.customers["served"].all()
    assert found == pytest.approx([7.4] * 3 + [0.0] * 3)
    assert energies == pytest.approx([18.0, 18.0 + 6.808, 18.0 + 2 * 6.808, 0.0, 0.0, 0.0])


def test_what_a_vehicle_tells_holds() -> None:
    day = two_buses([[2.0]] * 6, [1.0], [OPEN] * 6)
    day = plugged_in(replace(day, chargers=chargers(2)), (0, 6))
    controller = Controller.of(day, RunOptions(mode="paper", horizon_h=6.0, isolate=False))
    times = day.grid.times
    told: dict[str, Any] = {
        "ev_soc": {"k0": 0.79},
        "plugged": {"k1": 1.0},
        "energy_needed_kwh": {"k1": 3.0},
    }
    other = Controller.of(day, RunOptions(mode="paper", horizon_h=6.0, isolate=False))
    unknown = other.step(Measurement(times[0], **told))
    assert "vehicle k1 at k1 is here and its departure is not known" in unknown.solve["estimated"]
    assert unknown.chargers is not None
    assert unknown.chargers["p_kw"]["k1"] == pytest.approx(3.0 / 0.92, abs=1e-4)
    step = controller.step(Measurement(times[0], **told, departure={"k1": times[2]}))
    assert step.chargers is not None
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


# Files and messages.


def test_the_tables_are_read_and_written(tiny: Scenario, tmp_path: Path) -> None:
    some = chargers(2, customer=["shop", ""], bus=[None, tiny.network.buses[1]])
    day = plugged_in(replace(tiny, chargers=some), (0.5, 3), (1, 9), tier="low")
    check_scenario(day)
    write_scenario(day, tmp_path / "day")
    again = read_scenario(tmp_path / "day")
    assert scenario_digest(again) == scenario_digest(day)
    assert (again.session_at == day.session_at).all()
    write_scenario(tiny, tmp_path / "plain")
    assert not list((tmp_path / "plain").glob("ev_*"))
    assert scenario_digest(read_scenario(tmp_path / "plain")) == scenario_digest(tiny)


@pytest.mark.parametrize(
    ("file", "before", "after", "message"),
    [
        ("ev_chargers", "k0,,2", "k0,nobody,", r"ev_chargers.csv, row 2.*customer.*nobody"),
        ("ev_chargers", "k0,,2", "k0,,", r"row 2.*neither a customer nor a bus"),
        ("ev_chargers", "7.4,0.0", "7.4,9.0", r"p_charge_min_kw.*9.*p_charge_kw \(7.4\)"),
        ("ev_sessions", "k0,car0", "k7,car0", r"ev_sessions.csv, row 2.*charger.*k7"),
        ("ev_sessions", ",0.8,", ",,", r"row 2.*soc_needed.*energy_needed_kwh"),
        ("ev_sessions", "T02:00", "T00:00", r"row 2.*plug_out.*does not come after plug_in"),
        ("ev_sessions", "critical", "none", r"row 2.*tier.*none.*not a tier"),
    ],
)
def test_mistakes_are_named(
    tmp_path: Path, file: str, before: str, after: str, message: str
) -> None:
    day = plugged_in(replace(evening(OPEN), tiers=("critical",)), (0, 2))
    write_scenario(day, tmp_path / "day")
    path = tmp_path / "day" / f"{file}.csv"
    text = path.read_text("utf-8")
    assert before in text
    path.write_text(text.replace(before, after, 1), "utf-8")
    with pytest.raises(InputError, match=message):
        read_scenario(tmp_path / "day")


def test_two_vehicles_at_a_charger_at_a_time_are_refused(tmp_path: Path) -> None:
    day = replace(evening(OPEN), tiers=("critical",))
    twice = plugged_in(replace(day, chargers=chargers(2)), (0, 3), (2, 4), charger="k0")
    write_scenario(twice, tmp_path / "day")
    with pytest.raises(InputError, match=r"row 3.*plug_in.*before the vehicle of row 2 has left"):
        read_scenario(tmp_path / "day")


def test_what_plans_no_vehicles_is_refused() -> None:
    day = evening(OPEN)
    with pytest.raises(InputError, match=r"controller.*idle.*plans no vehicles.*Use mpc"):
        run_day(day, RunOptions(controller="idle"))
    dear = replace(day, price_gbp_per_kwh=np.full(14, 1e4))
    with pytest.raises(InputError, match=r"lambda_grid.*makes energy dearer than.*at most"):
        run_day(dear)
    parts = replace(
        day,
        chargers=chargers(customer="c0", bus=None),
        customers=replace(day.customers, shed_steps=[2]),
    )
    with pytest.raises(InputError, match=r"customer.*c0.*switched in parts.*charger k0"):
        run_day(parts)


def test_a_vehicle_that_needs_more_than_it_holds_is_refused_by_row(tmp_path: Path) -> None:
    folder = tmp_path / "village"
    write_scenario(load_scenario("village-hot-week"), folder)
    file = folder / "ev_sessions.csv"
    sessions = pd.read_csv(file, dtype=str)
    sessions.loc[0, ["energy_needed_kwh", "capacity_kwh"]] = ["90", "40"]
    sessions.loc[0, ["soc_at_plug_in", "soc_needed"]] = np.nan
    sessions.to_csv(file, index=False)
    with pytest.raises(InputError, match=r"row 2.*energy_needed_kwh.*more than the vehicle holds"):
        load_scenario(folder)


SAID: dict[str, list[dict[str, float]]] = {
    # Of each hour: whether it is plugged in, what it needs, and in how many hours of the first it leaves.
    "departure passed": [{"plugged": 1, "need": 20, "leaves": 1}]
    + [{"plugged": 1, "leaves": 1}] * 3,
    "departure never said": [{"plugged": 1, "need": 20}] + [{"plugged": 1}] * 3,
    "said once": [{"plugged": 1, "need": 20, "leaves": 4}, {}, {}, {}],
    "need said once": [{"plugged": 1, "need": 20, "leaves": 4}] + [{"plugged": 1}] * 3,
    "departure moved": [{"plugged": 1, "need": 20, "leaves": 4}, {"leaves": 2}]
    + [{"plugged": 1}] * 2,
    "departure put off": [
        {"plugged": 1, "need": 20, "leaves": 1},
        {"plugged": 1, "leaves": 4},
        {},
        {},
    ],
    "need said again": [
        {"plugged": 1, "need": need, "leaves": 1} for need in (20, 13.192, 6.384, 0.0)
    ],
}


def left_kwh(said: list[dict[str, float]]) -> list[float]:
    """What a charger of 7.4 kW and 0.92 has given by the beginning of each hour, of 20 kWh."""
    return [min(7.4 * 0.92 * hour, 20.0) for hour in range(len(said))]


@pytest.mark.parametrize("name", SAID)
def test_a_vehicle_that_is_here_is_charged_whatever_it_says(name: str) -> None:
    """By Python: 20 kWh in three hours, whether or not it says so again; and it is named late."""
    steps = SAID[name]
    day = replace(two_buses([[2.0]] * 4, [1.0], [OPEN] * 4), chargers=chargers(1))
    options = RunOptions(horizon_h=1.0, isolate=False)
    controller = Controller.of(day, options)
    times = controller.times
    leaves = 0.0
    for hour, told in enumerate(steps):
        if hour == 2:  # another process goes on
            controller = Controller.of(day, options, state=json.loads(controller.saved()))
        leaves = told.get("leaves", leaves)
        measured = Measurement(
            times[hour],
            plugged={"k0": told["plugged"]} if "plugged" in told else None,
            energy_needed_kwh={"k0": told["need"]} if "need" in told else None,
            departure={"k0": times[0] + told["leaves"] * HOUR} if "leaves" in told else None,
        )
        found = controller.step(measured)
        assert found.solve["fallback"] == "none" and found.customers["served"].all()
        assert found.chargers is not None
        given_kwh = left_kwh(steps)[hour]
        power_kw = float(found.chargers["p_kw"].iloc[0])
        assert power_kw == pytest.approx(min((20.0 - given_kwh) / 0.92, 7.4), abs=1e-3), hour
        late = "vehicle k0 at k0 is here" in found.solve["estimated"]
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
                "plugged": said_now.get("plugged"),
                "energy_needed_kwh": said_now.get("need"),
                "departure": (NOON + leaves * HOUR).timestamp() if "leaves" in said_now else None,
            }
            series = [
                {**one, "resolution": "PT1M"}
                for quantity, value in values.items()
                if value is not None
                for one in readings(clock.now(), quantity, {"k0": float(value)})
            ]
            if series:
                assert http.post("/v1/telemetry", {"series": series}).json()["refused"] == []
            plan = decided(http, clock, clock.now())
            assert plan["status"] == "ok"
            power_kw = said(plan, "chargers")["k0"]["p_kw"]
            given_kwh = left_kwh(SAID[name])[hour]
            assert power_kw == pytest.approx(min((20.0 - given_kwh) / 0.92, 7.4), abs=1e-3), hour
            late = [one for one in plan["estimated"] if one.startswith("vehicle k0 at k0 is here")]
            assert len(late) == (said_now.get("plugged") == 1 and leaves <= hour), hour
            shown = http.get("/v1/overview").json()["plan"]
            assert set(late) <= set(shown["estimated"])
            assert "k0" in shown["expected"]["vehicles"]


def test_what_is_odd_of_a_vehicle_is_named(tiny: Scenario) -> None:
    day = plugged_in(replace(tiny, chargers=chargers(2)), (0, 2))
    controller = Controller.of(day, RunOptions(horizon_h=1.0, isolate=False))

    def estimated(**told: Any) -> str:
        found = controller.step(
            Measurement(controller.times[0], {"big": 0.5, "small": 0.5}, **told)
        )
        assert found.solve["fallback"] == "none"
        return str(found.solve["estimated"])

    more = estimated(energy_needed_kwh={"k0": 90.0})
    assert "vehicle car0 at k0 needs 90 kWh, and holds 60 kWh" in more
    unknown = estimated(plugged={"k1": 1.0})
    assert "vehicle at k1 is here and what it needs is not known" in unknown
    soon = controller.times[0] + pd.Timedelta("20min")
    told = estimated(plugged={"k0": 1.0}, departure={"k0": soon})
    assert "vehicle car0 at k0 leaves within this step and is not charged in it" in told
    assert estimated() == ""


def test_a_vehicle_that_stays_leaves_no_time_for_the_next_one(tiny: Scenario) -> None:
    """It was to leave at one, and stays until three: the next one, announced for two, comes then."""
    day = plugged_in(replace(tiny, chargers=chargers(1)), (0, 1), (2, 4), charger="k0")
    controller = Controller.of(day, RunOptions(horizon_h=4.0, isolate=False))
    times = controller.times
    soc = {"big": 0.5, "small": 0.5}
    leaves = {"k0": times[0] + 3 * HOUR}
    first = controller.step(Measurement(times[0], soc, plugged={"k0": 1.0}, departure=leaves))
    assert first.chargers is not None
    assert first.chargers["vehicle"].tolist() == ["car0"]
    found = [controller.step(Measurement(times[t], soc)).chargers for t in (1, 2, 3)]
    assert [None if one is None else one["vehicle"].iloc[0] for one in found] == [
        "car0",
        "car0",
        "car1",
    ]
