"""The route of what is measured."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse

from vppres.core.errors import InputError
from vppres.service import payloads
from vppres.service.answers import listed
from vppres.service.knowledge import readings_of
from vppres.service.routes.guard import Guard
from vppres.service.runner import Runner


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """Readings come in."""
    router = APIRouter()

    @router.post("/v1/telemetry")
    def telemetry(body: payloads.Telemetry, actor: str = guarded("telemetry")) -> Response:
        """Readings; to send them twice does no harm.

        ``asked_again`` says which of them stand alone, and are to be sent again within seconds.
        """
        now = runner.clock.now()
        until = runner.begun(now) + 2 * runner.length
        good, problems = readings_of(body.series, runner.scenario, until)
        if problems and not good:
            raise InputError(problems)
        kept = runner.hear(good, now, actor)
        again = runner.asked_again(good)
        return JSONResponse(
            {
                "accepted": kept.accepted,
                "duplicates": kept.duplicates,
                "refused": listed(problems),
                **({"asked_again": again} if again else {}),
            }
        )

    return router
