"""One evening against a service of its own: what a control room does and meets, minute by minute.

The evening reads a state of charge 13 minutes before a step and loses the grid 13 minutes after it;
a battery rejects its set-point, which is an alarm that the operator acknowledges before taking over
by hand; the service ends and starts again, and the grid comes back.
"""

from __future__ import annotations

import time as machine
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from vppres.day.options import RunOptions
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written
from vppres.service.http.client import Client
from vppres.service.http.started import started
from vppres.service.operation.runner import Service

STEP = pd.Timestamp("2026-11-21T18:00Z")
SOC = 0.62
PATIENCE_S = 60.0
"""For a plan that is made anew: a window's time limit and the start of its process."""


@dataclass(frozen=True)
class Moment:
    """Orders after something happened.

    Parameters
    ----------
    time : str
        When, on the service's clock.
    event : str
        What happened.
    seconds : float
        Until the plan knew, in real time.
    plan : dict
        The plan.
    wrong : list of str
        What should not be.
    """

    time: str
    event: str
    seconds: float
    plan: dict[str, Any]
    wrong: list[str] = field(default_factory=list)

    def line(self, scenario: Scenario) -> str:
        """The moment in a line."""
        off = off_in(self.plan)
        first = [name for name in off if name in critical(scenario)]
        words = f"{self.time} {self.event}: {self.plan['status']}, {len(off)} off"
        solve_s = (self.plan.get("solve") or {}).get("seconds") or 0.0
        words += f", of the first tier {len(first)}, after {self.seconds:.1f} s"
        words += f", {max(self.seconds - solve_s, 0.0):.1f} s of them beside the solver"
        return f"{words}. WRONG: {'; '.join(self.wrong)}" if self.wrong else f"{words}."


def critical(scenario: Scenario) -> set[str]:
    """Customers of the first tier."""
    c = scenario.customers
    return {str(name) for name, tier in zip(c.id, c.tier, strict=True) if tier == scenario.tiers[0]}


def off_in(plan: dict[str, Any]) -> list[str]:
    """Customers that a plan leaves off."""
    return [one["asset"] for one in plan["setpoints"] if one.get("served") is False]


