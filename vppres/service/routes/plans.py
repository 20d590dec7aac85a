"""Routes of what is decided."""

from __future__ import annotations

from typing import Annotated, Any

import pandas as pd
from fastapi import APIRouter, Header, Query, Response
from fastapi.responses import JSONResponse

from vppres.core.errors import InputError, Problem
from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.plans import at, etag
from vppres.service.routes.guard import Guard
from vppres.service.runner import Runner


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """Steps are asked for, plans and set-points looked at."""
    router = APIRouter()

    @router.post("/v1/steps")
    def step(
        body: payloads.StepRequest | None = None, _: str = guarded("operator")
    ) -> dict[str, Any]:
        """Decide a step, or give its stored plan: to ask twice does no harm."""
        return runner.step(None if body is None else body.time)

    @router.get("/v1/plan")
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

    @router.get("/v1/setpoints")
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

    return router


def _moment(text: str) -> pd.Timestamp:
    try:
        return payloads.read_moment(text)
    except ValueError as error:
        raise InputError(
            Problem("request", str(error), "Give a time.", field="at", value=text)
        ) from None
