"""What is published is the plan: an island's losses are in it, and what is shed against it is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.live_service import NOON, readings, said, serving, site
from vppres.control import linearisation
from vppres.day.options import RunOptions
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.model.beyond_paper import losses
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service

HOSPITAL_KW = 33.0
LOSSES_KW = 0.182
"""Of the hospital's supply, over lines of forty times the resistance."""


def one_battery(tiny: Scenario) -> Scenario:
    """No sun, and one battery far from the hospital, which has half its demand."""
    first = replace(
        tiny.batteries.rows(np.array([True, False])),
        bus=[4],
        energy_kwh=np.array([100.0]),
        p_max_kw=np.array([90.0]),
        s_max_kva=np.array([100.0]),
    )
    return replace(
        tiny,
        batteries=first,
        pv_kw=0.0 * tiny.pv_kw,
        load_kw=tiny.load_kw[4] * np.ones((6, 1)) * np.array([0.5, 0.3, 0.2]),
        network=replace(tiny.network, r_ohm=40.0 * tiny.network.r_ohm),
    )


def charged(beyond_kw: float) -> float:
    """A state of charge for the hospital's demand over an hour and so much more."""
    return 0.15 + (HOSPITAL_KW + beyond_kw) / 0.95 / 100.0


@pytest.mark.parametrize(
    ("beyond_kw", "served"),
    [(0.5 * LOSSES_KW, ["shop", "homes"]), (1.1 * LOSSES_KW, ["hospital"])],
)
def test_nobody_is_shed_for_losses_that_a_plan_can_know(
    tiny: Scenario, beyond_kw: float, served: list[str]
) -> None:
    """With half of them the hospital was planned for and shed, and then all were off."""
    day = one_battery(tiny)
    options = RunOptions(horizon_h=1.0, isolate=False, mode="physical", priority="strict")
    controller = Controller.of(day, options)
    soc = {"big": charged(beyond_kw)}
    points = controller.step(Measurement(time=day.grid.times[4], soc=soc))
    c = points.customers
    assert list(c.index[c["served"]]) == served
    assert not c["shed"].any()
    assert points.solve["status"] == "optimal"


@pytest.mark.nightly
def test_what_is_shed_against_the_plan_is_said(
    tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As status, alarm and reason; here the plan may lack the losses."""
    monkeypatch.setattr(linearisation, "SHORT_KW", np.inf)
    monkeypatch.setattr(losses, "LOSS_MARGIN", 0.0)
    options = RunOptions(horizon_h=0.0, isolate=False, mode="physical", priority="strict")
    clock = SetClock(NOON)
    with serving(Service(site(one_battery(tiny)), options), tmp_path, clock) as (http, _):
        storm = {"type": "outage", "start": written(NOON), "end": "2026-11-21T13:00:00Z"}
        http.put("/v1/events/storm", storm)
        soc = readings(NOON, "soc", {"big": charged(0.0)})
        http.post("/v1/telemetry", {"series": soc})
        plan: dict[str, Any] = http.post("/v1/steps").json()
        alarms = {one["kind"]: one for one in http.get("/v1/alarms").json()["alarms"]}
        why = http.get("/v1/explanations").json()
    because = "what forms the grid cannot supply it"
    assert plan["solve"]["status"] == "shed" and plan["solve"]["levels"] is None
    assert plan["shed"] == [{"asset": "hospital", "reason": because}]
    assert said(plan, "customers")["hospital"]["reason"] == f"shed: {because}"
    assert alarms["shed"]["priority"] == "high"
    assert alarms["shed"]["text"] == f"hospital shed, although the plan supplied it: {because}."
    words = {one["asset"]: one["words"] for one in why["reasons"] if one["kind"] == "customers"}
    assert words["hospital"] == f"Shed: planned as supplied, then disconnected ({because})."
