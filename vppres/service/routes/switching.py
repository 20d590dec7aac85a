"""Routes of switches that an operator moves."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from vppres.service import payloads
from vppres.service.operation.switching import SWITCHING
from vppres.service.routes.guard import Operator, Reader, Sender
from vppres.service.routes.versions import IfMatch, replaced_by

router = APIRouter()


def _told(by: Sender, response: Response) -> dict[str, Any]:
    """Present state, with the ETag that ``If-Match`` takes."""
    response.headers["ETag"] = f'"{by.runner.store.setting(SWITCHING)[1]}"'
    return by.runner.watch.switchgear().told()


def _keep(by: Sender, asked: dict[str, Any], seen: str, if_match: str | None) -> None:
    """Keep what is asked for in the place of what was seen, and of what a sender has seen."""
    replaced = replaced_by(if_match)
    tag = seen if replaced is None else replaced
    by.runner.store.put_setting(SWITCHING, asked, by.runner.clock.now(), by.actor, tag)


@router.get("/v1/switching")
def switching(by: Reader, response: Response) -> dict[str, Any]:
    """States of the switches, and the operations that are left."""
    return _told(by, response)


@router.put("/v1/switching")
def put_switching(
    by: Operator, body: payloads.SwitchingRequest, response: Response, if_match: IfMatch = None
) -> dict[str, Any]:
    """Ask for states of switches; no operation is carried out before it is confirmed."""
    before, seen = by.runner.store.setting(SWITCHING)
    asked = {**body.model_dump(), "issued": by.runner.watch.switchgear(before).told()["issued"]}
    by.runner.watch.switchgear(asked).check()
    _keep(by, asked, seen, if_match)
    return _told(by, response)


@router.delete("/v1/switching")
def delete_switching(by: Operator, response: Response, if_match: IfMatch = None) -> dict[str, Any]:
    """Ask for nothing more; an operation that was confirmed is not taken back."""
    before, seen = by.runner.store.setting(SWITCHING)
    issued = by.runner.watch.switchgear(before).told()["issued"]
    _keep(by, {"issued": issued}, seen, if_match)
    return _told(by, response)


@router.post("/v1/switching/confirm")
def confirm(
    by: Operator, body: payloads.ConfirmedOperation, response: Response, if_match: IfMatch = None
) -> dict[str, Any]:
    """Confirm the next operation, which devices then carry out."""
    before, seen = by.runner.store.setting(SWITCHING)
    _keep(by, by.runner.watch.switchgear(before).confirmed(body.switch), seen, if_match)
    return _told(by, response)
