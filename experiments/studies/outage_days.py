"""Days with outages that are foreseen, missed or called in vain, drawn from a seed.

What is announced is the posterior of someone who sees noisy signs of the truth. Time of onset and
logarithm of the duration are normal with normal signs, and the probability follows a likelihood
ratio, so that beliefs are calibrated by construction: of the outages announced with 70 % seven in
ten come, and nine in ten restorations come before ``duration_p90_h``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator

from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.scenario.scenario import Scenario

Z90 = 1.2815515655446004
"""Standard deviations from the median to the 90 % quantile of a normal distribution."""

HOURS_A_DAY = 24.0
HOURS_A_YEAR = 8760.0

HALF_WIDTH = 6.0**0.5
"""Half the base of a symmetric triangle, in its standard deviations."""


@dataclass(frozen=True)
class OutageClimate:
    """How outages and their warnings come."""

    warned: float = 0.9  #: share of days with warnings of an outage around noon
    comes: float = 0.74  #: share of first warnings after which it comes
    hazard_per_h: float = 0.004  #: rate of outages that nobody foresees, at any time of any day
    #: Mean and standard deviation of an announced onset in hours after midnight.
    onset_h: float = 12.0
    onset_std_h: float = 1.5
    #: Median, and standard deviation of the logarithm, of every duration.
    duration_median_h: float = 4.0
    duration_sigma: float = 0.5
    lead_h: tuple[int, int] = (2, 7)  #: least and largest lead time of the first warning
    onset_sign_std_h: float = 0.5  #: error of a sign of the onset for each hour ahead
    duration_sign: float = 1.5  #: error of a sign of the duration's logarithm before the outage
    restoration_sign: float = 1.0  #: the same once the outage is there
    #: Distance, in standard deviations, between signs of an outage that comes and of a false alarm.
    sign_of_coming: float = 0.5

    @property
    def statistics(self) -> OutageStatistics:
        """What an operator who knows the climate says of outages without a warning."""
        return OutageStatistics(
            saifi_per_year=self.hazard_per_h * HOURS_A_YEAR,
            caidi_h=float(self.duration_median_h * np.exp(self.duration_sigma**2 / 2)),
            duration_sigma=self.duration_sigma,
        )

    def duration_h(self, rng: Generator) -> float:
        """A random duration."""
        return self.duration_median_h * float(np.exp(self.duration_sigma * rng.standard_normal()))


@dataclass(frozen=True)
class Outage:
    """Onset in hours after midnight, and duration in h."""

    onset_h: float
    duration_h: float

    @property
    def steps(self) -> range:
        """Hours without grid: those nearest, and one at least."""
        begin = round(self.onset_h)
        return range(begin, begin + max(round(self.duration_h), 1))


@dataclass(frozen=True)
class OutageDay:
    """The truth of a day, and what was said of it."""

    expected: Outage | None  #: the outage of the warnings, whether it comes or not
    comes: bool  #: whether it comes
    surprise: Outage | None  #: an outage that nobody foresaw
    warnings: tuple[OutageWarning, ...]  #: in the order of their times

    @property
    def outages(self) -> list[Outage]:
        """What really happens."""
        announced = self.expected if self.comes else None
        return [outage for outage in (announced, self.surprise) if outage is not None]

    @property
    def kind(self) -> str:
        """Whether its first outage was announced or not, or that there is none."""
        if self.comes:
            return "announced"
        if self.surprise is not None:
            return "unannounced"
        return "quiet" if self.expected is None else "false alarm"


@dataclass(frozen=True)
class Normal:
    """A belief in a number, which signs of it sharpen."""

    mean: float
    std: float

    def seen(self, sign: float, error: float) -> Normal:
        """The belief after an unbiased sign with a normal error."""
        precision = self.std**-2 + error**-2
        mean = (self.mean * self.std**-2 + sign * error**-2) / precision
        return Normal(mean, precision**-0.5)


def draw_outage_day(
    seed: int, midnight: pd.Timestamp, climate: OutageClimate | None = None
) -> OutageDay:
    """The outages of a seed and what is said of them, on the day that begins at ``midnight``.

    Examples
    --------
    >>> day = draw_outage_day(3, pd.Timestamp("2022-07-19", tz="UTC"))
    >>> day.kind, len(day.warnings) > 0
    ('announced', True)
    """
    climate = climate or OutageClimate()
    rng = np.random.default_rng([seed, 1503])
    expected = _expected(climate, rng)
    comes = expected is not None and bool(rng.random() < climate.comes)
    surprise = _surprise(climate, rng)
    if comes and expected is not None and surprise is not None and _touch(expected, surprise):
        surprise = None
    messages: list[OutageWarning] = []
    if expected is not None:
        writer = _Writer(climate, midnight, expected, "announced", rng)
        messages += writer.before(comes)
        messages += writer.during() if comes else [writer.all_clear()]
    if surprise is not None:
        messages += _Writer(climate, midnight, surprise, "surprise", rng).during()
    messages.sort(key=lambda message: message.issued_at)
    return OutageDay(expected, comes, surprise, tuple(messages))


def _expected(climate: OutageClimate, rng: Generator) -> Outage | None:
    """What the warnings of a day are about, None on a day without."""
    if rng.random() >= climate.warned:
        return None
    onset_h = climate.onset_h + climate.onset_std_h * float(rng.standard_normal())
    return Outage(onset_h, climate.duration_h(rng))


def _surprise(climate: OutageClimate, rng: Generator) -> Outage | None:
    """The first outage of a day that nobody foresees, None if there is none."""
    onset_h = float(rng.exponential(1.0 / climate.hazard_per_h))
    outage = Outage(onset_h, climate.duration_h(rng))
    return outage if onset_h < HOURS_A_DAY - 1.0 else None


def _touch(one: Outage, other: Outage) -> bool:
    """Whether two outages leave no hour with grid between them."""
    return one.steps.start <= other.steps.stop and other.steps.start <= one.steps.stop


class _Writer:
    """Writes the messages of a day from its truth; what it believes sharpens with every sign."""

    def __init__(
        self,
        climate: OutageClimate,
        midnight: pd.Timestamp,
        outage: Outage,
        name: str,
        rng: Generator,
    ) -> None:
        self.climate = climate
        self.midnight = midnight
        self.outage = outage
        self.name = name
        self.rng = rng
        self.onset = Normal(climate.onset_h, climate.onset_std_h)
        self.log_duration = Normal(float(np.log(climate.duration_median_h)), climate.duration_sigma)
        self.log_odds = float(np.log(climate.comes / (1.0 - climate.comes)))

    def before(self, comes: bool) -> list[OutageWarning]:
        """Warnings each hour from the first one to the last before the onset."""
        least, most = self.climate.lead_h
        lead_h = int(self.rng.integers(least, most + 1))
        begin = self.outage.steps.start
        return [self._warning(hour, comes) for hour in range(max(begin - lead_h, 0), begin)]

    def _warning(self, hour: int, comes: bool) -> OutageWarning:
        onset_h = self.outage.onset_h
        error_h = self.climate.onset_sign_std_h * (onset_h - hour)
        self.onset = self.onset.seen(onset_h + error_h * self._noise(), error_h)
        self._see_duration(self.climate.duration_sign)
        distance = self.climate.sign_of_coming
        sign = distance * ((0.5 if comes else -0.5) * distance + self._noise())
        self.log_odds += sign
        reach_h = HALF_WIDTH * self.onset.std
        likely_h = max(self.onset.mean, hour + 0.5)
        return OutageWarning(
            issued_at=self._at(hour),
            outage=self.name,
            onset_earliest=self._at(max(self.onset.mean - reach_h, hour)),
            onset_likely=self._at(likely_h),
            onset_latest=self._at(max(self.onset.mean + reach_h, likely_h + 0.5)),
            probability=1.0 / (1.0 + float(np.exp(-self.log_odds))),
            **self._durations(),
        )

    def during(self) -> list[OutageWarning]:
        """Estimates of the restoration, each hour of the outage."""
        return [self._estimate(hour) for hour in self.outage.steps]

    def _estimate(self, hour: int) -> OutageWarning:
        self._see_duration(self.climate.restoration_sign)
        return OutageWarning(
            issued_at=self._at(hour),
            outage=self.name,
            onset_likely=self._at(self.outage.steps.start),
            probability=1.0,
            **self._durations(),
        )

    def all_clear(self) -> OutageWarning:
        """The end of a false alarm, one to three hours after the onset that did not come."""
        hour = int(np.ceil(self.outage.onset_h)) + int(self.rng.integers(0, 3))
        return OutageWarning(self._at(hour), self.name, probability=0.0)

    def _see_duration(self, error: float) -> None:
        truth = float(np.log(self.outage.duration_h))
        self.log_duration = self.log_duration.seen(truth + error * self._noise(), error)

    def _durations(self) -> dict[str, Any]:
        belief = self.log_duration
        return {
            f"duration_p{share}_h": float(np.exp(belief.mean + z * belief.std))
            for share, z in ((10, -Z90), (50, 0.0), (90, Z90))
        }

    def _noise(self) -> float:
        return float(self.rng.standard_normal())

    def _at(self, hour: float) -> pd.Timestamp:
        return (self.midnight + pd.Timedelta(hours=hour)).round("min")


def with_outage_day(
    scenario: Scenario, day: OutageDay, climate: OutageClimate | None = None
) -> Scenario:
    """A scenario whose outages are those of a day, with what was said of them; hourly steps."""
    hour = np.arange(scenario.grid.n_steps)
    out = np.zeros(len(hour), dtype=bool)
    for outage in day.outages:
        out |= np.isin(hour, outage.steps)
    with_grid = np.where(scenario.outage, np.inf, scenario.grid_limit_kw)
    return replace(
        scenario,
        grid_limit_kw=np.where(out, 0.0, with_grid),
        warnings=day.warnings,
        outage_statistics=(climate or OutageClimate()).statistics,
    )


def biased(
    warnings: Sequence[OutageWarning], shift_h: float = 0.0, factor: float = 1.0
) -> tuple[OutageWarning, ...]:
    """The warnings of someone who is wrong about durations: longer by hours or by a factor."""
    return tuple(_wrong(warning, shift_h, factor) for warning in warnings)


INCIDENT = "INC-1"
WRONG_SHARE = 0.28
"""Share of estimates of restoration that say nothing of the truth: after storm Arwen 28 % of
customers had had one that was wrong by more than a day (Ofgem 2022)."""

ESTIMATE_EVERY_H = 2
NOTICE_H = 1.0
NOTICE_SHARE, FALSE_SHARE = 0.72, 0.05
"""How well a crew's notice of the end is to be believed."""


