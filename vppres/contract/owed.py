"""Demand that was dimmed and may still be caught up: arithmetic on arrays.

:mod:`vppres.model.beyond_paper.dimmed` states the same for the solver.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.kinds.customer.physics import ROUNDING
from vppres.scenario.assets import Customers

MOST_SHARE = 2.0
"""Share of its demand that a customer can take at most: as much again as it lacked before."""


@dataclass(frozen=True, eq=False)
class Owed:
    """Demand that dimmed customers lack, by the steps in which it may still be caught up.

    Parameters
    ----------
    kw : array, shape (K, C)
        Demand of a step; that of row k may be caught up in the next k + 1 steps.
    steps : array of int, shape (C,)
        Steps in which each may catch up, 0 for a customer that does not.
    """

    kw: Floats
    steps: Wholes

    @classmethod
    def of(cls, customers: Customers, dt_h: float) -> Owed | None:
        """Nothing is owed yet; None if no customer catches up."""
        steps = np.floor(customers.recovery_h / dt_h + ROUNDING).astype(int)
        if not steps.any():
            return None
        return cls(np.zeros((steps.max(), len(customers))), steps)

    def after(self, load_kw: Floats, share: Floats) -> Owed:
        """Owed demand after a step of this demand, of which each was given a share, (C,) each.

        The oldest is caught up first. Of a customer that is off, nothing is caught up later.

        >>> owed = Owed(np.zeros((2, 1)), np.array([2]))
        >>> owed = owed.after(np.array([10.0]), np.array([0.4]))
        >>> owed.kw.ravel().tolist()
        [0.0, 6.0]
        >>> owed.after(np.array([10.0]), np.array([1.5])).kw.ravel().tolist()
        [1.0, 0.0]
        """
        paid_kw = load_kw * np.maximum(share - 1.0, 0.0)
        before_kw = np.cumsum(self.kw, axis=0) - self.kw
        left_kw = self.kw - np.clip(paid_kw - before_kw, 0.0, self.kw)
        aged = np.vstack([left_kw[1:], np.zeros_like(left_kw[:1])])
        more_kw = np.where(share > 0.0, load_kw * np.maximum(1.0 - share, 0.0), 0.0)
        newest = np.arange(len(aged))[:, None] == self.steps - 1
        return Owed(aged + newest * more_kw, self.steps)

    def valid(self, n_steps: int) -> Floats:
        """Demand that may still be caught up at the beginning of each step of a window, (W, C)."""
        rows = np.vstack([self.kw, np.zeros((n_steps, self.kw.shape[1]))])
        return np.cumsum(rows[::-1], axis=0)[::-1][:n_steps]
