"""Earthing of a phased feeder's buses, with the grid as source or with an island's former.

Only lines and transformers do, from a source or a winding that is earthed: charging, capacitors and
the millionth of a transformer's rating hold no voltage to ground against a customer's current.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from vppres.scenario.phases import (
    GROUND,
    LINES,
    PHASES,
    Coil,
    PhaseBus,
    PhaseConnection,
    Phases,
    coils_of,
)

LITTLE = 1e-9
"""Weight of a shift of all voltages beside what lines and transformers make of it."""

SHIFTED = 0.5
"""Share of a shift from which a node follows it: it is next to none or next to all."""


def unearthed(phases: Phases, bus: str, to_ground: bool) -> set[str]:
    """Buses with a phase whose voltage to ground nothing holds.

    All voltages to ground are shifted by 1 pu as far as no line and no transformer resists: what is
    earthed stays.

    The source at ``bus`` holds its phases against ground, or only against each other.

    Examples
    --------
    A transformer with two deltas earths nothing behind it, one with a wye does:

    >>> from vppres.scenario.phases import PhaseTransformer
    >>> def behind(coils):
    ...     unit = PhaseTransformer("t", "x", "ab bc ca", 1.0, "y", coils, 1.0, 100.0, 1.0, 4.0)
    ...     buses = tuple(PhaseBus(bus, bus, 1.0, "a b c") for bus in "xy")
    ...     return unearthed(Phases(buses, (), (unit,)), "x", to_ground=True)
    >>> behind("ab bc ca"), behind("a b c")
    ({'y'}, set())
    """
    found = []
    for unit in phases.transformers:
        first = phases.by_bus[unit.from_bus], unit.from_kv * unit.from_tap, unit.from_coils
        second = phases.by_bus[unit.to_bus], unit.to_kv * unit.to_tap, unit.to_coils
        pairs = zip(coils_of(first[2]), coils_of(second[2]), strict=True)
        found += [
            [*_across(phases, *first[:2], own, 1.0), *_across(phases, *second[:2], other, -1.0)]
            for own, other in pairs
        ]
    rows = [*_of_source(phases, bus, to_ground), *_of_lines(phases), *found]
    count = len(phases.nodes)
    numbers = [i for i, row in enumerate(rows) for _ in row]
    columns = [column for row in rows for column, _ in row]
    values = [value for row in rows for _, value in row]
    resisting = sp.csr_array((values, (numbers, columns)), shape=(len(rows), count))
    factors = splu(sp.csc_array(resisting.T @ resisting + LITTLE * sp.eye_array(count)))
    shift = factors.solve(np.full(count, LITTLE))
    return {phases.nodes[i][0] for i in np.flatnonzero(np.abs(shift) > SHIFTED)}


Row = list[tuple[int, float]]
"""A sum of nodes' voltages in pu that has to be 0."""


def _of_source(phases: Phases, bus: str, to_ground: bool) -> list[Row]:
    a, b, c = (phases.node_index[bus, phase] for phase in range(len(PHASES)))
    if to_ground:
        return [[(node, 1.0)] for node in (a, b, c)]
    return [[(a, 1.0), (b, -1.0)], [(b, 1.0), (c, -1.0)]]


def _of_lines(phases: Phases) -> list[Row]:
    """No current in any phase."""
    at = phases.node_index
    return [
        [(at[line.from_bus, phase], 1.0), (at[line.to_bus, phase], -1.0)]
        for line in phases.lines
        for phase in line.phases
    ]


def _across(phases: Phases, row: PhaseBus, kv: float, coil: Coil, sign: float) -> Row:
    """Voltage across a coil as a share of its rated one."""
    share = sign * row.kv / np.sqrt(3.0) / kv
    ends = zip(coil, (share, -share), strict=True)
    return [(phases.node_index[row.bus, end], value) for end, value in ends if end is not None]


def with_grid(phases: Phases) -> Phases:
    """The tables with limits between phases where nothing earths two phases or three."""
    bare = unearthed(phases, phases.buses[0].bus, to_ground=True)
    rows = [
        replace(row, limits=LINES if row.bus in bare and len(row.phases.split()) > 1 else GROUND)
        for row in phases.buses
    ]
    return replace(phases, buses=tuple(rows))


@lru_cache(maxsize=16)
def in_island(phases: Phases, former: str) -> Phases:
    """The tables with the limits of an island that a battery forms.

    They are between phases at buses of three that nothing earths there, but for those at which an
    asset has a coil to ground: its own voltage is to ground. Those of the same feeder are reckoned
    once: each reading of a voltage asks for them.
    """
    bare = unearthed_by(phases, former)
    bare -= {row.bus for row in phases.connections if row.to_ground}
    rows = [
        replace(row, limits=LINES)
        if row.bus in bare and len(row.phases.split()) == len(PHASES)
        else row
        for row in phases.buses
    ]
    return replace(phases, buses=tuple(rows))


def unearthed_by(phases: Phases, former: str) -> set[str]:
    """Buses that nothing earths in an island that a battery forms."""
    own = phases.connection(former)
    return unearthed(phases, own.bus, own.to_ground)


def floating(phases: Phases, former: str, customers: list[str]) -> list[str]:
    """Customers with a coil to ground at a bus that nothing earths in a battery's island."""
    bare = unearthed_by(phases, former)
    rows: dict[str, PhaseConnection] = {name: phases.connection(name) for name in customers}
    return [name for name, row in rows.items() if row.to_ground and row.bus in bare]
