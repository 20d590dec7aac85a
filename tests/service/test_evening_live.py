"""An evening as an operator: loss of grid, former rejected and back, off, by hand, grid back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.browser import FLAGS, chromium, listening
from tests.support.live_service import NOON, decided, readings, said, serving, site
from vppres.day.options import RunOptions
from vppres.day.reliability import reliability_by_tier
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access
from vppres.service.clock import SetClock, written
from vppres.service.http.app import make_app
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.replay.export import export

ISLAND = RunOptions(horizon_h=1.0, isolate=False, mode="physical")
MINUTE = pd.Timedelta("1min")
END = "2026-11-21T14:30:00Z"


class Evening:
    """What happens, minute by minute."""

    def __init__(self, http: Caller, runner: Runner) -> None:
        self.http = http
        self.runner = runner

    def at(self, minutes: float) -> None:
        assert isinstance(self.runner.clock, SetClock)
        self.runner.clock.set(NOON + minutes * MINUTE)

    def anew(self) -> None:
        assert self.runner.anew() is not None
        self.runner.watch.check_alarms()

    def read(self, quantity: str, **values: float) -> None:
        sent = readings(self.runner.clock.now(), quantity, dict(values))
        assert self.http.post("/v1/telemetry", {"series": sent}).status == 200

    def moments(self) -> Iterator[str]:
        """Each by its name, once it has happened."""
        assert isinstance(self.runner.clock, SetClock)
        self.read("grid_on", grid=1.0)
        decided(self.http, self.runner.clock, NOON, soc=0.8)
        yield "calm"
        self.at(20)
        self.read("grid_on", grid=0.0)
        self.anew()
        yield "island"
        self.at(21)
        for name, point in said(self.http.get("/v1/plan").json(), "batteries").items():
            body = {"status": "rejected", "reason": f"{name} trips"}
            self.http.post(f"/v1/setpoints/{point['id']}/status", body)
        self.anew()
        yield "dark"
        self.at(22)
        self.read("soc", big=0.78, small=0.78)
        self.anew()
        yield "back"
        self.at(25)
        self.http.put("/v1/mode", {"mode": "off", "reason": "work"})
        self.anew()
        yield "off"
        self.at(27)
        point = {"kind": "customers", "asset": "shop", "served": True}
        body = {"mode": "manual", "until": END, "reason": "crew", "setpoints": [point]}
        assert self.http.put("/v1/mode", body).status == 200
        self.anew()
        yield "manual"
        self.at(30)
        self.read("grid_on", grid=1.0)
        self.http.put("/v1/mode", {"mode": "auto"})
        self.anew()
        yield "light"


@contextmanager
def evening(tiny: Scenario, folder: Path) -> Iterator[tuple[Evening, Service]]:
    service = Service(site(tiny), ISLAND)
    with serving(service, folder, SetClock(NOON)) as (http, runner):
        yield Evening(http, runner), service


def test_an_evening_is_told_minute_by_minute(tiny: Scenario, tmp_path: Path) -> None:
    found: dict[str, dict[str, Any]] = {}
    with evening(tiny, tmp_path) as (now, service):
        for name in now.moments():
            found[name] = now.http.get("/v1/overview").json()
        now.at(60)
        (hour,) = now.http.get(f"/v1/history?since={written(NOON)}").json()["steps"]
        run = export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T13:00")
    lost = [
        name
        for name, told in found.items()
        for one in told["alarms"]
        if one["kind"] == "grid_lost" and not (one["cleared_at"] or one["gone_since"])
    ]
    assert lost == ["island", "dark", "back", "off", "manual"]
    off = {name: {one["asset"] for one in told["plan"]["off"]} for name, told in found.items()}
    assert off["calm"] == off["light"] == set()
    assert "hospital" not in off["island"] | off["back"]
    assert off["dark"] == {"hospital", "shop", "homes"}
    assert found["dark"]["plan"]["dark"] == "nothing can form the grid"
    assert found["dark"]["plan"]["expected"]["v_min_pu"] is None
    assert found["manual"]["mode"]["mode"] == "manual" and "shop" not in off["manual"]
    # The minute in which both batteries rejected their set-points, and that until they were back.
    assert hour["off_min"]["hospital"] == pytest.approx(2.0)
    assert reliability_by_tier(run).loc["critical", "minutes_lost"] == pytest.approx(2.0)


VERDICTS = {
    "calm": ("fine", "All 3 customers supplied."),
    "island": ("warning", "Outage, end unknown: "),
    "dark": ("alarm", "Nothing can form the grid: all 3 customers are off supply."),
    "back": ("warning", "Outage, end unknown: "),
    "off": ("warning", "Outage, end unknown. Switched off by the operator"),
    "manual": ("warning", "Outage, end unknown: "),
    "light": ("fine", "All 3 customers supplied."),
}


@pytest.mark.nightly
@pytest.mark.skipif(chromium() is None, reason="no chromium or chrome on the path")
def test_an_evening_on_a_desk_and_on_a_phone(tiny: Scenario, tmp_path: Path) -> None:
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with evening(tiny, tmp_path) as (now, _):
        moments = list[str]()
        views: list[dict[str, Any]] = []
        for name in now.moments():
            moments.append(name)
            views.append(now.http.get("/v1/overview").json())
        assert moments == list(VERDICTS)
        shown: list[dict[str, Any]] = []

        def answer(route: Any) -> None:
            route.fulfill(json=shown[0])

        app = make_app(now.runner, Access())
        with listening(app) as address, sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium(), args=list(FLAGS))
            for width in (1400, 390):
                page = browser.new_page(viewport={"width": width, "height": 844})
                page.route("**/v1/overview", answer)
                for name, view in zip(moments, views, strict=True):
                    shown[:] = [view]
                    page.goto(address)
                    level, words = VERDICTS[name]
                    page.locator("#verdict-words", has_text=words).wait_for(timeout=20_000)
                    assert page.locator("#verdict").get_attribute("class") == level, name
                    assert page.evaluate("document.documentElement.scrollWidth") <= width
                    text = page.locator("body").inner_text()
                    if name in ("dark", "off", "manual"):
                        assert "Customers supplied\n3" not in text, name
                        assert "all 3 customers supplied" not in text, name
                page.close()
            browser.close()
