"""Sets that switching rules allow without any search: a last answer if time ran out."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vppres.core.arrays import Flags
from vppres.model.data import WindowData


def steady_sets(data: WindowData) -> Iterator[Flags]:
    """Supply schedules (W, C) of hardly any actions, from the one of most service down.

    All customers are supplied throughout, or until power is first limited, or never. A customer
    whose rules forbid that stays as before the window, or takes the first of the others that they
    allow.
    """
    rules = data.switching
    if rules is None:
        return
    shape = data.load_kw.shape
    limited = np.flatnonzero(np.isfinite(data.grid_limit_kw))
    always = np.ones(shape, dtype=bool)
    until = always.copy()
    until[limited[0] if len(limited) else 0 :] = False
    as_before = np.tile(rules.served_before, (shape[0], 1))
    for wanted in (always, until, ~always):
        found = wanted.copy()
        for other in (always, until, ~always, as_before):
            broken = rules.broken(found)
            allowed = broken & ~rules.broken(other)
            found[:, allowed] = other[:, allowed]
        yield found
