"""Reads what a caller gave, value by value, and collects every mistake.

Nothing of a measurement is trusted: numbers may be strings, tables may have two columns of one
name, times may be anything. Whatever does not fit is a problem that names quantity, identifier,
value and cure; what fits comes out as arrays.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names, Wholes
from vppres.core.errors import InputError, Problem
from vppres.io.messages import did_you_mean, shown
from vppres.kinds.table import parts
from vppres.live.ranges import RANGES, Ranges
from vppres.scenario.timegrid import TimeGrid

WHERE = "measurement"

MOST_OF_A_KIND = 20
"""Problems of one quantity that are listed; the others are counted."""

HOUR = pd.Timedelta(hours=1)

MEANS = (
    "battery_kw",
    "import_kw",
    *(name for live in parts("live").values() for name in live.MEANS),
)
"""Powers that are measured over a time, and reckoned where they are missing."""

WRITE_A_TIME = "Write it with an offset, for example 2022-07-19T12:00:00Z."
BY_ASSET = "a mapping or a Series"
TWICE = ("is given more than once", "Give each identifier once.")
LEAVE_OUT = "Give a number; leave out what was not measured, or give NaN."


class Mistakes:
    """Problems of what a caller gave, those of one quantity counted where there are many."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.problems = list[Problem]()
        self._counts: Counter[str] = Counter()

    def problem(
        self, field: str, message: str, cure: str, value: object = None, of: Any = None
    ) -> None:
        """Keep a problem of a quantity, or of one asset's; count it where there are many."""
        self._counts[field] += 1
        if self._counts[field] <= MOST_OF_A_KIND:
            text = None if value is None else readable(value)
            what = _named(field, of)
            self.problems.append(Problem(self.where, message, cure, field=what, value=text))

    def finish(self) -> None:
        """Raise all problems at once.

        Raises
        ------
        InputError
            If there is one.
        """
        more = [
            Problem(
                self.where,
                f"has {count - MOST_OF_A_KIND} more problems",
                "Fix those above first.",
                field=field,
            )
            for field, count in self._counts.items()
            if count > MOST_OF_A_KIND
        ]
        if self.problems:
            raise InputError([*self.problems, *more])


