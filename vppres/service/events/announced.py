"""From events to what they say of the steps ahead: import limits, prices, and messages of outages.

An outage is a fact in the steps that it touches; a belief is one in none. Both become messages for
controllers that plan with beliefs, of which a certain outage is the special case.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.day.outages import BELIEF, LIKELY, LOOKAHEAD_H
from vppres.outlook.durations import Z90
from vppres.scenario.outage_warnings import OnsetShares, OutageLength, OutageWarning
from vppres.service import payloads
from vppres.service.storage.records import Event, moment
from vppres.service.window import Window

Interval = tuple[pd.Timestamp, pd.Timestamp]

HOUR = pd.Timedelta(hours=1)

OPEN = pd.Timestamp("2260-01-01T00:00Z")
"""End of what has no known end: behind all times that there are."""

SAID_OF_END = {
    "not_before": "restored_not_before",
    "likely": "restored_likely",
    "by": "restored_by",
}
"""What a crew says of the end, and the field of a warning that it becomes."""


def prices(events: Iterable[Event], window: Window) -> Floats:
    """Import prices of a window, (W,): those of events over those of the profile.

    At each time the event counts that was written last.
    """
    found = window.series["price_gbp_per_kwh"].copy()
    said = [event.said for event in sorted(events, key=lambda one: one.made_at)]
    window.lay(found, [(o, o.price_gbp_per_kwh) for o in said if isinstance(o, payloads.Prices)])
    return found


def limits_kw(events: Iterable[Event], window: Window) -> Floats:
    """Import limits of a window as long as there is grid, (W,)."""
    return _limited(window.series["grid_limit_kw"], events, window)


def announced_kw(events: Iterable[Event], window: Window, own_days: bool) -> Floats | None:
    """Import limits that are known beforehand, (W,), NaN where none is; None if nothing is.

    Limits of a profile are known. Where the scenario's own days come, as in a rehearsal, its limits
    ahead are what is not known, and the one of now is taken to stay.
    """
    known = window.series["grid_limit_kw"]
    if own_days:
        known = np.full(len(known), known[0] if known[0] > 0.0 else np.nan)
    found = _limited(known, events, window)
    return None if own_days and np.array_equal(found, known, equal_nan=True) else found


def _limited(found: Floats, events: Iterable[Event], window: Window) -> Floats:
    """Limits with those of events below them."""
    for event in events:
        if isinstance(event.said, payloads.ImportLimit):
            touched = window.touched(event.said.start, event.said.end or OPEN)
            found = np.where(touched, np.fmin(found, event.said.limit_kw), found)
    return np.array(found)


def outages(events: Iterable[Event], window: Window) -> Flags:
    """Which steps of a window a certain outage touches, (W,)."""
    found = np.zeros(len(window.times), dtype=bool)
    for start, end in _certain(events):
        found |= window.touched(start, end)
    return found


def announced_at(events: Iterable[Event], time: pd.Timestamp) -> bool:
    """Whether a certain outage was announced for a time."""
    return any(start <= time < end for start, end in _certain(events))


def _certain(events: Iterable[Event]) -> Iterator[Interval]:
    """Beginnings and ends of outages that are certain."""
    found = (certain_interval(event.said) for event in events)
    return (interval for interval in found if interval)


def is_over(said: payloads.Event, now: pd.Timestamp) -> bool:
    """Whether an event has ended, as it says itself."""
    return _last_end(said) <= now


def check_not_over(said: payloads.Event, now: pd.Timestamp) -> None:
    """Refuse to announce what is wholly in the past; an event that is known may be ended so.

    Raises
    ------
    InputError
        If it is over.
    """
    end = _last_end(said)
    if end <= now:
        raise InputError.of(
            "event",
            "lies wholly in the past",
            f"It is {now.isoformat()}; give times that are still to come.",
            field="end",
            value=end.tz_convert("UTC").isoformat(),
        )


def check_new(
    said: Mapping[str, payloads.Event], known: Mapping[str, Any], now: pd.Timestamp
) -> None:
    """Refuse events by name none of which is known or to come; InputError with the first."""
    if not said or known.keys() & said.keys():
        return
    past: list[InputError] = []
    for event in said.values():
        try:
            check_not_over(event, now)
        except InputError as error:
            past.append(error)
        else:
            return
    raise past[0]


def _last_end(said: payloads.Event) -> pd.Timestamp:
    """When an event is over at the latest."""
    if isinstance(said, payloads.Interval):
        return said.end or OPEN
    if isinstance(said, payloads.Restoration):
        return said.times[-1]
    if isinstance(said, payloads.Prices):
        return said.start + len(said.price_gbp_per_kwh) * said.resolution
    if isinstance(said.duration, payloads.Until):
        return said.duration.until
    if interval := certain_interval(said):
        return interval[1]
    longest = _distribution(said.duration)
    most_h = max(longest.hours, default=longest.max_h) if longest else np.inf
    return _shares(said.onset).end + most_h * HOUR if np.isfinite(most_h) else OPEN


def certain_interval(said: payloads.Event | None) -> Interval | None:
    """Beginning and end of an outage that leaves nothing to chance; None if this one does."""
    if isinstance(said, payloads.Outage):
        return said.start, said.end or OPEN
    if not isinstance(said, payloads.Belief) or said.probability < 1.0:
        return None
    if len(_possible(said.onset.probabilities)) > 1:
        return None
    start, length = _shares(said.onset).likely, said.duration
    if isinstance(length, payloads.Until):
        return start, length.until
    if isinstance(length, payloads.Discrete) and len(_possible(length.probabilities)) == 1:
        return start, start + length.hours[_possible(length.probabilities)[0]] * HOUR
    return None


def believes(options: RunOptions) -> bool:
    """Whether plans weigh outages by their probability; otherwise they are known, or unknown."""
    return options.outages in (BELIEF, LIKELY)


def check_belief(said: payloads.Event, options: RunOptions) -> None:
    """Refuse what the controller would have to round, and lengths that no outage has.

    Raises
    ------
    InputError
        For an uncertain outage where outages are taken for known, or for unknown; for a
        distribution of which one length in ten is nothing, or without end.
    """
    if not isinstance(said, payloads.Belief | payloads.Restoration):
        return
    if not (believes(options) or certain_interval(said)):
        raise InputError.of(
            "event",
            f"is uncertain, and the service takes outages for {options.outages}",
            f"Start it with --outages {BELIEF}, or put an event outage, with its end if known.",
            field="type",
            value=said.type,
        )
    if isinstance(said, payloads.Restoration):
        return
    length = _distribution(said.duration)
    if length and not all(0.0 < h < np.inf for h in _quantiles_h(length).values()):
        name = "sigma" if length.family == "lognormal" else "shape"
        raise InputError.of(
            "event",
            "gives lengths that no outage has",
            "Give one between 0.5 and 2, as outages have it.",
            field=f"duration.{name}",
            value=length.shape,
        )


def warnings(events: Mapping[str, Event], now: pd.Timestamp, step: pd.Timedelta) -> list[Any]:
    """Messages of all outages that may be now or later; ``now`` is a step's beginning."""
    found = []
    for name, event in events.items():
        message = _message(name, event, now, step)
        if not message:
            continue
        # Since when it is known, and what is said now; of a crew what it said last.
        crew = isinstance(event.said, payloads.Restoration)
        issued = {
            min(moment(at), now) for at in (event.made_at, event.made_at if crew else event.since)
        }
        found += [replace(message, issued_at=at) for at in sorted(issued)]
    return found


