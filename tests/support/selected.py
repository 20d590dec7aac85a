"""How far given values are from the rows of a selection."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.solve.selection import CONE, Selected


def missed_by(selected: Selected, values: Mapping[str, Any]) -> dict[str, Floats]:
    """By how much letters' values miss each family of a filled selection, in its rows' shape."""
    numbers = selected.numbers()
    x = np.zeros(len(numbers.cost))
    for name, first in selected.first.items():
        if name in values:
            flat = np.ravel(np.array(values[name], dtype=float), order="F")
            x[first : first + len(flat)] = flat
    return rows_missed(selected, numbers.rows @ x - numbers.limit)


def rows_missed(selected: Selected, over: Floats) -> dict[str, Floats]:
    """Excess of rows over their limits, by part."""
    found = {}
    for part in selected.parts:
        rows = over[selected.rows_of[part.name]]
        if part.kind == CONE:
            radius, P, Q = -rows.reshape(-1, 3).T
            found[part.name] = np.reshape(
                np.hypot(P, Q) - radius, (selected.sheet.n_steps, -1), order="F"
            )
        else:
            found[part.name] = np.reshape(rows, part.shape, order="F")
    return found
