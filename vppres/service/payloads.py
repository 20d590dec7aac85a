"""Bodies of requests. Names carry their units; whatever is not named here is refused."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pandas as pd
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    model_validator,
)

from vppres.kinds.table import KINDS, parts
from vppres.live.door import moment_of
from vppres.live.ranges import RANGES
from vppres.service.clock import written

MOST_SERIES = 2_000
MOST_VALUES = 2_000
MOST_READINGS = 20_000
"""Of a batch: what is kept in a transaction of a second or so."""

MOST_FIELDS = 50
"""Of an object: more than any of ours has; of each beyond a mistake would be made."""

LONGEST_NAME = 100
LARGEST_SUM_ERROR = 1e-3
FIRST_YEAR, LAST_YEAR = 2000, 2199

OTHER_CENTURY = "is not a time of this century or the next"
_DURATION = re.compile(r"PT(?=\d)(?:(\d{1,4})H)?(?:(\d{1,6})M)?(?:(\d{1,8})S)?")


def read_moment(value: Any) -> pd.Timestamp:
    """A time in ISO 8601 with an offset.

    >>> read_moment("2026-11-21T20:00:00+01:00").isoformat()
    '2026-11-21T20:00:00+01:00'
    """
    moment = moment_of(value) if isinstance(value, str) else None
    if moment is None:
        raise ValueError("is not a time. Write ISO 8601, for example 2026-07-19T12:00:00Z")
    if moment.tzinfo is None:
        raise ValueError("has no offset. Write one, for example 2026-07-19T12:00:00Z")
    if not FIRST_YEAR <= moment.year <= LAST_YEAR:
        raise ValueError(OTHER_CENTURY)
    return moment


def read_duration(value: Any) -> pd.Timedelta:
    """A duration in ISO 8601, in hours, minutes and seconds.

    >>> read_duration("PT30M")
    Timedelta('0 days 00:30:00')
    """
    found = _DURATION.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise ValueError("is not a duration. Write hours, minutes or seconds, for example PT30M")
    # pandas reads no hours of three digits.
    hours, minutes, whole = (int(number or 0) for number in found.groups())
    duration = pd.Timedelta(seconds=3600 * hours + 60 * minutes + whole)
    if duration <= pd.Timedelta(0):
        raise ValueError("must be longer than nothing")
    return duration


def _within(quantity: str) -> Any:
    """A finite number that a quantity can have."""
    numbers = RANGES[quantity]
    return Field(strict=True, allow_inf_nan=False, ge=numbers.lowest, le=numbers.highest)


Moment = Annotated[
    pd.Timestamp,
    PlainValidator(read_moment),
    PlainSerializer(written),
    WithJsonSchema({"type": "string", "format": "date-time"}),
]
Duration = Annotated[
    pd.Timedelta,
    PlainValidator(read_duration),
    PlainSerializer(lambda length: f"PT{round(length.total_seconds())}S"),
    WithJsonSchema({"type": "string", "pattern": f"^{_DURATION.pattern}$", "examples": ["PT1H"]}),
]
Name = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME, pattern=r"^[^\x00-\x1f\x7f]+$")]
Bus = Annotated[Name, BeforeValidator(lambda bus: str(bus) if type(bus) is int else bus)]
"""A bus of the feeder, by its name or number."""
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Value = Annotated[Any, WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "null"}]})]
"""A number or null; anything else is refused by itself, where the quantity is known."""
Power = Annotated[float, _within("load_kw")]
Limit = Annotated[float, _within("grid_limit_kw")]
Price = Annotated[float, _within("price_gbp_per_kwh")]
Share = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1)]
Hours = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=8760)]
Shape = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=20)]

Probabilities = Annotated[list[Share], Field(fail_fast=True, min_length=1, max_length=MOST_VALUES)]
Powers = Annotated[list[Power], Field(fail_fast=True, min_length=1, max_length=MOST_VALUES)]

OF_SITE = (
    "soc",
    "load_kw",
    "pv_kw",
    "battery_kw",
    "import_kw",
    "source_kva",
    "v_pu",
    "online",
    "grid_on",
    "closed",
)
"""Facts of every site."""

if TYPE_CHECKING:
    Quantity = str
    Kind = str
else:
    OF_UNITS = tuple(name for live in parts("live").values() for name in live.QUANTITIES)
    Quantity = Literal[(*OF_SITE, *OF_UNITS)]
    Kind = Literal[("batteries", "pv", "customers", *KINDS)]
Phase = Annotated[str, Field(pattern=r"^[abc]{1,2}$")]


class Body(BaseModel):
    """Body of a request: fields that are not named are refused."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

    @model_validator(mode="before")
    @classmethod
    def _not_too_many_fields(cls, given: Any) -> Any:
        if isinstance(given, dict) and len(given) > MOST_FIELDS:
            raise ValueError(f"has {len(given)} fields. Leave out those that there are not")
        return given


