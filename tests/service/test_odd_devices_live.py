"""Devices that do not do what is expected: a set that does not start, a car, a thermometer.

An operator sees each of them named, and nobody is off needlessly.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.homes import hot
from tests.support.live_service import (
    HERE,
    NOON,
    client,
    decided,
    readings,
    said,
    serving,
    site,
    with_units,
)
from tests.support.played_service import Here, crowded
from tests.support.sets import gensets
from tests.support.small_windows import DARK
from tests.support.vans import van
from vppres import Controller, Measurement, RunOptions
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service
from vppres.service.plans.world import Series, World
from vppres.service.replay.explanations import explained, question
from vppres.service.simulate import Play, Player

REAL = RunOptions(mode="physical", horizon_h=2.0, isolate=False)
HOUR = pd.Timedelta(hours=1)


class Odd(World):
    """A world in which the van is gone at noon, the thermometer stands still, and no set starts."""

    def readings(self, t: int) -> list[Series]:
        """What devices say of it."""
        gone = self.scenario.grid.times[t] >= self.scenario.grid.start + 2 * HOUR
        found = []
        for one in super().readings(t):
            if one["quantity"] == "plugged" and gone:
                one = {**one, "values": [0.0]}
            if one["quantity"] in ("ev_soc", "departure") and gone:
                continue
            if one["quantity"] == "indoor_c":
                one = {**one, "values": [24.0]}
            found.append(one)
        return found

    def obey(self, t: int, setpoints: Any) -> Any:
        """What becomes of set-points for sets, and for a van that is not there."""
        odd = ("gensets", "chargers")
        return super().obey(t, [one for one in setpoints if one["kind"] not in odd])


@pytest.mark.nightly
def test_what_is_odd_is_named_and_nobody_is_off_for_it(
    tiny: Scenario, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Customers are on for as long as without the set and the van, in an island of batteries."""
    day = crowded(tiny)
    nobody = type(day.sessions)()
    plain = replace(day, gensets=gensets(0), sessions=nobody)
    players = []
    for name, there, world in (("odd", day, Odd(day, REAL)), ("plain", plain, World(plain, REAL))):
        caplog.clear()
        service = Service(there, REAL, rehearsal=True)
        with client(service, tmp_path / name) as http, caplog.at_level(logging.WARNING):
            player = Player(world, Here(http), Play(announced=False))
            assert player.play().statuses == {"ok": 6}
            alarms = http.get("/v1/alarms?since=2022-07-19T00:00:00Z").json()["alarms"]
        of_devices = [one for one in alarms if one["subject"] is not None]
        assert bool(of_devices) == (name == "odd") and player.tally.off_needlessly == 0
        logged = [record.getMessage() for record in caplog.records]
        named = [
            "indoor_c h0",
            "vehicle van is not at k0",
            "genset g0 is out",
            "g0 did not follow",
        ]
        found = [any(words in line for line in logged) for words in named]
        assert found == [name == "odd"] * len(named)
        players.append([each.customers["served"] for each in world.records])
    # Of equal plans, which step a customer is on in depends on where the search begins.
    assert np.array_equal(*np.sum(players, axis=1))
    assert not np.all(players[0])


def test_a_van_that_left_is_away_until_it_is_plugged_in_again(
    tiny: Scenario, tmp_path: Path
) -> None:
    day = site(tiny)
    charger, vehicle = van(NOON.floor("1D"), NOON.ceil("1D"))
    clock = SetClock(NOON)
    with client(
        Service(replace(day, chargers=charger, sessions=vehicle), HERE), tmp_path, clock
    ) as http:
        for hours, plugged, is_there in (
            (0, None, True),
            (1, 0.0, False),
            (4, None, False),
            (5, 1.0, True),
        ):
            time = NOON + hours * HOUR
            clock.set(time)
            if hours == 0:
                http.post("/v1/telemetry", {"series": readings(time, "ev_soc", {"k0": 0.4})})
            if plugged is not None:
                http.post("/v1/telemetry", {"series": readings(time, "plugged", {"k0": plugged})})
            plan = decided(http, clock, time)
            assert ("k0" in plan["expected"]["vehicles"]) == is_there
            late = [one["quantity"] for one in plan["late"] if one["asset"] == "k0"]
            assert is_there or "ev_soc" not in late
            assert ("vehicle van is not at k0" in plan["estimated"]) != is_there


