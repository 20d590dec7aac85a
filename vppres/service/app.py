"""Routes: what the service takes and says over HTTP, under ``/v1``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import pandas as pd
from fastapi import Depends, FastAPI, Header, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.middleware.trustedhost import TrustedHostMiddleware

import vppres
from vppres.core.errors import InputError, Problem, StorageError, VppresError
from vppres.service import payloads
from vppres.service.access import LOOPBACK, Access, Denied
from vppres.service.clock import written
from vppres.service.knowledge import check_forecast, last_heard, readings_of
from vppres.service.metrics import Figures
from vppres.service.plans import at, etag
from vppres.service.runner import Runner

PROBLEM = "application/problem+json"
MOST_PROBLEMS = 50
MOST_BYTES = 8_000_000
"""Of a request: a batch of telemetry of a thousand assets and a day of minutes."""

TITLES = {
    400: "The request cannot be read",
    401: "Nobody knows who asks",
    403: "This may not be asked",
    404: "There is no such thing",
    405: "This cannot be done here",
    412: "It has changed since",
    413: "The request is too large",
    422: "The request has mistakes",
    500: "Something broke",
    503: "The service is not ready",
}


def make_app(runner: Runner, access: Access, hosts: Sequence[str] = LOOPBACK) -> FastAPI:
    """The service's routes around a runner.

    Parameters
    ----------
    runner : Runner
        Who decides.
    access : Access
        Who may ask.
    hosts : sequence of str
        Names under which the service answers; a page of a stranger that calls it by its own name
        gets nothing.
    """
    app = FastAPI(
        title="vppres",
        version=str(vppres.__version__),
        description="A controller of a virtual power plant that runs day and night.",
        docs_url=None,
        redoc_url=None,
        max_body_size=MOST_BYTES,
    )
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(hosts))
    _answer_errors(app)
    _health(app, runner)
    guarded = _Guard(access)
    _inputs(app, runner, guarded)
    _steps(app, runner, guarded)
    _operation(app, runner, guarded)
    return app


class _Guard:
    """Dependencies that let a scope pass and name who asks."""

    def __init__(self, access: Access) -> None:
        self.access = access

    def __call__(self, scope: str) -> Any:
        def actor(authorization: Annotated[str | None, Header()] = None) -> str:
            return self.access.actor(authorization, scope)

        return Depends(actor)


def _health(app: FastAPI, runner: Runner) -> None:
    """For whoever watches the service; no token."""
    figures = Figures(runner)

    @app.get("/livez")
    def livez() -> dict[str, str]:
        """Whether the service answers."""
        return {"status": "ok"}

    @app.get("/readyz")
    def readyz() -> Response:
        """Whether there is a plan for now, and a database to keep the next one in."""
        checks = {
            "database": runner.store.ready(),
            "plan": runner.ahead_s > 0.0,
            "decided": runner.last is not None and runner.last["status"] != "failed",
        }
        ready = all(checks.values())
        ahead = runner.ahead_s if runner.last is not None else None
        body = {"ready": ready, "checks": checks, "plan_ahead_s": ahead}
        return JSONResponse(body, 200 if ready else 503)

    @app.get("/metrics")
    def metrics() -> Response:
        """Figures for Prometheus."""
        return Response(figures.text(), media_type="text/plain; version=0.0.4; charset=utf-8")


def _inputs(app: FastAPI, runner: Runner, guarded: _Guard) -> None:
    """What is measured, expected and announced."""

    @app.post("/v1/telemetry")
    def telemetry(body: payloads.Telemetry, _: str = guarded("telemetry")) -> Response:
        """Readings; to send them twice does no harm."""
        now = runner.clock.now()
        until = runner.begun(now) + 2 * runner.length
        good, problems = readings_of(body.series, runner.scenario, until)
        if problems and not good:
            raise InputError(problems)
        kept = runner.store.write_readings(good, now)
        return JSONResponse(
            {
                "accepted": kept.accepted,
                "duplicates": kept.duplicates,
                "refused": _listed(problems),
            }
        )

    @app.put("/v1/forecasts/{quantity}")
    def forecast(
        quantity: str, body: payloads.Forecasts, _: str = guarded("events")
    ) -> dict[str, Any]:
        """What is expected of ``load_kw`` or ``pv_kw``; older forecasts are kept."""
        if quantity not in ("load_kw", "pv_kw"):
            raise HTTPException(404, "There are forecasts of load_kw and pv_kw.")
        check_forecast(quantity, body.assets, body.start, body.resolution, runner.scenario)
        runner.store.put_forecast(quantity, body.issued_at, _plain(body))
        return {"quantity": quantity, "issued_at": written(body.issued_at)}

    @app.get("/v1/events")
    def events(_: str = guarded("read")) -> dict[str, Any]:
        """All events that hold."""
        found = runner.store.events()
        return {name: {"version": version, **body} for name, (version, body) in found.items()}

    @app.put("/v1/events/{identifier}")
    def put_event(
        identifier: payloads.Name,
        body: payloads.Event,
        response: Response,
        actor: str = guarded("events"),
        if_match: Annotated[str | None, Header()] = None,
    ) -> dict[str, Any]:
        """An outage, an import limit, prices or an alert; a new version replaces the old one."""
        before = runner.store.events().get(identifier)
        if if_match is not None and (before is None or if_match != f'"{before[0]}"'):
            raise HTTPException(412, "The event has another version than If-Match names.")
        if isinstance(body, payloads.Prices):
            check_forecast("load_kw", {}, body.start, body.resolution, runner.scenario)
        plain = _plain(body)
        version = runner.store.put_event(identifier, plain, runner.clock.now(), actor)
        response.status_code = 201 if before is None else 200
        response.headers["ETag"] = f'"{version}"'
        return {"version": version, **plain}

    @app.delete("/v1/events/{identifier}")
    def delete_event(identifier: payloads.Name, actor: str = guarded("events")) -> dict[str, Any]:
        """Withdraw an event; its history stays."""
        if identifier not in runner.store.events():
            raise HTTPException(404, "There is no such event.")
        version = runner.store.put_event(identifier, None, runner.clock.now(), actor)
        return {"version": version}


def _steps(app: FastAPI, runner: Runner, guarded: _Guard) -> None:
    """What is decided."""

    @app.post("/v1/steps")
    def step(
        body: payloads.StepRequest | None = None, _: str = guarded("operator")
    ) -> dict[str, Any]:
        """Decide a step, or give its stored plan: to ask twice does no harm."""
        return runner.step(None if body is None else body.time)

    @app.get("/v1/plan")
    def plan(
        response: Response,
        _: str = guarded("read"),
        if_none_match: Annotated[str | None, Header()] = None,
    ) -> Any:
        """The last plan; ``stale`` when it is over, ``none`` before the first."""
        found = runner.last
        if found is None:
            return {"status": "none"}
        shown = found if runner.ahead_s > 0.0 else {**found, "status": "stale"}
        tag = etag(shown)
        headers = {"ETag": tag, "Cache-Control": "no-cache"}
        if if_none_match == tag:
            return Response(status_code=304, headers=headers)
        return JSONResponse(shown, headers=headers)

    @app.get("/v1/setpoints")
    def setpoints(
        time: Annotated[str | None, Query(alias="at", max_length=40)] = None,
        asset: Annotated[str | None, Query(max_length=payloads.LONGEST_NAME)] = None,
        _: str = guarded("read"),
    ) -> Response:
        """What devices must do at a time, now if not given; defaults when that is over."""
        now = runner.clock.now() if time is None else _moment(time)
        found = runner.store.last_step(now)
        every = [] if found is None else found["setpoints"]
        chosen = [at(one, now) for one in every if asset in (None, one["asset"])]
        body = {"at": written(now), "setpoints": chosen}
        return JSONResponse(body, headers={"Cache-Control": "no-store"})


def _operation(app: FastAPI, runner: Runner, guarded: _Guard) -> None:
    """How the service is, and what it is told to do."""

    @app.get("/v1/status")
    def status(_: str = guarded("read")) -> dict[str, Any]:
        """Sources, what is late, steps so far, and the mode."""
        last = runner.last
        return {
            "now": written(runner.clock.now()),
            "site": runner.scenario.name,
            "mode": runner.mode,
            "rehearsal": runner.rehearsal,
            "step": None if last is None else {"start": last["start"], "status": last["status"]},
            "steps": runner.outcomes,
            "sources": last_heard(runner.store),
            "heard": [vars(one) for one in runner.heard],
        }

    @app.put("/v1/mode")
    def mode(body: payloads.ModeRequest, actor: str = guarded("operator")) -> dict[str, Any]:
        """Decide (``auto``), or give defaults only (``off``), from the next step on."""
        runner.store.put_setting("mode", _plain(body), runner.clock.now(), actor)
        return runner.mode


def _answer_errors(app: FastAPI) -> None:
    """Errors as problem+json, each mistake with its cure."""

    @app.exception_handler(RequestValidationError)
    async def mistaken(_: Request, error: RequestValidationError) -> Response:
        problems = [
            Problem(
                "request",
                str(details["msg"]).removeprefix("Value error, "),
                "The fields are described in /openapi.json.",
                field=".".join(str(part) for part in details["loc"])[:200],
            )
            for details in error.errors()[:MOST_PROBLEMS]
        ]
        return _problem(422, problems[0].message, problems)

    @app.exception_handler(VppresError)
    async def known(_: Request, error: VppresError) -> Response:
        if isinstance(error, InputError):
            first = str(error).splitlines()[0]
            return _problem(422, first, [p for p in error.problems if isinstance(p, Problem)])
        return _problem(503 if isinstance(error, StorageError) else 500, str(error))

    @app.exception_handler(Denied)
    async def denied(_: Request, error: Denied) -> Response:
        return _problem(error.status, str(error))

    @app.exception_handler(HTTPException)
    async def refused(_: Request, error: HTTPException) -> Response:
        return _problem(error.status_code, str(error.detail))


def _problem(status: int, detail: str, problems: Sequence[Problem] = ()) -> Response:
    """RFC 9457."""
    body = {
        "type": "about:blank",
        "title": TITLES.get(status, "The request was refused"),
        "status": status,
        "detail": detail,
        "problems": _listed(problems),
    }
    headers = {"WWW-Authenticate": "Bearer"} if status == 401 else None
    return JSONResponse(body, status, headers, media_type=PROBLEM)


def _listed(problems: Sequence[Problem]) -> list[dict[str, Any]]:
    """Problems as JSON, not more than anybody reads."""
    return [
        {
            "where": problem.where,
            "message": problem.message,
            "cure": problem.cure,
            "field": problem.field,
            "value": None if problem.value is None else str(problem.value)[:100],
        }
        for problem in problems[:MOST_PROBLEMS]
    ]


def _plain(body: payloads.Body) -> dict[str, Any]:
    """A body as it is kept: times with offsets, durations as they were read."""
    return {name: _plain_value(value) for name, value in body.model_dump().items()}


def _plain_value(value: Any) -> Any:
    if isinstance(value, pd.Timestamp):
        return written(value)
    if isinstance(value, pd.Timedelta):
        return f"PT{round(value.total_seconds())}S"
    return value


def _moment(text: str) -> pd.Timestamp:
    try:
        return payloads.read_moment(text)
    except ValueError as error:
        raise InputError(
            Problem("request", str(error), "Give a time.", field="at", value=text)
        ) from None
