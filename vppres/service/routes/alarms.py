"""Routes of alarms."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query

from vppres.core.errors import InputError
from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.operation.runner import Runner
from vppres.service.routes.guard import Guard
from vppres.service.routes.times import moment_asked

Number = Annotated[int, Path(ge=1, lt=2**31)]
"""Of an alarm, as databases count."""


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """Alarms are looked at, acknowledged and shelved."""
    router = APIRouter()

    @router.get("/v1/alarms")
    def alarms(
        since: Annotated[str | None, Query(max_length=40)] = None, _: str = guarded("read")
    ) -> dict[str, Any]:
        """Alarms that stand or wait for an acknowledgement; with ``since`` all since a time."""
        now = runner.clock.now()
        begin = None if since is None else moment_asked(since)
        return {"now": written(now), "alarms": runner.watch.alarms.listed(now, begin)}

    @router.post("/v1/alarms/{number}/acknowledge")
    def acknowledge(
        number: Number, body: payloads.Remark | None = None, actor: str = guarded("operator")
    ) -> dict[str, Any]:
        """Note that an operator has seen an alarm; it stays until its condition is gone."""
        reason = body.reason if body else ""
        return runner.watch.alarms.acknowledge(number, actor, reason, runner.clock.now())

    @router.put("/v1/alarms/{number}/shelf")
    def shelve(
        number: Number, body: payloads.Shelf, actor: str = guarded("operator")
    ) -> dict[str, Any]:
        """Let an alarm send no notification up to a time, also if it is raised again before."""
        now = runner.clock.now()
        if body.until <= now:
            raise InputError.of(
                "alarm",
                "is over",
                f"Give a time after {written(now)}.",
                field="until",
                value=written(body.until),
            )
        return runner.watch.alarms.shelve(number, body.until, actor, body.reason, now)

    @router.delete("/v1/alarms/{number}/shelf")
    def unshelve(number: Number, actor: str = guarded("operator")) -> dict[str, Any]:
        """Let an alarm notify again."""
        return runner.watch.alarms.shelve(number, None, actor, "", runner.clock.now())

    return router