@pytest.mark.parametrize(("announced", "minutes"), [(True, 55), (True, 10), (False, 55)])
def test_a_vehicle_that_comes_before_its_announced_time_is_charged_at_once(
    tiny: Scenario, tmp_path: Path, announced: bool, minutes: int
) -> None:
    """From then until its departure; of one that was not announced nothing is known yet."""
    charger, vehicle = van(NOON + HOUR, NOON + 8 * HOUR)
    vehicle = replace(vehicle, announced=np.array([announced]))
    day, clock = replace(site(tiny), chargers=charger, sessions=vehicle), SetClock(NOON)
    with serving(Service(day, HERE), tmp_path, clock) as (http, runner):
        assert decided(http, clock, NOON)["expected"]["vehicles"] == {}
        clock.set(NOON + HOUR - pd.Timedelta(minutes=minutes))
        series = readings(clock.now(), "plugged", {"k0": 1.0})
        series += readings(clock.now(), "ev_soc", {"k0": 0.4})
        http.post("/v1/telemetry", {"series": series})
        plan = runner.anew()
        assert plan is not None
        if announced:
            seen = plan["expected"]["vehicles"]["k0"]
            leaves = written(NOON + 8 * HOUR)
            assert (seen["vehicle"], seen["energy_kwh"], seen["leaves"]) == ("van", 24.0, leaves)
            assert said(plan, "chargers")["k0"]["p_limit_kw"] > 0.0
        else:
            assert "vehicle at k0 is here and what it needs is not known" in plan["estimated"]


@pytest.mark.parametrize(("quantity", "at_first", "slow", "far", "kwh"), [
    ("ev_soc", 0.4, 0.41, 0.8, 48.0),
    ("energy_needed_kwh", 20.0, 19.5, 6.0, 6.0),
])  # fmt: skip
def test_a_vehicle_far_from_the_plan_is_planned_for_at_once(
    tiny: Scenario, tmp_path: Path, quantity: str, at_first: float, slow: float, far: float,
    kwh: float,
) -> None:  # fmt: skip
    """Its gauge was set right, or its driver needs less; one that charges slowly is no news."""
    charger, vehicle = van(NOON.floor("1D"), NOON.ceil("1D"))
    day, clock = replace(site(tiny), chargers=charger, sessions=vehicle), SetClock(NOON)
    with serving(Service(day, HERE), tmp_path, clock) as (http, runner):

        def told(minutes: float, value: float) -> tuple[str, ...]:
            clock.set(NOON + pd.Timedelta(minutes=minutes))
            series = readings(clock.now(), quantity, {"k0": value})
            assert http.post("/v1/telemetry", {"series": series}).status == 200
            return runner.changes.reasons

        told(0.0, at_first)
        decided(http, clock, NOON)
        assert told(10.0, slow) == ()
        assert told(20.0, far) == (f"{quantity} of k0 is {far:g} (scada)",)
        plan = runner.anew()
        assert plan is not None
        found = plan["expected"]["vehicles"]["k0"]
        field = "energy_kwh" if quantity == "ev_soc" else "needed_kwh"
        assert found[field] == pytest.approx(kwh)
        assert told(21.0, far) == ()


def test_a_vehicle_that_only_its_charger_told_of_is_explained(
    tiny: Scenario, tmp_path: Path
) -> None:
    """No session of the scenario knows it; it comes for two hours, and its need is told anew."""
    day = replace(site(tiny), chargers=van(NOON, NOON)[0])
    clock = SetClock(NOON)
    with serving(Service(day, HERE), tmp_path, clock) as (http, runner):
        leaves = (NOON + 2 * HOUR).timestamp()
        for hours, needed_kwh in ((0, None), (1, 5.0), (2, None)):
            time = NOON + hours * HOUR
            clock.set(time)
            if needed_kwh is not None:
                series = readings(time, "energy_needed_kwh", {"k0": needed_kwh})
                series += readings(time, "departure", {"k0": leaves})
                assert http.post("/v1/telemetry", {"series": series}).status == 200
            plan = decided(http, clock, time)
            reasons = explained(question(runner, plan))["reasons"]
            of_cars = [one["words"] for one in reasons if one["kind"] == "vehicles"]
            if needed_kwh is None:
                assert of_cars == []
            else:
                assert of_cars == ["Charges 5.4 kW: it leaves at 14:00 and needs 5.0 kWh more."]