class Readings(Body):
    """Readings of one quantity of one asset, equally apart; null where one is known to be missing.

    ``soc``, ``load_kw``, ``pv_kw``, ``online`` and ``grid_on`` (1 or 0) hold at their time,
    ``battery_kw`` (charging positive) and ``import_kw`` are means from then on. The asset of
    ``import_kw`` and ``grid_on`` is ``grid``. ``closed`` (1 or 0) is the state of a switch.

    Of chargers of vehicles, ``plugged`` (1 or 0), ``ev_soc``, ``energy_needed_kwh`` and
    ``departure``, in seconds since 1970, hold at their time too; of rooms and tanks ``indoor_c``,
    the temperature in °C; of generating sets ``running`` and ``start_fault`` (1 or 0) and
    ``fuel_litres``. ``genset_kw``, what a set gives, is a mean from its time on.

    On phased feeders powers may have a ``phase``, one of those of the asset's ``phases``: those of
    all its phases are sent in one batch. ``v_pu`` (of a bus) and ``source_kva`` (of ``grid``, or of
    the battery that holds the island) always have one; they are means too.
    """

    source: Name
    asset: Name
    quantity: Quantity
    phase: Phase | None = None
    start: Moment
    resolution: Duration
    values: Annotated[list[Value], Field(min_length=1, max_length=MOST_VALUES)]

    @model_validator(mode="after")
    def _of_our_time(self) -> Readings:
        _check_last(self.start, self.resolution, len(self.values))
        return self


@dataclass(frozen=True)
class Unread:
    """A series that cannot be read, as it was sent, and why."""

    given: Any
    error: ValidationError


def _by_itself(given: Any, read: ValidatorFunctionWrapHandler) -> Readings | Unread:
    """A series, or what is wrong with it: those beside it are read."""
    try:
        found: Readings = read(given)
        return found
    except ValidationError as error:
        return Unread(given, error)


class Telemetry(Body):
    """A batch of readings; to send it twice does no harm."""

    series: list[Annotated[Readings, WrapValidator(_by_itself)]] = Field(
        min_length=1, max_length=MOST_SERIES
    )

    @property
    def each(self) -> list[Readings | Unread]:
        """All series, in their order."""
        return [*self.series]

    @model_validator(mode="after")
    def _not_too_many(self) -> Telemetry:
        readings = (one for one in self.each if isinstance(one, Readings))
        if sum(len(one.values) for one in readings) > MOST_READINGS:
            raise ValueError(f"has more than {MOST_READINGS} readings. Send them in parts")
        return self


class Interval(Body):
    """From a time on, up to another one, or until further notice."""

    source: Name = "operator"
    start: Moment
    end: Moment | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Interval:
        if self.end and self.end <= self.start:
            raise ValueError("ends before it begins. Give a later end, or none")
        return self


class Outage(Interval):
    """No grid; every step that it touches counts."""

    type: Literal["outage"]


class Fault(Interval):
    """A line or a bus that is out of service; every step that it touches counts.

    ``line`` is the bus that the line feeds, ``bus`` one that is out with all of its lines.
    """

    type: Literal["fault"]
    line: Bus | None = None
    bus: Bus | None = None

    @model_validator(mode="after")
    def _of_one_place(self) -> Fault:
        if (self.line is None) == (self.bus is None):
            raise ValueError("names not one place. Give line, the bus that it feeds, or bus")
        return self


