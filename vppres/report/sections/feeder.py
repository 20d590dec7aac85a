"""The feeder as a one-line diagram, one step at a time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from vppres.day.trajectory import Trajectory
from vppres.kinds.table import KINDS
from vppres.report.one_line import (
    LOADING_EDGES,
    drawing,
    step_states,
    voltage_colours,
    voltage_edges,
)
from vppres.report.sections.base import Run, Section, section

SIGNS = {name: kind.sign for name, kind in KINDS.items()}
"""Signs of devices beside those that every feeder has, in words."""

EN_DASH = "\N{EN DASH}"


def feeder_section(run: Run) -> Section:
    """The diagram in the worst outage step, with a choice of the others."""
    day = run.trajectory.scenario
    drawn, states = drawing(run.trajectory), step_states(run.trajectory)
    edges = voltage_edges(run.trajectory)
    voltages = [f"{low:.4g}{EN_DASH}{high:.4g}" for low, high in pairwise(edges)]
    customers = [
        f"{name} ({tier})" for name, tier in zip(day.customers.id, day.customers.tier, strict=True)
    ]
    ends = [f"{a} to {b}" for a, b in zip(day.network.from_bus, day.network.to_bus, strict=True)]
    return section(
        "feeder",
        "The feeder",
        {
            "drawing": drawn,
            "start": states["start"],
            "states": states,
            "colours": voltage_colours(len(voltages)),
            "voltages": voltages,
            "loadings": _loading_words(run.trajectory),
            "rated": day.network.has_ratings,
            "limits": (day.network.v_min_ac_pu, day.network.v_max_ac_pu),
            "tiers": day.tiers,
            "kinds": {kind: words for kind, words in SIGNS.items() if len(getattr(day, kind))},
            "has_outage": bool(run.trajectory.steps["outage"].any()),
            "data": states
            | {
                "customers": customers,
                "lines": ends,
                "ratings": [
                    round(rating, 1) if np.isfinite(rating) else None
                    for rating in run.trajectory.scenario.network.i_max_a.tolist()
                ],
                "batteries": day.batteries.id.tolist(),
                "buses": [{"name": bus.name, "connected": bus.connected} for bus in drawn.buses],
                "devices": {
                    kind: [f"{words} {name}" for name in getattr(day, kind).id]
                    for kind, words in {"pv": "PV", **SIGNS}.items()
                },
            },
        },
    )


def _loading_words(run: Trajectory) -> list[str]:
    """Range of each loading class."""
    edges = [0.0, *LOADING_EDGES]
    words = [f"{low:.0%}{EN_DASH}{high:.0%}" for low, high in pairwise(edges)]
    return [*words, f"above {edges[-1]:.0%}"] if run.scenario.network.has_ratings else words
