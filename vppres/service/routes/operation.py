"""Routes of the service's status and mode."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.operation.site import MODE
from vppres.service.routes.guard import Operator, Reader
from vppres.service.routes.versions import IfMatch, replaced_by
from vppres.service.telemetry.knowledge import check_setpoints, last_heard

router = APIRouter()


@router.get("/v1/status")
def status(by: Reader) -> dict[str, Any]:
    """Sources, what is late, steps so far, and the mode."""
    last = by.runner.last
    return {
        "now": written(by.runner.clock.now()),
        "site": by.runner.scenario.name,
        "mode": by.runner.mode,
        "rehearsal": by.runner.rehearsal,
        "step": {"start": last["start"], "status": last["status"]} if last else None,
        "steps": by.runner.outcomes,
        "sources": last_heard(by.runner.store),
        "alarms": by.runner.watch.alarms.listed(by.runner.clock.now()),
        "heard": by.runner.deciding.heard,
    }


@router.get("/v1/mode")
def mode(by: Reader, response: Response) -> dict[str, Any]:
    """Mode that the operator set, with the ETag that ``If-Match`` takes."""
    response.headers["ETag"] = f'"{by.runner.store.setting(MODE)[1]}"'
    return by.runner.mode


@router.put("/v1/mode")
def put_mode(
    by: Operator, body: payloads.ModeRequest, response: Response, if_match: IfMatch = None
) -> dict[str, Any]:
    """Decide, hold the last set-points, give the operator's or defaults, at once."""
    check_setpoints(body.setpoints, by.runner.scenario)
    asked = body.model_dump()
    found = by.runner.watch.checked(asked) if body.setpoints else []
    now, replaced = by.runner.clock.now(), replaced_by(if_match)
    tag = by.runner.store.put_setting(MODE, asked, now, by.actor, replaced)
    by.runner.changes.note(f"mode {body.mode}")
    response.headers["ETag"] = f'"{tag}"'
    return {**by.runner.mode, **({"found": found} if body.setpoints else {})}


@router.post("/v1/mode/check")
def check_mode(by: Operator, body: payloads.ModeRequest) -> dict[str, Any]:
    """Check an operator's set-points by balance and AC power flow; nothing is changed."""
    check_setpoints(body.setpoints, by.runner.scenario)
    return {"found": by.runner.watch.checked(body.model_dump()) if body.setpoints else []}


@router.put("/v1/clock")
def clock(by: Operator, body: payloads.ClockRequest) -> dict[str, str]:
    """Set the clock of a service that is played: it never goes back."""
    by.runner.set_clock(body.now)
    return {"now": written(by.runner.clock.now())}