class Evening:
    """The control room and its devices.

    Parameters
    ----------
    client : Client
        The service, whose clock is set.
    scenario : Scenario
        The site.
    """

    def __init__(self, client: Client, scenario: Scenario) -> None:
        self.client = client
        self.scenario = scenario

    def at(self, minutes: int) -> pd.Timestamp:
        """Let it be some minutes after the step's beginning."""
        now = STEP + pd.Timedelta(minutes=minutes)
        self.client.wanted("PUT", "/v1/clock", {"now": written(now)})
        return now

    def read(self, quantity: str, values: dict[str, float], time: pd.Timestamp) -> None:
        """Readings, every five minutes."""
        series = [
            {
                "source": "scada",
                "asset": asset,
                "quantity": quantity,
                "start": written(time),
                "resolution": "PT5M",
                "values": [value],
            }
            for asset, value in values.items()
        ]
        self.client.wanted("POST", "/v1/telemetry", {"series": series})

    def stored(self, soc: float, time: pd.Timestamp) -> None:
        """States of charge, all the same."""
        self.read("soc", {str(name): soc for name in self.scenario.batteries.id}, time)

    def decided(self, event: str) -> Moment:
        """The step as it is decided at its beginning."""
        answer = self.client.wanted("POST", "/v1/steps")
        return self._moment(event, answer.seconds, answer.body)

    def anew(self, event: str, change: Callable[[], object]) -> Moment:
        """The plan after a change within the step."""
        before = self.client.wanted("GET", "/v1/plan").body["id"]
        begin = machine.monotonic()
        change()
        while True:
            plan = self.client.wanted("GET", "/v1/plan").body
            if plan["id"] != before and "unaware_of" not in plan:
                return self._moment(event, machine.monotonic() - begin, plan)
            if machine.monotonic() > begin + PATIENCE_S:
                found = self._moment(event, PATIENCE_S, plan)
                found.wrong.append("the plan was not made anew")
                return found
            machine.sleep(0.05)

    def _moment(self, event: str, seconds: float, plan: dict[str, Any]) -> Moment:
        now = self.client.wanted("GET", "/v1/status").body["now"]
        found = Moment(now, event, seconds, plan)
        expect = found.wrong.append
        if plan["status"] == "failed":
            expect(plan["reason"])
        if any(str(one["reason"]).startswith("default: more") for one in plan["setpoints"]):
            expect("the gate held back what was decided on another state of charge")
        return found

    def alarms(self, kind: str) -> list[dict[str, Any]]:
        """Alarms of a kind that stand."""
        every = self.client.wanted("GET", "/v1/alarms").body["alarms"]
        return [one for one in every if one["kind"] == kind and one["cleared_at"] is None]

    def until_manual(self) -> Iterator[Moment]:
        """Up to the end of the service."""
        first = critical(self.scenario)
        self.stored(SOC, self.at(-13))
        self.at(0)
        yield self.decided(f"read {SOC:.0%} 13 min before the step")
        lost = self.at(13)
        dark = self.anew("grid lost", lambda: self.read("grid_on", {"grid": 0.0}, lost))
        if dark.plan["grid"]["available"]:
            dark.wrong.append("the plan counts on the grid")
        if first <= set(off_in(dark.plan)):
            dark.wrong.append(f"nobody of the first tier is on with {SOC:.0%} stored")
        yield dark
        self.at(25)
        points = dark.plan["setpoints"]
        busy = max(
            (one for one in points if one["kind"] == "batteries"), key=lambda one: abs(one["p_kw"])
        )
        refused = self.anew(
            f"{busy['asset']} rejects",
            lambda: self.client.wanted(
                "POST", f"/v1/setpoints/{busy['id']}/status", {"status": "rejected"}
            ),
        )
        if f"battery {busy['asset']} is out" not in refused.plan["estimated"]:
            refused.wrong.append("the battery is still in the plan")
        raised = [a for a in self.alarms("setpoint_rejected") if a["subject"] == busy["asset"]]
        if not raised:
            refused.wrong.append("the battery is no alarm")
        for alarm in raised:
            self.client.wanted("POST", f"/v1/alarms/{alarm['id']}/acknowledge")
        yield refused
        self.at(35)
        name = min(first - set(off_in(refused.plan)), default=min(first))
        mode = {
            "mode": "manual",
            "until": written(STEP + pd.Timedelta("90min")),
            "setpoints": [{"kind": "customers", "asset": name, "served": False}],
        }
        manual = self.anew("by hand", lambda: self.client.wanted("PUT", "/v1/mode", mode))
        if name not in off_in(manual.plan):
            manual.wrong.append("the operator's set-point is not there")
        yield manual

    def after_the_restart(self) -> Iterator[Moment]:
        """From the start of the service on."""
        self.at(45)
        auto = self.anew(
            "started again, decides",
            lambda: self.client.wanted("PUT", "/v1/mode", {"mode": "auto"}),
        )
        if auto.plan["grid"]["available"]:
            auto.wrong.append("the plan counts on the grid")
        if [a["state"] for a in self.alarms("setpoint_rejected")] != ["acknowledged"]:
            auto.wrong.append("the alarm of the battery has not lasted over the restart")
        yield auto
        now = self.at(60)
        self.stored(0.4, now - pd.Timedelta("4min"))
        told = self.decided("next step, read 40% 4 min before")
        if self.alarms("setpoint_rejected"):
            told.wrong.append("the battery was heard and is an alarm still")
        yield told
        back = self.at(80)
        light = self.anew("grid back", lambda: self.read("grid_on", {"grid": 1.0}, back))
        if off_in(light.plan):
            light.wrong.append("customers are off with grid")
        yield light


def evening(scenario: Scenario, options: RunOptions, folder: Path) -> list[Moment]:
    """The evening at a site; the service's state is kept in a folder over its restart."""
    service = Service(scenario, options, paced=True)
    found: list[Moment] = []
    for part in (Evening.until_manual, Evening.after_the_restart):
        with started(service, folder) as own, closing(Client(own.url)) as client:
            found += part(Evening(client, scenario))
    return found
