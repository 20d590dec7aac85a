"""Windows that are solved, and decisions of one step after another, of any site."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from tests.support.small_windows import window
from vppres import Controller, Measurement, RunOptions, SetPoints
from vppres.contract.ahead import KindsAhead
from vppres.core.arrays import Floats
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.plant.plant import Plant
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution

HERE = RunOptions(isolate=False)
"""Solved in this process."""


def known(day: Scenario, data: WindowData | None = None) -> WindowData:
    """All steps as one window, or those of another one, with what is known of units at first."""
    data = window(day) if data is None else data
    states = Plant(day).states_at(0)
    return replace(data, ahead=KindsAhead.of(day, range(data.n_steps), states, None))


def solved(
    day: Scenario, method: str = "decomposed", data: WindowData | None = None
) -> WindowSolution:
    """The answer of a window, which is optimal and breaks nothing."""
    data = known(day) if data is None else data
    answer = WindowSolver(Site.of(day), method).solve(data)
    assert answer.status == "optimal"
    assert not broken(Site.of(day), data, answer.dispatch)
    return answer


def planned_kw(day: Scenario, method: str = "decomposed") -> Floats:
    """Power of units in the plan of all steps of a site with one kind, (W, n)."""
    (taken,) = solved(day, method).dispatch.taken_kw.values()
    return taken


def restarted(controller: Controller, day: Scenario, options: RunOptions) -> Controller:
    """Another process that goes on where this one is."""
    return Controller.of(day, options, state=json.loads(controller.saved()))


def live(
    day: Scenario, told: Iterable[Mapping[str, Any]], options: RunOptions = HERE
) -> list[SetPoints]:
    """Decisions from the first step on, each with these readings and by a process of its own.

    Batteries do as they are told, and no plan is a fallback.
    """
    controller, found = Controller.of(day, options), []
    soc = dict(zip(day.batteries.id, day.batteries.soc_initial, strict=True))
    for time, each in zip(day.grid.times, told, strict=False):
        step = controller.step(Measurement(time, **{"soc": soc, **each}))
        assert step.solve["fallback"] == "none"
        soc = dict(step.batteries["soc_end"])
        found.append(step)
        controller = restarted(controller, day, options)
    return found


def metered(
    day: Scenario,
    hours: Iterable[tuple[float, float | None]],
    who: str,
    soc: Mapping[str, float],
    horizon_h: float = 0.0,
    import_factor: float = 1.0,
) -> list[SetPoints]:
    """Decisions with grid while a customer's meter tells one power and the import another.

    Each hour has what is told and what is taken, in kW; None is what was believed. The import is
    told as ``import_factor`` times what it is.
    """
    controller, found = Controller.of(day, RunOptions(horizon_h=horizon_h, isolate=False)), []
    came: dict[str, Any] = {}
    for time, (told_kw, taken_kw) in zip(controller.times, hours, strict=False):
        step = controller.step(Measurement(time, dict(soc), load_kw={who: told_kw}, **came))
        found.append(step)
        over_kw = 0.0 if taken_kw is None else taken_kw - float(step.customers["load_kw"][who])
        import_kw = import_factor * (step.import_kw + over_kw)
        came = {"battery_kw": dict(step.batteries["p_kw"]), "import_kw": import_kw}
    return found
