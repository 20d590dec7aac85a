"""The service over HTTP: routes by subject, around a runner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fastapi import FastAPI

import vppres
from vppres.service.access import LOOPBACK, Access
from vppres.service.answers import answer_errors
from vppres.service.http.perimeter import Perimeter
from vppres.service.limits import Rate, RateLimits
from vppres.service.operation.metrics import Figures
from vppres.service.operation.runner import Runner
from vppres.service.overview import Overview
from vppres.service.replay.explainer import Explainer
from vppres.service.routes import (
    alarms,
    events,
    forecasts,
    health,
    operation,
    page,
    plans,
    setpoints,
    switching,
    telemetry,
)
from vppres.service.routes.guard import Guard

SUBJECTS = (
    *(health, telemetry, forecasts, events, plans),
    *(setpoints, alarms, operation, switching, page),
)


def make_app(
    runner: Runner,
    access: Access,
    hosts: Sequence[str] = LOOPBACK,
    encrypted: bool = False,
    rates: Mapping[str, Rate] | None = None,
) -> FastAPI:
    """The service's routes around a runner.

    It answers under the names ``hosts`` alone: a page of a stranger that calls it by its own name
    gets nothing. ``rates`` say by scope how often may be asked; a rehearsal has no limit.
    """
    app = FastAPI(
        title="vppres",
        version=str(vppres.__version__),
        description="A controller of a virtual power plant that runs day and night.",
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    answer_errors(app)
    # Not by `include_router`, which prepares every route once more at the first request.
    for subject in SUBJECTS:
        app.router.routes += subject.router.routes
    # Who rehearses asks for one step after another.
    guarded = Guard(access, RateLimits({} if runner.rehearsal else rates))
    app.add_middleware(Perimeter, guard=guarded, hosts=hosts, encrypted=encrypted)
    app.state.runner, app.state.guard = runner, guarded
    app.state.figures, app.state.overview = Figures(runner), Overview(runner)
    app.state.explainer = Explainer(runner)
    runner.on_plan = app.state.explainer.begin
    return app
