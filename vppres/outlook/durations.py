"""How long an outage lasts, as the probability of each number of steps.

Every function gives an array of length ``n_steps``: entry ``k`` is the probability of a length of
``k + 1`` steps, rounded to the nearest and at least one; the last entry holds all that is longer.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from vppres.core.arrays import Floats
from vppres.scenario.outage_warnings import OutageLength

Z90 = 1.2815515655446004
"""Quantile of the standard normal distribution at 90 %."""

LEAST_SPREAD = 1e-9
"""Standard deviation of a logarithm that is known on one side of its median."""


def known(hours: float, dt_h: float, n_steps: int) -> Floats:
    """A length that is known.

    >>> known(2.0, 1.0, 4)
    array([0., 1., 0., 0.])
    """
    found = np.zeros(n_steps)
    steps = int(np.clip(round(hours / dt_h), 1, n_steps))
    found[steps - 1] = 1.0
    return found


def lognormal(median_h: float, sigma: float, dt_h: float, n_steps: int) -> Floats:
    """A length whose logarithm is normal; ``sigma`` 0 is a known one.

    >>> lognormal(4.0, 0.5, 1.0, 24).argmax() + 1
    np.int64(3)
    """
    if sigma <= 0.0:
        return known(median_h, dt_h, n_steps)
    return _in_steps(ndtr(np.log(_edges_h(dt_h, n_steps) / median_h) / sigma))


def weibull(scale_h: float, shape: float, dt_h: float, n_steps: int) -> Floats:
    """A length whose hazard falls with time where ``shape`` is below 1, as in severe weather."""
    return _in_steps(-np.expm1(-((_edges_h(dt_h, n_steps) / scale_h) ** shape)))


def discrete(
    hours: Sequence[float], probability: Sequence[float], dt_h: float, n_steps: int
) -> Floats:
    """One of several lengths, such as those of an operator's own log.

    >>> discrete([1.0, 3.0], [0.25, 0.75], 1.0, 3)
    array([0.25, 0.  , 0.75])
    """
    found = np.zeros(n_steps)
    for length, weight in zip(hours, probability, strict=True):
        found += weight * known(length, dt_h, n_steps)
    return np.asarray(found / found.sum())


def of_length(length: OutageLength, dt_h: float, n_steps: int) -> Floats:
    """A length as a message gives it; what is beyond its longest counts as that.

    >>> of_length(OutageLength("lognormal", 2.0, 1.0, max_h=3.0), 1.0, 5).round(2)
    array([0.39, 0.2 , 0.41, 0.  , 0.  ])
    """
    if length.family == "discrete":
        found = discrete(length.hours, length.probability, dt_h, n_steps)
    elif length.family == "weibull":
        found = weibull(length.scale_h, length.shape, dt_h, n_steps)
    else:
        found = lognormal(length.scale_h, length.shape, dt_h, n_steps)
    last = int(np.clip(np.ceil(length.max_h / dt_h), 1, n_steps)) - 1
    return np.concatenate([found[:last], [found[last:].sum()], np.zeros(n_steps - 1 - last)])


def between_quantiles(
    p10_h: float, p50_h: float, p90_h: float, dt_h: float, n_steps: int
) -> Floats:
    """A length that keeps all three quantiles: lognormal, each side of the median with its spread.

    A length that can hardly be longer than its median, but much shorter, gets no long tail.

    >>> between_quantiles(1.0, 4.0, 4.0, 1.0, 6).round(2)
    array([0.18, 0.15, 0.12, 0.55, 0.  , 0.  ])
    """
    if p10_h == p50_h == p90_h:
        return known(p50_h, dt_h, n_steps)
    off = np.log(_edges_h(dt_h, n_steps) / p50_h)
    shorter = max(float(np.log(p50_h / p10_h)) / Z90, LEAST_SPREAD)
    longer = max(float(np.log(p90_h / p50_h)) / Z90, LEAST_SPREAD)
    return _in_steps(ndtr(np.where(off < 0.0, off / shorter, off / longer)))


def _edges_h(dt_h: float, n_steps: int) -> Floats:
    """Lengths in h at which rounding passes to the next number of steps, (n_steps - 1,)."""
    return np.asarray((np.arange(1, n_steps) + 0.5) * dt_h)


def _in_steps(below: Floats) -> Floats:
    """Probabilities of the steps from those of lying below the edges."""
    return np.asarray(np.diff(below, prepend=0.0, append=1.0))