class Onset(Body):
    """The probability of each interval to be the one in which an outage begins, if it comes."""

    start: Moment
    resolution: Duration
    probabilities: Probabilities

    @model_validator(mode="after")
    def _sums_to_one(self) -> Onset:
        _check_sum(self.probabilities)
        _check_last(self.start, self.resolution, len(self.probabilities))
        return self


class Lognormal(Body):
    """A length whose logarithm is normal; an estimate without ``sigma`` has the site's spread."""

    family: Literal["lognormal"]
    median_h: Hours
    sigma: Shape | None = None
    max_h: Hours | None = None


class Weibull(Body):
    """A length whose hazard falls with time where ``shape`` is below 1."""

    family: Literal["weibull"]
    scale_h: Hours
    shape: Shape
    max_h: Hours | None = None


class Discrete(Body):
    """One of several lengths."""

    family: Literal["discrete"]
    hours: Annotated[list[Hours], Field(fail_fast=True, min_length=1, max_length=MOST_VALUES)]
    probabilities: Probabilities

    @model_validator(mode="after")
    def _belong_together(self) -> Discrete:
        if len(self.hours) != len(self.probabilities):
            raise ValueError("has lengths without a probability. Give each its own")
        _check_sum(self.probabilities)
        return self


class Until(Body):
    """A known end."""

    family: Literal["until"]
    until: Moment


Length = Annotated[Lognormal | Weibull | Discrete | Until, Field(discriminator="family")]


class Belief(Body):
    """An outage that may come; without a duration it lasts as long as the site's usually do."""

    type: Literal["outage_belief"]
    source: Name = "operator"
    issued_at: Moment | None = None
    probability: Share
    onset: Onset
    duration: Length | None = None
    limit_kw: Literal[0] = 0
    openadr_type: Name | None = None

    @model_validator(mode="after")
    def _ends_after_it_begins(self) -> Belief:
        if isinstance(self.duration, Until) and self.duration.until <= self.onset.start:
            raise ValueError("ends before it begins. Give a later end")
        return self


class Restoration(Body):
    """Notice of a crew on the end of the present outage."""

    type: Literal["restoration"]
    source: Name = "crew"
    not_before: Moment | None = None
    likely: Moment | None = None
    by: Moment | None = None

    @property
    def times(self) -> list[pd.Timestamp]:
        """Times that are given, in the order that they must have."""
        return [one for one in (self.not_before, self.likely, self.by) if one]

    @model_validator(mode="after")
    def _says_something(self) -> Restoration:
        if not self.times:
            raise ValueError("says nothing. Give not_before, likely or by")
        if self.times != sorted(self.times):
            raise ValueError("has times out of order. Give not_before <= likely <= by")
        return self


def _check_last(start: pd.Timestamp, resolution: pd.Timedelta, values: int) -> None:
    """Whether the last of so many values is of our time, by arithmetic that has no end."""
    years = (values - 1) * resolution.total_seconds() / (365.25 * 86_400)
    if start.year + years > LAST_YEAR:
        raise ValueError(f"has values beyond the year {LAST_YEAR}. Give fewer, or nearer ones")


def _check_sum(probabilities: list[float]) -> None:
    if abs(sum(probabilities) - 1.0) > LARGEST_SUM_ERROR:
        raise ValueError("has probabilities that do not sum to 1. Give all that can happen")


class ImportLimit(Interval):
    """No more import than this."""

    type: Literal["import_limit"]
    limit_kw: Limit


class Prices(Body):
    """Import prices of the steps from a time on."""

    type: Literal["price"]
    source: Name = "operator"
    start: Moment
    resolution: Duration
    price_gbp_per_kwh: Annotated[
        list[Price], Field(fail_fast=True, min_length=1, max_length=MOST_VALUES)
    ]

    @model_validator(mode="after")
    def _of_our_time(self) -> Prices:
        _check_last(self.start, self.resolution, len(self.price_gbp_per_kwh))
        return self


class Alert(Interval):
    """Something to be shown; it decides nothing."""

    type: Literal["alert"]
    text: str = Field(max_length=500)


Event = Annotated[
    Outage | Fault | Belief | Restoration | ImportLimit | Prices | Alert,
    Field(discriminator="type"),
]


