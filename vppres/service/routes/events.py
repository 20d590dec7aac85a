"""Routes of what is announced."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Header, Response
from starlette.exceptions import HTTPException

from vppres.service import payloads
from vppres.service.announced import believes, check_belief, check_new
from vppres.service.clock import written
from vppres.service.openadr import OpenADREvent, events_of, those_of
from vppres.service.records import moment
from vppres.service.routes.guard import Guard
from vppres.service.runner import Runner
from vppres.service.window import check_forecast


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """Events come, change and go."""
    router = APIRouter()

    @router.get("/v1/events")
    def events(_: str = guarded("read")) -> dict[str, Any]:
        """All events that hold."""
        found = runner.store.events()
        return {name: {"version": event.version, **event.body} for name, event in found.items()}

    @router.get("/v1/events/{identifier}")
    def event(
        identifier: payloads.Name, response: Response, _: str = guarded("read")
    ) -> dict[str, Any]:
        """One of them."""
        found = runner.store.events().get(identifier)
        if found is None:
            raise HTTPException(404, "There is no such event.")
        response.headers["ETag"] = f'"{found.version}"'
        return {"version": found.version, **found.body}

    @router.get("/v1/events/{identifier}/versions")
    def versions(identifier: payloads.Name, _: str = guarded("read")) -> list[dict[str, Any]]:
        """All that was ever said of an event, in its order; withdrawn where it has no type."""
        return [
            {"version": one.version, "made_at": written(moment(one.made_at)), **one.body}
            for one in runner.store.events_ever().get(identifier, [])
        ]

    @router.put("/v1/events/{identifier}")
    def put_event(
        identifier: payloads.Name,
        body: payloads.Event,
        response: Response,
        actor: str = guarded("events"),
        if_match: Annotated[str | None, Header()] = None,
    ) -> dict[str, Any]:
        """An outage, a belief or what a crew says of its end; an import limit, prices or an alert.

        It replaces the old one.
        """
        if isinstance(body, payloads.Prices):
            check_forecast("load_kw", {}, body.start, body.resolution, runner.scenario)
        plain = body.model_dump()
        if isinstance(body, payloads.Belief | payloads.Restoration):
            check_belief(plain, runner.options)
        now = runner.clock.now()
        check_new({identifier: plain}, runner.store.events(), now)
        version = _version(if_match)
        put = runner.store.put_events({identifier: plain}, now, actor, version)[identifier]
        if not isinstance(body, payloads.Alert):
            runner.changes.note(f"event {identifier}")
        response.status_code = 201 if put.new else 200
        response.headers["ETag"] = f'"{put.version}"'
        return {"version": put.version, **plain}

    @router.delete("/v1/events/{identifier}")
    def delete_event(
        identifier: payloads.Name,
        actor: str = guarded("events"),
        if_match: Annotated[str | None, Header()] = None,
    ) -> dict[str, Any]:
        """Withdraw an event; its history stays."""
        if identifier not in runner.store.events():
            raise HTTPException(404, "There is no such event.")
        now = runner.clock.now()
        version = _version(if_match)
        put = runner.store.put_events({identifier: None}, now, actor, version)[identifier]
        runner.changes.note(f"event {identifier} withdrawn")
        return {"version": put.version}

    @router.post("/v1/openadr/events", status_code=201)
    def openadr(body: OpenADREvent, actor: str = guarded("events")) -> dict[str, Any]:
        """An event of OpenADR 3 as it stands; it replaces all that an earlier one of it said."""
        found, ignored = events_of(body, believes(runner.options))
        for event in found.values():
            if isinstance(event, payloads.Prices):
                check_forecast("load_kw", {}, event.start, event.resolution, runner.scenario)
        known = runner.store.events()
        now = runner.clock.now()
        said = {name: event.model_dump() for name, event in found.items()}
        check_new(said, known, now)
        bodies = {**dict.fromkeys(those_of(body, known)), **said}
        runner.store.put_events(bodies, now, actor)
        if any(not isinstance(event, payloads.Alert) for event in found.values()):
            runner.changes.note(f"event {body.name}")
        return {"events": list(found), "ignored": ignored}

    return router


def _version(if_match: str | None) -> int | None:
    """The version that is to be replaced; none that there can be if the header names none."""
    if if_match is None:
        return None
    text = if_match.strip().strip('"')
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else -1
