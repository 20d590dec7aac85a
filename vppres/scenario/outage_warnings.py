"""Knowledge of outages whose times are uncertain: warnings, and statistics for all others.

Checked values; what follows from them is computed in :mod:`vppres.outlook`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from vppres.core.arrays import Floats
from vppres.core.errors import InputError, Problem

STATISTICS_PRESETS = ("average", "with-major-events", "equipment", "none")
WARNING_PRESETS = ("", "announced", "rota", "psps", "wind", "heat")
"""Names of the figures of :mod:`vppres.outlook.presets`."""


@dataclass(frozen=True)
class OnsetShares:
    """Onset of an outage if it comes: the probability of each of some equal intervals.

    Examples
    --------
    >>> noon = pd.Timestamp("2022-07-19T12:00Z")
    >>> OnsetShares(noon, 2.0, (0.5, 0.5)).begun([0.0, 1.0, 3.0])
    array([0.  , 0.25, 0.75])
    """

    start: pd.Timestamp  #: beginning of the first interval, with time zone
    interval_h: float  #: length of each in h; within one, no moment is likelier than another
    probability: tuple[float, ...]  #: of each; together 1

    @property
    def end(self) -> pd.Timestamp:
        """End of the last interval."""
        return self.start + pd.Timedelta(hours=self.interval_h * len(self.probability))

    @property
    def likely(self) -> pd.Timestamp:
        """Beginning of the likeliest interval."""
        return self.start + pd.Timedelta(hours=self.interval_h * int(np.argmax(self.probability)))

    def begun(self, hours: ArrayLike) -> Floats:
        """Probability that it has begun some hours after the start."""
        edges = self.interval_h * np.arange(len(self.probability) + 1)
        begun = np.concatenate([[0.0], np.cumsum(self.probability)])
        found: Floats = np.interp(np.asarray(hours, dtype=float), edges, begun).astype(float)
        return found


@dataclass(frozen=True)
class OutageLength:
    """How long an outage lasts, as a distribution."""

    family: str  #: what kind of distribution
    #: Median in h and standard deviation of the logarithm; or scale and shape.
    scale_h: float = 1.0
    shape: float = 1.0
    #: Each length that there is, and how likely it is.
    hours: tuple[float, ...] = ()
    probability: tuple[float, ...] = ()
    max_h: float = np.inf  #: what is longer counts as this


TIMES = (
    "issued_at",
    "onset_earliest",
    "onset_likely",
    "onset_latest",
    "restored_not_before",
    "restored_likely",
    "restored_by",
)
"""Fields of a warning that are times."""


@dataclass(frozen=True)
class OutageWarning:
    """One message about an outage: that it may come, how long it lasts, or the all-clear.

    Examples
    --------
    >>> noon = pd.Timestamp("2022-07-19T12:00Z")
    >>> OutageWarning(noon - pd.Timedelta(hours=6), onset_likely=noon, probability=0.7).all_clear
    False
    """

    issued_at: pd.Timestamp  #: when it was issued, with time zone; it is not known before
    #: Which outage it speaks of, where several are expected; the last message about each counts.
    outage: str = ""
    #: Name of a kind of warning (:mod:`vppres.outlook.presets`) that fills in what is not given.
    preset: str = ""
    #: When the outage begins. Only the likely one: then for certain.
    onset_earliest: pd.Timestamp | None = None
    onset_likely: pd.Timestamp | None = None
    onset_latest: pd.Timestamp | None = None
    #: Probability that it comes to *this* feeder; 0 is the all-clear.
    probability: float | None = None
    #: Length of the whole outage in h that it stays below with a probability of 10, 50 and 90 %.
    #: Only the median: then for certain, if it was said before the outage; an estimate of one that
    #: has begun gets the spread of estimates (:class:`OutageStatistics`).
    duration_p10_h: float | None = None
    duration_p50_h: float | None = None
    duration_p90_h: float | None = None
    #: What a crew says of the end: that the grid is not back earlier; an estimate, as a time and
    #: not as a length; that it is back by then ("within the hour"), which is a notice.
    restored_not_before: pd.Timestamp | None = None
    restored_likely: pd.Timestamp | None = None
    restored_by: pd.Timestamp | None = None
    #: Distributions instead of the three times and the three lengths, which then sum them up for
    #: people.
    onset: OnsetShares | None = None
    length: OutageLength | None = None

    def __post_init__(self) -> None:
        problems = [
            Problem("outage warning", message, cure, field=field, value=getattr(self, field))
            for field, message, cure in self.contradictions()
        ]
        if problems:
            raise InputError(problems)

    @property
    def all_clear(self) -> bool:
        """Whether it says that the outage does not come."""
        return self.probability == 0.0

    @property
    def chance(self) -> float:
        """Probability that it comes, which is certain where none is given."""
        return 1.0 if self.probability is None else self.probability

    @property
    def says_length(self) -> bool:
        """Whether it says how long the outage lasts."""
        return self.duration_p50_h is not None or self.restored_likely is not None

    def contradictions(self) -> list[tuple[str, str, str]]:
        """Statements of the warning that contradict each other: field, message, cure."""
        found = self._wrong_numbers()
        onsets = ("onset_earliest", "onset_likely", "onset_latest")
        ends = ("restored_not_before", "restored_likely", "restored_by")
        durations = ("duration_p10_h", "duration_p50_h", "duration_p90_h")
        for names, wrong in ((onsets, "comes before"), (durations, "is below")):
            given = [(name, getattr(self, name)) for name in names if _known(getattr(self, name))]
            found += _out_of_order(given, wrong)
            middle = names[1]
            if given and middle not in dict(given):
                found.append((middle, "is missing", f"Give it, or leave out {given[0][0]} too."))
        said = [(name, getattr(self, name)) for name in ends if _known(getattr(self, name))]
        found += _out_of_order(said, "comes before")
        begins = next((at for name in onsets if _known(at := getattr(self, name))), None)
        found += [
            (name, "does not come after the onset", "Give a later time.")
            for name, time in said
            if begins is not None and not _less(begins, time)
        ]
        if self.restored_by is not None and self.restored_by <= self.issued_at:
            found.append(("restored_by", "does not come after issued_at", "Give a later time."))
        if self.restored_likely is not None and self.duration_p50_h is not None:
            cure = "Leave out one of the two."
            found.append(("restored_likely", "is given beside duration_p50_h", cure))
        return found

    def _wrong_numbers(self) -> list[tuple[str, str, str]]:
        """Times without zone, and numbers out of their range."""
        found = []
        for name in TIMES:
            time = getattr(self, name)
            if time is not None and time.tzinfo is None:
                cure = "Write it with an offset, for example 2022-07-19T05:00Z."
                found.append((name, "has no time zone", cure))
        if self.probability is not None and not 0.0 <= self.probability <= 1.0:
            cure = "Give a share, for example 0.7; 0 is the all-clear."
            found.append(("probability", "must lie between 0 and 1", cure))
        for name in ("duration_p10_h", "duration_p50_h", "duration_p90_h"):
            hours = getattr(self, name)
            if hours is not None and not (np.isfinite(hours) and hours > 0.0):
                found.append((name, "must be above 0", "Give hours, for example 4."))
        return found


@dataclass(frozen=True)
class OutageStatistics:
    """How often and how long a feeder is out without warning.

    What is None is that of the preset (:mod:`vppres.outlook.presets`).

    Examples
    --------
    >>> OutageStatistics(saifi_per_year=0.0) == OutageStatistics()
    False
    """

    preset: str = "average"  #: public figures to begin with
    #: Outages of a customer in a year; 0 for none that is not announced.
    saifi_per_year: float | None = None
    caidi_h: float | None = None  #: mean length of an outage in h
    #: Spread of the length: standard deviation of its logarithm.
    duration_sigma: float | None = None
    #: What a kWh that is not supplied is worth beside one that is bought.
    value_of_lost_load_gbp_per_kwh: float | None = None
    #: What an outage lasts as a multiple of a lone estimate that is given while it lasts: one in
    #: ten less than the first, half of them less than the second, nine in ten less than the third.
    estimate_p10: float | None = None
    estimate_p50: float | None = None
    estimate_p90: float | None = None
    #: How long before the end of an outage the crew gives notice; then its silence is news too.
    #: None if it gives none as a rule.
    notice_h: float | None = None
    #: Share of outages with such a notice, and of other hours in which it is given in vain.
    notice_share: float | None = None
    notice_false_share: float | None = None

    def __post_init__(self) -> None:
        positive = {"caidi_h", "value_of_lost_load_gbp_per_kwh", "notice_h"}
        positive |= {"estimate_p10", "estimate_p50", "estimate_p90"}
        problems = []
        for name in (f.name for f in fields(self) if f.name != "preset"):
            value = getattr(self, name)
            if value is None:
                continue
            least = value > 0.0 if name in positive else value >= 0.0
            if not (np.isfinite(value) and least):
                word = "above 0" if name in positive else "zero or positive"
                problems.append(
                    Problem(
                        "outage statistics",
                        f"must be {word}",
                        "Give a number, or leave it out for the preset's.",
                        field=name,
                        value=value,
                    )
                )
        problems += [
            Problem("outage statistics", message, cure, field=field, value=getattr(self, field))
            for field, message, cure in self._wrong_shares()
        ]
        if problems:
            raise InputError(problems)

    def _wrong_shares(self) -> list[tuple[str, str, str]]:
        """Shares that are none, and quantiles that cross: field, message, cure."""
        names = ("estimate_p10", "estimate_p50", "estimate_p90")
        given = [(name, getattr(self, name)) for name in names if _known(getattr(self, name))]
        found = _out_of_order(given, "is below")
        for name in ("notice_share", "notice_false_share"):
            share = getattr(self, name)
            if share is not None and not 0.0 <= share < 1.0:
                found.append((name, "must be a share below 1", "Give for example 0.72."))
        return found


def _out_of_order(given: list[tuple[str, Any]], wrong: str) -> list[tuple[str, str, str]]:
    """Values below the one before them: field, message, cure."""
    return [
        (high, f"{wrong} {low}", "Put them in their order.")
        for (low, less), (high, more) in pairwise(given)
        if _less(more, less)
    ]


def _less(one: Any, other: Any) -> bool:
    """Whether a number or time is less than another; with and without a zone times do not tell."""
    zones = {getattr(value, "tzinfo", None) is None for value in (one, other)}
    return len(zones) == 1 and bool(one < other)


def _known(value: object) -> bool:
    """Whether something was given."""
    return value is not None