class Quantiles(Body):
    """The median of each step, and what one in ten lies below or above."""

    p10: Powers | None = None
    p50: Powers
    p90: Powers | None = None

    @model_validator(mode="after")
    def _do_not_cross(self) -> Quantiles:
        ordered = [row for row in (self.p10, self.p50, self.p90) if row]
        if any(len(row) != len(self.p50) for row in ordered):
            raise ValueError("has quantiles of different lengths. Give one value for each step")
        for lower, upper in pairwise(ordered):
            if any(a > b for a, b in zip(lower, upper, strict=True)):
                raise ValueError("has quantiles that cross. Give p10 <= p50 <= p90")
        return self


class Forecasts(Body):
    """Forecast of customers or PV systems, of which the plan takes the median."""

    issued_at: Moment
    start: Moment
    resolution: Duration
    assets: Annotated[
        dict[Name, Quantiles], Field(fail_fast=True, min_length=1, max_length=MOST_SERIES)
    ]

    @model_validator(mode="after")
    def _of_our_time(self) -> Forecasts:
        longest = max(len(one.p50) for one in self.assets.values())
        _check_last(self.start, self.resolution, longest)
        return self


class StepRequest(Body):
    """The step to decide on; the present one if no time is given."""

    time: Moment | None = None


class ClockRequest(Body):
    """Time of a service whose clock is set."""

    now: Moment


OF_KIND = {
    "customers": "served",
    "batteries": "p_kw",
    "pv": "p_kw",
    **{kind: live.SETPOINT for kind, live in parts("live").items()},
}
"""What an operator says of each kind of device."""


class OperatorSetpoint(Body):
    """Set-point of one device from an operator.

    Power of batteries and PV systems, the most that a charger charges with, the temperature of a
    thermostat, power of a generating set (0 stops it), whether a customer is on, and of one that
    may be dimmed the share that it gets.
    """

    kind: Kind
    asset: Name
    p_kw: Number | None = None
    q_kvar: Number = 0.0
    served: bool | None = None
    share: Share | None = None
    p_limit_kw: Power | None = None
    setpoint_c: Number | None = None

    @model_validator(mode="after")
    def _of_its_kind(self) -> OperatorSetpoint:
        said = {name for name in OF_KIND.values() if getattr(self, name) is not None}
        if said != {OF_KIND[self.kind]} or (self.share is not None and not self.served):
            each = ", ".join(f"{name} for {kind}" for kind, name in OF_KIND.items())
            raise ValueError(f"is not of its kind. Give {each}; share for customers that are on")
        return self


class ModeRequest(Body):
    """Mode of the service from now on.

    ``auto`` decides, ``off`` gives defaults only, ``hold`` gives the last set-points again, and
    ``manual`` the operator's, with the last ones for devices that are not named.
    """

    mode: Literal["auto", "hold", "manual", "off"]
    until: Moment | None = None
    reason: str = Field("", max_length=200)
    setpoints: list[OperatorSetpoint] = Field([], max_length=MOST_SERIES)

    @model_validator(mode="after")
    def _ends(self) -> ModeRequest:
        if self.mode in ("hold", "manual") and not self.until:
            raise ValueError("must have an end. Give until")
        if (self.mode == "manual") != bool(self.setpoints):
            raise ValueError("and set-points do not belong together. Give set-points for manual")
        return self


class SwitchingRequest(Body):
    """States of switches that are to be reached: closed, or open."""

    closed: dict[Name, Annotated[bool, Field(strict=True)]] = Field(
        min_length=1, max_length=MOST_SERIES
    )
    reason: str = Field("", max_length=200)


class ConfirmedOperation(Body):
    """The switch of the next operation, as its operator confirms it."""

    switch: Name


class Remark(Body):
    """Why something is done, for the audit."""

    reason: str = Field("", max_length=200)


class Shelf(Remark):
    """Until when an alarm sends no notification, and why."""

    until: Moment


class SetpointStatus(Body):
    """Status of a set-point, in the words of S2."""

    status: Literal["accepted", "rejected", "started", "succeeded", "aborted"]
    value: Number | None = None
    reason: str = Field("", max_length=200)
