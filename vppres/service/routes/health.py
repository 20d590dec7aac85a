"""Routes for monitoring; no token."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse

from vppres.service.operation.metrics import Figures
from vppres.service.operation.runner import Runner


def routes(runner: Runner) -> APIRouter:
    """Whether it lives, whether it is ready, and its figures."""
    router = APIRouter()
    figures = Figures(runner)

    @router.get("/livez")
    async def livez() -> dict[str, str]:
        """Whether the service answers."""
        return {"status": "ok"}

    @router.get("/readyz")
    def readyz() -> Response:
        """Whether there is a plan for now, and a database to keep the next one in."""
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
    def metrics() -> Response:
        """Figures for Prometheus."""
        return Response(figures.text(), media_type="text/plain; version=0.0.4; charset=utf-8")

    return router