def test_a_thermometer_that_stands_still_while_the_room_swings_is_found() -> None:
    """Without power it becomes 24.7, 23.9 and 23.2 °C: never 1 K from the reading."""
    day = hot([DARK] * 4, c_kwh_per_c=1.0)
    day = replace(day, temperature_c=np.array([25.5, 17.5, 17.5, 21.5]))
    controller = Controller.of(day, RunOptions(mode="paper", isolate=False))
    words = []
    for time in day.grid.times:
        step = controller.step(Measurement(time, indoor_c={"h0": 24.0}))
        words.append(step.solve["estimated"])
    assert words == ["", "", "", "indoor_c h0 23.2 (frozen)"]


def test_a_thermometer_whose_clock_is_ahead_does_not_stand_still_when_its_next_reading_is_lost() -> (
    None
):
    """A reading is dated 90 s after the decision that knew it: a step later it is no new one."""
    day = hot([DARK] * 4, c_kwh_per_c=0.5)
    controller = Controller.of(day, RunOptions(mode="paper", isolate=False))
    first, second, third = day.grid.times[:3]

    def words(now: pd.Timestamp, read: pd.Timestamp) -> str:
        at = {"indoor_c": {"h0": read}}
        told = Measurement(now, indoor_c={"h0": 24.0}, read_at=at)
        return str(controller.step(told).solve["estimated"])

    ahead = first + pd.Timedelta("90s")
    assert words(first, ahead) == ""
    assert words(second, ahead).endswith("(missing)")
    # One that is sent anew and still says the same does stand still.
    assert words(third, third).endswith("(frozen)")


def test_what_rejects_to_be_off_or_less_on_is_named_and_can_be_used(
    tiny: Scenario, tmp_path: Path
) -> None:
    """It stays as it was: nobody is switched off for it, and a set that runs on forms the grid."""
    c = site(tiny).customers
    share_min = np.where(c.id == "shop", 0.5, 1.0)
    day = with_units(tiny, customers=replace(c, share_min=share_min))
    clock = SetClock(NOON)
    asked = [
        {"kind": "customers", "asset": "shop", "served": True, "share": 0.5},
        {"kind": "customers", "asset": "homes", "served": False},
        {"kind": "gensets", "asset": "g0", "p_kw": 0.0},
        {"kind": "chargers", "asset": "k0", "p_limit_kw": 2.0},
        {"kind": "thermal_loads", "asset": "h0", "setpoint_c": 22.0},
        {"kind": "pv", "asset": str(day.pv.id[0]), "p_kw": 0.0},
    ]
    names = {str(one["asset"]) for one in asked}
    with serving(Service(day, HERE), tmp_path, clock) as (http, runner):
        plan = decided(http, clock, NOON)
        until = {"until": "2026-11-21T13:00:00Z", "reason": "work"}
        http.put("/v1/mode", {"mode": "manual", **until, "setpoints": asked})
        clock.set(NOON + HOUR / 4)
        plan = runner.anew() or {}
        points = {one["asset"]: one for one in plan["setpoints"] if one["asset"] in names}
        for one in points.values():
            answer = http.post(f"/v1/setpoints/{one['id']}/status", {"status": "rejected"})
            assert answer.status == 200
        runner.watch.check_alarms()
        alarms = http.get("/v1/alarms").json()["alarms"]
        assert {one["subject"] for one in alarms if one["kind"] == "setpoint_rejected"} == names
        texts = {one["subject"]: one["text"] for one in alarms}
        assert texts["k0"] == "k0 did not follow its set-point: rejected."
        plan = decided(http, clock, NOON + HOUR)
        assert plan["lost"] == [] and not plan["expected"]["gensets"]["g0"]["out"]
        assert all(one["served"] for one in plan["setpoints"] if one["kind"] == "customers")
        left = http.get("/v1/alarms").json()["alarms"]
        assert all(one["cleared_at"] for one in left if one["kind"] == "setpoint_rejected")


