"""Cold-load pickup as it happens: demand after a restoration, kept apart from the model."""

from __future__ import annotations

from math import ceil
from typing import Any, ClassVar

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.scenario.rules import SwitchingRules


class ColdLoad:
    """Higher demand of restored customers, and for how many more steps it lasts.

    Parameters
    ----------
    rules : SwitchingRules
        Factor and duration; the other rules are of no concern here.
    dt_h : float
        Length of a step in h.
    n_customers : int
        Customers C, all served before the first step.

    Examples
    --------
    >>> load = ColdLoad(SwitchingRules(cold_load_factor=1.5), dt_h=1.0, n_customers=1)
    >>> for served in (False, True, True):
    ...     print(load.factors(np.array([served])))
    ...     load.advance(np.array([served]))
    [1.]
    [1.5]
    [1.]
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {"served": Flags, "steps_left": Wholes}

    def __init__(self, rules: SwitchingRules, dt_h: float, n_customers: int) -> None:
        self.factor = rules.cold_load_factor
        self.steps = max(ceil(rules.cold_load_h / dt_h - 1e-9), 1)
        self.served = np.ones(n_customers, dtype=bool)
        self.steps_left = np.zeros(n_customers, dtype=int)

    def factors(self, served: Flags) -> Floats:
        """Demand of each customer in this step as a multiple of the usual one, (C,)."""
        cold = served & (~self.served | (self.steps_left > 0))
        return np.where(cold, self.factor, 1.0)

    def advance(self, served: Flags) -> None:
        """End the step."""
        left = np.where(served & ~self.served, self.steps, self.steps_left)
        self.steps_left = np.where(served, np.maximum(left - 1, 0), 0)
        self.served = served.copy()
