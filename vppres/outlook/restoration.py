"""Crews' news of the end of an outage: not yet, or near, or none at all.

Lengths are probabilities of numbers of steps, as in :mod:`vppres.outlook.durations`: entry ``k`` is
that of an outage of ``k + 1`` steps, which ends ``k + 1`` steps after it began.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats


@dataclass(frozen=True)
class Notices:
    """How well a crew that says that the grid will be back soon is to be believed."""

    share: float  #: share of outages of which it is said in time
    false_share: float  #: share of other hours in which it is said in vain
    #: How long before the end it is said in h; None if nothing follows from silence.
    lead_h: float | None

    def likelihood(
        self, ends_h: Floats, now_h: float, said: Sequence[tuple[float, float]], dt_h: float
    ) -> Floats:
        """Likelihood of all that was said and not said, for each end of an outage.

        Ends, in h from its beginning, are those of steps which the outage still touches. ``said``
        has of each notice when it was given, and by when the grid was to be back.

        Examples
        --------
        An outage of at most four hours, in its second: nothing was said of an end within the hour.

        >>> Notices(0.75, 0.0, 1.0).likelihood(np.arange(1.0, 5.0), 1.0, [], 1.0)
        array([0.25, 0.25, 1.  , 1.  ])
        """
        found = np.ones(len(ends_h))
        known = np.zeros(len(ends_h), dtype=bool)
        for given_h, by_h in said:
            right = (given_h < ends_h) & (ends_h < by_h + dt_h)
            # Said again it is no news.
            found *= np.where(right, np.where(known, 1.0, self.share), self.false_share)
            known |= right
        if self.lead_h is not None:
            silent = ~known & (ends_h - self.lead_h <= now_h)
            found[silent] *= (1.0 - self.share) / (1.0 - self.false_share)
        return found


def not_before(duration: Floats, steps: float) -> Floats:
    """Lengths of an outage that lasts so many steps at least; what is longer stays as it was.

    >>> not_before(np.array([0.5, 0.25, 0.25]), 1.5)
    array([0.  , 0.25, 0.25])
    """
    least = int(np.clip(np.ceil(steps - 1e-9) - 1, 0, len(duration) - 1))
    return np.concatenate([np.zeros(least), duration[least:]])
