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
from vppres.service.payloads import read_duration, read_moment
from vppres.service.records import Event, moment
from vppres.service.window import Window

Interval = tuple[pd.Timestamp, pd.Timestamp | None]  # without an end it is not known

HOUR = pd.Timedelta(hours=1)

RESTORATION = "restoration"

SAID_OF_END = {
    "not_before": "restored_not_before",
    "likely": "restored_likely",
    "by": "restored_by",
}
"""What a crew says of the end, and the field of a warning that it becomes."""

SHAPES = {"lognormal": "sigma", "weibull": "shape"}
"""What says of a family how different its lengths are."""


def prices(events: Iterable[Event], window: Window) -> Floats:
    """Import prices of a window, (W,): those of events over those of the profile."""
    found = window.series["price_gbp_per_kwh"].copy()
    for body in _bodies(events, "price"):
        window.lay(found, body, body["price_gbp_per_kwh"])
    return found


def limits_kw(events: Iterable[Event], window: Window) -> Floats:
    """Import limits of a window as long as there is grid, (W,)."""
    return _limited(window.series["grid_limit_kw"], events, window)


def announced_kw(events: Iterable[Event], window: Window, own_days: bool) -> Floats | None:
    """Import limits that are known beforehand, (W,), NaN where none is; None if nothing is.

    Parameters
    ----------
    events : iterable of Event
        What is announced.
    window : Window
        The steps.
    own_days : bool
        Whether the scenario's own days come, as in a rehearsal: then its limits ahead are what
        is not known, and the one of now is taken to stay. Those of a profile are known.
    """
    known = window.series["grid_limit_kw"]
    if own_days:
        known = np.full(len(known), known[0] if known[0] > 0.0 else np.nan)
    found = _limited(known, events, window)
    return None if own_days and np.array_equal(found, known, equal_nan=True) else found


def _limited(found: Floats, events: Iterable[Event], window: Window) -> Floats:
    """Limits with those of events below them."""
    for body in _bodies(events, "import_limit"):
        touched = window.touched(read_moment(body["start"]), _moment(body["end"]))
        found = np.where(touched, np.fmin(found, float(body["limit_kw"])), found)
    return np.array(found)


def outages(events: Iterable[Event], window: Window) -> Flags:
    """Which steps of a window a certain outage touches, (W,)."""
    found = np.zeros(len(window.times), dtype=bool)
    for start, end in _certain(events):
        found |= window.touched(start, end)
    return found


def announced_at(events: Iterable[Event], time: pd.Timestamp) -> bool:
    """Whether a certain outage was announced for a time."""
    return any(start <= time and (end is None or time < end) for start, end in _certain(events))


def _certain(events: Iterable[Event]) -> Iterator[Interval]:
    """Beginnings and ends of outages that are certain."""
    bodies = _bodies(events, "outage", "outage_belief")
    return (found for found in map(certain_interval, bodies) if found is not None)


def is_over(body: Mapping[str, Any], now: pd.Timestamp) -> bool:
    """Whether an event has ended, by its own end."""
    end = _moment(body.get("end"))
    return end is not None and end <= now


def check_not_over(body: Mapping[str, Any], now: pd.Timestamp) -> None:
    """Refuse to announce what is wholly in the past; an event that is known may be ended so.

    Raises
    ------
    InputError
        If it is over.
    """
    end = _moment(body.get("end"))
    if body["type"] == "price":
        end = read_moment(body["start"]) + len(body["price_gbp_per_kwh"]) * read_duration(
            body["resolution"]
        )
    elif body["type"] == RESTORATION:
        end = max(read_moment(body[name]) for name in SAID_OF_END if body.get(name))
    elif body["type"] == "outage_belief":
        end = _last_end(body)
    if end is not None and end <= now:
        raise InputError.of(
            "event",
            "lies wholly in the past",
            f"It is {now.isoformat()}; give times that are still to come.",
            field="end",
            value=end.isoformat(),
        )


