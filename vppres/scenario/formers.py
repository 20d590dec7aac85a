"""Devices that can form an island's grid: batteries, and units of kinds where these cannot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vppres.core.arrays import Flags
from vppres.kinds.table import KINDS
from vppres.scenario.network import BusId


def forming_kinds(site: Any) -> dict[str, Any]:
    """Units of kinds that can form islands, of a scenario or site."""
    return {kind: getattr(site, kind) for kind in KINDS if KINDS[kind].forms}


def named_units(site: Any) -> dict[str, Flags]:
    """Units that are to form islands, (n,), by kind, of a scenario or site."""
    found = {kind: units.grid_forming for kind, units in forming_kinds(site).items()}
    return {kind: named for kind, named in found.items() if named.any()}


def bus_of_former(site: Any, forms: Mapping[str, Flags]) -> BusId | None:
    """Bus of the unit that forms the grid, marked by kind in (n,); None if none does."""
    for kind, flags in forms.items():
        if flags.any():
            bus: BusId = getattr(site, kind).buses(site.customers)[np.argmax(flags)]
            return bus
    return None


def forming_batteries(site: Any) -> Flags:
    """Batteries that form the grid, (B,), of a scenario or site; with phases those with all three.

    They are those that are named. If none is, it is the largest, unless a unit of a kind is named.
    """
    batteries = site.batteries
    if named_units(site) and not batteries.grid_forming.any():
        return np.zeros(len(batteries), dtype=bool)
    if site.phases:
        return np.asarray(site.phases.formers(batteries))
    return np.asarray(batteries.formers)


def formers_within(site: Any, inside: Flags) -> Flags:
    """Batteries that form the grid of a part of a feeder, (B,), by those that it has.

    If none of the feeder is named, it is the largest of the part; with phases of those with three.
    """
    batteries = site.batteries
    formers = forming_batteries(site)
    if batteries.grid_forming.any() or not formers.any():
        return np.asarray(formers & inside)
    able = inside & (batteries.active_max_kw > 0.0)
    if site.phases:
        able &= site.phases.complete(batteries)
    largest = np.argmax(np.where(able, batteries.s_max_kva, -1.0))
    return np.asarray(able & (np.arange(len(able)) == largest))


def island_formers(site: Any) -> list[str]:
    """Names of devices that hold islands: the largest battery that forms them, then units."""
    battery = largest_forming_battery(site)
    found = [] if battery is None else [str(site.batteries.id[battery])]
    for kind, named in named_units(site).items():
        units = getattr(site, kind)
        order = np.argsort(-units.largest_kw, kind="stable")
        found += [str(units.id[i]) for i in order if named[i]]
    return found


def island_former(site: Any) -> str | None:
    """Name of the device that holds an island: the largest battery that forms it, else unit."""
    return next(iter(island_formers(site)), None)


def former_kva(site: Any, name: str) -> float:
    """Rating of a device that holds an island."""
    for table in (site.batteries, *forming_kinds(site).values()):
        for at in np.flatnonzero(table.id == name):
            return float(table.s_max_kva[at])
    raise KeyError(name)


def largest_forming_battery(site: Any) -> int | None:
    """Position of the one with the largest inverter; None without any."""
    formers = forming_batteries(site)
    if not formers.any():
        return None
    return int(np.argmax(np.where(formers, site.batteries.s_max_kva, -1.0)))
