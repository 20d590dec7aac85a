"""Routes of alarms."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query

from vppres.core.errors import InputError
from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.routes.guard import Operator, Reader
from vppres.service.routes.times import moment_asked

Number = Annotated[int, Path(ge=1, lt=2**31)]
"""Of an alarm, as databases count."""

router = APIRouter()


@router.get("/v1/alarms")
def alarms(by: Reader, since: Annotated[str | None, Query(max_length=40)] = None) -> dict[str, Any]:
    """Alarms that stand or wait for an acknowledgement; with ``since`` all since a time."""
    now = by.runner.clock.now()
    begin = None if since is None else moment_asked(since)
    return {"now": written(now), "alarms": by.runner.watch.alarms.listed(now, begin)}


@router.post("/v1/alarms/{number}/acknowledge")
def acknowledge(
    by: Operator, number: Number, body: payloads.Remark | None = None
) -> dict[str, Any]:
    """Note that an operator has seen an alarm; it stays until its condition is gone."""
    reason = body.reason if body else ""
    return by.runner.watch.alarms.acknowledge(number, by.actor, reason, by.runner.clock.now())


@router.put("/v1/alarms/{number}/shelf")
def shelve(by: Operator, number: Number, body: payloads.Shelf) -> dict[str, Any]:
    """Let an alarm send no notification up to a time, also if it is raised again before."""
    now = by.runner.clock.now()
    if body.until <= now:
        raise InputError.of(
            "alarm",
            "is over",
            f"Give a time after {written(now)}.",
            field="until",
            value=written(body.until),
        )
    return by.runner.watch.alarms.shelve(number, body.until, by.actor, body.reason, now)


@router.delete("/v1/alarms/{number}/shelf")
def unshelve(by: Operator, number: Number) -> dict[str, Any]:
    """Let an alarm notify again."""
    return by.runner.watch.alarms.shelve(number, None, by.actor, "", by.runner.clock.now())
