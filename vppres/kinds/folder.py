"""Interface of the modules in the folder of a kind, beside ``rows`` and ``service``.

:class:`vppres.model.beyond_paper.addition.Addition` is that of ``ROWS``, and
:class:`vppres.service.of_kind.OfKind` that of ``SERVICE``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import pandas as pd

from vppres.core.arrays import Floats
from vppres.kinds.kind import Followers, Kind, Moment, UnitPlan, UnitsAhead, UnitsNow, Why


class DataPart(Protocol):
    """The folder itself: tables of the scenario, and names."""

    KIND: Kind  #: its names

    def contents(self, content: Mapping[str, Any]) -> str:
        """How many there are in words, from the counts of a scenario."""


class PhysicsPart(Protocol):
    """``physics``: arithmetic of windows and of the plant."""

    #: Its ``of(scenario, steps, state, past_days)`` is the window that begins with a state.
    WINDOW: type[UnitsAhead]
    PLANT: Callable[[Any], Followers]  #: it is made of a scenario

    def check_prices(self, scenario: Any, horizon_h: float, seed: int) -> None:
        """Refuse prices of energy beside which what is missed counts nothing."""


class WordsPart(Protocol):
    """``words``: a run's table, figures, sentences and reasons."""

    ACTIONS: Mapping[str, str]  #: words of each action that reasons are given for

    def record(self, day: Any, units: Any, t: int, realised: Any) -> Mapping[str, Any]:
        """Columns of a step, (n,) each, before the units of the plant go on."""

    def state_of(self, rows: pd.DataFrame) -> Any:
        """State of the plant's units at the beginning of a step, from its rows."""

    def figures(self, trajectory: Any) -> dict[str, Any]:
        """Figures of the summary."""

    def cautions(self, trajectory: Any) -> list[str]:
        """Sentences on what was missed; none if nothing was."""

    def events(self, run: Any) -> Iterator[tuple[int, str]]:
        """Step, from 0, at whose beginning something happened, and what; T is the end of all."""

    def assumption(self, run: Any) -> str:
        """Assumptions of plans, in a sentence."""

    def energies(self, figures: Mapping[str, Any]) -> list[tuple[str, float]]:
        """Energies of the first page in kWh, by what they are."""

    def reasons(self, step: Any) -> Iterator[tuple[str, str, Why]]:
        """Name of a unit, its action, and the reason."""


class LivePart(Protocol):
    """``live``: readings, estimates and set-points."""

    #: Plausible numbers of each field that a measurement has for the kind.
    RANGES: Mapping[str, Any]
    QUANTITIES: tuple[str, ...]  #: those of them that devices send to a service
    MEANS: tuple[str, ...]  #: those that are means since the last decision
    HELD: tuple[str, ...]  #: those that set-points change: followed from a reading's time on
    SETPOINT: str  #: number of a set-point that an operator gives
    NUMBERS: tuple[str, ...]  #: columns of set-points without which a unit cannot follow
    FORESEEN: tuple[str, ...]  #: tables of what a plan foresees
    #: Readings, and columns of the units' table, that the page of the service shows.
    SHOWN: tuple[str, ...]
    FIGURES: tuple[str, ...]
    #: The units from a decision on with their set-points, written into a controller's state.
    PAST: type[Any]

    def read(
        self,
        door: Any,
        scenario: Any,
        told: Mapping[str, Any],
        ages_h: Mapping[str, Any],
        past: Any,
    ) -> tuple[Any, Any]:
        """The scenario with what a measurement says of it, and readings for ``now``."""

    def now(self, moment: Moment, read: Any, past: Any) -> UnitsNow:
        """The units in the step that is decided."""

    def set_points(self, day: Any, t: int, columns: Mapping[str, Any]) -> dict[str, Any]:
        """Columns of the set-points of a step, (n,) each, from its record."""

    def foreseen(
        self, window: Any, ahead: UnitsAhead, plan: UnitPlan, times: pd.DatetimeIndex
    ) -> dict[str, pd.DataFrame]:
        """Tables of the plan for the steps after the first one."""

    def own_ranges(self, scenario: Any) -> Iterator[tuple[str, Any, Floats, Callable[..., Any]]]:
        """A reading, the units, a number of each, and the range that this number makes."""

    def excesses(self, table: pd.DataFrame, scenario: Any) -> dict[str, Any]:
        """Excess of set-points beyond limits, (n,), by what is said of it; they are not sent."""

    def defaults(self, scenario: Any) -> dict[str, dict[str, Any]]:
        """Set-points without a plan, by unit."""

    def by_rule(self, now: Any) -> dict[str, Any]:
        """Set-points of all units in a step whose plan failed."""

    def expected(self, rows: pd.DataFrame) -> dict[str, Any]:
        """State of units before and after a step, as a stored plan says it."""


PARTS: Mapping[str, type[Any]] = {
    "": DataPart,
    "physics": PhysicsPart,
    "words": WordsPart,
    "live": LivePart,
}
"""Interface of each module of a folder, by its name."""
