"""The page to watch: files that are sent as they are, and what they ask for."""

from __future__ import annotations

from importlib.resources import files
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from starlette.concurrency import run_in_threadpool

from vppres.service.clock import written
from vppres.service.overview import Overview
from vppres.service.routes.guard import Reader
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

router = APIRouter()
"""The page's files need no token: they know nothing of the site."""


@router.get("/v1/site")
def what(request: Request, _: Reader) -> dict[str, Any]:
    """Constant data of the site: names, limits, ratings, tiers and modes."""
    found: dict[str, Any] = request.app.state.overview.site
    return found


@router.get("/v1/overview")
async def how(request: Request, _: Reader) -> Response:
    """All that a control room looks at: mode, plan, who is off, sources, the last hours."""
    overview: Overview = request.app.state.overview
    text = overview.fresh() or await run_in_threadpool(overview.text)
    headers = {"Cache-Control": "no-store"}
    return Response(text, media_type="application/json", headers=headers)


@router.get("/v1/history")
def history(
    by: Reader,
    request: Request,
    since: Annotated[str, Query(max_length=40)],
    until: Annotated[str | None, Query(max_length=40)] = None,
) -> dict[str, Any]:
    """Steps that were, from a time on; of more than 1,000 the last ones."""
    now = by.runner.clock.now()
    end = now if until is None else moment_asked(until)
    return {
        "now": written(now),
        "steps": request.app.state.overview.history(moment_asked(since), end),
    }


def _sender(name: str, content: bytes) -> Any:
    """Answers with a file."""
    headers = {"Content-Security-Policy": POLICY, "Cache-Control": "no-cache"}
    media_type = TYPES[name.rpartition(".")[2]]

    async def send(_: Any) -> Response:
        return Response(content, media_type=media_type, headers=headers)

    return send


_PAGE, _DRAWING = files("vppres.service") / "page", files("vppres.report") / "templates"
for _name in (*FILES, PICTURES):
    _path = "/" if _name == "page.html" else f"/page/{_name}"
    _file = (_DRAWING if _name == PICTURES else _PAGE) / _name
    router.add_route(_path, _sender(_name, _file.read_bytes()))
