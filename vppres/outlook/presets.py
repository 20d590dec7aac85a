"""Statistics and warnings to begin with, from public figures; each says where it comes from.

What a weather warning does *not* say is that one feeder will be out: its hit rate is about the
weather. ``heat`` and ``wind`` therefore multiply the probability of the weather by that of an
outage here (``OUTAGE_HERE``), which an operator who knows the feeder replaces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp

import pandas as pd

from vppres.outlook.durations import Z90
from vppres.outlook.restoration import Notices
from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.scenario.scenario import DEFAULT_VOLL_GBP_PER_KWH

OUTAGE_HERE = 0.005
"""Probability that a feeder is out in weather that was warned of. On 18 and 19 July 2022 some
15,000 homes of Northern Powergrid's 3.9 million lost supply at the peak, 0.4%, under a red warning
of the Met Office."""


ESTIMATE = (0.6, 1.0, 1.8)
"""Quantiles (10, 50, 90 %) of an outage's length as multiples of a lone estimate: an assumption.
After storm Arwen 28 % of customers had had an estimate that was wrong by more than a day (Ofgem
2022)."""

NOTICE = (0.72, 0.05)
"""Share of outages of which a crew says in time that they end, and of other hours in which it says
so in vain: an assumption, in the middle of what pays (``docs/uncertain-outages.md``)."""


@dataclass(frozen=True)
class StatisticsPreset:
    """Outages without a warning."""

    saifi_per_year: float  #: outages of a customer in a year
    caidi_h: float  #: mean length of an outage in h
    duration_sigma: float  #: standard deviation of the logarithm of the length
    source: str  #: where the figures come from
    #: Quantiles of the length as multiples of a lone estimate.
    estimate: tuple[float, float, float] = ESTIMATE


STATISTICS: dict[str, StatisticsPreset] = {
    "average": StatisticsPreset(
        1.02,
        2.0,
        1.0,
        "EIA, Electric Power Annual, table 11.1: United States 2023 without major event days, "
        "SAIFI 1.02, CAIDI 121 min. The spread is an assumption",
    ),
    "with-major-events": StatisticsPreset(
        1.35,
        4.5,
        1.3,
        "EIA, Electric Power Annual, table 11.1: United States 2023 with major events, SAIFI 1.35, "
        "CAIDI 272 min. The spread is an assumption",
    ),
    "equipment": StatisticsPreset(
        1.02,
        3.7 * exp(1.76**2 / 2),
        1.76,
        "Mukherjee, Nateghi and Hastak, Data in Brief 2018: failures of equipment among major "
        "outages in the United States 2000 to 2016, median 3.7 h until all are restored, an upper "
        "view; how often as in EIA's table 11.1",
    ),
    "none": StatisticsPreset(0.0, 2.0, 1.0, "every outage is announced"),
}
"""Statistics by the name that ``[outage_statistics]`` gives as ``preset``."""


@dataclass(frozen=True)
class WarningPreset:
    """Assumptions for a kind of warning, where it does not say."""

    probability: float  #: probability that the outage comes to this feeder
    onset_spread_h: float  #: half the width of the onset around its likely time in h
    #: Quantiles of its length in h.
    p10_h: float
    p50_h: float
    p90_h: float
    source: str  #: where the figures come from


def _lognormal(
    median_h: float, sigma: float, most_h: float = float("inf")
) -> tuple[float, float, float]:
    """Quantiles of 10, 50 and 90 %."""
    factor = exp(Z90 * sigma)
    return median_h / factor, median_h, min(median_h * factor, most_h)


WARNINGS: dict[str, WarningPreset] = {
    "announced": WarningPreset(
        0.95, 1.0, 3.0, 4.0, 5.0, "planned work: an assumption; give the hours that were announced"
    ),
    "rota": WarningPreset(
        0.8,
        0.5,
        *_lognormal(3.7, 0.25),
        "load shed by rota: median of outages for system operability in Mukherjee, Nateghi and "
        "Hastak 2018; probability and spread are assumptions",
    ),
    "psps": WarningPreset(
        0.7,
        6.0,
        *_lognormal(48.0, 0.5),
        "public-safety power shutoff: households in California are out for 48 h on average (PSE "
        "Healthy Energy 2023); probability and spread are assumptions",
    ),
    "wind": WarningPreset(
        0.69 * OUTAGE_HERE,
        6.0,
        *_lognormal(48.4, 1.25),
        "high-wind warnings come true in 69 % (Barnes and others 2007, Weather and Forecasting "
        "22), times an outage here; lengths of whole events in Mukherjee, Nateghi and Hastak 2018",
    ),
    "heat": WarningPreset(
        OUTAGE_HERE,
        6.0,
        *_lognormal(7.0, 1.33, 72.0),
        "a red heat warning, times an outage here; lengths of ten heat events in Mukherjee, "
        "Nateghi and Hastak 2018, at most 72 h",
    ),
}
"""Kinds of warning by the name that ``warnings.csv`` gives as ``preset``."""


@dataclass(frozen=True)
class Statistics:
    """Outages that were not announced, nothing left open.

    ``median_h`` is that of a lognormal length.
    """

    hazard_per_h: float
    median_h: float
    sigma: float
    value_of_lost_load_gbp_per_kwh: float
    estimate: tuple[float, float, float]
    notices: Notices

    @classmethod
    def of(cls, given: OutageStatistics) -> Statistics:
        """Statistics as given, and the preset's for the rest.

        >>> of_a_storm = Statistics.of(OutageStatistics(saifi_per_year=36.5, duration_sigma=0.0))
        >>> round(24 * of_a_storm.hazard_per_h, 6), of_a_storm.median_h
        (0.1, 2.0)
        """
        preset = STATISTICS[given.preset]
        saifi = _first(given.saifi_per_year, preset.saifi_per_year)
        sigma = _first(given.duration_sigma, preset.duration_sigma)
        caidi_h = _first(given.caidi_h, preset.caidi_h)
        voll = _first(given.value_of_lost_load_gbp_per_kwh, DEFAULT_VOLL_GBP_PER_KWH)
        # A lognormal mean lies above its median by half the variance of the logarithm.
        median_h = caidi_h * exp(-(sigma**2) / 2.0)
        low, middle, high = preset.estimate
        middle = _first(given.estimate_p50, middle)
        estimate = (
            min(_first(given.estimate_p10, low), middle),
            middle,
            max(_first(given.estimate_p90, high), middle),
        )
        notices = Notices(
            _first(given.notice_share, NOTICE[0]),
            _first(given.notice_false_share, NOTICE[1]),
            given.notice_h,
        )
        return cls(saifi / HOURS_PER_YEAR, median_h, sigma, voll, estimate, notices)


HOURS_PER_YEAR = 8760.0


def completed(warning: OutageWarning) -> OutageWarning:
    """A warning with what its preset says where it says nothing itself."""
    preset = WARNINGS.get(warning.preset)
    if not preset or warning.all_clear:
        return warning
    found = warning
    if found.probability is None:
        found = replace(found, probability=preset.probability)
    if found.onset_likely and not (found.onset_earliest or found.onset_latest):
        spread = pd.Timedelta(hours=preset.onset_spread_h)
        found = replace(
            found,
            onset_earliest=found.onset_likely - spread,
            onset_latest=found.onset_likely + spread,
        )
    if not found.says_length:
        found = replace(
            found,
            duration_p10_h=preset.p10_h,
            duration_p50_h=preset.p50_h,
            duration_p90_h=preset.p90_h,
        )
    return found


def _first(given: float | None, otherwise: float) -> float:
    return otherwise if given is None else given
