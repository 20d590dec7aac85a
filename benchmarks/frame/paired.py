"""Runs of several kinds on the same days: their columns in the order of the days, and means."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from scipy import stats

from vppres.core.arrays import Floats

CONFIDENCE = 0.95
RESAMPLES = 9999


class OfSeed(Protocol):
    """A run on the day of a seed."""

    @property
    def seed(self) -> int:
        """The day, the same for every kind."""


R = TypeVar("R", bound=OfSeed)


def by_seed(runs: Sequence[R], value: Callable[[R], Any], **kind: object) -> Floats:
    """A value of each run with some attributes, in the order of the seeds; NaN for None."""
    alike = [run for run in runs if all(getattr(run, k) == v for k, v in kind.items())]
    return np.array([value(run) for run in sorted(alike, key=lambda run: run.seed)], dtype=float)


@dataclass(frozen=True)
class Estimate:
    """A mean and its confidence interval."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Floats) -> Estimate:
        """By bootstrap over the days; the mean alone where all are equal or there is but one."""
        mean = float(np.mean(values))
        if len(values) < 2 or np.ptp(values) == 0.0:
            return cls(mean, mean, mean)
        found = stats.bootstrap(
            (values,),
            np.mean,
            n_resamples=RESAMPLES,
            method="percentile",
            confidence_level=CONFIDENCE,
            rng=np.random.default_rng(0),
        )
        return cls(
            mean, float(found.confidence_interval.low), float(found.confidence_interval.high)
        )

    def text(self, form: str) -> str:
        """Mean and interval in a format."""
        return f"{self.mean:{form}} [{self.low:{form}}, {self.high:{form}}]"
