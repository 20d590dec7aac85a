"""Axes: where values, times and other quantities lie, and where their ticks are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.day.series import edges_of, outage_spans
from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock

MOST_TIMES, MOST_VALUES = 13, 6
"""Ticks that fit on an axis of a report's width, and of a panel's height."""

HOURS_OF_PLAIN_CLOCK = 48
"""A run that is longer has dates below its times."""

TIME_STEPS_MIN = (1, 2, 5, 10, 15, 30, 60, 120, 180, 240, 360, 720)
DAY_MIN = 1440

SMALLEST_DECIMAL = 1e-4
"""Smaller values are written with a power of ten."""


@dataclass(frozen=True)
class TimeAxis:
    """Times of a run across a drawing, from ``left`` to ``right`` in px."""

    run: Trajectory
    left: float
    right: float

    @property
    def edges(self) -> Floats:
        """Beginning of every step and the end of the last, in px, shape (T + 1,)."""
        return np.linspace(self.left, self.right, len(self.run.steps) + 1)

    @property
    def outages(self) -> list[tuple[float, float]]:
        """Beginning and end of every outage, in px."""
        edges = self.edges
        return [(edges[first], edges[last]) for first, last in outage_spans(self.run)]

    def ticks(self) -> list[tuple[float, str]]:
        """Places in px of round times on the site's clocks, and their names."""
        times = edges_of(self.run)
        grid = self.run.scenario.grid
        start, end = (grid.local(pd.Timestamp(time)) for time in (times[0], times[-1]))
        minutes = (end - start).total_seconds() / 60.0
        step = pd.Timedelta(minutes=time_step_min(minutes))
        midnight = start.normalize()
        first = midnight + step * math.ceil((start - midnight) / step)
        across = (self.right - self.left) / (end - start).total_seconds()
        ticks = pd.date_range(first, end, freq=step)
        text = "%d %b\n%H:%M" if minutes / 60.0 > HOURS_OF_PLAIN_CLOCK else "%H:%M"
        return [(self.left + across * (t - start).total_seconds(), f"{t:{text}}") for t in ticks]

    @property
    def title(self) -> str:
        """Which times these are."""
        grid = self.run.scenario.grid
        return f"{Clock(grid).heading}, from {grid.local(grid.start):%d %B %Y}"


@dataclass(frozen=True, eq=False)
class Scale:
    """Horizontal scale of a chart that is not over the time of a run."""

    title: str  #: what it is
    places: Floats  #: where points lie, (n,); of values that hold over a step the ends of the steps
    #: Words for the places, or for the steps between them; round values without.
    names: Sequence[str] = ()
    room: float = 0.0  #: what is left free at both ends, as a share of all


