"""What a window's problem says of its end: nothing, a state of charge to hold, or a value."""

from __future__ import annotations

import cvxpy as cp

from vppres.contract.stored_value import Ending
from vppres.model.beyond_paper.stored_value import ValueAtEnd
from vppres.model.beyond_paper.terminal import HeldAtEnd

AtEnd = HeldAtEnd | ValueAtEnd


def end_of_window(ending: Ending, G: int) -> AtEnd | None:
    """Variables and parameters of an end of a kind, for G batteries or lumped fleets."""
    if ending == "value":
        return ValueAtEnd.create()
    return HeldAtEnd.create(G) if ending == "target" else None


def f2_at_end(end: AtEnd | None) -> cp.Expression | float:
    """What the end adds to the cost, in GBP."""
    return 0.0 if end is None else end.f2_missing


def f7_at_end(end: AtEnd | None) -> cp.Expression | float:
    """Later service that the end adds, in weighted customer hours."""
    return end.f7_later if isinstance(end, ValueAtEnd) else 0.0
