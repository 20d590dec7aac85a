"""Options of a new scenario, and their checks."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import inf, isclose
from typing import Literal

import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.io import schema

PVRule = Literal["auto", "existing", "sized", "none"]
PriceRule = Literal["time-of-use", "flat"]
Outage = tuple[pd.Timestamp, pd.Timestamp]

FIRST_DAY = pd.Timestamp("2025-07-01T00:00:00Z")
# The paper's fleet: 2.542 MWh for a peak load of 4.068 MW.
BATTERY_KWH_PER_PEAK_KW = 0.625

_CLOCK = re.compile(r"(\d{1,2}):(\d{2})")
_STEPS = "a step that divides the day, for example 60, 30 or 15."


@dataclass(frozen=True)
class NewScenarioOptions:
    """Rules of a new scenario.

    Parameters
    ----------
    start : pandas.Timestamp
        Beginning of the first day, with time zone.
    step_minutes : float
        Step length; it must divide a day.
    days : int
        Number of days.
    outages : tuple of (start, end)
        Half-open intervals; without any, 12:00 to 18:00 of the first day.
    tier_shares : tuple of float
        Shares of the customers that are critical, high and low, by count.
    pv : str
        ``existing`` takes the feeder's own PV, ``sized`` the rule, ``auto`` the former where the
        feeder has any, ``none`` no PV.
    pv_share_of_peak, pv_share_of_buses : float
        The rule: PV of this share of the customer's peak load, at this share of the customers.
    battery_kwh_per_peak_kw : float
        Energy of a customer's battery for each kW of its peak load; 0 for no batteries.
    price : str
        ``time-of-use`` or ``flat``.
    v_slack_pu : float, optional
        Voltage of the slack bus; the feeder's if not given.
    export_limit_kw : float
        Largest export of the connection; infinite without limit, 0 imports only.
    export_price_gbp_per_kwh : float
        What exported energy earns.
    seed : int
        Seed of what is drawn: who is in which tier, and who has PV.
    """

    start: pd.Timestamp = FIRST_DAY
    step_minutes: float = 60.0
    days: int = 1
    outages: tuple[Outage, ...] = ()
    tier_shares: tuple[float, float, float] = (0.2, 0.3, 0.5)
    pv: PVRule = "auto"
    pv_share_of_peak: float = 0.5
    pv_share_of_buses: float = 0.8
    battery_kwh_per_peak_kw: float = BATTERY_KWH_PER_PEAK_KW
    price: PriceRule = "time-of-use"
    v_slack_pu: float | None = None
    export_limit_kw: float = inf
    export_price_gbp_per_kwh: float = 0.0
    seed: int = 0


def parse_start(text: str) -> pd.Timestamp:
    """Beginning of the first day, written with its time zone.

    >>> parse_start("2025-07-01T00:00+01:00").isoformat()
    '2025-07-01T00:00:00+01:00'
    """
    try:
        return _dated(text)
    except ValueError:
        raise InputError(
            Problem(
                "options",
                "is not a date with a time zone",
                "Write it with an offset, for example 2025-07-01T00:00Z.",
                field="start",
                value=text,
            )
        ) from None


def parse_outage(text: str, start: pd.Timestamp) -> Outage:
    """An outage written as ``start..end``: times of the first day, or dates with a time zone.

    >>> parse_outage("12:00..18:00", pd.Timestamp("2025-07-01T00:00:00Z"))[1].hour
    18
    """
    parts = text.split("..")
    try:
        first, last = (_moment(part, start) for part in parts)
    except ValueError:
        raise InputError(
            Problem(
                "options",
                "is not an interval of time",
                "Write start..end, for example 12:00..18:00 (first day) or "
                "2025-07-02T06:00Z..2025-07-02T09:00Z.",
                field="outage",
                value=text,
            )
        ) from None
    return first, last


def _moment(text: str, start: pd.Timestamp) -> pd.Timestamp:
    """A time of the first day, or a date with its own time zone."""
    clock = _CLOCK.fullmatch(text.strip())
    if clock:
        hours, minutes = (int(part) for part in clock.groups())
        if hours > 24 or minutes > 59:
            raise ValueError(text)
        return start.normalize() + pd.Timedelta(hours=hours, minutes=minutes)
    return _dated(text).tz_convert(start.tzinfo)


def _dated(text: str) -> pd.Timestamp:
    """A date with its time zone."""
    moment = pd.Timestamp(text.strip())
    if pd.isna(moment) or moment.tzinfo is None:
        raise ValueError(text)
    return moment


def check_options(options: NewScenarioOptions) -> list[Problem]:
    """Options out of their range."""
    shares = options.tier_shares
    faults: list[tuple[bool, str, object, str, str]] = [
        (
            not (options.step_minutes >= 1 and (1440 / options.step_minutes).is_integer()),
            "step_minutes",
            options.step_minutes,
            "must be at least 1 and divide a day",
            f"Give {_STEPS}",
        ),
        (
            not 1 <= options.days <= schema.MAX_GRID_DAYS,
            "days",
            options.days,
            f"must lie between 1 and {schema.MAX_GRID_DAYS}",
            "Give the number of days.",
        ),
        (
            min(shares) < 0 or not isclose(sum(shares), 1.0, abs_tol=1e-9),
            "tier_shares",
            shares,
            "must be shares that add up to 1",
            "Give critical, high and low, for example 0.2 0.3 0.5.",
        ),
        (
            not 0 < options.pv_share_of_peak <= 10,
            "pv_share_of_peak",
            options.pv_share_of_peak,
            "must lie between 0 and 10",
            "Give kW of PV per kW of peak load, for example 0.5.",
        ),
        (
            not 0 <= options.pv_share_of_buses <= 1,
            "pv_share_of_buses",
            options.pv_share_of_buses,
            "must lie between 0 and 1",
            "Give the share of customers with PV, for example 0.8.",
        ),
        (
            not 0 <= options.battery_kwh_per_peak_kw <= 100,
            "battery_kwh_per_peak_kw",
            options.battery_kwh_per_peak_kw,
            "must lie between 0 and 100",
            "Give kWh per kW of peak load, for example 0.625.",
        ),
        (
            not options.export_limit_kw >= 0,
            "export_limit_kw",
            options.export_limit_kw,
            "must be at least 0",
            "Give kW; 0 imports only.",
        ),
        (
            not abs(options.export_price_gbp_per_kwh) <= schema.MAX_PRICE,
            "export_price_gbp_per_kwh",
            options.export_price_gbp_per_kwh,
            f"must lie between -{schema.MAX_PRICE:g} and {schema.MAX_PRICE:g}",
            "Give GBP per kWh, for example 0.05.",
        ),
        (options.seed < 0, "seed", options.seed, "must be at least 0", "Give another seed."),
    ]
    problems = [
        Problem("options", message, cure, field=field, value=value)
        for wrong, field, value, message, cure in faults
        if wrong
    ]
    return problems or _check_outages(options)


def _check_outages(options: NewScenarioOptions) -> list[Problem]:
    """Outages that are empty, leave the scenario, or cut a step."""
    step = pd.Timedelta(minutes=options.step_minutes)
    end = options.start + pd.Timedelta(days=options.days)
    problems = []
    for first, last in outages_of(options):
        cut = any((moment - options.start) % step != pd.Timedelta(0) for moment in (first, last))
        message = (
            "must end after it begins"
            if not first < last
            else "lies outside the scenario"
            if first < options.start or last > end
            else "begins or ends inside a step"
            if cut
            else None
        )
        if message:
            problems.append(
                Problem(
                    "options",
                    message,
                    f"The scenario is {options.start.isoformat()} to "
                    f"{end.isoformat()} in steps of {options.step_minutes:g} min.",
                    field="outage",
                    value=f"{first.isoformat()}..{last.isoformat()}",
                )
            )
    return problems


def outages_of(options: NewScenarioOptions) -> tuple[Outage, ...]:
    """The outages asked for, or the one of the paper's day."""
    return options.outages or (parse_outage("12:00..18:00", options.start),)
