"""What the page to watch asks for: the overview, the site, and files that a browser may not leave."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.live_service import NOON, Running, decide, running
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access, new_token
from vppres.service.clock import written
from vppres.service.http.app import make_app
from vppres.service.operation.runner import Runner
from vppres.service.overview import Overview
from vppres.service.routes.page import FILES
from vppres.service.storage.records import Reading, seconds

HOUR = pd.Timedelta("1h")


@pytest.fixture
def live(tiny: Scenario, tmp_path: Path) -> Iterator[Running]:
    """A service at noon; an outage begins at two."""
    with running(tiny, tmp_path) as found:
        outage = {"type": "outage", "start": written(NOON + 2 * HOUR), "end": None}
        found[2].store.put_events({"storm": outage}, NOON, "test")
        yield found


@pytest.fixture
def runner(live: Running) -> Runner:
    return live[2]


def test_before_the_first_step_there_is_no_plan(live: Running) -> None:
    found = live[0].get("/v1/overview").json()
    assert (found["plan"], found["past"], found["ahead_s"]) == (None, [], None)
    assert found["now"] == "2026-11-21T12:00:00Z" and found["mode"]["mode"] == "auto"


def test_a_plan_tells_what_it_foresees(runner: Runner) -> None:
    decide(runner, NOON)
    plan = decide(runner, NOON + HOUR)
    ahead = plan["ahead"]
    assert ahead["times"] == ["2026-11-21T14:00:00Z", "2026-11-21T15:00:00Z"]
    assert ahead["grid_limit_kw"] == [0.0, 0.0]
    assert ahead["import_kw"] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert set(ahead["served"]) == {"hospital", "shop", "homes"}
    assert all(0.15 - 1e-4 <= soc <= 0.85 + 1e-4 for row in ahead["soc"].values() for soc in row)
    later = decide(runner, NOON + 2 * HOUR, soc=plan["expected"]["soc"]["big"])
    assert later["expected"]["grid_limit_kw"] == 0.0 and later["expected"]["v_min_bus"] is not None


def test_the_overview_names_who_is_off_until_when_and_by_tier(live: Running) -> None:
    http, _, runner = live
    decide(runner, NOON)
    decide(runner, NOON + HOUR)
    plan = decide(runner, NOON + 2 * HOUR, soc=0.2)
    found = http.get("/v1/overview").json()
    off = {one["asset"] for one in plan["setpoints"] if one.get("served") is False}
    assert off and {one["asset"] for one in found["plan"]["off"]} == off
    tiers = {"hospital": "critical", "shop": "high", "homes": "low"}
    for one in found["plan"]["off"]:
        assert one["tier"] == tiers[one["asset"]]
        row = plan["ahead"]["served"][one["asset"]]
        back = plan["ahead"]["times"][row.index(True)] if True in row else None
        assert one["until"] == back
    last = found["past"][-1]
    assert last["served"] == {tier: float(name not in off) for name, tier in tiers.items()}
    assert [step["start"][11:13] for step in found["past"]] == ["12", "13", "14"]
    assert found["measured"]["soc big"] == {
        "value": 0.2, "at": "2026-11-21T14:00:00Z", "source": "scada",
    }  # fmt: skip
    assert found["sources"] == [
        {
            "source": "scada",
            "last_contact": "2026-11-21T14:00:00Z",
            "stale": [],
            "lost": [],
            "refused": [],
            "ok": 2,
        }
    ]


def test_sources_grow_old_and_plans_run_out(live: Running) -> None:
    _, clock, runner = live
    decide(runner, NOON)
    overview = Overview(runner)

    def now(after: str) -> dict[str, Any]:
        clock.set(NOON + pd.Timedelta(after))
        return overview._now()

    assert now("50min")["ahead_s"] == 600.0 and now("50min")["plan"]["active"]
    assert now("63min")["plan"]["active"] and not now("67min")["plan"]["active"]
    assert now("67min")["plan"]["off"] == []  # defaults: customers are on
    assert now("2h")["sources"][0]["stale"] == ["soc of big", "soc of small"]
    assert now("4h")["sources"][0]["lost"] == ["soc of big", "soc of small"]
    missed = decide(runner, NOON + 3 * HOUR) and now("3h")
    assert [step["status"] for step in missed["past"]] == ["ok", "missed", "missed", "ok"]
    assert missed["steps"]["missed"] == 2


def test_a_late_state_of_charge_is_the_reading_and_the_set_points_since(live: Running) -> None:
    """The battery charges before the outage; it is read once more within the hour."""
    _, clock, runner = live
    at = NOON + HOUR
    plan = decide(runner, at, soc=0.2)
    begun, after = (plan["expected"][name]["big"] for name in ("soc_start", "soc"))
    assert begun == 0.2 and after > 0.25
    overview = Overview(runner)

    def now(minutes: int) -> float:
        clock.set(at + pd.Timedelta(minutes=minutes))
        return float(overview._now()["soc"]["big"])

    assert now(0) == now(1) == 0.2  # it holds for its hour
    short = [Reading("big", "soc", seconds(at) + 600, "scada", 300, 0.21)]
    runner.store.write_readings(short, at)
    assert now(12) == 0.21
    assert now(40) == pytest.approx(0.21 + (after - begun) / 2)
    assert now(60) == now(65) == pytest.approx(0.21 + (after - begun) * 5 / 6)


def test_older_steps_are_asked_for(live: Running) -> None:
    http, _, runner = live
    for hour in range(3):
        decide(runner, NOON + hour * HOUR)
    asked = f"/v1/history?since={written(NOON)}&until={written(NOON + 2 * HOUR)}"
    steps = http.get(asked).json()["steps"]
    assert [step["start"] for step in steps] == [written(NOON), written(NOON + HOUR)]
    assert steps == http.get("/v1/overview").json()["past"][:2]
    assert http.get("/v1/history").status == 422


def test_what_the_gate_refused_is_named(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "vppres.service.operation.deciding.refusals", lambda *_: {("batteries", "big"): "no number"}
    )
    decide(runner, NOON)
    found = Overview(runner)._now()
    assert found["past"][0]["refused"] == [{"asset": "big", "reason": "no number"}]
    assert [(one["kind"], one["subject"], one["text"]) for one in found["alarms"]] == [
        (
            "setpoint_rejected",
            "big",
            "The last check rejected the set-point of big: no number. The default was sent.",
        )
    ]


def test_it_is_made_once_for_all_who_ask(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    decide(runner, NOON)
    made: list[int] = []
    overview = Overview(runner)
    really = overview._now
    monkeypatch.setattr(overview, "_now", lambda: made.append(1) or really())
    assert overview.text() == overview.text() and len(made) == 1
    runner.store.put_events({"storm": {}}, NOON, "test")
    assert b"storm" not in overview.text() and len(made) == 2


def test_a_change_is_seen_while_the_overview_is_made_for_others(live: Running) -> None:
    _, clock, runner = live
    decide(runner, NOON)
    overview = Overview(runner)
    before = overview.text()
    clock.set(NOON + pd.Timedelta("5s"))
    with overview._turn:  # another one makes it anew: only time has passed
        assert overview.fresh() == before
    assert overview.text() != before
    runner.store.put_setting("mode", {"mode": "off", "until": None, "reason": ""}, NOON, "test")
    with overview._turn:
        assert overview.fresh() is None
    assert b'"mode":{"mode":"off"' in overview.text()


def test_the_page_asks_for_nothing_but_itself(runner: Runner) -> None:
    _, token = new_token("panel:read")
    http = Caller(make_app(runner, Access([token])))
    assert {path.name for path in (files("vppres.service") / "page").iterdir()} == set(FILES)
    for name in FILES:
        answer = http.get("/" if name == "page.html" else f"/page/{name}")
        assert answer.status == 200, name
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy and "unsafe" not in policy
        text = answer.content.decode()
        assert "http://www.w3.org/2000/svg" in text or "http" not in text, name
        assert "innerHTML" not in text and "localStorage" not in text, name
    page = http.get("/").content.decode()
    assert " style=" not in page and "<script>" not in page and " onclick" not in page
    assert http.get("/page/nothing.js").status == 404
    assert http.get("/v1/overview").status == 401 and http.get("/v1/site").status == 401


def test_steps_that_the_operator_holds_are_shown_too(live: Running) -> None:
    http, _, runner = live
    decide(runner, NOON)
    until = written(NOON + 5 * HOUR)
    assert http.put("/v1/mode", {"mode": "hold", "until": until, "reason": "works"}).status == 200
    held = decide(runner, NOON + HOUR)
    found = http.get("/v1/overview").json()
    assert held["status"] == "hold" and found["plan"]["status"] == "hold"
    assert [step["status"] for step in found["past"]] == ["ok", "hold"]
    assert found["mode"]["mode"] == "hold" and found["mode"]["until"] == until
    assert http.get("/v1/site").json()["modes"] == ["auto", "hold", "manual", "off"]