def by_several_names(day: OutageDay, seed: int, climate: OutageClimate | None = None) -> OutageDay:
    """The day with estimates of the outage system, under a name of its own, every two hours.

    Some are wrong: they are those of another outage, with the same claimed spread.
    """
    climate = climate or OutageClimate()
    rng = np.random.default_rng([seed, 1543])
    messages: list[OutageWarning] = []
    told = 0
    for one in day.warnings:
        onset = one.onset_likely
        if one.all_clear or onset is None or one.issued_at < onset:
            messages.append(one)
            continue
        told += 1
        wrong = rng.random() < WRONG_SHARE
        factor = climate.duration_h(rng) / climate.duration_median_h if wrong else 1.0
        if told % ESTIMATE_EVERY_H:
            messages.append(replace(_wrong(one, 0.0, factor), outage=INCIDENT))
    return replace(day, warnings=tuple(messages))


def before_the_onset(day: OutageDay) -> OutageDay:
    """The day without any estimate of the end of an outage that has begun."""
    kept = [
        one
        for one in day.warnings
        if one.all_clear or one.onset_likely is None or one.issued_at < one.onset_likely
    ]
    return replace(day, warnings=tuple(kept))


def with_notices(day: OutageDay, midnight: pd.Timestamp, seed: int) -> OutageDay:
    """The day with a crew's notices: an hour before the end in most cases, else rarely in vain."""
    rng = np.random.default_rng([seed, 1544])
    messages = list(day.warnings)
    for outage in day.outages:
        for hour in outage.steps:
            last = hour == outage.steps[-1]
            if rng.random() < (NOTICE_SHARE if last else FALSE_SHARE):
                now = midnight + pd.Timedelta(hours=hour)
                back = now + pd.Timedelta(hours=NOTICE_H)
                messages.append(OutageWarning(now, "crew", restored_by=back))
    messages.sort(key=lambda message: message.issued_at)
    return replace(day, warnings=tuple(messages))


def _wrong(warning: OutageWarning, shift_h: float, factor: float) -> OutageWarning:
    names = ("duration_p10_h", "duration_p50_h", "duration_p90_h")
    believed = {name: getattr(warning, name) for name in names}
    return replace(
        warning,
        **{
            name: max(factor * hours + shift_h, 0.5)
            for name, hours in believed.items()
            if hours is not None
        },
    )
