"""Times of others' series, and of a day on a wall clock: zones, days of 23 and of 25 hours."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.scenario.timegrid import TimeGrid, is_zone

_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
_CURE_ZONE = "Give one such as Europe/London, or UTC."


def check_zone(zone: str) -> list[Problem]:
    """A name that is no time zone."""
    if is_zone(zone):
        return []
    return [Problem("options", "is not a time zone", _CURE_ZONE, field="time_zone", value=zone)]


def local_midnight(text: str, zone: str) -> pd.Timestamp:
    """Beginning of a date in a zone; where clocks skip midnight, the first moment after it.

    Examples
    --------
    >>> local_midnight("2025-03-30", "Europe/London").isoformat()
    '2025-03-30T00:00:00+00:00'
    """
    problems = check_zone(zone)
    if not problems and not _DATE.fullmatch(text.strip()):
        problems = [_no_date(text)]
    if problems:
        raise InputError(problems)
    try:
        return _at(pd.Timestamp(text.strip()), zone)
    except ValueError:  # 30 February
        raise InputError(_no_date(text)) from None


def _no_date(text: str) -> Problem:
    return Problem(
        "options", "is not a date", "Write it like 2025-03-30.", field="date", value=text
    )


def _at(clock: pd.Timestamp, zone: str) -> pd.Timestamp:
    return clock.tz_localize(ZoneInfo(zone), ambiguous=True, nonexistent="shift_forward")


def days_later(start: pd.Timestamp, days: int, zone: str) -> pd.Timestamp:
    """Time some days later with the same reading of the clock; a day may have 23 or 25 hours.

    Examples
    --------
    >>> start = local_midnight("2025-10-26", "Europe/London")
    >>> (days_later(start, 1, "Europe/London") - start).total_seconds() / 3600
    25.0
    """
    clock = start.tz_convert(ZoneInfo(zone)).tz_localize(None)
    if start == _at(clock.normalize(), zone):  # also where clocks skip midnight
        clock = clock.normalize()
    return _at(clock + pd.Timedelta(days=days), zone)


def grid_from(start: pd.Timestamp, days: int, step_minutes: float, zone: str) -> TimeGrid:
    """The steps of some days on the clock, if they fill them: hours of 4 fill no day of 23."""
    hours = (days_later(start, days, zone) - start) / pd.Timedelta(hours=1)
    steps = hours * 60.0 / step_minutes
    if not float(steps).is_integer():
        raise InputError.of(
            "options",
            f"does not divide the {hours:g} hours from {start.isoformat()}",
            "Give a step that divides an hour, for example 60, 30 or 15.",
            field="step_minutes",
            value=step_minutes,
        )
    return TimeGrid(start, step_minutes, round(steps), zone)


def time_of_day(start: pd.Timestamp, hours: int, minutes: int) -> pd.Timestamp:
    """A time on the clock of the day on which ``start`` is; 24:00 is the next midnight."""
    clock = start.tz_localize(None).normalize() + timedelta(hours=hours, minutes=minutes)
    # A zone of pytz has the offset of the start alone.
    name = getattr(start.tzinfo, "zone", None)
    zone = start.tzinfo if name is None else ZoneInfo(name)
    naive: datetime = clock.to_pydatetime()
    early = naive.replace(tzinfo=zone, fold=0)
    late = naive.replace(tzinfo=zone, fold=1)
    if early.utcoffset() != late.utcoffset():
        raise InputError.of(
            "options",
            "is a time that the clocks skip or show twice on this day",
            "Write it with its date and offset, for example "
            f"{naive.isoformat()}{early.isoformat()[19:]}.",
            field="outage",
            value=f"{hours:02d}:{minutes:02d}",
        )
    return pd.Timestamp(early)


def in_utc(
    times: pd.Index, zone: str | None, where: str, field: str = "time"
) -> tuple[pd.DatetimeIndex, list[Problem]]:
    """Times of a series in UTC, as a DatetimeIndex; empty where there are problems.

    Dates, or text in ISO 8601, all have an offset or none has. Of times without one, in ``zone``,
    an hour that the clocks show twice must be there twice.
    """
    dated, bad = _dated(times)
    if bad.any():
        return _refused(
            times,
            bad,
            Problem(
                where, "is not an ISO 8601 time", "Write it like 2022-07-19T12:00:00Z.", field=field
            ),
        )
    if dated.tz is not None:
        return dated.tz_convert("UTC"), []
    if zone is None:
        return pd.DatetimeIndex([], tz="UTC"), [
            Problem(
                where,
                "has no time zone",
                "Write the offset behind every time, or give --time-zone, for example "
                "Europe/London.",
                field=field,
                value=str(times[0]),
            )
        ]
    return _localised(dated, zone, where, field)


def _dated(times: pd.Index) -> tuple[pd.DatetimeIndex, np.ndarray]:
    """Times as dates, aware if all have an offset, and which of them are none."""
    if isinstance(times, pd.DatetimeIndex):
        return times, np.asarray(times.isna())
    texts = pd.Series(times).astype(str).str.strip()
    offset = texts.str.contains(r"(?:Z|[+-]\d{2}:?\d{2})$", case=False, regex=True)
    aware = bool(offset.mean() > 0.5) if len(texts) else True
    dates = pd.to_datetime(texts, format="ISO8601", errors="coerce", utc=aware)
    bad = dates.isna() | (offset != aware) | ~texts.str[:4].str.isdigit()
    return pd.DatetimeIndex(dates), bad.to_numpy(dtype=bool)


def _localised(
    clock: pd.DatetimeIndex, zone: str, where: str, field: str
) -> tuple[pd.DatetimeIndex, list[Problem]]:
    """Clock times in UTC; the second of two equal hours is the later one."""
    place = ZoneInfo(zone)
    skipped = np.asarray(clock.tz_localize(place, ambiguous=True, nonexistent="NaT").isna())
    if skipped.any():
        return _refused(
            clock,
            skipped,
            Problem(
                where,
                f"is a time that the clocks of {zone} skip",
                "Write the times with their offset, or give the zone that they are in.",
                field=field,
            ),
        )
    twice = np.asarray(clock.tz_localize(place, ambiguous="NaT").isna())
    once = twice & ~clock.duplicated(keep=False)
    if once.any():
        return _refused(
            clock,
            once,
            Problem(
                where,
                f"is a time that the clocks of {zone} show twice, and it is there once",
                "Write the times with their offset, or give both hours.",
                field=field,
            ),
        )
    summer = ~clock.duplicated()  # the first time through the hour clocks are not yet put back
    return clock.tz_localize(place, ambiguous=summer).tz_convert("UTC"), []


def _refused(
    times: pd.Index, bad: np.ndarray, problem: Problem
) -> tuple[pd.DatetimeIndex, list[Problem]]:
    """No times, and the problem of the first that is bad; others of its kind are counted."""
    first = int(np.flatnonzero(bad)[0])
    told = replace(problem, row=first + 2, value=str(times[first])[:60], more=int(bad.sum()) - 1)
    return pd.DatetimeIndex([], tz="UTC"), [told]
