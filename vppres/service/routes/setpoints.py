"""Routes of what devices must do, and what became of it."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Response
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.operation.runner import Runner
from vppres.service.plans.document import points_at
from vppres.service.routes.guard import Guard
from vppres.service.routes.times import check_asset, moment_asked
from vppres.service.storage.followed import REFUSED
from vppres.service.storage.records import asks

LONGEST_ID = 1300
"""Characters of an identifier: of four bytes of a name twelve are made."""

NEW = {"status": "new"}
"""Of a set-point whose result was not reported."""


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """Set-points are looked at, and answered."""
    router = APIRouter()

    @router.get("/v1/setpoints")
    def setpoints(
        time: Annotated[str | None, Query(alias="at", max_length=40)] = None,
        asset: Annotated[str | None, Query(max_length=payloads.LONGEST_NAME)] = None,
        _: str = guarded("read"),
    ) -> Response:
        """Set-points of devices at a time, now if not given; defaults once they are over."""
        check_asset(asset, runner.scenario)
        now = runner.clock.now() if time is None else moment_asked(time)
        every = points_at(runner.store.last_step(now), now)
        chosen = [one for one in every if asset in (None, one["asset"])]
        said = runner.store.acks(one["id"] for one in chosen)
        chosen = [{**one, "status": said.get(one["id"], NEW)["status"]} for one in chosen]
        body = {"at": written(now), "setpoints": chosen}
        return JSONResponse(body, headers={"Cache-Control": "no-store"})

    @router.post("/v1/setpoints/{identifier:path}/status")
    def status(
        identifier: Annotated[str, Path(max_length=LONGEST_ID)],
        body: payloads.SetpointStatus,
        actor: str = guarded("telemetry"),
    ) -> dict[str, Any]:
        """Store a set-point's status; a battery that refuses is left out until its next reading."""
        found = runner.store.setpoint(identifier)
        if found is None:
            raise HTTPException(404, "There is no such set-point.")
        said = body.model_dump()
        before = runner.store.acks([found["id"]]).get(found["id"], NEW)["status"]
        was_out = found["asset"] in runner.store.refusing(found["kind"])
        runner.store.put_ack(found, said, runner.clock.now(), actor)
        # One that accepts may have refused the set-point before this one.
        turned = before not in REFUSED if body.status in REFUSED else was_out
        if turned and asks(found):
            runner.changes.note(f"{found['asset']} {body.status}")
        return {"id": found["id"], **said}

    return router
