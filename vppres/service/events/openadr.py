"""An OpenADR 3 event as it stands, in the words of our own events.

What each payload means is OpenADR's; how likely a possible outage is it does not say, and that is
an assumption here. Payloads that mean nothing to a feeder are named and left out.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator
from typing import Annotated, Any

import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from vppres.core.errors import InputError
from vppres.service import payloads
from vppres.service.clock import written

POSSIBLE_OUTAGE = 0.5
"""Probability of an outage that is announced as possible."""

LONGEST = pd.Timedelta(days=366)
LONGEST_NAME = 60
"""Of an event: what is longer is cut, with a hash instead of its end."""

SOURCE = "openadr"
RANDOMISED = "randomizeStart"
POUND = "GBP"
POWER_KW = {"KW": 1.0, "W": 1e-3, "MW": 1e3}
ALERTS = (
    "ALERT_GRID_EMERGENCY",
    "ALERT_BLACK_START",
    "ALERT_FLEX_ALERT",
    "ALERT_OTHER",
)
_EVENT: TypeAdapter[Any] = TypeAdapter(payloads.Event)
_ONE: TypeAdapter[Any] = TypeAdapter(
    Annotated[list[payloads.Number], Field(min_length=1, max_length=1)]
)


class _Part(BaseModel):
    """A part of an event; what is not read here may be there."""

    model_config = ConfigDict(extra="ignore")


class Period(_Part):
    """When an interval begins and how long it lasts."""

    start: Annotated[str, Field(max_length=40)] | None = None
    duration: Annotated[str, Field(max_length=40)] | None = None
    randomizeStart: Annotated[str, Field(max_length=40)] | None = None

    @property
    def randomised(self) -> bool:
        """Whether the start is to be drawn: a plan that is repeated needs the one that is said."""
        text = self.randomizeStart
        return text is not None and any(digit in "123456789" for digit in text)


class Payload(_Part):
    """Values of a type."""

    type: Annotated[str, Field(max_length=100)]
    values: list[Any] = Field([], max_length=payloads.MOST_VALUES)


class Part(_Part):
    """An interval; without a period it follows the one before."""

    id: int = 0
    intervalPeriod: Period | None = None
    payloads: list[Payload] = Field(fail_fast=True, max_length=50)


class Descriptor(_Part):
    """Units of a type."""

    payloadType: Annotated[str, Field(max_length=100)] = ""
    units: Annotated[str, Field(max_length=100)] | None = None
    currency: Annotated[str, Field(max_length=10)] | None = None


class OpenADREvent(_Part):
    """An event of OpenADR 3, as a VTN has it."""

    id: payloads.Name | None = None
    programID: payloads.Name
    eventName: payloads.Name | None = None
    intervalPeriod: Period | None = None
    payloadDescriptors: list[Descriptor] | None = Field(None, max_length=50)
    intervals: list[Part] = Field(fail_fast=True, min_length=1, max_length=payloads.MOST_VALUES)

    @property
    def name(self) -> str:
        """Prefix of the names of our events from this program."""
        name: str = self.id or self.eventName or self.programID
        if len(name) <= LONGEST_NAME:
            return name
        digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:16]
        return f"{name[: LONGEST_NAME - 17]}.{digest}"


def events_of(event: OpenADREvent, believes: bool) -> tuple[dict[str, Any], list[str]]:
    """Our events by name, and what means nothing here: types, and a start that is to be drawn.

    Where no beliefs are planned with a possible outage is an alert.

    Raises
    ------
    InputError
        If times or values are not those of its types.
    """
    found: dict[str, Any] = {}
    periods = [event.intervalPeriod, *(part.intervalPeriod for part in event.intervals)]
    drawn = any(period and period.randomised for period in periods)
    ignored = {RANDOMISED} if drawn else set()
    for number, (start, length, part) in enumerate(_intervals(event)):
        for payload in part.payloads:
            body = _body(payload, start, length, event, believes)
            if body:
                found[f"{event.name}.{number}.{payload.type}"] = _checked(body)
            else:
                ignored.add(payload.type)
    if len(found) > payloads.MOST_VALUES:
        cure = f"Send {payloads.MOST_VALUES} payloads at most."
        raise _wrong("intervals", "have too many payloads", cure, str(len(found)))
    return found, sorted(ignored)


def those_of(event: OpenADREvent, names: Iterable[str]) -> list[str]:
    """Of names of our events those that an earlier message of this event gave."""
    ours = re.compile(rf"{re.escape(event.name)}\.\d+\.\w+")
    return [name for name in names if ours.fullmatch(name)]


def _intervals(event: OpenADREvent) -> Iterator[tuple[pd.Timestamp, pd.Timedelta, Part]]:
    """Beginning and length of each interval."""
    common = event.intervalPeriod or Period()
    start = None if common.start is None else _time(common.start)
    for part in event.intervals:
        own = part.intervalPeriod or Period()
        start = start if own.start is None else _time(own.start)
        text = own.duration or common.duration
        if start is None or text is None:
            raise _wrong("intervalPeriod", "is missing", "Give a start and a duration.")
        length = _length(text)
        yield start, length, part
        start = start + length
        if start.year > payloads.LAST_YEAR:
            raise _wrong("intervalPeriod", payloads.OTHER_CENTURY, "Give an earlier end.")


def _body(
    payload: Payload,
    start: pd.Timestamp,
    length: pd.Timedelta,
    event: OpenADREvent,
    believes: bool,
) -> dict[str, Any]:
    """Our event of a payload; empty if it means nothing here."""
    span = {"source": SOURCE, "start": written(start), "end": written(start + length)}
    seconds = f"PT{round(length.total_seconds())}S"
    if payload.type == "ALERT_POSSIBLE_OUTAGE" and believes:
        return {
            "type": "outage_belief",
            "source": SOURCE,
            "probability": POSSIBLE_OUTAGE,
            "onset": {"start": span["start"], "resolution": seconds, "probabilities": [1.0]},
            "openadr_type": payload.type,
        }
    if payload.type == "ALERT_POSSIBLE_OUTAGE" or payload.type in ALERTS:
        words = ", ".join(str(value) for value in payload.values)
        return {"type": "alert", **span, "text": f"{payload.type} {words}".strip()[:500]}
    if payload.type == "IMPORT_CAPACITY_LIMIT":
        factor = POWER_KW.get((_unit(event, payload.type, "units") or "KW").upper())
        if not factor:
            raise _wrong("units", "is no unit of power that is known", "Give KW, W or MW.")
        return {"type": "import_limit", **span, "limit_kw": factor * _number(payload)}
    if payload.type == "PRICE":
        currency = _unit(event, payload.type, "currency") or POUND
        if currency != POUND:
            raise _wrong("currency", "is another than the site's", f"Give prices in {POUND}.")
        return {
            "type": "price",
            "source": SOURCE,
            "start": span["start"],
            "resolution": seconds,
            "price_gbp_per_kwh": [_number(payload)],
        }
    return {}


def _unit(event: OpenADREvent, kind: str, field: str) -> str | None:
    """Unit in the descriptor of a type."""
    for one in event.payloadDescriptors or []:
        if one.payloadType == kind:
            found: str | None = getattr(one, field)
            return found
    return None


def _number(payload: Payload) -> float:
    """The only value."""
    try:
        (value,) = _ONE.validate_python(payload.values)
    except ValidationError:
        raise _wrong("values", f"of {payload.type} is not one number", "Give [number].") from None
    return float(value)


def _time(text: str) -> pd.Timestamp:
    try:
        return payloads.read_moment(text)
    except ValueError as error:
        raise _wrong("start", str(error), "Give a time.", text) from None


def _length(text: str) -> pd.Timedelta:
    """A duration of ISO 8601, days included."""
    problem = _wrong("duration", "is no duration of up to a year", "Give PT1H or P1D.", text)
    if not text.startswith("P"):
        raise problem
    try:
        found = pd.Timedelta(text)
    except (ValueError, OverflowError):
        raise problem from None
    if not pd.Timedelta(0) < found <= LONGEST:
        raise problem
    return found


def _checked(body: dict[str, Any]) -> Any:
    """The event, as if it had come in our words."""
    try:
        return _EVENT.validate_python(body)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"])
        raise _wrong(field, str(first["msg"]), "Correct the event.") from None


def _wrong(field: str, message: str, cure: str, value: str | None = None) -> InputError:
    return InputError.of("OpenADR event", message, cure, field=field, value=value)
