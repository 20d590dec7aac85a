"""Islands that no battery can form: the generating set that forms them, for as long as it can.

One set forms the grid over a window. It runs in every step in which it can, and what it forms is
lit then; no plan lets an island go dark to save fuel. So who forms the grid is known before the
window is solved, and its voltages can be held at one bus in each step.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.kinds.gensets.data import Gensets, steps_of
from vppres.kinds.gensets.physics import SetsAhead
from vppres.model.data import WindowData
from vppres.model.site import Site

LARGEST_SHARE = 0.25
"""Share of the range of powers of a set that its headroom may take up, at either end."""


def formed_by_set(
    site: Site, data: WindowData, dark: Flags, headroom: float
) -> tuple[WindowData, Flags]:
    """The window with the set that forms the grid where no battery can, and what stays dark.

    Of several the one forms it that can for most steps, then the one that runs, then the largest.
    Once its fuel ends it runs no more in the window, but for steps that it forms.

    Parameters
    ----------
    site : Site
        Fixed data.
    data : WindowData
        The window.
    dark : array of bool, shape (W,)
        Island steps that no battery can form.
    headroom : float
        Share of the rating that is left free above and below the plan.
    """
    ahead, sets = data.ahead.find(SetsAhead), site.gensets
    if ahead is None or not dark.any() or not sets.grid_forming.any():
        return data, dark
    room_kw = headroom_kw(sets, headroom)
    lit = [_steps_of(ahead, sets, int(g), dark, room_kw, site.dt_h) for g in _forming_sets(sets)]
    order = [
        (int(steps.sum()), bool(ahead.was_on[0, g] > 0.5), float(sets.p_max_kw[g]), -int(g))
        for g, steps in zip(_forming_sets(sets), lit, strict=True)
    ]
    best = max(range(len(order)), key=order.__getitem__)
    forms = np.zeros(ahead.forms.shape, dtype=bool)
    forms[:, _forming_sets(sets)[best]] = lit[best]
    known = ahead.forming(forms, room_kw)
    spent = np.logical_or.accumulate(dark & ~lit[best] & _after_first_lit(lit[best]))
    can_run = known.can_run.copy()
    can_run[:, _forming_sets(sets)[best]] &= lit[best] | ~spent
    formed = data.ahead.with_window(replace(known, can_run=can_run))
    return replace(data, ahead=formed), dark & ~lit[best]


def _after_first_lit(lit: Flags) -> Flags:
    """Steps after the first that is lit, (W,)."""
    return np.logical_or.accumulate(lit) & ~lit


def headroom_kw(sets: Gensets, share: float) -> Floats:
    """Power that each leaves free above and below its plan while it forms the grid, (G,)."""
    range_kw = sets.p_max_kw - sets.p_min_kw
    return np.minimum(share * sets.p_max_kw, LARGEST_SHARE * range_kw)


def _forming_sets(sets: Gensets) -> list[int]:
    """Sets that can form the grid."""
    return [int(g) for g in np.flatnonzero(sets.grid_forming)]


def _steps_of(
    ahead: SetsAhead, sets: Gensets, g: int, dark: Flags, room_kw: Floats, dt_h: float
) -> Flags:
    """Steps that a set can form at its least power, (W,), if it has nothing else to do.

    It starts where it may, runs while it has fuel, and rests then.
    """
    least_kw = sets.p_min_kw + room_kw
    burnt = float(sets.litres(np.ones(len(sets), dtype=bool), least_kw, dt_h)[g])
    needed = burnt + dt_h * float(sets.litres_per_kwh[g] * room_kw[g])
    least_off = int(steps_of(sets.min_off_h[g], dt_h))
    lit = np.zeros(len(dark), dtype=bool)
    fuel, on, stopped = 0.0, bool(ahead.was_on[0, g] > 0.5), -least_off
    for t in range(len(dark)):
        fuel = min(fuel + float(ahead.added_litres[t, g]), float(sets.tank_litres[g]))
        ready = on or (bool(ahead.rested[t, g]) and t - stopped >= least_off)
        if dark[t] and ready and ahead.can_run[t, g] and fuel >= needed:
            lit[t] = on = True
            fuel -= burnt
        else:
            stopped = t if on else stopped
            on = False
    return lit
