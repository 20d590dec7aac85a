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
from vppres.service.operation.runner import Runner
from vppres.service.routes.guard import Guard
from vppres.service.routes.versions import IfMatch, replaced_by
from vppres.service.storage.records import Event, moment


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """Events come, change and go."""
    router = APIRouter()

    @router.get("/v1/events")
    def events(_: str = guarded("read")) -> dict[str, Any]:
        """All events that hold."""
        found = runner.store.events()
        return {name: {"version": event.version, **event.body} for name, event in found.items()}

    @router.get("/v1/events/{identifier:path}/versions")
    def versions(identifier: payloads.Name, _: str = guarded("read")) -> list[dict[str, Any]]:
        """All that was ever said of an event, in its order; withdrawn where it has no type."""
        return [
            {"version": one.version, "made_at": written(moment(one.made_at)), **one.body}
            for one in runner.store.events_ever().get(identifier, [])
        ]

    @router.get("/v1/events/{identifier:path}")
    def event(
        identifier: payloads.Name, response: Response, _: str = guarded("read")
    ) -> dict[str, Any]:
        """One of them."""
        found = runner.store.events().get(identifier)
        if found is None:
            raise HTTPException(404, "There is no such event.")
        response.headers["ETag"] = f'"{found.version}"'
        return {"version": found.version, **found.body}

    @router.put("/v1/events/{identifier:path}")
    def put_event(
        identifier: payloads.Name,
        body: payloads.Event,
        response: Response,
        actor: str = guarded("events"),
        if_match: IfMatch = None,
    ) -> dict[str, Any]:
        """An outage, a belief or what a crew says of its end; a line or bus that is out.

        Also an import limit, prices or an alert.

        It replaces the old one.
        """
        put = _put(identifier, {identifier: body}, (), actor, _version(if_match))[identifier]
        response.status_code = 201 if put.new else 200
        response.headers["ETag"] = f'"{put.version}"'
        return {"version": put.version, **put.body}

    @router.delete("/v1/events/{identifier:path}")
    def delete_event(
        identifier: payloads.Name,
        actor: str = guarded("events"),
        if_match: IfMatch = None,
    ) -> dict[str, Any]:
        """Withdraw an event; its history stays."""
        if identifier not in runner.store.events():
            raise HTTPException(404, "There is no such event.")
        now = runner.clock.now()
        version = _version(if_match)
        put = runner.store.put_events({identifier: {}}, now, actor, version)[identifier]
        runner.changes.note(f"event {identifier} withdrawn")
        return {"version": put.version}

    @router.post("/v1/openadr/events", status_code=201)
    def openadr(body: OpenADREvent, actor: str = guarded("events")) -> dict[str, Any]:
        """An event of OpenADR 3 as it stands; it replaces all that an earlier one of it said."""
        found, ignored = events_of(body, believes(runner.options), runner.clock.now())
        _put(body.name, found, those_of(body, runner.store.events()), actor)
        return {"events": list(found), "ignored": ignored}

    def _put(
        name: str,
        said: Mapping[str, payloads.Event],
        replaced: Iterable[str],
        actor: str,
        version: int | None = None,
    ) -> dict[str, Event]:
        """Keep events that can be, in the place of others; a plan does not know them yet."""
        for one in said.values():
            check_belief(one, runner.options)
            check_fault(one, runner.scenario)
        now = runner.clock.now()
        check_new(said, runner.store.events(), now)
        bodies: dict[str, dict[str, Any]] = {name: {} for name in replaced}
        bodies |= {key: one.model_dump() for key, one in said.items()}
        put = runner.store.put_events(bodies, now, actor, version)
        if not all(isinstance(one, payloads.Alert) for one in said.values()):
            runner.changes.note(f"event {name}")
        return put

    return router


def _version(if_match: str | None) -> int | None:
    """The version that is to be replaced; none that there can be if the header names none."""
    text = replaced_by(if_match)
    if text is None:
        return None
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else -1
