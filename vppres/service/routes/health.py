"""Routes for monitoring; no token."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse

from vppres.service.operation.runner import Runner

PROMETHEUS = "text/plain; version=0.0.4; charset=utf-8"

router = APIRouter()


@router.get("/livez")
async def livez() -> dict[str, str]:
    """Whether the service answers."""
    return {"status": "ok"}


@router.get("/readyz")
def readyz(request: Request) -> Response:
    """Whether there is a plan for now, and a database to keep the next one in."""
    runner: Runner = request.app.state.runner
    checks = {
        "database": runner.store.ready(),
        "plan": runner.ahead_s > 0.0,
        "decided": runner.last.get("status", "failed") != "failed",
        "notices": runner.watch.notifier is None or runner.watch.notifier.alive(),
    }
    ready = all(checks.values())
    ahead = runner.ahead_s if runner.last else None
    body = {"ready": ready, "checks": checks, "plan_ahead_s": ahead}
    return JSONResponse(body, 200 if ready else 503)


@router.get("/metrics")
def metrics(request: Request) -> Response:
    """Figures for Prometheus."""
    return Response(request.app.state.figures.text(), media_type=PROMETHEUS)
