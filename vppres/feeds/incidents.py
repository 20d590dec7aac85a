"""A network operator's incident, whichever feed it is in."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import pandas as pd

from vppres.core.errors import InputError
from vppres.service.clock import written

ZONE = "Europe/London"
"""Of times without an offset: the clocks of Great Britain."""

_AREA = re.compile(r"[A-Z]{1,2}\d[A-Z\d]?( \d([A-Z]{2})?)?")
_INWARD = re.compile(r"\d[A-Z]{2}")


@dataclass(frozen=True)
class Incident:
    """An outage in a feed."""

    name: str  #: reference of the operator
    postcodes: tuple[str, ...]  #: postcodes, or sectors and districts, that are affected
    planned: bool = False  #: whether it is planned work with a known beginning
    start: pd.Timestamp | None = None  #: beginning
    end: pd.Timestamp | None = None  #: planned end, or estimated restoration
    restored: bool = False  #: whether it is over

    def touches(self, areas: Iterable[str]) -> bool:
        """Whether it is in one of some areas: postcodes, sectors or districts."""
        others = [area(other).partition(" ") for other in areas]
        return any(
            _overlap(area(one).partition(" "), other) for one in self.postcodes for other in others
        )

    def event(self, source: str, now: pd.Timestamp) -> dict[str, Any] | None:
        """The event of the service that says the same; None if it says nothing of what comes.

        Planned work is an outage with its beginning and end. An estimate of restoration is what a
        crew says of the present outage: where there is grid, it says nothing.
        """
        if self.restored or self.end is None or self.end <= now:
            return None
        if self.planned and self.start is not None:
            if self.end <= self.start:
                return None
            times = {"start": written(self.start), "end": written(self.end)}
            return {"type": "outage", "source": source, **times}
        return {"type": "restoration", "source": source, "likely": written(self.end)}


@dataclass(frozen=True)
class FeedSnapshot:
    """Incidents of a feed at one time."""

    incidents: tuple[Incident, ...]  #: all that it holds
    made_at: pd.Timestamp | None = None  #: when the operator made it, where the feed says so
    left_out: int = 0  #: rows that could not be read


def area(text: str) -> str:
    """A postcode, sector or district as it is compared: outward code, space, the rest.

    >>> area("cm4 0"), area("CM40AB"), area("cm4")
    ('CM4 0', 'CM4 0AB', 'CM4')
    """
    parts = text.upper().split()
    if len(parts) == 1 and len(parts[0]) >= 5 and _INWARD.fullmatch(parts[0][-3:]):
        parts = [parts[0][:-3], parts[0][-3:]]
    return " ".join(parts)


def check_areas(texts: Iterable[str]) -> list[str]:
    """Areas of a user.

    Raises
    ------
    InputError
        If there are none, or one is no postcode, sector or district.
    """
    found = [area(text) for text in texts]
    wrong = [one for one in found if not _AREA.fullmatch(one)]
    if wrong or not found:
        raise InputError.of(
            "options",
            "is no postcode, sector or district" if wrong else "is missing",
            'Give those of the site, for example "CM4 0".',
            field="postcode",
            value=wrong[0] if wrong else None,
        )
    return found


def _overlap(one: tuple[str, str, str], other: tuple[str, str, str]) -> bool:
    """Whether one area holds the other, each as outward code, space and the rest."""
    (here, _, rest), (there, _, other_rest) = one, other
    return here == there and (rest.startswith(other_rest) or other_rest.startswith(rest))


def time_in(value: Any) -> pd.Timestamp | None:
    """A time of a feed in UTC, from ISO 8601; None where there is none.

    Raises
    ------
    ValueError
        If it is no such time.

    Examples
    --------
    >>> time_in("2026-07-01T12:00:00").isoformat(), time_in("")
    ('2026-07-01T11:00:00+00:00', None)
    """
    if value is None or value == "":
        return None
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is no time")
    found = pd.Timestamp(datetime.fromisoformat(value))
    if found.tzinfo is None:
        found = found.tz_localize(ZONE, ambiguous=True, nonexistent="shift_forward")
    return found.tz_convert("UTC").floor("s")