def warnings_ever(
    versions: Mapping[str, Sequence[Event]], start: pd.Timestamp, step: pd.Timedelta
) -> list[OutageWarning]:
    """All that was ever said of outages, each message when it came; a step begins at ``start``."""
    found = []
    for name, each in versions.items():
        spoken = False
        for event in each:
            issued = moment(event.made_at)
            if event.said:
                message = _message(name, event, _step_of(issued, start, step), step)
            else:
                message = OutageWarning(issued, name, probability=0.0) if spoken else None
            spoken = bool(message and event.said)
            if message:
                found.append(replace(message, issued_at=issued))
    return sorted(found, key=lambda one: one.issued_at)


def _message(
    name: str, event: Event, now: pd.Timestamp, step: pd.Timedelta
) -> OutageWarning | None:
    """Notice of an outage in an event; None if there is none that counts now."""
    said, made = event.said, moment(event.made_at)
    if isinstance(said, payloads.Restoration):
        if said.by and said.by <= made:  # it was over when it was said
            return None
        of_end: dict[str, Any] = {field: getattr(said, key) for key, field in SAID_OF_END.items()}
        return OutageWarning(min(made, now), name, **of_end)
    interval = certain_interval(said)
    if not interval:
        return _uncertain(name, said, now, step) if isinstance(said, payloads.Belief) else None
    start, end = interval
    # One that was seen is explained by what was said of it, when it is over too.
    if end + LOOKAHEAD_H * HOUR <= now:
        return None
    begun = _step_of(start, now, step)
    lasts: dict[str, Any] = {}
    if end < OPEN:
        names = ("duration_p10_h", "duration_p50_h", "duration_p90_h")
        lasts = dict.fromkeys(names, (now - (now - end) // step * step - begun) / HOUR)
    return OutageWarning(now, name, onset_likely=begun, probability=1.0, **lasts)


def _uncertain(
    name: str, said: payloads.Belief, now: pd.Timestamp, step: pd.Timedelta
) -> OutageWarning:
    """A belief as a message: distributions, and the quantiles that sum them up."""
    shares = _shares(said.onset)
    length = _length(said.duration, _step_of(shares.likely, now, step), step)
    known = shares.end - shares.start <= step
    onset = _step_of(shares.start, now, step)
    times: dict[str, Any] = (
        {"onset_likely": onset}
        if known
        else {
            "onset_earliest": shares.start,
            "onset_likely": shares.likely,
            "onset_latest": shares.end,
            "onset": shares,
        }
    )
    return OutageWarning(
        now,
        name,
        probability=said.probability,
        length=length,
        **times,
        **(_quantiles_h(length) if length else _alone(said.duration)),
    )


def _alone(duration: payloads.Length | None) -> dict[str, Any]:
    """An estimate without a spread."""
    return {"duration_p50_h": duration.median_h} if isinstance(duration, payloads.Lognormal) else {}


def _length(
    said: payloads.Length | None, begun: pd.Timestamp, step: pd.Timedelta
) -> OutageLength | None:
    """How long it lasts; up to a known end, from its likeliest beginning on."""
    if isinstance(said, payloads.Until):
        steps = max(-((begun - said.until) // step), 1)
        return OutageLength("discrete", hours=(steps * (step / HOUR),), probability=(1.0,))
    return _distribution(said)


def _distribution(said: payloads.Length | None) -> OutageLength | None:
    """A length that does not depend on the beginning; None of a known end or an estimate alone."""
    if isinstance(said, payloads.Discrete):
        shares = tuple(said.probabilities)
        return OutageLength(said.family, hours=tuple(said.hours), probability=shares)
    if isinstance(said, payloads.Weibull):
        return OutageLength(said.family, said.scale_h, said.shape, max_h=said.max_h or np.inf)
    if isinstance(said, payloads.Lognormal) and said.sigma:
        return OutageLength(said.family, said.median_h, said.sigma, max_h=said.max_h or np.inf)
    return None


def _quantiles_h(length: OutageLength) -> dict[str, Any]:
    """The lengths that 10, 50 and 90 % stay below, for people."""
    if length.family == "discrete":
        order = np.argsort(length.hours)
        below = np.cumsum(np.array(length.probability)[order])
        places = np.searchsorted(below, np.array([0.1, 0.5, 0.9]) - 1e-9)
        values = np.array(length.hours)[order][np.minimum(places, len(order) - 1)]
    elif length.family == "lognormal":
        values = length.scale_h * np.exp(length.shape * Z90 * np.array([-1.0, 0.0, 1.0]))
    else:
        with np.errstate(over="ignore", divide="ignore"):
            values = length.scale_h * (-np.log([0.9, 0.5, 0.1])) ** (1.0 / np.float64(length.shape))
    names = ("duration_p10_h", "duration_p50_h", "duration_p90_h")
    return {
        name: float(min(value, length.max_h)) for name, value in zip(names, values, strict=True)
    }


def _shares(onset: payloads.Onset) -> OnsetShares:
    probability = np.array(onset.probabilities) / sum(onset.probabilities)
    start = onset.start.tz_convert("UTC")
    return OnsetShares(start, onset.resolution / HOUR, tuple(probability.tolist()))


def _step_of(time: pd.Timestamp, now: pd.Timestamp, step: pd.Timedelta) -> pd.Timestamp:
    """Beginning of the step that covers a time, where one begins now."""
    return now + ((time - now) // step) * step


def _possible(probabilities: list[float]) -> list[int]:
    """Places of what can happen."""
    return [place for place, each in enumerate(probabilities) if each > 0.0]
