"""Routes of what is announced."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from fastapi import APIRouter, Response
from starlette.exceptions import HTTPException

from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.events.announced import believes, check_belief, check_new
from vppres.service.events.faults import check_fault
from vppres.service.events.openadr import OpenADREvent, events_of, those_of
from vppres.service.routes.guard import Announcer, Reader, Sender
from vppres.service.routes.versions import IfMatch, replaced_by
from vppres.service.storage.records import Event, moment

router = APIRouter()


@router.get("/v1/events")
def events(by: Reader) -> dict[str, Any]:
    """All events that hold."""
    found = by.runner.store.events()
    return {name: {"version": event.version, **event.body} for name, event in found.items()}


@router.get("/v1/events/{identifier:path}/versions")
def versions(by: Reader, identifier: payloads.Name) -> list[dict[str, Any]]:
    """All that was ever said of an event, in its order; withdrawn where it has no type."""
    return [
        {"version": one.version, "made_at": written(moment(one.made_at)), **one.body}
        for one in by.runner.store.events_ever().get(identifier, [])
    ]


@router.get("/v1/events/{identifier:path}")
def event(by: Reader, identifier: payloads.Name, response: Response) -> dict[str, Any]:
    """One of them."""
    found = by.runner.store.events().get(identifier)
    if found is None:
        raise HTTPException(404, "There is no such event.")
    response.headers["ETag"] = f'"{found.version}"'
    return {"version": found.version, **found.body}


@router.put("/v1/events/{identifier:path}")
def put_event(
    by: Announcer,
    identifier: payloads.Name,
    body: payloads.Event,
    response: Response,
    if_match: IfMatch = None,
) -> dict[str, Any]:
    """An outage, a belief or what a crew says of its end; a line or bus that is out.

    Also an import limit, prices or an alert.

    It replaces the old one.
    """
    put = _put(by, identifier, {identifier: body}, version=_version(if_match))[identifier]
    response.status_code = 201 if put.new else 200
    response.headers["ETag"] = f'"{put.version}"'
    return {"version": put.version, **put.body}


@router.delete("/v1/events/{identifier:path}")
def delete_event(
    by: Announcer, identifier: payloads.Name, if_match: IfMatch = None
) -> dict[str, Any]:
    """Withdraw an event; its history stays."""
    if identifier not in by.runner.store.events():
        raise HTTPException(404, "There is no such event.")
    now = by.runner.clock.now()
    version = _version(if_match)
    put = by.runner.store.put_events({identifier: {}}, now, by.actor, version)[identifier]
    by.runner.changes.note(f"event {identifier} withdrawn")
    return {"version": put.version}


@router.post("/v1/openadr/events", status_code=201)
def openadr(by: Announcer, body: OpenADREvent) -> dict[str, Any]:
    """An event of OpenADR 3 as it stands; it replaces all that an earlier one of it said."""
    found, ignored = events_of(body, believes(by.runner.options), by.runner.clock.now())
    _put(by, body.name, found, those_of(body, by.runner.store.events()))
    return {"events": list(found), "ignored": ignored}


def _put(
    by: Sender,
    name: str,
    said: Mapping[str, payloads.Event],
    replaced: Iterable[str] = (),
    version: int | None = None,
) -> dict[str, Event]:
    """Keep events that can be, in the place of others; a plan does not know them yet."""
    for one in said.values():
        check_belief(one, by.runner.options)
        check_fault(one, by.runner.scenario)
    now = by.runner.clock.now()
    check_new(said, by.runner.store.events(), now)
    bodies: dict[str, dict[str, Any]] = {name: {} for name in replaced}
    bodies |= {key: one.model_dump() for key, one in said.items()}
    put = by.runner.store.put_events(bodies, now, by.actor, version)
    if not all(isinstance(one, payloads.Alert) for one in said.values()):
        by.runner.changes.note(f"event {name}")
    return put


def _version(if_match: str | None) -> int | None:
    """The version that is to be replaced; none that there can be if the header names none."""
    text = replaced_by(if_match)
    if text is None:
        return None
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else -1