@dataclass(frozen=True)
class ScaleAxis:
    """A scale across a drawing, from ``left`` to ``right`` in px."""

    scale: Scale
    left: float
    right: float

    outages = ()
    """It has none."""

    @property
    def _values(self) -> ValueAxis:
        low, high = float(self.scale.places.min()), float(self.scale.places.max())
        free = self.scale.room * ((high - low) or 1.0)
        return ValueAxis(low - free, high + free, self.left, self.right)

    @property
    def edges(self) -> Floats:
        """The places in px, shape (n,)."""
        return self._values(self.scale.places)

    def ticks(self) -> list[tuple[float, str]]:
        """Places in px, and their names; of many names only some."""
        names, at = self.scale.names, self.edges
        if not names:
            return self._values.ticks()
        at = at if len(at) == len(names) else (at[:-1] + at[1:]) / 2.0
        every = -(-len(names) // MOST_TIMES)
        return [*zip(at.tolist(), names, strict=True)][::every]

    @property
    def title(self) -> str:
        """Title of the axis."""
        return self.scale.title


def time_step_min(minutes: float) -> int:
    """Minutes from one tick to the next, for a run of so many.

    >>> time_step_min(24 * 60), time_step_min(90), time_step_min(7 * 1440)
    (120, 10, 1440)
    """
    fits = (step for step in TIME_STEPS_MIN if minutes / step < MOST_TIMES)
    days = math.ceil(minutes / DAY_MIN / MOST_TIMES)
    return next(fits, DAY_MIN * days)


@dataclass(frozen=True)
class ValueAxis:
    """Values from ``low`` to ``high`` up a panel, between two places in px.

    On a logarithmic one equal ratios are equally far apart, and values below ``low`` lie at the
    bottom.
    """

    low: float
    high: float
    bottom: float
    top: float
    logarithmic: bool = False

    def __call__(self, values: Floats) -> Floats:
        """Places of values in px."""
        low, high = self._scaled(np.array([self.low, self.high]))
        share = (self._scaled(np.asarray(values, dtype=float)) - low) / (high - low)
        return np.asarray(self.bottom + share * (self.top - self.bottom))

    def _scaled(self, values: Floats) -> Floats:
        if not self.logarithmic:
            return values
        # A value that is not a number stays none.
        return np.asarray(np.log10(np.where(values < self.low, self.low, values)))

    def ticks(self) -> list[tuple[float, str]]:
        """Places in px of round values, and their names."""
        values = (
            _decades(self.low, self.high) if self.logarithmic else round_values(self.low, self.high)
        )
        names = value_names(values)
        return [*zip(map(float, self(np.array(values))), names, strict=True)]


def round_values(low: float, high: float) -> list[float]:
    """Round values from low to high, at most six.

    >>> round_values(0.0, 23.0), round_values(0.948, 1.002)
    ([0.0, 5.0, 10.0, 15.0, 20.0], [0.95, 0.96, 0.97, 0.98, 0.99, 1.0])
    """
    unit = 10.0 ** math.floor(math.log10((high - low) / MOST_VALUES))
    step = next(
        k * unit
        for k in (1, 2, 2.5, 5, 10, 20)
        if math.floor(high / (k * unit)) - math.ceil(low / (k * unit)) < MOST_VALUES
    )
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [float(f"{step * k:.12g}") for k in range(first, last + 1)]


def _decades(low: float, high: float) -> list[float]:
    """Powers of ten, at most six, or one, two and five times them."""
    first = math.ceil(math.log10(low) - 1e-9)
    last = math.floor(math.log10(high) + 1e-9)
    if last > first:
        every = -(-(last - first + 1) // MOST_VALUES)
        return [10.0**k for k in range(first, last + 1, every)]
    near = [k * 10.0 ** (first - 1) for k in (1, 2, 5, 10, 20, 50)]
    return [value for value in near if low <= value <= high]


def value_names(values: list[float]) -> list[str]:
    """Round values as texts, all with as many decimals.

    >>> value_names([0.98, 1.0]), value_names([-500.0, 12500.0]), value_names([1e-9, 1e-6])
    (['0.98', '1.00'], ['\u2212500', '12,500'], ['1e\u22129', '1e\u22126'])
    """
    if any(0.0 < abs(value) < SMALLEST_DECIMAL for value in values):
        texts = [f"{value:.0e}".replace("e-0", "e-") for value in values]
    else:
        decimals = max((len(f"{value:.6g}".partition(".")[2]) for value in values), default=0)
        texts = [f"{value:,.{decimals}f}" for value in values]
    return [text.replace("-", "\N{MINUS SIGN}") for text in texts]


def range_of(
    values: list[Floats], low: float | None, high: float | None, logarithmic: bool
) -> tuple[float, float]:
    """Range of an axis for values: what is given, else a little more than they take."""
    known = np.concatenate([np.ravel(v) for v in values] or [np.zeros(1)])
    known = known[np.isfinite(known)]
    if logarithmic:
        known = known[known > (low or 0.0)]
    least = float(known.min()) if len(known) else (low or 0.0)
    most = float(known.max()) if len(known) else (low or 0.0) + 1.0
    if logarithmic:
        return (low or least / 1.3), (high or max(most * 1.3, 10.0 * (low or 0.0)))
    bottom = least if low is None else low
    room = 0.06 * ((most - bottom) or abs(most) or 1.0)
    return bottom - (room if low is None else 0.0), (most + room if high is None else high)
