"""Output of a run for each kind of flexible power: its table, figures and words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from vppres.day.trajectory import Trajectory
from vppres.kinds.table import KINDS, parts, units_of
from vppres.plant.plant import Plant, Realised


def records_of(plant: Plant, t: int, realised: Realised) -> dict[str, dict[str, Any]]:
    """Record of the units of each kind in a step."""
    records = parts("record")
    return {
        kind: records[kind].record(plant.scenario, units, t, realised)
        for kind, units in plant.units.items()
    }


def kind_figures(trajectory: Trajectory) -> dict[str, Any]:
    """Figures of each kind that the site has, by the name of its table."""
    records = parts("record")
    return {
        KINDS[kind].table: records[kind].figures(trajectory)
        for kind in units_of(trajectory.scenario)
    }


def kind_events(trajectory: Trajectory) -> Iterator[tuple[int, str]]:
    """Step and words of what units did that is an event."""
    records = parts("record")
    for kind in units_of(trajectory.scenario):
        yield from records[kind].events(trajectory)


def kind_words(trajectory: Trajectory) -> list[str]:
    """Cautions about kinds, in sentences."""
    records = parts("record")
    kinds = units_of(trajectory.scenario)
    return [words for kind in kinds for words in records[kind].cautions(trajectory)]
