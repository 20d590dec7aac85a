"""Changes of a step's powers that need no communication: who takes, gives or exports less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.kinds.table import KINDS
from vppres.plant.plant import Plant, Powers

TAKE_LESS = tuple(kind for kind in reversed(KINDS) if KINDS[kind].takes_less)
"""Kinds that take less, in this order, before an island's batteries give more."""

CUT_MARGIN_KW = 1e-3
"""Margin of a cut beyond the need, so that the set has something left to settle with."""


def taking(powers: Powers, kind: str, taken_kw: Floats) -> Powers:
    """Powers in which the units of a kind take these, (n,)."""
    return replace(powers, taken_kw={**powers.taken_kw, kind: taken_kw})


def taking_less(plant: Plant, t: int, powers: Powers, kind: str, less_kw: Floats) -> Powers | None:
    """Powers in which the units of a kind take so much less, (n,), or what they can.

    One that has a least power takes nothing below it. None if that is not less.
    """
    taken_kw = powers.taken_kw[kind]
    able_kw, running = plant.units[kind].follow(
        t, taken_kw - less_kw, powers.running[kind], powers.served
    )
    if able_kw.sum() >= taken_kw.sum():
        return None
    return taking(replace(powers, running={**powers.running, kind: running}), kind, able_kw)


def spare(plant: Plant, powers: Powers) -> dict[str, Floats]:
    """Power that units can give less without stopping, (n,) by kind; sets come first.

    The set that forms the grid takes up what is too much by itself.
    """
    return {
        kind: plant.units[kind].spare_kw(powers.taken_kw[kind], powers.running[kind])
        * ~forms(powers, kind)
        for kind in reversed(plant.units)
    }


def forms(powers: Powers, kind: str) -> Flags:
    """Units of a kind that form the grid, (n,)."""
    which = np.zeros(len(powers.taken_kw[kind]), dtype=bool)
    if kind == "gensets":
        which[[one.genset for one in powers.forming]] = True
    return which


def part_of(powers_kw: Floats, need_kw: float) -> Floats:
    """So much of each power, in proportion, that their sum meets the need."""
    total_kw = float(powers_kw.sum())
    return powers_kw * min(1.0, need_kw / total_kw) if total_kw else powers_kw


def curtailed(powers: Powers, surplus_kw: float) -> Powers:
    """PV power off until the surplus is gone, exports in proportion first."""
    exports = powers.pv_export_kw if powers.pv_export_kw.sum() > 0 else powers.pv_self_kw
    off = part_of(exports, surplus_kw)
    from_export = off if exports is powers.pv_export_kw else np.zeros_like(off)
    return replace(
        powers,
        pv_export_kw=powers.pv_export_kw - from_export,
        pv_self_kw=powers.pv_self_kw - (off - from_export),
        pv_curtailed_kw=powers.pv_curtailed_kw + off,
    )