def check_new(
    said: Mapping[str, Mapping[str, Any]], known: Mapping[str, Any], now: pd.Timestamp
) -> None:
    """Refuse events by name none of which is known or to come; InputError with the first."""
    if not said or known.keys() & said.keys():
        return
    past: list[InputError] = []
    for body in said.values():
        try:
            check_not_over(body, now)
        except InputError as error:
            past.append(error)
        else:
            return
    raise past[0]


def _last_end(body: Mapping[str, Any]) -> pd.Timestamp | None:
    """When a believed outage is over at the latest; None if nothing says so."""
    length = body["duration"]
    if length is not None and length["family"] == "until":
        return read_moment(length["until"])
    interval = certain_interval(body)
    if interval is not None:
        return interval[1]
    longest = _distribution(length)
    most_h = np.inf if longest is None else max(longest.hours, default=longest.max_h)
    return _shares(body["onset"]).end + most_h * HOUR if np.isfinite(most_h) else None


def certain_interval(body: Mapping[str, Any]) -> Interval | None:
    """Beginning and end of an outage that leaves nothing to chance; None if this one does."""
    if body["type"] == "outage":
        return read_moment(body["start"]), _moment(body["end"])
    onset = body["onset"]
    length = body["duration"]
    if body["probability"] < 1.0 or len(_possible(onset["probabilities"])) > 1 or length is None:
        return None
    start = _shares(onset).likely
    if length["family"] == "until":
        return start, read_moment(length["until"])
    if length["family"] == "discrete" and len(_possible(length["probabilities"])) == 1:
        only = _possible(length["probabilities"])[0]
        return start, start + length["hours"][only] * HOUR
    return None


def believes(options: RunOptions) -> bool:
    """Whether plans weigh outages by their probability; otherwise they are known, or unknown."""
    return options.outages in (BELIEF, LIKELY)


def check_belief(body: Mapping[str, Any], options: RunOptions) -> None:
    """Refuse what the controller would have to round, and lengths that no outage has.

    Raises
    ------
    InputError
        For an uncertain outage where outages are taken for known, or for unknown; for a
        distribution of which one length in ten is nothing, or without end.
    """
    restoration = body["type"] == RESTORATION
    if not believes(options) and (restoration or certain_interval(body) is None):
        raise InputError.of(
            "event",
            f"is uncertain, and the service takes outages for {options.outages}",
            f"Start it with --outages {BELIEF}, or put an event outage, with its end if known.",
            field="type",
            value=body["type"],
        )
    if restoration:
        return
    lengths_h = list(_quantiles_h(_distribution(body["duration"])).values())
    if not all(np.isfinite(hours) and hours > 0.0 for hours in lengths_h):
        name = SHAPES[body["duration"]["family"]]
        raise InputError.of(
            "event",
            "gives lengths that no outage has",
            "Give one between 0.5 and 2, as outages have it.",
            field=f"duration.{name}",
            value=body["duration"][name],
        )


def warnings(events: Mapping[str, Event], now: pd.Timestamp, step: pd.Timedelta) -> list[Any]:
    """Messages of all outages that may be now or later; ``now`` is a step's beginning."""
    found = []
    for name, event in events.items():
        message = _message(name, event.body, now, step)
        if message is None:
            continue
        # Since when it is known, and what is said now; of a crew what it said last.
        crew = event.body["type"] == RESTORATION
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
            if not event.body:
                message = OutageWarning(issued, name, probability=0.0) if spoken else None
            else:
                message = _message(name, event.body, _step_of(issued, start, step), step)
            spoken = message is not None and bool(event.body)
            if message is not None:
                found.append(replace(message, issued_at=issued))
    return sorted(found, key=lambda one: one.issued_at)


