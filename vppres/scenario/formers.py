"""Devices that can form an island's grid: batteries, and generating sets where these cannot."""

from __future__ import annotations

from typing import Any

import numpy as np

from vppres.core.arrays import Flags


def forming_batteries(site: Any) -> Flags:
    """Batteries that form the grid, (B,), of a scenario or site; with phases those with all three.

    They are those that are named. If none is, it is the largest, unless a generating set is named.
    """
    batteries = site.batteries
    if site.gensets.grid_forming.any() and not batteries.grid_forming.any():
        return np.zeros(len(batteries), dtype=bool)
    if site.phases is not None:
        return np.asarray(site.phases.formers(batteries))
    return np.asarray(batteries.formers)


def island_former(site: Any) -> str | None:
    """Name of the device that holds an island: the largest battery that forms it, else set."""
    sets, battery = site.gensets, largest_forming_battery(site)
    if battery is not None:
        return str(site.batteries.id[battery])
    if not sets.grid_forming.any():
        return None
    return str(sets.id[np.argmax(np.where(sets.grid_forming, sets.p_max_kw, -1.0))])


def former_kva(site: Any, name: str) -> float:
    """Rating of a device that holds an island."""
    for table in (site.batteries, site.gensets):
        for at in np.flatnonzero(table.id == name):
            return float(table.s_max_kva[at])
    raise KeyError(name)


def largest_forming_battery(site: Any) -> int | None:
    """Position of the one with the largest inverter; None without any."""
    formers = forming_batteries(site)
    if not formers.any():
        return None
    return int(np.argmax(np.where(formers, site.batteries.s_max_kva, -1.0)))
