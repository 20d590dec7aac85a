"""Options of a new scenario, and their checks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, isclose
from pathlib import Path
from typing import Any, Literal
from zoneinfo import ZoneInfo

import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.feeders.series.clocks import check_zone, grid_from, local_midnight, time_of_day
from vppres.io import schema
from vppres.scenario.option_table import NEW_OPTIONS, NumberRange
from vppres.scenario.timegrid import UTC, TimeGrid

PVRule = Literal["existing", "sized", "none"]
ProfileUnit = Literal["kw", "mw", "pu", "wh", "kwh", "mwh"]
Outage = tuple[pd.Timestamp, pd.Timestamp]

FIRST_DAY = pd.Timestamp("2025-07-01T00:00:00Z")
# The paper's fleet: 2.542 MWh for a peak load of 4.068 MW.
BATTERY_KWH_PER_PEAK_KW = 0.625
TIER_SHARES = (0.2, 0.3, 0.5)
PV_SHARE_OF_PEAK = 0.5
PV_SHARE_OF_BUSES = 0.8

_CLOCK = re.compile(r"(\d{1,2}):(\d{2})")
_RANGES = {
    "step_minutes": NumberRange(
        1,
        1440,
        "must be at least 1 and divide a day",
        "Give a step that divides the day, for example 60, 30 or 15.",
    ),
    "days": NumberRange(
        1,
        schema.MAX_GRID_DAYS,
        f"must lie between 1 and {schema.MAX_GRID_DAYS}",
        "Give the number of days.",
    ),
    "pv_share_of_peak": NumberRange(
        1e-9, 10, "must lie between 0 and 10", "Give kW of PV per kW of peak load, for example 0.5."
    ),
    "battery_kwh_per_peak_kw": NumberRange(
        0, 100, "must lie between 0 and 100", "Give kWh per kW of peak load, for example 0.625."
    ),
    "export_price_gbp_per_kwh": NumberRange(
        -schema.MAX_PRICE,
        schema.MAX_PRICE,
        f"must lie between -{schema.MAX_PRICE:g} and {schema.MAX_PRICE:g}",
        "Give GBP per kWh, for example 0.05.",
    ),
    "seed": NumberRange(0, inf, "must be at least 0", "Give another seed."),
    "max_gap_minutes": NumberRange(
        0,
        7 * 1440,
        "must lie between 0 and a week",
        "Give the longest gap that is filled, for example 120.",
    ),
    "profile_step_minutes": NumberRange(
        0, inf, "must be positive", "Give minutes, for example 15.", open_least=True
    ),
}

_DEFAULT: dict[str, Any] = {option.field: option.default for option in NEW_OPTIONS}


@dataclass(frozen=True)
class NewScenarioOptions:
    """Rules of a new scenario; defaults are those of :mod:`vppres.scenario.option_table`.

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
    draw_tiers : bool
        Whether customers that the source gives no tier draw one. Otherwise all customers are in
        one tier, or in the lowest where the source gives a tier to others.
    tier_shares : tuple of float, optional
        Shares of the customers that draw critical, high and low, by count; 0.2, 0.3 and 0.5.
    pv : str
        ``existing`` takes the source's generators, ``sized`` invents PV in the place of the
        source's, ``none`` takes no generator at all.
    pv_share_of_peak : float, optional
        Sized PV as a share of the customer's peak load; 0.5.
    add_batteries : bool
        Whether every customer gets a battery, besides those of the source.
    battery_kwh_per_peak_kw : float, optional
        Energy of an added battery for each kW of the customer's peak load; 0.625, that of the
        paper's fleet.
    v_slack_pu : float, optional
        Voltage of the slack bus; the feeder's if not given.
    export_limit_kw : float
        Largest export of the connection; infinite without limit, 0 imports only.
    export_price_gbp_per_kwh : float
        What exported energy earns.
    accept_deviation : bool
        Whether voltages may be more than 0.005 pu away from those of the source.
    seed : int
        Seed of what is drawn: who is in which tier, and who has PV.
    time_zone : str, optional
        Zone of the feeder's clocks: days begin and end with it, and times without offset are in
        it. UTC, and no time without offset, if not given.
    profiles : str or Path, optional
        A folder or file of series, or ``source`` for those that come with the network; without it
        load and PV follow one bundled day.
    profile_unit : str, optional
        ``kw``, ``mw``, ``pu``, ``wh``, ``kwh`` or ``mwh``, for series whose columns and files do
        not say.
    profile_step_minutes : float, optional
        Length of a row of series without times; the first row begins with the scenario.
    max_gap_minutes : float
        Longest gap of a series that is filled.
    """

    start: pd.Timestamp = FIRST_DAY
    step_minutes: float = _DEFAULT["step_minutes"]
    days: int = _DEFAULT["days"]
    outages: tuple[Outage, ...] = ()
    draw_tiers: bool = _DEFAULT["draw_tiers"]
    tier_shares: tuple[float, float, float] | None = _DEFAULT["tier_shares"]
    pv: PVRule = _DEFAULT["pv"]
    pv_share_of_peak: float | None = _DEFAULT["pv_share_of_peak"]
    add_batteries: bool = _DEFAULT["add_batteries"]
    battery_kwh_per_peak_kw: float | None = _DEFAULT["battery_kwh_per_peak_kw"]
    v_slack_pu: float | None = _DEFAULT["v_slack_pu"]
    export_limit_kw: float = _DEFAULT["export_limit_kw"]
    export_price_gbp_per_kwh: float = _DEFAULT["export_price_gbp_per_kwh"]
    accept_deviation: bool = _DEFAULT["accept_deviation"]
    seed: int = _DEFAULT["seed"]
    time_zone: str | None = _DEFAULT["time_zone"]
    profiles: str | Path | None = _DEFAULT["profiles"]
    profile_unit: ProfileUnit | None = _DEFAULT["profile_unit"]
    profile_step_minutes: float | None = _DEFAULT["profile_step_minutes"]
    max_gap_minutes: float = _DEFAULT["max_gap_minutes"]

    @property
    def zone(self) -> str:
        """Zone of the days."""
        return self.time_zone or UTC

    @property
    def grid(self) -> TimeGrid:
        """The steps of the days; InputError if they do not fill them."""
        return grid_from(self.start, self.days, self.step_minutes, self.zone)


def first_day(start: str | None, date: str | None, zone: str | None) -> pd.Timestamp:
    """Beginning of the first day, by its time or by its date on the clocks of a zone.

    >>> first_day(None, "2025-10-26", "Europe/London").isoformat()
    '2025-10-26T00:00:00+01:00'
    """
    if start is not None and date is not None:
        raise InputError.of(
            "options", "is given beside a date", "Keep one.", field="start", value=start
        )
    if zone is not None and (problems := check_zone(zone)):
        raise InputError(problems)
    if date is not None:
        return local_midnight(date, zone or UTC)
    if start is None:
        return FIRST_DAY if zone is None else local_midnight("2025-07-01", zone)
    return parse_start(start, zone)


def parse_start(text: str, zone: str | None = None) -> pd.Timestamp:
    """Beginning of the first day, written with its offset, or as its clocks show it.

    >>> parse_start("2025-07-01T00:00+01:00").isoformat()
    '2025-07-01T00:00:00+01:00'
    """
    try:
        return _dated(text, zone)
    except ValueError:
        raise InputError.of(
            "options",
            "is not a date with a time zone",
            "Write it with an offset, for example 2025-07-01T00:00Z, or give --time-zone.",
            field="start",
            value=text,
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
        raise InputError.of(
            "options",
            "is not an interval of time",
            "Write start..end, for example 12:00..18:00 (first day) or "
            "2025-07-02T06:00Z..2025-07-02T09:00Z.",
            field="outage",
            value=text,
        ) from None
    return first, last


def _moment(text: str, start: pd.Timestamp) -> pd.Timestamp:
    """A time of the first day, or a date with its own time zone."""
    clock = _CLOCK.fullmatch(text.strip())
    if clock:
        hours, minutes = (int(part) for part in clock.groups())
        if hours > 24 or minutes > 59:
            raise ValueError(text)
        return time_of_day(start, hours, minutes)
    return _dated(text).tz_convert(start.tzinfo)


def _dated(text: str, zone: str | None = None) -> pd.Timestamp:
    """A date with its offset, or on the clocks of a zone; in the zone, if there is one."""
    moment = pd.Timestamp(text.strip())
    if zone is not None and not pd.isna(moment):
        if moment.tzinfo is None:
            return time_of_day(local_midnight(text.strip()[:10], zone), moment.hour, moment.minute)
        return moment.tz_convert(ZoneInfo(zone))
    if pd.isna(moment) or moment.tzinfo is None:
        raise ValueError(text)
    return moment


def check_options(options: NewScenarioOptions) -> list[Problem]:
    """Options of another kind, out of their range, and sizes of what was not asked for."""
    wrong_kind = [p for one in NEW_OPTIONS for p in one.problems(getattr(options, one.field))]
    if wrong_kind:
        return wrong_kind
    shares = options.tier_shares or TIER_SHARES
    minutes = options.step_minutes
    problems = [
        _fault(name, getattr(options, name), allowed.message, allowed.cure)
        for name, allowed in _RANGES.items()
        if getattr(options, name) is not None and not allowed.holds(getattr(options, name))
    ]
    if minutes >= 1 and not (1440 / minutes).is_integer():
        wrong = _RANGES["step_minutes"]
        problems.append(_fault("step_minutes", minutes, wrong.message, wrong.cure))
    if not options.export_limit_kw >= 0:  # infinite without limit
        message, cure = "must be at least 0", "Give kW; 0 imports only."
        problems.append(_fault("export_limit_kw", options.export_limit_kw, message, cure))
    if (
        len(shares) != len(TIER_SHARES)
        or min(shares) < 0
        or not isclose(sum(shares), 1.0, abs_tol=1e-9)
    ):
        message = "must be three shares that add up to 1"
        cure = "Give critical, high and low, for example 0.2 0.3 0.5."
        problems.append(_fault("tier_shares", shares, message, cure))
    problems += [*_sizes_of_nothing(options), *check_zone(options.zone)]
    return problems or _check_outages(options)


def _fault(name: str, value: object, message: str, cure: str) -> Problem:
    return Problem("options", message, cure, field=name, value=value)


def _sizes_of_nothing(options: NewScenarioOptions) -> Iterator[Problem]:
    """Sizes that are given while what they size was not asked for."""
    asked = {
        "tier_shares": (options.draw_tiers, "--draw-tiers"),
        "pv_share_of_peak": (options.pv == "sized", "--pv sized"),
        "battery_kwh_per_peak_kw": (options.add_batteries, "--add-batteries"),
    }
    for name, (wanted, flag) in asked.items():
        value = getattr(options, name)
        if value is not None and not wanted:
            message = "is given, and nothing is drawn or added that it could size"
            yield _fault(name, value, message, f"Add {flag}, or leave it out.")


def _check_outages(options: NewScenarioOptions) -> list[Problem]:
    """Outages that are empty, leave the scenario, or cut a step."""
    try:
        end = options.grid.end
    except InputError as error:
        return [problem for problem in error.problems if isinstance(problem, Problem)]
    start, step = options.start, pd.Timedelta(minutes=options.step_minutes)
    cure = (
        f"The scenario is {start.isoformat()} to {end.isoformat()} in steps of "
        f"{options.step_minutes:g} min."
    )
    problems = []
    for first, last in outages_of(options):
        interval = f"{first.isoformat()}..{last.isoformat()}"
        if not first < last:
            message = "must end after it begins"
        elif first < start or last > end:
            message = "lies outside the scenario"
        elif any((moment - start) % step != pd.Timedelta(0) for moment in (first, last)):
            message = "begins or ends inside a step"
        else:
            continue
        problems.append(_fault("outage", interval, message, cure))
    return problems


def outages_of(options: NewScenarioOptions) -> tuple[Outage, ...]:
    """The outages asked for, or the one of the paper's day."""
    return options.outages or (parse_outage("12:00..18:00", options.start),)
