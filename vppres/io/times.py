"""Times in ISO 8601 with their offset, and what is wrong with others."""

from __future__ import annotations

import re
from datetime import datetime

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags
from vppres.core.errors import InputError

_LONGEST_TIME = 64  # characters; a time has 35, and the search takes their square
_OFFSET = re.compile(r"\d[T ]?.*(Z|[+-]\d{2}:?\d{2})$", re.IGNORECASE)


def parsed_times(texts: pd.Series[str]) -> tuple[pd.Series[pd.Timestamp], Flags, Flags]:
    """Times in UTC, which of the texts are none, and which have an offset."""
    times = pd.to_datetime(texts, utc=True, format="ISO8601", errors="coerce")
    unreadable = (times.isna() | ~texts.str[:4].str.isdigit().astype(bool)).to_numpy(bool)
    has_offset = np.fromiter((bool(_OFFSET.search(text[:_LONGEST_TIME])) for text in texts), bool)
    return times, unreadable, has_offset


def time_fault(text: str, unreadable: bool) -> tuple[str, str]:
    """Message and cure for a text that is not a time with an offset."""
    if unreadable:
        return "is not an ISO 8601 time", "Write it like 2022-07-19T12:00:00Z."
    return "has no time zone", f"Add the offset, for example {text}Z."


def time_of(text: str) -> tuple[pd.Timestamp | None, str, str]:
    """The time that a text says; None where it says none, with what is wrong and the cure.

    >>> time_of("2022-07-19T12:00")[1:]
    ('has no time zone', 'Add the offset, for example 2022-07-19T12:00Z.')
    """
    times, unreadable, has_offset = parsed_times(pd.Series([text], dtype=object))
    if unreadable[0] or not has_offset[0]:
        return None, *time_fault(text, bool(unreadable[0]))
    return times.iloc[0], "", ""


def option_time(text: str, zone: str = "UTC") -> pd.Timestamp:
    """A time of the command line; by the clocks of a zone if it says nothing else.

    Examples
    --------
    >>> option_time("2017-04-01").isoformat()
    '2017-04-01T00:00:00+00:00'
    """
    try:
        time = pd.Timestamp(datetime.fromisoformat(text))
    except ValueError:
        raise InputError.of(
            "options",
            "is not a time",
            "Write it like 2017-04-01 or 2017-04-01T12:00Z.",
            field="from or to",
            value=text,
        ) from None
    return time.tz_localize(zone) if time.tzinfo is None else time


def usual_step(times: pd.DatetimeIndex) -> pd.Timedelta:
    """The most frequent distance of times; a single one is taken as an hour."""
    if len(times) < 2:
        return pd.Timedelta(hours=1)
    return pd.Timedelta(times.to_series().diff().mode().iloc[0])
