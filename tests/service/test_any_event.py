"""Whatever changes, at any second of a step, is planned for at once, and so is its end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.live_service import HERE, NOON, heard, readings, said, serving, site
from tests.support.played_service import crowded
from tests.support.vans import van
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service

Plan = dict[str, Any]
Act = Callable[["Site"], None]


@dataclass(frozen=True)
class Site:
    """What asks a service, whose clock is set over HTTP."""

    http: Caller
    runner: Runner

    @property
    def now(self) -> pd.Timestamp:
        """By its clock."""
        return self.runner.clock.now()

    def go_to(self, time: pd.Timestamp) -> None:
        """Set the clock."""
        assert self.http.put("/v1/clock", {"now": written(time)}).status == 200

    def tell(self, quantity: str, asset: str, value: float) -> None:
        """Send a reading of now."""
        sent = {"series": readings(self.now, quantity, {asset: value})}
        assert self.http.post("/v1/telemetry", sent).json()["accepted"] == 1

    def put(self, path: str, body: Any) -> None:
        """Put something."""
        assert self.http.put(path, body).status in (200, 201)

    def answer(self, kind: str, asset: str, status: str) -> None:
        """What became of the last set-point of a device."""
        plan = self.http.get("/v1/plan").json()
        path = f"/v1/setpoints/{said(plan, kind)[asset]['id']}/status"
        assert self.http.post(path, {"status": status}).status == 200

    def in_minutes(self, minutes: float) -> str:
        """A time from now on."""
        return written(self.now + pd.Timedelta(minutes=minutes))


def reading(quantity: str, asset: str, value: float) -> Act:
    return lambda site: site.tell(quantity, asset, value)


def setpoint(kind: str, asset: str, status: str) -> Act:
    return lambda site: site.answer(kind, asset, status)


def event(**body: Any) -> Act:
    return lambda site: site.put("/v1/events/e", {"start": written(site.now), **body})


def ending(**body: Any) -> Act:
    return lambda site: event(end=site.in_minutes(2), **body)(site)


def withdrawn(site: Site) -> None:
    assert site.http.delete("/v1/events/e").status == 200


def mode(name: str, **more: Any) -> Act:
    def act(site: Site) -> None:
        until = {} if name in ("auto", "off") else {"until": site.in_minutes(2)}
        site.put("/v1/mode", {"mode": name, **until, **more})

    return act


def passing(site: Site) -> None:
    site.go_to(site.now + pd.Timedelta("2min"))


def out(battery: str) -> Callable[[Plan], bool]:
    return lambda plan: f"battery {battery} is out" in plan["estimated"]


def off(customer: str) -> Callable[[Plan], bool]:
    return lambda plan: not said(plan, "customers")[customer]["served"]


def dark(plan: Plan) -> bool:
    return not plan["grid"]["available"]


def line_out(plan: Plan) -> bool:
    return any(one["out"] for one in plan.get("faults", ()))


BY_HAND = [{"kind": "batteries", "asset": "big", "p_kw": 1.0}]
CHANGES: dict[str, tuple[Act, Act, Callable[[Plan], bool]]] = {
    "a battery": (reading("online", "big", 0.0), reading("online", "big", 1.0), out("big")),
    "a set": (
        reading("start_fault", "g0", 1.0),
        reading("start_fault", "g0", 0.0),
        lambda plan: plan["expected"]["gensets"]["g0"]["out"],
    ),
    "a customer": (reading("online", "shop", 0.0), reading("online", "shop", 1.0), off("shop")),
    "the grid": (reading("grid_on", "grid", 0.0), reading("grid_on", "grid", 1.0), dark),
    "a vehicle": (
        reading("plugged", "k0", 0.0),
        reading("plugged", "k0", 1.0),
        lambda plan: "k0" not in plan["expected"]["vehicles"],
    ),
    "a battery's set-point": (
        setpoint("batteries", "small", "rejected"),
        setpoint("batteries", "small", "accepted"),
        out("small"),
    ),
    "a battery that is heard again": (
        setpoint("batteries", "small", "aborted"),
        reading("soc", "small", 0.5),
        out("small"),
    ),
    "a customer's set-point": (
        setpoint("customers", "shop", "rejected"),
        reading("online", "shop", 1.0),
        off("shop"),
    ),
    "an outage": (event(type="outage"), withdrawn, dark),
    "an outage that ends": (ending(type="outage"), passing, dark),
    "a fault": (event(type="fault", line="4"), withdrawn, line_out),
    "a fault that ends": (ending(type="fault", bus="4"), passing, line_out),
    "a limit": (
        event(type="import_limit", limit_kw=5.0),
        withdrawn,
        lambda plan: plan["expected"]["grid_limit_kw"] == 5.0,
    ),
    "switched off": (mode("off"), mode("auto"), lambda plan: plan["status"] == "off"),
    "by hand": (
        mode("manual", setpoints=BY_HAND),
        mode("auto"),
        lambda plan: plan["status"] == "manual",
    ),
    "by hand for a time": (mode("hold"), passing, lambda plan: plan["status"] == "hold"),
}
"""What changes, how that is taken back, and what shows in a plan that it is so."""


@pytest.fixture
def noon(tiny: Scenario, tmp_path: Path) -> Iterator[Site]:
    """A service with all kinds of devices that has decided the step of noon."""
    charger, vehicle = van(NOON.floor("1D"), NOON.ceil("1D"))
    day = replace(crowded(site(tiny)), chargers=charger, sessions=vehicle)
    service = Service(day, HERE, paced=True)
    with serving(service, tmp_path, SetClock(NOON)) as (http, runner):
        http.post("/v1/telemetry", heard(NOON))
        assert http.post("/v1/steps").json()["status"] == "ok"
        yield Site(http, runner)


@pytest.mark.parametrize("seed", range(100))
def test_any_change_at_any_second_is_planned_for_at_once(seed: int, noon: Site) -> None:
    """By property: four changes of a step, and that they are taken back."""
    rng = np.random.default_rng([seed, 573])
    names = [str(name) for name in rng.permutation(list(CHANGES))[:4]]
    seconds = np.sort(rng.choice(np.arange(1, 20), 8, replace=False)) * 150 + rng.integers(0, 20, 8)
    moments = iter([NOON + pd.Timedelta(seconds=int(each)) for each in seconds])
    for name in names:
        change, back, shows = CHANGES[name]
        for act, is_so in ((change, True), (back, False)):
            noon.go_to(max(next(moments), noon.now + pd.Timedelta("1s")))
            act(noon)
            assert noon.runner.changes.new.is_set(), (names, name, is_so)
            if not is_so and back is not passing:
                noon.go_to(noon.now + pd.Timedelta("1s"))
            plan = noon.runner.anew()
            assert plan is not None and plan["status"] != "failed", (names, name, is_so)
            assert shows(plan) == is_so, (names, name, is_so, plan["estimated"])
            assert noon.runner.changes.reasons == ()
