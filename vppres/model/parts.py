"""Parts of a feeder in the steps of a window: each has a balance of its own, or is dead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import ByStep, Flags, Floats, Wholes
from vppres.model.site import Site
from vppres.scenario.faults import OutOfService, parts_by_bus
from vppres.scenario.formers import formers_within, named_units
from vppres.scenario.network import Network


@dataclass(frozen=True, eq=False)
class Parts(ByStep):
    """Parts of a feeder in W steps: all of it is one where no line is out."""

    lines: Flags  #: lines that are out, (W, L): they carry nothing
    of_bus: Wholes  #: number of the part of each bus, (W, N); 0 is that with the grid's bus
    dead: Flags  #: buses of parts that nothing forms, and buses that are out themselves, (W, N)
    #: Bus that holds the voltage of each, (W, N): the grid's, or that of a battery; -1 in dead
    #: parts.
    reference: Wholes
    forms: Flags  #: batteries that form a part without grid, (W, B)

    @classmethod
    def one(cls, network: Network, n_batteries: int, n_steps: int) -> Parts:
        """Steps in which the feeder is one part, that of the grid."""
        at_buses = (n_steps, network.n_buses)
        return cls(
            np.zeros((n_steps, network.n_lines), dtype=bool),
            np.zeros(at_buses, dtype=int),
            np.zeros(at_buses, dtype=bool),
            np.zeros(at_buses, dtype=int),
            np.zeros((n_steps, n_batteries), dtype=bool),
        )

    @property
    def cut(self) -> Flags:
        """Steps in which lines are out, (W,)."""
        return np.asarray(self.lines.any(axis=1))

    @property
    def whole(self) -> bool:
        """Whether no line is out in any step."""
        return not self.lines.any()

    @property
    def beyond(self) -> Flags:
        """Buses behind a line that is out, (W, N)."""
        return np.asarray(self.of_bus != 0)


def at_items(flags: Flags, place: sp.csr_array) -> Flags:
    """Flags of buses, (W, N), as those of the items that are placed on them, (W, n)."""
    return np.asarray((place.T @ flags.T.astype(float)).T > 0.0)


def parts_of(
    site: Site, out: OutOfService, soc: Floats, island: Flags, needs_former: bool
) -> Parts:
    """Parts of the steps of a window, and which of them nothing forms.

    A battery forms a part if it holds energy at first, or has been with the grid before in the
    window.

    With ``needs_former`` the part with the grid's bus needs one in these steps too, and only
    batteries are planned to be one, as in physical mode and with phases.
    """
    if not out.lines.any():
        return Parts.one(site.network, len(soc), len(island))
    needs_former = needs_former or bool(site.phases)
    part = parts_by_bus(site.network, out.lines)
    grid = (part == 0) & ~island[:, None]
    reference = np.where((part == 0) & ~(island[:, None] & needs_former), 0, -1)
    forms = np.zeros((len(part), len(soc)), dtype=bool)
    charged = site.batteries.holds_energy(soc)
    at = _buses(site, "batteries")
    index = site.network.bus_index
    others = [
        index[bus]
        for kind, flags in ({} if needs_former else named_units(site)).items()
        for bus in getattr(site, kind).buses(site.customers)[flags]
    ]
    for t, numbers in enumerate(part):
        charged = charged | grid[t, at]
        formed = numbers[others]
        for number in np.unique(numbers):
            inside = numbers == number
            formers = formers_within(site, inside[at]) & charged
            if reference[t, number] != 0:
                if formers.any():
                    largest = np.argmax(np.where(formers, site.batteries.s_max_kva, -1.0))
                    reference[t, inside] = at[largest]
                elif number in formed:
                    reference[t, inside] = number
            forms[t] |= formers & ~grid[t, at]
    dead = (reference < 0) | out.buses
    return Parts(out.lines, part, dead, np.where(dead, -1, reference), forms)


def held_by_units(site: Site, parts: Parts) -> Wholes:
    """Number of the part of each bus, (W, N), where units of kinds form it; -1 elsewhere."""
    found = np.where(parts.dead | ~parts.beyond, -1, parts.of_bus)
    at = _buses(site, "batteries")
    for t, battery in zip(*np.nonzero(parts.forms), strict=True):
        found[t, parts.of_bus[t] == parts.of_bus[t, at[battery]]] = -1
    return found


def _buses(site: Site, table: str) -> Wholes:
    """Positions of the buses of a table's items."""
    index = site.network.bus_index
    return np.array([index[bus] for bus in getattr(site, table).bus], dtype=int)
