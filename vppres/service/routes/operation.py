"""Routes of the service's status and mode."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import MODE
from vppres.service.routes.guard import Guard
from vppres.service.routes.versions import IfMatch, replaced_by
from vppres.service.telemetry.knowledge import check_setpoints, last_heard


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """Status is looked at, the mode set."""
    router = APIRouter()

    @router.get("/v1/status")
    def status(_: str = guarded("read")) -> dict[str, Any]:
        """Sources, what is late, steps so far, and the mode."""
        last = runner.last
        return {
            "now": written(runner.clock.now()),
            "site": runner.scenario.name,
            "mode": runner.mode,
            "rehearsal": runner.rehearsal,
            "step": {"start": last["start"], "status": last["status"]} if last else None,
            "steps": runner.outcomes,
            "sources": last_heard(runner.store),
            "alarms": runner.watch.alarms.listed(runner.clock.now()),
            "heard": runner.deciding.heard,
        }

    @router.get("/v1/mode")
    def mode(response: Response, _: str = guarded("read")) -> dict[str, Any]:
        """Mode that the operator set, with the ETag that ``If-Match`` takes."""
        response.headers["ETag"] = f'"{runner.store.setting(MODE)[1]}"'
        return runner.mode

    @router.put("/v1/mode")
    def put_mode(
        body: payloads.ModeRequest,
        response: Response,
        actor: str = guarded("operator"),
        if_match: IfMatch = None,
    ) -> dict[str, Any]:
        """Decide, hold the last set-points, give the operator's or defaults, at once."""
        check_setpoints(body.setpoints, runner.scenario)
        asked = body.model_dump()
        found = runner.watch.checked(asked) if body.setpoints else []
        now, replaced = runner.clock.now(), replaced_by(if_match)
        tag = runner.store.put_setting(MODE, asked, now, actor, replaced)
        runner.changes.note(f"mode {body.mode}")
        response.headers["ETag"] = f'"{tag}"'
        return {**runner.mode, **({"found": found} if body.setpoints else {})}

    @router.post("/v1/mode/check")
    def check_mode(body: payloads.ModeRequest, _: str = guarded("operator")) -> dict[str, Any]:
        """Check an operator's set-points by balance and AC power flow; nothing is changed."""
        check_setpoints(body.setpoints, runner.scenario)
        return {"found": runner.watch.checked(body.model_dump()) if body.setpoints else []}

    @router.put("/v1/clock")
    def clock(body: payloads.ClockRequest, _: str = guarded("operator")) -> dict[str, str]:
        """Set the clock of a service that is played: it never goes back."""
        runner.set_clock(body.now)
        return {"now": written(runner.clock.now())}

    return router
