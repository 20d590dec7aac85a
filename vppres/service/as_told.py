"""States of the units of each kind as stored plans give them, for their replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vppres.core.arrays import Floats, Names

Plan = Mapping[str, Any]
Plans = Sequence[Plan]  # by step, empty for a step without


def expected_by(plan: Plan) -> Mapping[str, Any]:
    """Values that a plan expects of its step; empty for a plan that the controller did not make."""
    return plan.get("expected") or {}


def said_of(
    plan: Plan, what: str, ids: Names, reckoned: Floats, field: str | None = None
) -> Floats:
    """State on which a step was decided, by unit; as reckoned where its plan does not give it."""
    told = expected_by(plan).get(what, {})
    values = [told.get(str(name)) for name in ids]
    found = [one[field] if field is not None and one is not None else one for one in values]
    return np.where([one is None for one in found], reckoned, np.array(found, dtype=float))
