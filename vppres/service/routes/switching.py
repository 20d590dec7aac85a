"""Routes of switches that an operator moves."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from vppres.service import payloads
from vppres.service.operation.runner import Runner
from vppres.service.operation.switching import SWITCHING
from vppres.service.routes.guard import Guard


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """States are asked for, and operations confirmed, one after another."""
    router = APIRouter()

    @router.get("/v1/switching")
    def switching(_: str = guarded("read")) -> dict[str, Any]:
        """States of the switches, and the operations that are left."""
        return runner.switchgear().told()

    @router.put("/v1/switching")
    def put_switching(
        body: payloads.SwitchingRequest, actor: str = guarded("operator")
    ) -> dict[str, Any]:
        """Ask for states of switches; no operation is carried out before it is confirmed."""
        asked = {**body.model_dump(), "issued": runner.switchgear().told()["issued"]}
        runner.switchgear(asked).check()
        runner.store.put_setting(SWITCHING, asked, runner.clock.now(), actor)
        return runner.switchgear().told()

    @router.delete("/v1/switching")
    def delete_switching(actor: str = guarded("operator")) -> dict[str, Any]:
        """Ask for nothing more; an operation that was confirmed is not taken back."""
        left = {"issued": runner.switchgear().told()["issued"]}
        runner.store.put_setting(SWITCHING, left, runner.clock.now(), actor)
        return runner.switchgear().told()

    @router.post("/v1/switching/confirm")
    def confirm(
        body: payloads.ConfirmedOperation, actor: str = guarded("operator")
    ) -> dict[str, Any]:
        """Confirm the next operation, which devices then carry out."""
        asked, tag = runner.store.setting(SWITCHING)
        changed = runner.switchgear(asked).confirmed(body.switch)
        runner.store.put_setting(SWITCHING, changed, runner.clock.now(), actor, tag)
        return runner.switchgear().told()

    return router
