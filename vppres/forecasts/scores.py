"""How good a forecast was: scores of equally likely values against what came.

Smaller is better for all scores. Shapes: the M values of a forecast are along the first axis, as
in :class:`vppres.forecasts.interface.LoadAndPV`.

References
----------
T. Gneiting, A. E. Raftery: Strictly Proper Scoring Rules, Prediction, and Estimation. JASA 102
(2007). T. Gneiting et al.: Assessing probabilistic forecasts of multivariate quantities. TEST 17
(2008).
"""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.forecasts.interface import quantiles


def crps(paths: Floats, came: Floats) -> Floats:
    """Continuous ranked probability score, in the unit of the values.

    The mean distance from what came, less half of the mean distance of two of the values. Of a
    single value it is the absolute error.

    Parameters
    ----------
    paths : array, shape (M, ...)
        Equally likely values.
    came : array, shape (...)
        What came.

    Examples
    --------
    >>> float(crps(np.array([1.0, 3.0]), np.array(2.0)))
    0.5
    """
    m = len(paths)
    off = np.abs(paths - came).mean(axis=0)
    # Sorted, the i-th value is above i - 1 others and below m - i.
    weight = (2.0 * np.arange(m) + 1.0 - m) / m**2
    apart = np.tensordot(weight, np.sort(paths, axis=0), axes=1)
    return np.asarray(off - apart)


def energy_score(paths: Floats, came: Floats) -> float:
    """Energy score of whole courses, whose distance is Euclid's: (M, W) and (W,).

    >>> energy_score(np.array([[0.0, 0.0], [6.0, 8.0]]), np.array([0.0, 0.0]))
    2.5
    """
    off = np.sqrt(((paths - came) ** 2).sum(axis=1)).mean()
    apart = np.sqrt(((paths[:, np.newaxis] - paths) ** 2).sum(axis=2)).mean()
    return float(off - 0.5 * apart)


def pit(paths: Floats, came: Floats) -> Floats:
    """Probability integral transform: the share of values below what came.

    Of a forecast whose spread is right it is evenly spread between 0 and 1. Each of the ``M + 1``
    places among the values is as likely; equal values count by half.

    >>> float(pit(np.array([1.0, 2.0, 3.0]), np.array(2.5)))
    0.625
    """
    below = (paths < came).sum(axis=0) + 0.5 * (paths == came).sum(axis=0)
    return np.asarray((below + 0.5) / (len(paths) + 1.0))


def interval(paths: Floats, share: float) -> tuple[Floats, Floats]:
    """Ends of the central interval that is to hold a share of what comes."""
    tail = 0.5 * (1.0 - share)
    low, high = quantiles(paths, [tail, 1.0 - tail])
    return low, high


def holds(ends: tuple[Floats, Floats], came: Floats) -> Flags:
    """Whether an interval holds what came."""
    low, high = ends
    return np.asarray((low <= came) & (came <= high))