def _message(
    name: str, body: Mapping[str, Any], now: pd.Timestamp, step: pd.Timedelta
) -> OutageWarning | None:
    """What an event says of an outage; None if it says nothing, or nothing that counts now."""
    if body["type"] == RESTORATION:  # what a crew says of the end of the present outage
        said: dict[str, Any] = {field: _moment(body.get(key)) for key, field in SAID_OF_END.items()}
        return OutageWarning(now, name, **said)
    if body["type"] not in ("outage", "outage_belief"):
        return None
    interval = certain_interval(body)
    if interval is None:
        return _uncertain(name, body, now, step)
    start, end = interval
    # One that was seen is explained by what was said of it, when it is over too.
    if end is not None and end + LOOKAHEAD_H * HOUR <= now:
        return None
    begun = _step_of(start, now, step)
    lasts_h = None if end is None else -((begun - end) // step) * (step / HOUR)
    names = ("duration_p10_h", "duration_p50_h", "duration_p90_h")
    lasts = dict.fromkeys(names, lasts_h)
    return OutageWarning(now, name, onset_likely=begun, probability=1.0, **lasts)


def _uncertain(
    name: str, body: Mapping[str, Any], now: pd.Timestamp, step: pd.Timedelta
) -> OutageWarning:
    """A belief as a message: distributions, and the quantiles that sum them up."""
    shares = _shares(body["onset"])
    length = _length(body["duration"], _step_of(shares.likely, now, step), step)
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
        probability=body["probability"],
        length=length,
        **times,
        **(_quantiles_h(length) or _alone(body["duration"])),
    )


def _alone(duration: Mapping[str, Any] | None) -> dict[str, Any]:
    """An estimate without a spread."""
    return {} if duration is None else {"duration_p50_h": duration["median_h"]}


def _length(
    body: Mapping[str, Any] | None, begun: pd.Timestamp, step: pd.Timedelta
) -> OutageLength | None:
    """How long it lasts; up to a known end, from its likeliest beginning on."""
    if body is None:
        return None
    if body["family"] == "until":
        steps = max(-((begun - read_moment(body["until"])) // step), 1)
        return OutageLength("discrete", hours=(steps * (step / HOUR),), probability=(1.0,))
    return _distribution(body)


def _distribution(body: Mapping[str, Any] | None) -> OutageLength | None:
    """A length that does not depend on the beginning; None if there is none, or a known end."""
    if body is None or body["family"] == "until":
        return None
    if body["family"] == "discrete":
        return OutageLength(
            "discrete", hours=tuple(body["hours"]), probability=tuple(body["probabilities"])
        )
    scale = "median_h" if body["family"] == "lognormal" else "scale_h"
    if body[SHAPES[body["family"]]] is None:
        return None  # an estimate alone
    return OutageLength(
        body["family"],
        scale_h=body[scale],
        shape=body[SHAPES[body["family"]]],
        max_h=np.inf if body["max_h"] is None else body["max_h"],
    )


def _quantiles_h(length: OutageLength | None) -> dict[str, Any]:
    """The lengths that 10, 50 and 90 % stay below, for people."""
    if length is None:
        return {}
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


def _shares(onset: Mapping[str, Any]) -> OnsetShares:
    probability = np.array(onset["probabilities"]) / sum(onset["probabilities"])
    start = read_moment(onset["start"]).tz_convert("UTC")
    return OnsetShares(
        start, read_duration(onset["resolution"]) / HOUR, tuple(probability.tolist())
    )


def _step_of(time: pd.Timestamp, now: pd.Timestamp, step: pd.Timedelta) -> pd.Timestamp:
    """Beginning of the step that covers a time, where one begins now."""
    return now + ((time - now) // step) * step


def _possible(probabilities: list[float]) -> list[int]:
    """Places of what can happen."""
    return [place for place, each in enumerate(probabilities) if each > 0.0]


def _bodies(events: Iterable[Event], *kinds: str) -> list[Mapping[str, Any]]:
    return [event.body for event in events if event.body["type"] in kinds]


def _moment(text: str | None) -> pd.Timestamp | None:
    return None if text is None else read_moment(text)
