"""Expected state after the set-points of the last step, from which the next one goes on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, get_type_hints

import numpy as np
import pandas as pd

from vppres.contract.operating_point import OperatingPoint
from vppres.core.arrays import Complexes, Flags, Floats
from vppres.core.plain import Given, from_plain, to_plain
from vppres.day.forecasting import PAPER, history_before
from vppres.day.options import RunOptions
from vppres.day.outages import GridSeen
from vppres.day.simulate import Day
from vppres.kinds.customer.physics import Owed, SwitchingState
from vppres.kinds.table import parts
from vppres.scenario.history import History
from vppres.scenario.scenario import Scenario

REMEMBERED_DAYS = 100
"""Days of measurements that a controller keeps, more than any forecaster looks at."""


@dataclass(frozen=True, eq=False)
class Past:
    """The site after a step.

    ``t`` counts from the controller's first step, -1 before it. ``voltages`` are solutions by the
    position of the source's bus, from which the next power flow starts. None is what no step has
    led to yet, and measurements that no forecaster learns from.
    ``closed`` are lines and ties that were closed, (E,): ``operating_point`` and ``voltages`` are
    of that configuration. ``kinds`` has the units of each kind, ``PAST`` of its live part.
    """

    t: int
    operating_point: OperatingPoint | None
    switching: SwitchingState
    owed: Owed
    served: Flags | None
    history: History | None
    voltages: dict[int, Complexes]
    closed: Flags
    grid_seen: GridSeen = field(default_factory=GridSeen)
    kinds: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def before_the_day(cls, scenario: Scenario, options: RunOptions) -> Past:
        """Before the first step: all customers have been supplied for long."""
        day = Day(scenario, options)
        history = None if options.forecaster == PAPER else history_before(scenario)
        closed = day.branches.closed
        plant = day.plant
        return cls(-1, None, plant.switching, plant.owed, None, history, {}, closed)

    def with_measured(self, start: pd.Timestamp, load_kw: Floats, pv_kw: Floats) -> History | None:
        """The history with a step, (C,) and (P,); None where no forecaster learns from it."""
        step = load_kw[np.newaxis], pv_kw[np.newaxis]
        return self.history and self.history.followed_by(start, *step).last_days(REMEMBERED_DAYS)

    def within_step(self, latest: Past) -> Past:
        """State for a step that is decided anew within it: what was ordered in it has happened.

        ``latest`` is the site after the step as it was decided first.
        """
        return replace(self, kinds=latest.kinds)

    def known_at(self, t: int) -> dict[str, Any]:
        """Fields of the observation of a step, set-points held over the steps in between.

        In these nothing was caught up.
        """
        switching, owed = self.switching, self.owed
        for _ in range(self.t + 1, t):
            owed = owed.after(np.zeros(len(owed.steps)), np.ones(len(owed.steps)))
            if self.served is not None:
                switching = switching.advance(self.served)
        return {
            "switching": switching,
            "owed": owed,
            "operating_point": self.operating_point,
            "served": self.served,
        }

    def as_plain(self, given: Given) -> dict[str, Any]:
        """State as JSON can hold it, but for the history, which a state holds once."""
        plain = {name: to_plain(getattr(self, name), given) for name in _types()}
        kinds = {kind: to_plain(one, given) for kind, one in self.kinds.items()}
        return plain | {"kinds": kinds}

    def read(self, plain: Any, history: History | None, given: Given, where: str) -> Past:
        """Another past of the same site, from what JSON holds of it and its history.

        Raises
        ------
        InputError
            If it is none.
        """
        found = from_plain(dict, plain, where)
        values = {
            name: from_plain(of_type, found.get(name), f"{where}.{name}", given)
            for name, of_type in _types().items()
        }
        live = parts("live")
        kinds = {
            kind: from_plain(live[kind].PAST, one, f"{where}.{kind}", given)
            for kind, one in from_plain(dict, found.get("kinds"), f"{where}.kinds").items()
        }
        return Past(history=history, kinds=kinds, **values)


@cache
def _types() -> dict[str, Any]:
    """Types of what is written as it is, by field."""
    types = get_type_hints(Past)
    return {name: each for name, each in types.items() if name not in ("kinds", "history")}
