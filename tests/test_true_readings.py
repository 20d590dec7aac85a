"""One bad reading or message: the step is decided, by what the others say."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.asgi import Caller
from tests.support.live_service import HERE, NOON, client, decided, heard, readings, said, site
from tests.support.tiny_day import tiny_scenario
from vppres.day.options import RunOptions
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.live.ranges import RANGES
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.runner import Service

HOUR = pd.Timedelta("1h")
SOC = {"big": 0.5, "small": 0.5}
DARK = {"type": "outage", "start": "2026-11-21T12:00:00Z"}


@pytest.fixture
def live(tiny: Scenario, tmp_path: Path) -> Iterator[tuple[Caller, SetClock]]:
    """A service at noon, years after its scenario's day."""
    clock = SetClock(NOON)
    with client(Service(site(tiny), HERE), tmp_path, clock) as http:
        yield http, clock


# A reading out of its range.


@pytest.mark.parametrize(
    ("quantity", "asset", "value"), [("battery_kw", "big", 5e4), ("pv_kw", "roof", 2e4)]
)
def test_a_meter_in_watts_is_refused_by_name_and_the_island_is_held(
    live: tuple[Caller, SetClock], quantity: str, asset: str, value: float
) -> None:
    http, clock = live
    http.put("/v1/events/storm", DARK)
    decided(http, clock, NOON)
    clock.set(NOON + HOUR)
    sent = readings(NOON, quantity, {asset: value}) + heard(NOON + HOUR)["series"]
    answer = http.post("/v1/telemetry", {"series": sent}).json()
    assert [one["field"] for one in answer["refused"]] == [f"{quantity} of {asset}"]
    assert answer["accepted"] == 2
    plan = http.post("/v1/steps").json()
    assert plan["status"] == "ok"
    on = said(plan, "customers")
    assert on["hospital"]["served"] and not all(one["served"] for one in on.values())


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (
            {"battery_kw": {"big": 40e3}},
            "battery_kw of big = 40000 is beyond the inverter's rating of 60 kVA",
        ),
        (
            {"load_kw": {"shop": 1e300}},
            "load_kw of shop = 1e+300 is more than any feeder has: check the unit",
        ),
        ({"load_kw": {"shop": np.inf}}, "load_kw of shop = inf must be a number not below 0"),
        (
            {"pv_kw": pd.DataFrame({"roof": [2e4]}, ["2022-07-19T11:00Z"])},
            "pv_kw of roof = 20000 is beyond the system's rating of 30 kW",
        ),
        ({"soc": {"big": 50.0}}, "soc of big = 50 must lie between 0 and 1"),
        ({"import_kw": 1e9}, "import_kw = 1e+09 is more than any feeder has: check the unit"),
    ],
)
def test_a_controller_leaves_out_what_no_device_can_have(
    tiny: Scenario, wrong: dict[str, Any], words: str
) -> None:
    """It decides as it does without the reading."""
    answers = []
    for given_now in (wrong, {"soc": {}} if "soc" in wrong else {}):
        controller = Controller.of(tiny, RunOptions(horizon_h=1.0, isolate=False))
        controller.step(Measurement(controller.times[0], SOC))
        answers.append(
            controller.step(Measurement(controller.times[1], **{"soc": SOC, **given_now}))
        )
    assert words in answers[0].solve["estimated"].split("; ")
    if "load_kw" not in wrong and "pv_kw" not in wrong:  # of these the scenario says the same
        assert answers[0].batteries["q_kvar"].equals(answers[1].batteries["q_kvar"])
    assert answers[0].solve["fallback"] == "none"


@pytest.mark.parametrize("wrong", [ValueError("odd"), KeyError("who")])
def test_a_step_that_raises_is_decided_by_rule(
    live: tuple[Caller, SetClock], monkeypatch: pytest.MonkeyPatch, wrong: Exception
) -> None:
    """In an outage that was known before: who cannot be held is off, not on."""
    http, clock = live
    http.put("/v1/events/storm", DARK)
    decided(http, clock, NOON)

    def broken(*_: Any) -> None:
        raise wrong

    monkeypatch.setattr("vppres.service.runner.known_at", broken)
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
    lambda quantity: st.tuples(
        st.just(quantity),
        st.sampled_from(ASSETS[quantity]),
        st.sampled_from(["PT1M", "PT15M", "PT1H", "PT9999H"]),
        st.integers(-180, 70),
        st.lists(NUMBERS, min_size=1, max_size=3),
    )
)


@settings(max_examples=25, deadline=None)
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
            {
                "source": "meter",
                "asset": asset,
                "quantity": quantity,
                "start": (NOON + HOUR + pd.Timedelta(minutes=minutes)).isoformat(),
                "resolution": resolution,
                "values": values,
            }
            for quantity, asset, resolution, minutes, values in batch
        ]
        if series:
            assert http.post("/v1/telemetry", {"series": series}).status in (200, 422)
        plan = http.post("/v1/steps").json()
        assert plan["status"] in ("ok", "fallback"), plan


def test_a_forecast_has_the_range_of_a_reading(live: tuple[Caller, SetClock]) -> None:
    http, clock = live
    body = {
        "issued_at": "2026-11-21T11:00:00Z",
        "start": "2026-11-21T12:00:00Z",
        "resolution": "PT1H",
        "assets": {"shop": {"p50": [RANGES["load_kw"].highest]}},
    }
    assert http.put("/v1/forecasts/load_kw", body).status == 200
    assert decided(http, clock, NOON)["status"] in ("ok", "fallback")
    body["assets"] = {"shop": {"p50": [2.0 * RANGES["load_kw"].highest]}}
    assert http.put("/v1/forecasts/load_kw", body).status == 422
