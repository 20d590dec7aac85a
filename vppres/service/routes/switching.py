"""Routes of switches that an operator moves."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from vppres.service import payloads
from vppres.service.operation.runner import Runner
from vppres.service.operation.switching import SWITCHING
from vppres.service.routes.guard import Guard
from vppres.service.routes.versions import IfMatch, replaced_by


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """States are asked for, and operations confirmed, one after another."""
    router = APIRouter()

    def told(response: Response) -> dict[str, Any]:
        """Present state, with the ETag that ``If-Match`` takes."""
        response.headers["ETag"] = f'"{runner.store.setting(SWITCHING)[1]}"'
        return runner.watch.switchgear().told()

    def kept(asked: dict[str, Any], seen: str, actor: str, if_match: str | None) -> None:
        """Keep what is asked for in the place of what was seen, and of what a sender has seen."""
        replaced = replaced_by(if_match)
        tag = seen if replaced is None else replaced
        runner.store.put_setting(SWITCHING, asked, runner.clock.now(), actor, tag)

    @router.get("/v1/switching")
    def switching(response: Response, _: str = guarded("read")) -> dict[str, Any]:
        """States of the switches, and the operations that are left."""
        return told(response)

    @router.put("/v1/switching")
    def put_switching(
        body: payloads.SwitchingRequest,
        response: Response,
        actor: str = guarded("operator"),
        if_match: IfMatch = None,
    ) -> dict[str, Any]:
        """Ask for states of switches; no operation is carried out before it is confirmed."""
        before, seen = runner.store.setting(SWITCHING)
        asked = {**body.model_dump(), "issued": runner.watch.switchgear(before).told()["issued"]}
        runner.watch.switchgear(asked).check()
        kept(asked, seen, actor, if_match)
        return told(response)

    @router.delete("/v1/switching")
    def delete_switching(
        response: Response, actor: str = guarded("operator"), if_match: IfMatch = None
    ) -> dict[str, Any]:
        """Ask for nothing more; an operation that was confirmed is not taken back."""
        before, seen = runner.store.setting(SWITCHING)
        kept({"issued": runner.watch.switchgear(before).told()["issued"]}, seen, actor, if_match)
        return told(response)

    @router.post("/v1/switching/confirm")
    def confirm(
        body: payloads.ConfirmedOperation,
        response: Response,
        actor: str = guarded("operator"),
        if_match: IfMatch = None,
    ) -> dict[str, Any]:
        """Confirm the next operation, which devices then carry out."""
        before, seen = runner.store.setting(SWITCHING)
        kept(runner.watch.switchgear(before).confirmed(body.switch), seen, actor, if_match)
        return told(response)

    return router
