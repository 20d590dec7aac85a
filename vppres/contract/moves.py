"""Battery powers of the previous plan, so that a new plan need not move them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.core.arrays import Floats


@dataclass(frozen=True, eq=False)
class Moves:
    """Battery powers of the previous plan over the steps of a window."""

    #: Charge less discharge, (W, B); NaN in steps that the previous plan did not reach.
    planned_kw: Floats
    weight: float  #: what a move by a battery's rated power is worth, in kW of line losses

    @classmethod
    def of(cls, plan_kw: Floats, steps_ago: int, n_steps: int, weight: float) -> Moves:
        """Moves of a plan, shape (V, B), that began some steps ago.

        >>> Moves.of(np.array([[1.0], [2.0], [3.0]]), 1, 3, 0.5).planned_kw[:, 0]
        array([ 2.,  3., nan])
        """
        known = plan_kw[steps_ago:][:n_steps]
        beyond = np.full((n_steps - len(known), plan_kw.shape[1]), np.nan)
        return cls(np.vstack([known, beyond]), weight)

    def part(self, steps: slice) -> Moves:
        """Moves in some of the steps."""
        return replace(self, planned_kw=self.planned_kw[steps])

    def targets(self, p_max_kw: Floats) -> tuple[Floats, Floats]:
        """Factors on the battery powers and what their products are to be near, (W, B) each.

        Squared differences are in kW of line losses; they are zero where nothing was planned.
        """
        known = np.isfinite(self.planned_kw)
        factor = np.where(known, np.sqrt(self.weight) / p_max_kw, 0.0)
        return factor, factor * np.where(known, self.planned_kw, 0.0)
