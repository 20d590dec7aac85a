"""Routes of steps: they are asked for, and their plans and reasons looked at."""

from __future__ import annotations

from typing import Annotated, Any

import pandas as pd
from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.operation.runner import Runner
from vppres.service.plans.document import etag
from vppres.service.replay.explainer import only
from vppres.service.routes.guard import Operator, Reader
from vppres.service.routes.times import check_asset, moment_asked

RESPOND_ASYNC = "respond-async"

router = APIRouter()


@router.post("/v1/steps", responses={202: {"description": "It is decided; see Location."}})
def step(
    by: Operator,
    body: payloads.StepRequest | None = None,
    prefer: Annotated[str | None, Header(max_length=200)] = None,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=100)] = None,
) -> Any:
    """Decide a step, or give its stored plan: to ask twice does no harm.

    ``Prefer: respond-async`` gets the job instead of the plan. With an ``Idempotency-Key`` a
    request for the present step that is sent again later still means the same step.
    """
    time = body.time if body else None
    if idempotency_key:
        time = _step_of(by.runner, idempotency_key, time)
    if RESPOND_ASYNC in (prefer or ""):
        name = by.runner.begin(time, by.actor)
        headers = {"Location": f"/v1/jobs/{name}", "Preference-Applied": RESPOND_ASYNC}
        return JSONResponse(by.runner.job(name), 202, headers)
    return JSONResponse(by.runner.step(time, by.actor))


def _step_of(runner: Runner, key: str, time: pd.Timestamp | None) -> pd.Timestamp:
    """The step of a key, which is the same whenever it is asked for."""
    wanted = runner.step_of(time)
    found = runner.store.step_of_key(key, wanted)
    if time and found != wanted:
        raise HTTPException(422, f"The Idempotency-Key was used for {written(found)}.")
    return found


@router.get("/v1/jobs/{name}")
def job(by: Reader, name: payloads.Name) -> dict[str, Any]:
    """A step that was asked for: queued, started, finished with its plan, or failed."""
    found = by.runner.job(name)
    if not found:
        raise HTTPException(404, "There is no such job.")
    return found


@router.get("/v1/plan")
def plan(
    by: Reader, response: Response, if_none_match: Annotated[str | None, Header()] = None
) -> Any:
    """The last plan; ``stale`` when it is over, ``none`` before the first."""
    found = by.runner.last
    if not found:
        return {"status": "none", "reason": by.runner.why_none}
    shown = found if by.runner.ahead_s > 0.0 else {**found, "status": "stale"}
    unknown = by.runner.changes.reasons
    shown = {**shown, "unaware_of": list(unknown)} if unknown else shown
    return _unless_known(shown, if_none_match)


@router.get("/v1/explanations")
def explanations(
    by: Reader,
    request: Request,
    time: Annotated[str | None, Query(alias="at", max_length=40)] = None,
    asset: Annotated[str | None, Query(max_length=payloads.LONGEST_NAME)] = None,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """Why each device does what it does in a step, the last one if no time is given."""
    check_asset(asset, by.runner.scenario)
    found = request.app.state.explainer.of(_kept(by.runner, time))
    return _unless_known(only(found, asset) if asset is not None else found, if_none_match)


def _kept(runner: Runner, time: str | None) -> dict[str, Any]:
    """The stored plan of a step."""
    plan = runner.last
    if time is not None:
        plan = runner.store.step(runner.begun(moment_asked(time).tz_convert("UTC")))
    if not plan:
        raise HTTPException(404, "No step of that time is kept.")
    return plan


def _unless_known(body: dict[str, Any], known: str | None) -> Response:
    """A body with its tag; 304 to a client that has it already."""
    tag = etag(body)
    headers = {"ETag": tag, "Cache-Control": "no-cache"}
    return Response(None, 304, headers) if known == tag else JSONResponse(body, headers=headers)
