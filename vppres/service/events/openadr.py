"""An OpenADR 3 event as it stands, in the words of our own events.

What each payload means is OpenADR's; how likely a possible outage is it does not say, and that is
an assumption here. Payloads that mean nothing to a feeder are named and left out.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Annotated, Any

import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from vppres.core.errors import InputError
from vppres.service import payloads
from vppres.service.clock import written
from vppres.service.events.announced import OPEN

POSSIBLE_OUTAGE = 0.5
"""Probability of an outage that is announced as possible."""

ENDLESS = "P9999Y"
"""Duration of what has no end."""

NOW = re.compile(r"0001-01-01(T00:00:00(\.0+)?)?(Z|[+-]00:?00)?")
"""Start of what begins now, or of an interval that follows the one before."""

LONGEST = pd.Timedelta(days=366)
LONGEST_NAME = 60
"""Of an event: what is longer is cut, with a hash instead of its end."""

SOURCE = "openadr"
RANDOMISED, REPEATED, PRIORITY = "randomizeStart", "duration", "priority"
POUND = "GBP"
POWER_KW = {"KW": 1.0, "W": 1e-3, "MW": 1e3}
ENERGY_KWH = {"KWH": 1.0, "WH": 1e-3, "MWH": 1e3}
ALERT, POSSIBLE = "ALERT_", "ALERT_POSSIBLE_OUTAGE"
_EVENT: TypeAdapter[Any] = TypeAdapter(payloads.Event)
_NUMBERS: TypeAdapter[list[float]] = TypeAdapter(
    Annotated[list[payloads.Number], Field(min_length=1)]
)
_DURATION: TypeAdapter[timedelta] = TypeAdapter(timedelta)
_CALENDAR = re.compile(r"P[^T]*[YM].*")


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
    duration: Annotated[str, Field(max_length=40)] | None = None
    priority: int | None = None
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


@dataclass(frozen=True)
class Timed:
    """An interval with its times."""

    start: pd.Timestamp
    length: pd.Timedelta | None  #: None if it has no end
    part: Part
    until: pd.Timestamp = OPEN  #: when the event ends, which cuts its intervals

    @property
    def end(self) -> pd.Timestamp:
        """When it is over."""
        return self.until if self.length is None else min(self.start + self.length, self.until)


def events_of(
    event: OpenADREvent, believes: bool, now: pd.Timestamp
) -> tuple[dict[str, Any], list[str]]:
    """Our events by name, and what has no effect: types, a drawn start, a priority, a repetition.

    Where no beliefs are planned with a possible outage is an alert. What repeats without end does
    so for a year, or as often as an event may have payloads; an endless price holds for a year.

    Raises
    ------
    InputError
        If times or values are not those of its types.
    """
    found: dict[str, Any] = {}
    periods = [event.intervalPeriod, *(part.intervalPeriod for part in event.intervals)]
    drawn = any(period and period.randomised for period in periods)
    spans, is_cut = _repeated(event, now)
    ignored = {RANDOMISED} if drawn else set()
    ignored |= {PRIORITY} if event.priority else set()
    ignored |= {REPEATED} if is_cut else set()
    for number, span in enumerate(spans):
        for payload in span.part.payloads:
            body = _body(payload, span, event, believes)
            if body:
                found[f"{event.name}.{number}.{payload.type}"] = _checked(body)
            else:
                ignored.add(payload.type)
            if payload.type == "PRICE" and span.end == OPEN:
                ignored.add(REPEATED)
    if len(found) > payloads.MOST_VALUES:
        cure = f"Send {payloads.MOST_VALUES} payloads at most."
        raise _wrong("intervals", "have too many payloads", cure, str(len(found)))
    return found, sorted(ignored)


def those_of(event: OpenADREvent, names: Iterable[str]) -> list[str]:
    """Of names of our events those that an earlier message of this event gave."""
    ours = re.compile(rf"{re.escape(event.name)}\.\d+\.\w+")
    return [name for name in names if ours.fullmatch(name)]


def _repeated(event: OpenADREvent, now: pd.Timestamp) -> tuple[list[Timed], bool]:
    """Intervals up to the end of the event, which may cut or repeat them, and whether some lack.

    Repetitions that are over before the last are left out, and those later than in a year.
    """
    spans = [*_spans(event, now)]
    lasts = None if event.duration is None else _length(event.duration, zero=True)
    if event.duration is None or lasts == pd.Timedelta(0):  # OpenADR's default
        return spans, False
    begin = min(span.start for span in spans)
    until = OPEN if lasts is None else begin + lasts
    once = max(span.end for span in spans) - begin
    each = sum(len(span.part.payloads) for span in spans)
    most = max(payloads.MOST_VALUES // max(each, 1), 1)
    last = min(until, max(now, begin) + LONGEST)
    end = -((begin - last) // once)
    first = min(max((now - begin) // once, 0), end - 1)
    turns = range(first, min(first + most, end))
    repeated = [
        replace(span, start=span.start + turn * once, until=until)
        for turn in turns
        for span in spans
        if span.start + turn * once < until
    ]
    return repeated, begin + turns.stop * once < until


def _spans(event: OpenADREvent, now: pd.Timestamp) -> Iterator[Timed]:
    """Beginning and length of each interval; one that does not say when follows the one before."""
    common = event.intervalPeriod or Period()
    start = None if common.start is None else _time(common.start, now)
    for part in event.intervals:
        own = part.intervalPeriod or Period()
        if own.start is not None and (start is None or not NOW.fullmatch(own.start)):
            start = _time(own.start, now)
        text = own.duration or common.duration
        if start is None or text is None:
            raise _wrong("intervalPeriod", "is missing", "Give a start and a duration.")
        length = _length(text)
        yield Timed(start, length, part)
        start = None if length is None else start + length
        if start is not None and start.year > payloads.LAST_YEAR:
            raise _wrong("intervalPeriod", payloads.OTHER_CENTURY, "Give an earlier end.")


def _body(payload: Payload, span: Timed, event: OpenADREvent, believes: bool) -> dict[str, Any]:
    """Our event of a payload; empty if it means nothing here."""
    begin, lasts = written(span.start), min(span.end - span.start, LONGEST)
    interval: dict[str, Any] = {
        "source": SOURCE, "start": begin, "end": None if span.end == OPEN else written(span.end)
    }  # fmt: skip
    if payload.type == POSSIBLE and believes:
        return {
            "type": "outage_belief",
            "source": SOURCE,
            "probability": POSSIBLE_OUTAGE,
            "onset": {"start": begin, "resolution": _seconds(lasts), "probabilities": [1.0]},
            "openadr_type": payload.type,
        }
    if payload.type.startswith(ALERT):
        words = ", ".join(str(value) for value in payload.values)
        return {"type": "alert", **interval, "text": f"{payload.type} {words}".strip()[:500]}
    if payload.type == "IMPORT_CAPACITY_LIMIT":
        factor = _factor(event, payload.type, POWER_KW, "KW")
        (limit,) = _numbers(payload, most=1)
        return {"type": "import_limit", **interval, "limit_kw": factor * limit}
    if payload.type == "PRICE":
        currency = _unit(event, payload.type, "currency") or POUND
        if currency != POUND:
            raise _wrong("currency", "is another than the site's", f"Give prices in {POUND}.")
        factor = _factor(event, payload.type, ENERGY_KWH, "KWH")
        values = _numbers(payload)
        # Several values share the time of their interval.
        each = (lasts if span.length is None else span.length) / len(values)
        return {
            "type": "price",
            "source": SOURCE,
            "start": begin,
            "resolution": _seconds(each),
            "price_gbp_per_kwh": [value / factor for value in values[: -(-lasts // each)]],
        }
    return {}


def _seconds(length: pd.Timedelta) -> str:
    """A duration of ISO 8601."""
    return f"PT{round(length.total_seconds())}S"


def _factor(event: OpenADREvent, kind: str, known: Mapping[str, float], usual: str) -> float:
    """Size of the unit that the descriptor of a type names."""
    unit = (_unit(event, kind, "units") or usual).upper()
    if unit not in known:
        cure = f"Give {', '.join([*known][:-1])} or {[*known][-1]}."
        raise _wrong("units", f"of {kind} is none that is known", cure, unit)
    return known[unit]


def _unit(event: OpenADREvent, kind: str, field: str) -> str | None:
    """Unit in the descriptor of a type."""
    for one in event.payloadDescriptors or []:
        if one.payloadType == kind:
            found: str | None = getattr(one, field)
            return found
    return None


def _numbers(payload: Payload, most: int = payloads.MOST_VALUES) -> list[float]:
    """Values of a payload that are numbers."""
    try:
        found = _NUMBERS.validate_python(payload.values)
    except ValidationError:
        found = []
    if not 0 < len(found) <= most:
        wanted = "one number" if most == 1 else "numbers"
        raise _wrong("values", f"of {payload.type} are not {wanted}", "Give [number].") from None
    return found


def _time(text: str, now: pd.Timestamp) -> pd.Timestamp:
    """A time, of which the first of all means now."""
    if NOW.fullmatch(text):
        return now
    try:
        return payloads.read_moment(text)
    except ValueError as error:
        raise _wrong("start", str(error), "Give a time.", text) from None


def _length(text: str, zero: bool = False) -> pd.Timedelta | None:
    """A duration of ISO 8601, None of one without end; months and years have no one length."""
    if text == ENDLESS:
        return None
    cure = f"Give PT1H or P1D; {ENDLESS} has no end."
    problem = _wrong("duration", "is no duration of up to a year", cure, text)
    if not text.startswith("P") or _CALENDAR.fullmatch(text):
        raise problem
    try:
        found = pd.Timedelta(_DURATION.validate_python(text))
    except (ValueError, OverflowError):
        raise problem from None
    if not pd.Timedelta(0) <= found <= LONGEST or not (found or zero):
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
