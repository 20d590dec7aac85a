"""Outage warnings against what came: of ten that say 70 %, seven are to be right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtr

from vppres.core.arrays import Floats
from vppres.outlook.durations import Z90
from vppres.outlook.outlook import SeenOutage
from vppres.scenario.outage_warnings import OutageWarning

BINS = 5


@dataclass(frozen=True)
class WarnedOutage:
    """A warning and what came of it.

    Parameters
    ----------
    warning : OutageWarning
        What was said.
    came : SeenOutage or None
        The outage, over; None if none came.
    """

    warning: OutageWarning
    came: SeenOutage | None

    @property
    def length_h(self) -> float:
        """Length of the outage, NaN where none came or it lasts."""
        if self.came is None or self.came.end is None:
            return float("nan")
        return (self.came.end - self.came.start) / pd.Timedelta(hours=1)


def reliability(pairs: Sequence[WarnedOutage], bins: int = BINS) -> pd.DataFrame:
    """How often an outage came of warnings of like probability.

    Parameters
    ----------
    pairs : sequence of WarnedOutage
        Those without a probability are left out.
    bins : int
        Equal parts of 0 to 1.

    Returns
    -------
    DataFrame
        One row for each part that has warnings: their number ``warnings``, the mean probability
        ``said``, the share ``came``, and ``low`` and ``high``, what a right forecast stays between
        in 95 of 100 cases (normal approximation).
    """
    said, came = _said(pairs)
    part = np.minimum((said * bins).astype(int), bins - 1)
    rows = []
    for value in np.unique(part):
        there = part == value
        mean = float(said[there].mean())
        band = 1.96 * float(np.sqrt((said[there] * (1.0 - said[there])).sum())) / there.sum()
        rows.append(
            {
                "warnings": int(there.sum()),
                "said": mean,
                "came": float(came[there].mean()),
                "low": max(mean - band, 0.0),
                "high": min(mean + band, 1.0),
            }
        )
    return pd.DataFrame(rows, columns=["warnings", "said", "came", "low", "high"])


def brier(pairs: Sequence[WarnedOutage]) -> float:
    """Mean squared distance of the probability from what came; NaN of no warning."""
    said, came = _said(pairs)
    return float(((said - came) ** 2).mean()) if len(said) else float("nan")


def duration_pit(pairs: Sequence[WarnedOutage]) -> Floats:
    """Where the lengths of outages lay in what was said of them, evenly spread if that was right.

    The logarithm of the length is normal on either side of the median, such that the quantiles are
    those of the warning. Outages of unknown length, and warnings without a spread, are left out.
    """
    found = []
    for pair in pairs:
        low, middle, high = (
            pair.warning.duration_p10_h,
            pair.warning.duration_p50_h,
            pair.warning.duration_p90_h,
        )
        if low is None or middle is None or high is None or np.isnan(pair.length_h):
            continue
        end = high if pair.length_h > middle else low
        spread = abs(np.log(end / middle)) / Z90
        if spread > 0.0:
            found.append(float(ndtr(np.log(pair.length_h / middle) / spread)))
    return np.array(found)


def _said(pairs: Sequence[WarnedOutage]) -> tuple[Floats, Floats]:
    """Probabilities, and 1 where an outage came."""
    given = [pair for pair in pairs if pair.warning.probability is not None]
    said = np.array([pair.warning.probability for pair in given], dtype=float)
    return said, np.array([pair.came is not None for pair in given], dtype=float)
