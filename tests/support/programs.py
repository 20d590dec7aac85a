"""Programs as arrays."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from vppres.solve.programs import Program


def knapsack(seed: int, items: int = 30) -> Program:
    """As much worth as fits into three budgets, as a least of its negative."""
    rng = np.random.default_rng(seed)
    none, all_ = np.zeros(items), np.ones(items)
    uses = rng.integers(20, 100, (3, items)).astype(float)
    return Program(
        -rng.integers(20, 100, items).astype(float),
        none,
        all_,
        sp.csc_array(uses),
        np.full(3, -np.inf),
        uses.sum(axis=1) / 2.0,
        np.arange(items),
    )
