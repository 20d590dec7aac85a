"""The feeder as a one-line diagram, one step at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from vppres.day.trajectory import Trajectory
from vppres.kinds.table import KINDS
from vppres.report.moments import moments_of
from vppres.report.one_line import (
    APART,
    FORMER,
    LOADING_EDGES,
    NO_VOLTAGE,
    WITHOUT_GRID,
    BranchStates,
    Drawing,
    drawing,
    step_states,
    voltage_colours,
    voltage_edges,
)
from vppres.report.sections.base import Run
from vppres.scenario.configuration import Branches
from vppres.scenario.scenario import Scenario

SIGNS = {name: kind.sign for name, kind in KINDS.items()}
"""Signs of devices beside those that every feeder has, in words."""

PARTS = {
    WITHOUT_GRID: "without the grid",
    APART: "another part without the grid",
    NO_VOLTAGE: "without voltage",
    FORMER: "forms the grid of its part",
}
"""Parts of the feeder, in words."""

LOOK = ("bus", "tile", "line", "part", "soc")
"""What the drawing shows of a step."""

EN_DASH = "\N{EN DASH}"


def feeder_of(run: Run) -> dict[str, Any]:
    """The diagram in the worst outage step, with a choice of the others."""
    day = run.trajectory.scenario
    drawn, states = drawing(run.trajectory), step_states(run.trajectory)
    edges = voltage_edges(run.trajectory)
    voltages = [f"{low:.4g}{EN_DASH}{high:.4g}" for low, high in pairwise(edges)]
    branches = Branches.of(day)
    moments = moments_of(run.trajectory, states)
    befores = [moment.before.part for moment in moments.shown]
    shown = [*states["part"], *befores]
    return {
        "drawing": drawn,
        "start": states["start"],
        "moments": moments,
        "names": branches.names,
        "opens": BranchStates.of(run.trajectory).opens,
        "states": states,
        "look": {name: states[name][states["start"]] for name in LOOK},
        "label_px": max(14, drawn.width // 50),
        "parts": {i: words for i, words in PARTS.items() if str(i) in "".join(shown)},
        "named_places": lambda look: _named_places(drawn, branches.names, {*look.moved, *look.out}),
        "colours": voltage_colours(len(voltages)),
        "voltages": voltages,
        "loadings": _loading_words(run.trajectory),
        "rated": day.network.has_ratings,
        "limits": (day.network.v_min_ac_pu, day.network.v_max_ac_pu),
        "tiers": day.tiers,
        "kinds": {kind: words for kind, words in SIGNS.items() if len(getattr(day, kind))},
        "has_outage": bool(run.trajectory.steps["outage"].any()),
        "data": states | _named(day, branches, drawn),
    }


def _named(day: Scenario, branches: Branches, drawn: Drawing) -> dict[str, Any]:
    """Names and ratings in the drawing, for the page's script."""
    customers = zip(day.customers.id, day.customers.tier, strict=True)
    ends = zip(branches.from_bus, branches.to_bus, strict=True)
    ratings = [round(rating, 1) for rating in branches.rating_a.tolist()]
    return {
        "customers": [f"{name} ({tier})" for name, tier in customers],
        "lines": [f"{a} to {b}" for a, b in ends],
        "ratings": [rating if np.isfinite(rating) else None for rating in ratings],
        "batteries": day.batteries.id.tolist(),
        "buses": [{"name": bus.name, "connected": bus.connected} for bus in drawn.buses],
        "devices": {
            kind: [f"{words} {name}" for name in getattr(day, kind).id]
            for kind, words in {"pv": "PV", **SIGNS}.items()
        },
    }


def _named_places(
    drawn: Drawing, names: Sequence[str], which: Iterable[int]
) -> Iterator[tuple[float, float, str]]:
    """Places of the names of branches: the middle of each."""
    ties = {switch.branch: switch.middle for switch in drawn.switches if not switch.closed}
    for branch in sorted(which):
        if branch in ties:
            yield *ties[branch], names[branch]
        else:
            x1, _, x2, y2 = drawn.lines[branch]
            yield (x1 + x2) / 2, y2 - 12, names[branch]


def _loading_words(run: Trajectory) -> list[str]:
    """Range of each loading class."""
    edges = [0.0, *LOADING_EDGES]
    words = [f"{low:.0%}{EN_DASH}{high:.0%}" for low, high in pairwise(edges)]
    return [*words, f"above {edges[-1]:.0%}"] if run.scenario.network.has_ratings else words
