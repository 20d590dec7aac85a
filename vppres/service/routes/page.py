"""The page to watch: files that are sent as they are, and what they ask for."""

from __future__ import annotations

from importlib.resources import files
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import Response
from starlette.concurrency import run_in_threadpool

from vppres.service.clock import written
from vppres.service.operation.runner import Runner
from vppres.service.overview import Overview, site_of
from vppres.service.routes.guard import Guard
from vppres.service.routes.times import moment_asked

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self'",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
"""What a browser may do with the page: nothing but ask this service."""

TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
PICTURES = "pictures.js"
"""The script of a report's charts: it draws the page's too."""

FILES = ("page.html", "page.css", "icon.svg", "page.js", "words.js", "chart.js", "operator.js")


def routes(runner: Runner, guarded: Guard) -> APIRouter:
    """``GET /`` and its files, ``GET /v1/site`` and ``GET /v1/overview``.

    The files need no token: they know nothing of the site.
    """
    router = APIRouter()
    folder, drawing = files("vppres.service") / "page", files("vppres.report") / "templates"
    for name in (*FILES, PICTURES):
        path = "/" if name == "page.html" else f"/page/{name}"
        file = (drawing if name == PICTURES else folder) / name
        router.add_route(path, _sender(name, file.read_bytes()))
    overview = Overview(runner)
    site = site_of(runner)

    @router.get("/v1/site")
    def what(_: str = guarded("read")) -> dict[str, Any]:
        """Constant data of the site: names, limits, ratings, tiers and modes."""
        return site

    @router.get("/v1/overview")
    async def how(_: str = guarded("read")) -> Response:
        """All that a control room looks at: mode, plan, who is off, sources, the last hours."""
        text = overview.fresh() or await run_in_threadpool(overview.text)
        headers = {"Cache-Control": "no-store"}
        return Response(text, media_type="application/json", headers=headers)

    @router.get("/v1/history")
    def history(
        since: Annotated[str, Query(max_length=40)],
        until: Annotated[str | None, Query(max_length=40)] = None,
        _: str = guarded("read"),
    ) -> dict[str, Any]:
        """Steps that were, from a time on; of more than 1,000 the last ones."""
        now = runner.clock.now()
        end = now if until is None else moment_asked(until)
        return {"now": written(now), "steps": overview.history(moment_asked(since), end)}

    return router


def _sender(name: str, content: bytes) -> Any:
    """Answers with a file."""
    headers = {"Content-Security-Policy": POLICY, "Cache-Control": "no-cache"}
    media_type = TYPES[name.rpartition(".")[2]]

    async def send(_: Any) -> Response:
        return Response(content, media_type=media_type, headers=headers)

    return send
