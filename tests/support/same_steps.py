"""Whether two controllers decided the same."""

from __future__ import annotations

import numpy as np

from vppres.live.set_points import SetPoints

FOUND = ("objective", "bound", "gap")


def same(one: SetPoints, other: SetPoints) -> bool:
    """Whether two decisions are the same to the last bit, but for their times of solution."""
    tables = ("customers", "batteries", "pv", "buses")
    return (
        one.time == other.time
        and all(getattr(one, name).equals(getattr(other, name)) for name in tables)
        and one.import_kw == other.import_kw
        and one.solve["status"] == other.solve["status"]
        and np.array_equal(*([s.solve[k] for k in FOUND] for s in (one, other)), equal_nan=True)
    )
