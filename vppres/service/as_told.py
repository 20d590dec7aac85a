"""States of the units of each kind as stored plans give them, for their replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names
from vppres.day.trajectory import SWITCHES_OPEN
from vppres.scenario.configuration import Branches

Plan = Mapping[str, Any]
Plans = Sequence[Plan]  # by step, empty for a step without


def expected_by(plan: Plan) -> Mapping[str, Any]:
    """Values that a plan expects of its step; empty for a plan that the controller did not make."""
    return plan.get("expected") or {}


def left_of(plan: Plan, step: pd.Timedelta) -> pd.Timedelta:
    """Length of the part of its step for which a plan holds."""
    begin = pd.Timestamp(plan["start"])
    return begin + step - pd.Timestamp(plan.get("valid_from", begin))


def closed_by(plan: Plan, branches: Branches) -> Flags:
    """Lines and ties that are closed in a plan, (E,); those of the site where it does not say."""
    names = plan.get(SWITCHES_OPEN)
    return branches.closed if names is None else branches.closed_but(names)


def said_of(
    plan: Plan, what: str, ids: Names, reckoned: Floats, field: str | None = None
) -> Floats:
    """State on which a step was decided, by unit; as reckoned where its plan does not give it."""
    told = expected_by(plan).get(what, {})
    values = [told.get(str(name)) for name in ids]
    found = np.array([one[field] if field and one else one for one in values], dtype=float)
    return np.where(np.isnan(found), reckoned, found)
