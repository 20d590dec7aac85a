"""What a run tells of each kind of flexible power: its table, figures and words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from vppres.day.gensets import genset_figures, genset_record, genset_words
from vppres.day.thermal_loads import climate_record, thermal_figures, thermal_words
from vppres.day.trajectory import Trajectory
from vppres.day.vehicles import vehicle_figures, vehicle_record, vehicle_words
from vppres.plant.plant import Plant, Realised


@dataclass(frozen=True)
class _Told:
    """What a run says of a kind: a step of its units, figures of a run, sentences about it."""

    record: Callable[[Plant, int, Realised], dict[str, Any]]
    figures: Callable[[Trajectory], dict[str, Any]]
    words: Callable[[Trajectory], list[str]]


_TOLD = {
    "chargers": _Told(vehicle_record, vehicle_figures, vehicle_words),
    "thermal_loads": _Told(climate_record, thermal_figures, thermal_words),
    "gensets": _Told(genset_record, genset_figures, genset_words),
}


def records_of(plant: Plant, t: int, realised: Realised) -> dict[str, dict[str, Any]]:
    """What the units of each kind did in a step, and how they are then."""
    return {kind: _TOLD[kind].record(plant, t, realised) for kind in realised.taken_kw}


def kind_figures(trajectory: Trajectory) -> dict[str, Any]:
    """Figures of all kinds that the site has."""
    figures: dict[str, Any] = {}
    for told in _TOLD.values():
        figures |= told.figures(trajectory)
    return figures


def kind_words(trajectory: Trajectory) -> list[str]:
    """What has to be known of kinds, in sentences."""
    return [words for told in _TOLD.values() for words in told.words(trajectory)]
