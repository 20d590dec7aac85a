"""Output of a run for each kind of flexible power: its table, figures and words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from vppres.day.trajectory import Trajectory
from vppres.kinds.table import KINDS, parts, units_of
from vppres.plant.plant import Plant, Realised


def records_of(plant: Plant, t: int, realised: Realised) -> dict[str, dict[str, Any]]:
    """Record of the units of each kind in a step."""
    words = parts("words")
    return {
        kind: words[kind].record(plant.scenario, units, t, realised)
        for kind, units in plant.units.items()
    }


def kind_figures(trajectory: Trajectory) -> dict[str, Any]:
    """Figures of each kind that the site has, by the name of its table."""
    words = parts("words")
    return {
        KINDS[kind].table: words[kind].figures(trajectory) for kind in units_of(trajectory.scenario)
    }


def kind_events(trajectory: Trajectory) -> Iterator[tuple[int, str]]:
    """Step and words of what units did that is an event."""
    words = parts("words")
    for kind in units_of(trajectory.scenario):
        yield from words[kind].events(trajectory)


def kind_words(trajectory: Trajectory) -> list[str]:
    """Cautions about kinds, in sentences."""
    words = parts("words")
    kinds = units_of(trajectory.scenario)
    return [one for kind in kinds for one in words[kind].cautions(trajectory)]