def dimming_shop(tiny: Scenario, shop_kw: float, homes_kw: float) -> Scenario:
    """A shop that may have a quarter of its demand, and homes."""
    day = site(tiny)
    c = day.customers
    share_min = np.where(c.id == "shop", 0.25, 1.0)
    load_kw = np.tile([0.0, shop_kw, homes_kw], (len(day.load_kw), 1))
    return replace(
        day, customers=replace(c, share_min=share_min), load_kw=load_kw, pv_kw=0.0 * day.pv_kw
    )


@pytest.mark.daily
def test_the_price_of_energy_counts_on_no_dimming_that_was_refused(
    tiny: Scenario, tmp_path: Path
) -> None:
    """A battery holds 10.3 kWh in an island; homes of 1 kW count 0.02, the shop of 10 kW 0.1.

    One more kWh of 95% goes to the shop, which is dimmed; to the homes, if that gets all.
    """
    day = dimming_shop(tiny, shop_kw=10.0, homes_kw=1.0)
    soc = 0.15 + 10.3 / 0.95 / 60.0
    clock = SetClock(NOON)
    prices, shares = [], []
    with client(Service(day, replace(HERE, horizon_h=0.0)), tmp_path, clock) as http:
        for hours in (0, 1):
            time = NOON + hours * HOUR
            clock.set(time)
            series = readings(time, "grid_on", {"grid": 0.0}) + readings(time, "online", {"big": 0})
            http.post("/v1/telemetry", {"series": series})
            plan = decided(http, clock, time, soc)
            shop = next(one for one in plan["setpoints"] if one["asset"] == "shop")
            shares.append(shop["share"])
            told = http.get("/v1/explanations").json()["price"]
            prices.append({one["asset"]: one["weighted_h"] for one in told}["small"])
            no = {"status": "rejected", "reason": "no relay"}
            http.post(f"/v1/setpoints/{shop['id']}/status", no)
    assert shares == pytest.approx([0.93, 1.0], abs=1e-4)
    assert prices == pytest.approx([0.95 * 0.1 / 10.0, 0.95 * 0.02 / 1.0], rel=1e-3)


@pytest.mark.parametrize("still", [{}, {"shop": 1.0}])
def test_a_customer_that_rejects_to_be_dimmed_is_not_dimmed_until_it_is_back(
    tiny: Scenario, tmp_path: Path, still: dict[str, float]
) -> None:
    """One battery of 30 kW in an island; the shop takes 40 kW and may have a quarter of it.

    A gateway that says in each hour that it is ``still`` there says nothing new.
    """
    day = dimming_shop(tiny, shop_kw=40.0, homes_kw=5.0)
    now = replace(HERE, horizon_h=0.0)
    clock = SetClock(NOON)

    def shop(http: Any, hours: int, **online: float) -> tuple[Any, list[str]]:
        time = NOON + hours * HOUR
        clock.set(time)
        series = readings(time, "soc", {"big": 0.0, "small": 0.9})
        series += readings(time, "grid_on", {"grid": 0.0})
        series += readings(time, "online", {**online, "big": 0.0})
        assert not http.post("/v1/telemetry", {"series": series}).json().get("refused")
        plan = decided(http, clock, time)
        return next(o for o in plan["setpoints"] if o["asset"] == "shop"), plan["estimated"]

    with client(Service(day, now), tmp_path, clock) as http:
        point, _ = shop(http, 0, **still)
        assert point["served"] and 0.25 <= point["share"] < 1.0
        no = {"status": "rejected", "reason": "no relay"}
        assert http.post(f"/v1/setpoints/{point['id']}/status", no).status == 200
    with client(Service(day, now), tmp_path, clock) as http:
        for hours, online in ((1, still), (2, still)):
            point, estimated = shop(http, hours, **online)
            assert not point["served"], "40 kW are more than 30"
            assert "shop cannot be dimmed (rejected: no relay)" in estimated
        if still:
            shop(http, 3, shop=0.0)
        point, estimated = shop(http, 4, shop=1.0)
        assert point["served"] and point["share"] < 1.0
        assert not [words for words in estimated if "dimmed" in words]
