"""The route of what is expected."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from starlette.exceptions import HTTPException

from vppres.core.errors import InputError
from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.routes.guard import Announcer
from vppres.service.window import check_forecast

router = APIRouter()


@router.put("/v1/forecasts/{quantity}")
def forecast(by: Announcer, quantity: str, body: payloads.Forecasts) -> dict[str, Any]:
    """Store a forecast of ``load_kw`` or ``pv_kw``; older forecasts are kept."""
    if quantity not in ("load_kw", "pv_kw"):
        raise HTTPException(404, "There are forecasts of load_kw and pv_kw.")
    now = by.runner.clock.now()
    until = by.runner.begun(now) + 2 * by.runner.length
    if body.issued_at > until:
        message, cure = (
            "lies in the future",
            f"It is {written(now)}; set the forecaster's clock.",
        )
        issued = written(body.issued_at)
        raise InputError.of("forecast", message, cure, field="issued_at", value=issued)
    latest = by.runner.store.latest(until, ["load_kw"], known=True)
    read_kw = {one.asset: one.value for one in latest}
    check_forecast(quantity, body.assets, by.runner.scenario, read_kw)
    by.runner.store.put_forecast(quantity, body.model_dump(), by.runner.clock.now(), by.actor)
    return {"quantity": quantity, "issued_at": written(body.issued_at)}
