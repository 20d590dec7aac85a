"""One bad reading or message: the step is decided, by what the others say."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.builders import metered
from tests.support.live_service import (
    HERE,
    NOON,
    Live,
    at_noon,
    client,
    decided,
    heard,
    reading,
    readings,
    said,
    site,
)
from tests.support.played_service import crowded
from tests.support.tiny_day import tiny_scenario
from vppres.day.options import RunOptions
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.live.set_points import SetPoints
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service

HOUR = pd.Timedelta("1h")
SOC = {"big": 0.5, "small": 0.5}
DARK = {"type": "outage", "start": "2026-11-21T12:00:00Z"}


# A reading out of its range.


IMPOSSIBLE: tuple[tuple[dict[str, Any], set[str]], ...] = (
    ({"battery_kw": {"big": 40e3}, "soc": {"big": 50.0}, "import_kw": 1e9}, {
        "battery_kw of big = 40000 is beyond the inverter's rating of 60 kVA",
        "soc of big = 50 must lie between 0 and 1",
        "import_kw = 1e+09 is more than any feeder has: check the unit"}),
    ({"load_kw": {"shop": 1e300, "homes": np.inf},
        "pv_kw": pd.DataFrame({"roof": [2e4]}, ["2022-07-19T11:00Z"])}, {
        "load_kw of shop = 1e+300 is more than any feeder has: check the unit",
        "load_kw of homes = inf must be a number not below 0",
        "pv_kw of roof = 20000 is beyond the system's rating of 30 kW"}),
)  # fmt: skip


def test_a_controller_leaves_out_what_no_device_can_have(tiny: Scenario) -> None:
    """It decides as it does without the readings."""

    def second_step(**given: Any) -> SetPoints:
        controller = Controller.of(tiny, RunOptions(horizon_h=1.0, isolate=False))
        controller.step(Measurement(controller.times[0], SOC))
        return controller.step(Measurement(controller.times[1], **given))

    devices, demand = (second_step(**wrong) for wrong, _ in IMPOSSIBLE)
    for found, (_, words) in zip((devices, demand), IMPOSSIBLE, strict=True):
        assert words <= set(found.solve["estimated"].split("; "))
        assert found.solve["fallback"] == "none"
    assert devices.batteries["q_kvar"].equals(second_step(soc={}).batteries["q_kvar"])


@pytest.mark.parametrize("wrong", [ValueError("odd"), KeyError("who")])
def test_a_step_that_raises_is_decided_by_rule(
    live: Live, monkeypatch: pytest.MonkeyPatch, wrong: Exception
) -> None:
    """In an outage that was known before: who cannot be held is off, not on."""
    http, clock = live
    http.put("/v1/events/storm", DARK)
    decided(http, clock, NOON)

    def broken(*_: Any) -> None:
        raise wrong

    monkeypatch.setattr("vppres.service.operation.deciding.known_at", broken)
    plan = decided(http, clock, NOON + HOUR)
    assert plan["status"] == "failed" and plan["reason"].startswith("by rule: ")
    on = said(plan, "customers")
    assert on["hospital"]["served"] and not on["homes"]["served"]
    assert min(one["p_kw"] for one in said(plan, "batteries").values()) < -1.0
    monkeypatch.undo()
    assert decided(http, clock, NOON + 2 * HOUR)["status"] == "ok"


ASSETS = {
    "soc": ("big", "small"),
    "battery_kw": ("big", "small"),
    "load_kw": ("hospital", "shop", "homes"),
    "pv_kw": ("roof", "field"),
    "import_kw": ("grid",),
    "grid_on": ("grid",),
    "online": ("big", "shop", "hospital"),
}
NUMBERS = st.one_of(
    st.none(),
    st.sampled_from([0.0, 1.0, -1.0, 0.5, 1e-300, 1e3, 5e4, 1e6, 1e308, -1e308]),
    st.floats(allow_nan=False, allow_infinity=False),
)
READINGS = st.sampled_from(sorted(ASSETS)).flatmap(
    lambda quantity: st.tuples(st.just(quantity), st.sampled_from(ASSETS[quantity]),
        st.sampled_from(["PT1M", "PT15M", "PT1H", "PT9999H"]), st.integers(-180, 70),
        st.lists(NUMBERS, min_size=1, max_size=3)),
)  # fmt: skip


@pytest.mark.daily
@settings(max_examples=6)
@given(batch=st.lists(READINGS, max_size=12), dark=st.booleans())
def test_whatever_is_read_the_step_is_decided(batch: list[Any], dark: bool) -> None:
    clock = SetClock(NOON)
    with (
        tempfile.TemporaryDirectory() as folder,
        client(Service(site(tiny_scenario()), HERE), folder, clock) as http,
    ):
        if dark:
            http.put("/v1/events/storm", DARK)
        decided(http, clock, NOON)
        clock.set(NOON + HOUR)
        series = [
            reading(
                asset, quantity, NOON + HOUR + pd.Timedelta(minutes=minutes), *values, lasts=lasts
            )
            for quantity, asset, lasts, minutes, values in batch
        ]
        if series:
            assert http.post("/v1/telemetry", {"series": series}).status in (200, 422)
        plan = http.post("/v1/steps").json()
        assert plan["status"] in ("ok", "fallback"), plan


def test_a_loss_that_is_read_is_planned_as_an_outage_without_an_end(
    tiny: Scenario, tmp_path: Path
) -> None:
    """With grid in the next hour the batteries would supply the shop in this one."""

    def supplied(how: str) -> dict[str, bool]:
        with at_noon(tiny, tmp_path / how) as (http, clock):
            if how == "announced":
                http.put("/v1/events/storm", DARK)
            else:
                http.post("/v1/telemetry", {"series": readings(NOON, "grid_on", {"grid": 0.0})})
            plan = decided(http, clock, NOON, soc=0.3)
            return {name: one["served"] for name, one in said(plan, "customers").items()}

    assert supplied("read") == supplied("announced")


# The newest reading counts.


def spoken(
    time: pd.Timestamp, soc: float, resolution: str = "PT1H", assets: Any = ("big", "small")
) -> dict[str, Any]:
    """Telemetry of batteries at a time."""
    series = readings(time, "soc", dict.fromkeys(assets, soc))
    return {"series": [{**one, "resolution": resolution} for one in series]}


@pytest.mark.parametrize(
    "minutes", [15, *(pytest.param(m, marks=pytest.mark.nightly) for m in (30, 60))]
)
def test_five_minute_telemetry_is_not_late_at_any_step(
    tiny: Scenario, tmp_path: Path, minutes: int
) -> None:
    """Heard four minutes before the step, as it is on every day."""
    day = site(tiny, minutes)
    clock = SetClock(NOON)
    step = pd.Timedelta(minutes=day.grid.step_minutes)
    with client(Service(day, HERE), tmp_path, clock) as http:
        for t in range(3):
            clock.set(NOON + t * step)
            http.post("/v1/telemetry", spoken(clock.now() - pd.Timedelta("4min"), 0.5, "PT5M"))
            plan = http.post("/v1/steps").json()
            assert plan["late"] == [] and not any("soc" in one for one in plan["estimated"])


def test_what_was_ordered_since_is_added_to_an_older_reading(tiny: Scenario) -> None:
    """Half an hour before the end of a step that discharges: half of what was ordered is gone."""
    controller = Controller.of(tiny, RunOptions(horizon_h=1.0, isolate=False))
    first = controller.step(Measurement(controller.times[3], SOC))
    power = first.batteries["p_kw"]["big"]
    assert power < -10.0
    second = controller.step(
        Measurement(
            controller.times[4],
            {"big": 0.6, "small": 0.3},
            soc_at={"big": controller.times[4] - 0.5 * HOUR},
        )
    )
    given_kwh = -power / tiny.batteries.eta_discharge[0] * 0.5
    assert second.batteries["soc"]["big"] == pytest.approx(0.6 - given_kwh / 100.0)
    assert second.batteries["soc"]["small"] == 0.3
    assert second.solve["estimated"] == ""


def test_a_battery_that_was_never_heard_is_out_and_says_so(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=1.0, isolate=False))
    found = controller.step(Measurement(controller.times[3], {"small": 0.85}))
    assert found.solve["estimated"] == "soc big was never received; battery big is out"
    assert found.batteries["p_kw"]["big"] == 0.0
    assert found.customers["served"]["hospital"]  # by the other one and the sun


def test_silent_batteries_hold_the_island_as_if_they_were_heard(
    tiny: Scenario, tmp_path: Path
) -> None:
    """By what was ordered; the other service is told each hour what was expected."""
    served = []
    for folder, silent in (("silent", True), ("heard", False)):
        clock = SetClock(NOON)
        with client(Service(site(tiny), HERE), tmp_path / folder, clock) as http:
            http.put("/v1/events/storm", DARK)
            plans = [decided(http, clock, NOON, soc=0.85)]
            for hour in range(1, 6):
                clock.set(NOON + hour * HOUR)
                if not silent:
                    soc = readings(clock.now(), "soc", plans[-1]["expected"]["soc"])
                    assert http.post("/v1/telemetry", {"series": soc}).json()["accepted"] == 2
                plans.append(http.post("/v1/steps").json())
            served.append(
                [{a: p["served"] for a, p in said(q, "customers").items()} for q in plans]
            )
        assert not any("is out" in one for plan in plans for one in plan["estimated"])
    assert served[0] == served[1]
    assert [on["hospital"] for on in served[0]].count(True) >= 2


# A reading that others contradict.


def test_a_demand_that_the_import_confirms_is_believed(tiny: Scenario) -> None:
    """A new machine of the shop, ten times all that was expected: doubted for one step."""
    found = metered(site(tiny), [(500.0, 500.0)] * 3, "shop", SOC, horizon_h=2.0)
    assert ["load shop" in each.solve["estimated"] for each in found] == [True, False, False]


@pytest.mark.parametrize("horizon_h", [0.0, 2.0])
@pytest.mark.parametrize("import_factor", [1.0, 1000.0])
def test_a_meter_in_watts_since_it_was_mounted_puts_nobody_off(
    tiny: Scenario, horizon_h: float, import_factor: float
) -> None:
    """Its first reading is judged as any other; an import in W confirms nothing."""
    hours = [(64e3, None)] * 4
    for found in metered(site(tiny), hours, "hospital", SOC, horizon_h, import_factor):
        assert found.customers["served"].all()
        assert found.solve["fallback"] == "none"
        assert "load hospital" in found.solve["estimated"]


@pytest.mark.parametrize(("soc", "grid_limit_kw"), [(0.05, 500.0), (0.98, 500.0), (0.98, 0.0)])
def test_a_battery_beyond_its_limits_is_used_within_them(
    tiny: Scenario, soc: float, grid_limit_kw: float
) -> None:
    """Below it may only charge, above it takes nothing; it holds an island as a full one does."""
    day = site(tiny)
    count = len(day.batteries)
    limits = {"soc_min": np.full(count, 0.2), "soc_max": np.full(count, 0.9)}
    limits["soc_initial"] = np.full(count, 0.5)
    day = replace(day, batteries=replace(day.batteries, **limits))
    controller = Controller.of(day, RunOptions(horizon_h=2.0, isolate=False))
    socs = dict.fromkeys(day.batteries.id, soc)
    found = controller.step(Measurement(controller.times[0], socs, grid_limit_kw=grid_limit_kw))
    assert found.solve["estimated"] == ""
    assert found.solve["fallback"] == "none"
    charge_kw = found.batteries["p_kw"].to_numpy(float)
    if soc < 0.2:
        assert (charge_kw >= -1e-6).all()
    else:
        assert (charge_kw <= 1e-6).all()
    if grid_limit_kw == 0.0:
        assert found.customers["served"].any()


def test_what_an_inverter_takes_at_night_counts_as_nothing(live: Live, tiny: Scenario) -> None:
    http, _ = live
    pv = site(tiny).pv
    night_kw = -0.005 * float(pv.p_max_kw[0])
    for kw, refused in ((night_kw, 0), (-float(pv.p_max_kw[0]), 1)):
        sent = readings(NOON, "pv_kw", {str(pv.id[0]): kw}) + heard(NOON)["series"][:1]
        answer = http.post("/v1/telemetry", {"series": sent}).json()
        assert len(answer["refused"]) == refused, answer
    controller = Controller.of(site(tiny), RunOptions(horizon_h=0.0, isolate=False))
    now = Measurement(controller.times[0], SOC, pv_kw={str(pv.id[0]): night_kw})
    found = controller.step(now)
    assert "pv" not in found.solve["estimated"]
    assert found.solve["fallback"] == "none"


@pytest.mark.parametrize("kinds", [False, True])
@pytest.mark.parametrize("factor", [9.0, 3.0, 0.2])
def test_the_import_of_the_step_before_contradicts_a_meter(
    tiny: Scenario, factor: float, kinds: bool
) -> None:
    """Beside vehicles, rooms and sets, of which nothing says what they take, too."""
    day = site(crowded(tiny) if kinds else tiny)
    first, *later = metered(day, [(factor * 64.0, 64.0)] * 4, "hospital", SOC)
    assert first.customers["load_kw"]["hospital"] == factor * 64.0
    for found in later:
        assert f"the import contradicts {factor * 64.0:g}" in found.solve["estimated"]
        assert found.customers["load_kw"]["hospital"] == pytest.approx(64.0, abs=4.0)
        assert found.customers["served"].all()


@pytest.mark.parametrize("factor", [9.0, 3.0, 0.2])
def test_a_demand_is_believed_where_the_import_agrees(tiny: Scenario, factor: float) -> None:
    for found in metered(site(tiny), [(factor * 64.0, factor * 64.0)] * 4, "hospital", SOC):
        assert found.customers["load_kw"]["hospital"] == factor * 64.0
        assert "load" not in found.solve["estimated"]


def test_a_meter_that_is_right_again_is_believed_at_once(tiny: Scenario) -> None:
    hours = [(64.0 * factor, 64.0 * min(factor, 1.1)) for factor in (1.0, 9.0, 9.0, 1.1, 1.1)]
    found = metered(site(tiny), hours, "hospital", SOC)
    told = ["load hospital" in each.solve["estimated"] for each in found]
    assert told == [False, False, True, False, False]


def test_a_demand_that_nothing_has_shown_costs_the_first_tier_no_supply(tiny: Scenario) -> None:
    """Nine times what is usual, with grid: beyond what the connection passes."""
    controller = Controller.of(site(tiny), RunOptions(horizon_h=2.0, isolate=False))
    wrong = {"hospital": 9.0 * 64.0}
    now = Measurement(controller.times[0], SOC, load_kw=wrong, grid_limit_kw=200.0)
    found = controller.step(now)
    assert found.customers["served"].all()
    assert found.customers["load_kw"]["hospital"] == 60.0
    words = "load hospital 60.00 kW (576 cannot be supplied, and no import has shown it)"
    assert words in found.solve["estimated"]


def test_a_demand_that_was_shown_is_let_go_where_it_must_be(tiny: Scenario) -> None:
    """The import agreed with it while the connection still passed it."""
    day = site(tiny)
    controller = Controller.of(day, RunOptions(horizon_h=0.0, isolate=False))
    large = {"hospital": 9.0 * 64.0}
    first = controller.step(Measurement(controller.times[0], SOC, load_kw=large))
    now = Measurement(
        controller.times[1],
        SOC,
        load_kw=large,
        battery_kw=dict(first.batteries["p_kw"]),
        import_kw=first.import_kw,
        grid_limit_kw=200.0,
    )
    found = controller.step(now)
    assert "load" not in found.solve["estimated"]
    assert not found.customers["served"]["hospital"]


@pytest.mark.parametrize("horizon_h", [0.0, 2.0])
def test_a_sun_that_was_never_read_is_that_of_the_profile(tiny: Scenario, horizon_h: float) -> None:
    """Of the first step, in an island."""
    day = site(tiny)
    controller = Controller.of(day, RunOptions(horizon_h=horizon_h, isolate=False))
    unread = dict.fromkeys(day.pv.id, np.nan)
    now = Measurement(controller.times[0], SOC, pv_kw=unread, grid_limit_kw=0.0)
    found = controller.step(now)
    assert found.solve["fallback"] == "none"
    assert "missing" in found.solve["estimated"]
    assert found.pv["available_kw"].tolist() == day.pv_kw[0].tolist()
