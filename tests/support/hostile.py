"""Requests that the service was not made for: none breaks it, none gets what it may not.

It sends requests that schemathesis makes from the OpenAPI description, and hostile ones of
:mod:`tests.support.hostile_requests`, first to a service that lets everybody in, then to one that
knows none of those who ask. Meanwhile hours pass and steps are decided on whatever was believed.
"""

from __future__ import annotations

import asyncio
import json
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import sqlalchemy as sa

from experiments.studies.within import ask
from tests.support.hostile_requests import Request, generated_requests, hostile_requests
from vppres.core.errors import VppresError
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access, new_token
from vppres.service.clock import SetClock
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service

NOON = pd.Timestamp("2026-11-21T12:00Z")
STEP_EVERY = 250
"""Requests between two steps."""

ALWAYS_OPEN = ("/livez", "/readyz", "/metrics", "/openapi.json", "/", "/page/")


@dataclass
class Tally:
    """Answers by status, what must not be with its request, and steps decided meanwhile."""

    answers: Counter[int] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    steps: int = 0


def judged(request: Request, answer: tuple[int, dict[str, str], bytes]) -> list[str]:
    """Faults of an answer."""
    status, headers, body = answer
    wrong = []
    not_ready = status == 503 and request.target.startswith("/readyz")
    if status >= 500 and not not_ready:
        wrong.append(f"answers {status}")
    if b"Traceback" in body or b'File "' in body:
        wrong.append("shows its insides")
    if status >= 400 and not not_ready and request.method != "HEAD":
        if headers.get("content-type") != "application/problem+json":
            wrong.append(f"{status} is no problem+json")
        elif not json.loads(body)["detail"]:
            wrong.append(f"{status} without a reason")
    if headers.get("x-content-type-options") != "nosniff" or "x-evil" in headers:
        wrong.append("has other headers")
    return wrong


def beyond_limits(plan: dict[str, Any], scenario: Scenario) -> list[str]:
    """Set-points that no device of the site can carry out."""
    b, pv = scenario.batteries, scenario.pv
    most_kva = {("batteries", str(n)): s for n, s in zip(b.id, b.s_max_kva, strict=True)}
    most_kva |= {("pv", str(n)): s for n, s in zip(pv.id, pv.s_max_kva, strict=True)}
    found = []
    for one in plan["setpoints"]:
        most = most_kva.get((one["kind"], one["asset"]), np.inf)
        apparent = np.hypot(one.get("p_kw", 0.0), one.get("q_kvar", 0.0))
        if not apparent <= 1.002 * most + 0.02:  # NaN is beyond, too
            found.append(f"{plan['start']}: {one['asset']} {apparent:.2f} of {most:.2f} kVA")
    return found


def attack(
    runner: Runner, requests: Iterable[Request], access: Access, steps: bool = True
) -> Tally:
    """Send requests one after another, a step in between now and then."""
    app = make_app(runner, access, rates={})
    tally = Tally()

    async def all_of_them() -> None:
        for number, request in enumerate(requests, 1):
            try:
                answer = await ask(app, request)
            except Exception as error:  # what a server would log, and answer with 500
                tally.wrong.append(f"{type(error).__name__}: {error}: {request}")
                continue
            tally.answers[answer[0]] += 1
            tally.wrong += [f"{what}: {request}" for what in judged(request, answer)]
            if steps and number % STEP_EVERY == 0:
                _next_step(runner, tally)

    asyncio.run(all_of_them())
    return tally


def _next_step(runner: Runner, tally: Tally) -> None:
    """An hour passes, and a step is decided on what is believed by then."""
    assert isinstance(runner.clock, SetClock)
    runner.clock.set(runner.begun(runner.clock.now()) + runner.length)
    try:
        plan = runner.step()
    except VppresError as error:
        tally.wrong.append(f"step: {error}")
        return
    tally.steps += 1
    tally.wrong += beyond_limits(plan, runner.scenario)


def content(runner: Runner) -> dict[str, list[Any]]:
    """All rows of all tables, without the check that the database takes a transaction."""
    with runner.store._engine.connect() as db:
        rows = {
            name: [tuple(row) for row in db.execute(sa.text(f"SELECT * FROM {name}"))]
            for name in sa.inspect(db).get_table_names()
        }
    rows["meta"] = [row for row in rows["meta"] if row[0] != "checked"]
    return rows


@contextmanager
def begun(served: Service) -> Iterator[Runner]:
    """A service at noon that has decided a step, in a folder that is forgotten."""
    with (
        tempfile.TemporaryDirectory() as folder,
        opened(served, Path(folder) / "live", SetClock(NOON)) as runner,
    ):
        runner.step()
        yield runner


def let_in(served: Service, generated: int, hostile: int, seed: int) -> tuple[list[Request], Tally]:
    """Requests of both kinds, and the answers of a service where everybody may ask."""
    with begun(served) as runner:
        description = make_app(runner, Access()).openapi()
        requests = [
            *generated_requests(description, generated, seed),
            *hostile_requests(runner.scenario, NOON, hostile, seed),
        ]
        return requests, attack(runner, requests, Access())


def shut_out(served: Service, requests: Iterable[Request]) -> tuple[Tally, list[str]]:
    """Answers of a service that knows none of those who ask, and tables that they changed."""
    with begun(served) as runner:
        _, token = new_token("nobody:read")
        before = content(runner)
        guarded = [one for one in requests if not _open(one.target)]
        tally = attack(runner, guarded, Access([token]), steps=False)
        after = content(runner)
        return tally, [name for name in before if before[name] != after[name]]


def _open(target: str) -> bool:
    path = target.partition("?")[0]
    return path in ALWAYS_OPEN or path.startswith("/page/")