class Door(Mistakes):
    """Reads the parts of one measurement and collects their problems.

    Where the guard ``estimates`` what is missing, readings of now may be. ``ranges`` are those of
    single assets, narrower than those of their quantity.

    Attributes
    ----------
    left_out : list of str
        Readings of now that no device can have, which the guard estimates.
    """

    def __init__(
        self,
        grid: TimeGrid,
        time: Any,
        estimates: bool = False,
        where: str = WHERE,
        ranges: Ranges | None = None,
    ) -> None:
        super().__init__(where)
        self.grid = grid
        self.estimates = estimates
        self.ranges = ranges or {}
        self.left_out = list[str]()
        self._start = pd.Timestamp(grid.start)
        self._length = grid.step
        self._left: Counter[str] = Counter()
        self.t = int(self._steps("time", [time])[0])
        self.begun = self._start + max(self.t, 0) * self._length

    def table(self, field: str, given: Any, ids: Names, series: Floats) -> Floats:
        """A series of shape (T, items) with what was given in its place.

        Readings of now that are missing or negative are NaN where they may be.
        """
        if given is None:
            return series
        result = series.copy()
        if not isinstance(given, pd.DataFrame):
            wanted = "a mapping, a Series or a DataFrame by time"
            result[self.t] = self.values(field, given, ids, series[self.t], wanted)
            return result
        rows = self._steps(field, list(given.index))
        columns = self._positions(field, list(given.columns), ids)
        values = self._values_of(field, given, rows)
        if self.problems:
            return series
        result[np.ix_(rows, columns)] = values
        return result

    def series(self, field: str, given: Any, series: Floats) -> Floats:
        """A series of shape (T,) with what was given in its place."""
        if given is None:
            return series
        if isinstance(given, pd.Series):
            steps = self._steps(field, list(given.index))
            values = [self._number(field, value) for value in given.to_list()]
        else:
            steps = np.array([self.t])
            values = [self._number(field, given)]
        if self.problems:
            return series
        result = series.copy()
        result[steps] = values
        return result

    def values(
        self, field: str, given: Any, ids: Names, default: Floats, wanted: str = BY_ASSET
    ) -> Floats:
        """One number for each item; the default where none was given, NaN where it is missing."""
        result = default.copy()
        for position, name, value in self._items(field, given, ids, wanted):
            number = self._number(field, value, name, now=True)
            if position >= 0:
                result[position] = number
        return result

    def flags(self, field: str, given: Any, ids: Names) -> Flags:
        """True or false for each item, true where nothing was given."""
        result = np.ones(len(ids), dtype=bool)
        for position, name, value in self._items(field, given, ids):
            if not isinstance(value, (bool, np.bool_)):
                self.problem(field, "is neither true nor false", "Give True or False.", value, name)
            elif position >= 0:
                result[position] = value
        return result

    def number(self, field: str, given: Any) -> float | None:
        """A single measured number, None if there is none."""
        if given is None:
            return None
        value = self._number(field, given, now=True)
        return None if np.isnan(value) else value

    def moment(self, field: str, given: Any, of: Any = None) -> pd.Timestamp | None:
        """A time with an offset; None if it is none, or none is given."""
        return None if given is None else self._moment(field, given, of)

    def moments(self, field: str, given: Any, ids: Names) -> list[pd.Timestamp | None]:
        """A time for each item, None where none was given."""
        result: list[pd.Timestamp | None] = [None] * len(ids)
        for position, name, value in self._items(field, given, ids):
            moment = self.moment(field, value, name)
            if position >= 0:
                result[position] = moment
        return result

    def ages_h(self, field: str, given: Any, ids: Names, now: pd.Timestamp) -> Floats:
        """How long ago each item was read, in h; now where no time is given."""
        moments = self.moments(field, given, ids)
        # Clocks may be ahead.
        ages_h = [0.0 if one is None else max((now - one) / HOUR, 0.0) for one in moments]
        return np.array(ages_h, dtype=float)

    def _items(
        self, field: str, given: Any, ids: Names, wanted: str = BY_ASSET
    ) -> Iterator[tuple[int, Any, Any]]:
        """Position, identifier and value of what was given for items; none of nothing."""
        named = {} if given is None else dict(self._pairs(field, given, wanted))
        positions = self._positions(field, list(named), ids).tolist()
        for (name, value), position in zip(named.items(), positions, strict=True):
            yield position, name, value

    def _pairs(self, field: str, given: Any, wanted: str) -> list[tuple[Any, Any]]:
        """Identifiers and values, each identifier once."""
        if isinstance(given, (Mapping, pd.Series)):
            pairs = list(given.items())
            if isinstance(given, Mapping) or given.index.is_unique:
                return pairs
            for name in given.index[given.index.duplicated()].unique():
                self.problem(field, *TWICE, name)
            return list(dict(pairs).items())
        cure = "Give values by identifier, for example {'a': 1}."
        value = f"{type(given).__name__} {readable(given)}"
        self.problem(field, f"is not {wanted}", cure, value)
        return []

    def _values_of(self, field: str, frame: pd.DataFrame, rows: Wholes) -> Floats:
        """A table's numbers, one by one only where a column has any that is not in its range."""
        limits = RANGES[field]
        now = rows == self.t
        found = np.empty(frame.shape)
        for column, name in enumerate(frame.columns):
            own = self.ranges.get((field, name), limits)
            lowest, highest = (
                np.where(now, getattr(own, end), getattr(limits, end))
                for end in ("lowest", "highest")
            )
            cells = frame.iloc[:, column]
            plain = isinstance(cells.dtype, np.dtype) and cells.dtype.kind in "fiu"
            numbers = cells.to_numpy(dtype=float) if plain else np.full(len(cells), np.nan)
            if not ((numbers >= lowest) & (numbers <= highest)).all():
                pairs = zip(cells.to_list(), now.tolist(), strict=True)
                numbers = np.array([self._number(field, one, name, at) for one, at in pairs])
            found[:, column] = numbers
        return found

    def _number(self, field: str, value: Any, name: Any = None, now: bool = False) -> float:
        """A number in its range; NaN for a reading of now that the guard estimates."""
        limits = RANGES[field]
        if now and isinstance(name, str):
            limits = self.ranges.get((field, name), limits)
        number = float_of(value)
        if number is None:
            shown_as = "None" if value is None else value
            self.problem(field, "is not a number", LEAVE_OUT, shown_as, name)
            return np.nan
        if limits.holds(number):
            return number
        if now and np.isnan(number) and (self.estimates or field in MEANS):
            return np.nan
        if not (now and self.estimates):
            self.problem(field, limits.text(number), limits.cure, value, name)
        elif number >= 0.0 or field not in ("load_kw", "pv_kw"):  # else a wrong sign or offset
            self._left[field] += 1
            if self._left[field] <= MOST_OF_A_KIND:
                words = f"{_named(field, name)} = {number:g} {limits.text(number)}"
                self.left_out.append(words)
        return np.nan

    def _steps(self, field: str, times: Sequence[Any]) -> Wholes:
        """Steps of the scenario that begin at these times, each once; -1 for no such step."""
        steps = np.array([self._step(field, time) for time in times], dtype=np.int64)
        known = steps[steps >= 0]
        for step in (np.bincount(known, minlength=1) > 1).nonzero()[0].tolist():
            time = self.grid.times[step]
            self.problem(field, "is given more than once", "Give each time once.", time)
        return steps

    def _step(self, field: str, time: Any) -> int:
        """The step that begins at a time, -1 if none does."""
        moment = self._moment(field, time)
        if moment is None:
            return -1
        try:
            step, rest = divmod(moment - self._start, self._length)
        except (OverflowError, ValueError):  # centuries away
            step, rest = -1, None
        grid = self.grid
        if rest == pd.Timedelta(0) and 0 <= step < grid.n_steps:
            return int(step)
        cure = (
            f"The scenario's steps begin at {grid.start.isoformat()} and last "
            f"{grid.step_minutes:g} min; there are {grid.n_steps}."
        )
        self.problem(field, "is not the beginning of a step", cure, time)
        return -1

    def _moment(self, field: str, time: Any, of: Any = None) -> pd.Timestamp | None:
        """A time with an offset, None if it is none."""
        moment = moment_of(time)
        if moment is None or moment.tzinfo is None:
            wrong = "is not a date and time" if moment is None else "has no time zone"
            self.problem(field, wrong, WRITE_A_TIME, "None" if time is None else time, of)
            return None
        return moment

    def _positions(self, field: str, names: Iterable[Any], ids: Names) -> Wholes:
        """Positions of identifiers, each once; -1 for those that the scenario does not have."""
        position = {name: i for i, name in enumerate(ids)}
        found = []
        taken = set[int]()
        for name in names:
            at = position.get(name, -1) if isinstance(name, Hashable) else -1
            found.append(at)
            if at in taken:
                self.problem(field, *TWICE, name)
            if at >= 0:
                taken.add(at)
            elif self._counts[field] >= MOST_OF_A_KIND:
                self._counts[field] += 1  # looking for a similar name takes time
            else:
                cure = did_you_mean(readable(name), [*map(str, ids)], "Correct the identifier.")
                self.problem(field, "is not in the scenario", cure, name)
        return np.array(found, dtype=np.int64)


def _named(field: str, of: Any) -> str:
    """A quantity, or that of an asset."""
    return field if of is None else f"{field} of {shown(of)}"


def moment_of(time: Any) -> pd.Timestamp | None:
    """A time as a Timestamp, from one, a datetime, or ISO 8601 text; None if it is none.

    Examples
    --------
    >>> moment_of("2022-07-19T12:00Z")
    Timestamp('2022-07-19 12:00:00+0000', tz='UTC')
    >>> moment_of("noon") is None
    True
    """
    try:
        if isinstance(time, str):
            return pd.Timestamp(datetime.fromisoformat(time))
        if isinstance(time, datetime):
            moment = pd.Timestamp(time)
            return None if pd.isna(moment) else moment
    except (ValueError, OverflowError):
        pass
    return None


def float_of(value: Any) -> float | None:
    """A real number as a float, infinite if it is too large for one; None if it is none."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:
        return -np.inf if value < 0 else np.inf
    except (TypeError, ValueError):
        return None


def readable(value: object) -> str:
    """Any value in a short line without control characters."""
    try:
        text = str(value)
    except Exception:
        return f"a {type(value).__name__} that cannot be shown"
    return shown(text if text.isprintable() else repr(text)) or "''"
