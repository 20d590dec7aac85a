"""A small part of ``tests.support.hostile``; and that its judgement can fail."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from fastapi import FastAPI

from tests.support import hostile, live_service
from tests.support.hostile_requests import Request, hostile_requests
from tests.support.tiny_day import tiny_scenario
from vppres.day.options import RunOptions
from vppres.service.access import Access
from vppres.service.http.app import make_app
from vppres.service.operation.site import Service


def site() -> Service:
    """The tiny day's feeder, in hours."""
    return Service(live_service.site(tiny_scenario()), RunOptions(horizon_h=0.0, isolate=False))


PLAIN = Request("GET", "/v1/plan", {"host": "localhost"})


@pytest.mark.nightly
def test_nothing_breaks_and_strangers_change_nothing(nightly: bool) -> None:
    pytest.importorskip("schemathesis")
    generated, spoiled = (60, 300) if nightly else (20, 100)
    requests, told = hostile.let_in(site(), generated, spoiled, seed=20261121)
    assert told.wrong == []
    assert min(told.answers[status] for status in (200, 400, 404, 405, 422)) > 1
    assert len(requests) > spoiled + (20 if nightly else 0)
    assert not nightly or told.steps >= 1
    refused, changed = hostile.shut_out(site(), requests)
    assert refused.wrong == changed == []
    assert not {200, 201, 202} & {*refused.answers}


def test_the_corpus_is_the_same_for_a_seed_and_has_all_kinds() -> None:
    day = tiny_scenario()
    first = list(hostile_requests(day, hostile.NOON, 300, 7))
    assert first == list(hostile_requests(day, hostile.NOON, 300, 7))
    assert first != list(hostile_requests(day, hostile.NOON, 300, 8))
    assert len({one.method for one in first}) > 6 and len({one.body for one in first}) > 60


@pytest.mark.parametrize(("status", "headers", "body", "found"), [
    (500, {}, b"{}", "answers 500"),
    (200, {}, b"Traceback (most recent call last)", "shows its insides"),
    (422, {}, b"{}", "422 is no problem+json"),
    (422, {"content-type": "application/problem+json"}, b'{"detail": ""}', "422 without a reason"),
])  # fmt: skip
def test_what_must_not_be_is_found(
    status: int, headers: dict[str, str], body: bytes, found: str
) -> None:
    safe = {"x-content-type-options": "nosniff"}
    assert found in hostile.judged(PLAIN, (status, safe | headers, body))
    assert hostile.judged(PLAIN, (200, {}, b"{}")) == ["has other headers"]
    assert hostile.judged(PLAIN, (200, safe, b"{}")) == []


def test_set_points_beyond_a_rating_are_found() -> None:
    day = tiny_scenario()
    name, most = str(day.batteries.id[0]), float(day.batteries.s_max_kva[0])

    def plan(p_kw: float, q_kvar: float) -> dict[str, Any]:
        point = {"asset": name, "kind": "batteries", "p_kw": p_kw, "q_kvar": q_kvar}
        return {"start": "now", "setpoints": [point]}

    assert hostile.beyond_limits(plan(most, 0.0), day) == []
    assert len(hostile.beyond_limits(plan(most, 0.3 * most), day)) == 1
    assert len(hostile.beyond_limits(plan(float("nan"), 0.0), day)) == 1


def test_a_service_that_breaks_is_found() -> None:
    app = FastAPI()

    @app.get("/v1/plan")
    def plan() -> None:
        raise RuntimeError("secret")

    with pytest.raises(RuntimeError):
        asyncio.run(hostile.ask(app, PLAIN))
    with hostile.begun(site()) as runner:
        served = make_app(runner, Access())
        served.router.routes[:] = app.router.routes
        with pytest.raises(RuntimeError):  # a server logs it, and answers:
            asyncio.run(hostile.ask(served, PLAIN))
        answers: list[Any] = []

        async def ask() -> None:
            async def send(message: Any) -> None:
                answers.append(message)

            async def receive() -> dict[str, Any]:
                return {"type": "http.request", "body": b"", "more_body": False}

            scope = {"type": "http", "method": "GET", "path": "/v1/plan", "query_string": b"",
                     "headers": [(b"host", b"localhost")], "client": None}  # fmt: skip
            with pytest.raises(RuntimeError):
                await served(scope, receive, send)

        asyncio.run(ask())
    assert answers[0]["status"] == 500
    assert (
        json.loads(answers[1]["body"])["detail"] == "The service has a mistake. Its log says which."
    )
