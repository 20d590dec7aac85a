"""How long customers of a window may be off at a time: arithmetic on arrays.

:mod:`vppres.model.beyond_paper.longest_off` states the same for the solver.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes

ROUNDING = 1e-9
"""Share of a step by which a limit may miss a whole number of steps."""


@dataclass(frozen=True, eq=False)
class LongestOff:
    """Limits of the n customers that have one, in a window of W steps.

    Parameters
    ----------
    customer : array of int, shape (n,)
        Their positions.
    steps : array of int, shape (n,)
        Steps that each may be off at a time.
    asked : array of bool, shape (W, n)
        Whether a step is beyond the limit if the customer was off in all steps of the window up to
        it: off before the window, or for long enough in it.
    price : array, shape (n,)
        Price of a step beyond it, in weighted customer hours.
    """

    customer: Wholes
    steps: Wholes
    asked: Flags
    price: Floats

    @classmethod
    def of(cls, longest_h: Floats, off_h: Floats, dt_h: float, n_steps: int) -> LongestOff | None:
        """The limits of the window that begins now, without prices; None if none says anything.

        Parameters
        ----------
        longest_h : array, shape (C,)
            How long each may be off at a time in h, infinite for any time.
        off_h : array, shape (C,)
            How long each has been off, 0 if it was served in the step before.
        dt_h : float
            Length of a step in h.
        n_steps : int
            Steps of the window.

        Examples
        --------
        Off for one hour of two: the second step is the first beyond the limit.

        >>> LongestOff.of(np.array([2.0, np.inf]), np.array([1.0, 0.0]), 1.0, 3).asked[:, 0]
        array([False,  True,  True])
        """
        customer = np.flatnonzero(np.isfinite(longest_h))
        steps = np.floor(longest_h[customer] / dt_h + ROUNDING).astype(int)
        before = np.round(off_h[customer] / dt_h).astype(int)
        asked = before + np.arange(n_steps)[:, None] >= steps
        if not asked.any():
            return None
        return cls(customer, np.minimum(steps, n_steps), asked, np.zeros(len(customer)))

    def priced(self, hour_beyond: Floats, dt_h: float) -> LongestOff:
        """The limits at the prices of an hour beyond, (C,)."""
        return replace(self, price=hour_beyond[self.customer] * dt_h)

    def beyond(self, served: Flags) -> Flags:
        """Steps beyond the limit under a service (W, C), shape (W, n)."""
        on = np.cumsum(served[:, self.customer], axis=0)
        before = np.arange(len(on))[:, None] - self.steps - 1
        until = np.take_along_axis(on, np.maximum(before, 0), axis=0)
        return np.asarray(self.asked & (on == np.where(before < 0, 0, until)))

    def cost(self, served: Flags) -> float:
        """Penalty of a service for steps beyond the limits, in weighted customer hours."""
        return float(self.beyond(served).sum(axis=0) @ self.price)

    def first(self, n_steps: int) -> LongestOff | None:
        """The limits of the first steps; None if they say nothing."""
        asked = self.asked[:n_steps]
        if not asked.any():
            return None
        return replace(self, steps=np.minimum(self.steps, len(asked)), asked=asked)


def due(longest_h: Floats, off_h: Floats, dt_h: float) -> Flags:
    """Customers that would be off beyond their longest time now, (C,).

    >>> due(np.array([1.5, np.inf]), np.array([1.0, 1.0]), dt_h=1.0)
    array([ True, False])
    """
    found = np.zeros(len(longest_h), dtype=bool)
    limits = LongestOff.of(longest_h, off_h, dt_h, n_steps=1)
    if limits is not None:
        found[limits.customer] = limits.asked[0]
    return found
