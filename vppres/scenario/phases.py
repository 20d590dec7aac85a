"""A feeder with its three phases: buses, lines as matrices, transformers as coils, connections.

The tables are those of a folder's ``phase_*.csv``. Buses are named in words here, also those that
are numbers in ``lines.csv``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vppres.core.arrays import Complexes, Flags, Floats, freeze
from vppres.core.errors import InputError, Problem
from vppres.kinds.table import KINDS, units_of
from vppres.scenario.assets import Batteries
from vppres.scenario.formers import forming_kinds
from vppres.scenario.network import BusId, Network

PHASES = "abc"
GROUND, LINES = "ground", "lines"
"""Voltages that a bus's limits hold for: phases against ground, or phases against each other."""

SOURCE_LACKS = "must be a b c for the source's bus"
"""What is wrong with a table of buses that lacks the source, or phases of it."""

TRIANGLE = tuple((row, column) for row in range(3) for column in range(row + 1))
"""Entries of a symmetric matrix of three phases that a table gives."""

Coil = tuple[int, int | None]
"""Two phases, or a phase and ground."""


def coils_of(words: str) -> tuple[Coil, ...]:
    """Coils from words: ``a b c`` are to ground, ``ab bc ca`` between phases.

    Raises
    ------
    ValueError
        If a word is not one or two different phases.

    Examples
    --------
    >>> coils_of("a c"), coils_of("ab")
    (((0, None), (2, None)), ((0, 1),))
    """
    coils: list[Coil] = []
    for word in words.split():
        if not 1 <= len(word) <= 2 or len(set(word)) < len(word) or not set(word) <= set(PHASES):
            raise ValueError(word)
        first, *other = (PHASES.index(letter) for letter in word)
        coils.append((first, other[0] if other else None))
    if not coils:
        raise ValueError(words)
    return tuple(coils)


def _pairs(own: list[str]) -> list[str]:
    """Pairs of phases: three of three, one of two.

    >>> _pairs(["a", "b", "c"])
    ['ab', 'bc', 'ca']
    """
    pairs = [first + own[(i + 1) % len(own)] for i, first in enumerate(own)]
    return pairs if len(own) == len(PHASES) else pairs[:1]


@dataclass(frozen=True)
class PhaseBus:
    """A bus: its place ``at`` a bus of the network, nominal kV between lines, phases, limits."""

    bus: str
    at: BusId
    kv: float
    phases: str
    limits: str = GROUND


@dataclass(frozen=True, eq=False)
class PhaseLine:
    """A line: impedance in ohm and charging in microsiemens, (3, 3); NaN for phases it lacks.

    ``i_max_a`` is what each phase may carry, NaN without a rating.
    """

    from_bus: str
    to_bus: str
    z_ohm: Complexes
    b_us: Floats
    i_max_a: float = np.nan

    def __post_init__(self) -> None:
        object.__setattr__(self, "z_ohm", freeze(self.z_ohm, complex))
        object.__setattr__(self, "b_us", freeze(self.b_us, float))

    @property
    def phases(self) -> list[int]:
        """Phases that it has."""
        return [int(i) for i in np.flatnonzero(~np.isnan(np.diag(self.z_ohm).real))]


@dataclass(frozen=True)
class PhaseTransformer:
    """Pairs of coils on one core each: a transformer, a regulator, or a unit of a bank.

    ``from_kv`` and ``to_kv`` are across a coil, ``kva`` is that of one pair; taps are ratios of
    turns. ``ppm`` millionths of the rating go to ground, half at each end of a coil, so that
    windings that nothing else grounds have a voltage. ``island_tap`` is ``to_tap`` in an island;
    None if it is the same there.
    """

    id: str
    from_bus: str
    from_coils: str
    from_kv: float
    to_bus: str
    to_coils: str
    to_kv: float
    kva: float
    r_pct: float
    x_pct: float
    from_tap: float = 1.0
    to_tap: float = 1.0
    ppm: float = 1.0
    island_tap: float | None = None


@dataclass(frozen=True)
class PhaseShunt:
    """A constant admittance: what all of its coils draw together at ``kv`` across each."""

    bus: str
    coils: str
    kv: float
    p_kw: float
    q_kvar: float
    island: str = "yes"


@dataclass(frozen=True)
class PhaseConnection:
    """Phases of an asset, and how its power follows the voltage across its coils."""

    id: str
    bus: str
    coils: str
    kv: float
    p_exponent: float = 0.0
    q_exponent: float = 0.0

    @property
    def three_coils(self) -> bool:
        """Whether it has a coil for each phase."""
        return len(self.coils.split()) == len(PHASES)

    @property
    def to_ground(self) -> bool:
        """Whether it has a coil between a phase and ground."""
        return any(len(word) == 1 for word in self.coils.split())


@dataclass(frozen=True, eq=False)
class Phases:
    """The three phases of a feeder; without any row, and false, those of a balanced one.

    Raises
    ------
    InputError
        If a row names a bus or phase that there is not, or the source does not reach a phase.
    """

    #: Rows of the tables. The first bus is the source's, with all three phases.
    buses: tuple[PhaseBus, ...] = ()
    lines: tuple[PhaseLine, ...] = ()
    transformers: tuple[PhaseTransformer, ...] = ()
    shunts: tuple[PhaseShunt, ...] = ()
    connections: tuple[PhaseConnection, ...] = ()
    rows: dict[str, tuple[int, ...]] = field(default_factory=dict)
    """Lines of the files by table, for messages; positions if not given."""

    def __post_init__(self) -> None:
        problems = self._wrong() if self else []
        if problems:
            raise InputError(problems)

    def __bool__(self) -> bool:
        tables = (self.buses, self.lines, self.transformers, self.shunts, self.connections)
        return any(tables)

    def __repr__(self) -> str:
        lines = [
            (x.from_bus, x.to_bus, x.z_ohm.tolist(), x.b_us.tolist(), x.i_max_a) for x in self.lines
        ]
        return repr((self.buses, lines, self.transformers, self.shunts, self.connections))

    @cached_property
    def key(self) -> str:
        """Digest of the content."""
        return hashlib.sha256(repr(self).encode()).hexdigest()

    @property
    def has_ratings(self) -> bool:
        """Whether the current of any line or transformer has a limit."""
        rated = [line for line in self.lines if np.isfinite(line.i_max_a)]
        return bool(rated or self.transformers)

    @cached_property
    def nodes(self) -> list[tuple[str, int]]:
        """Bus and phase of each node, those of the source first."""
        return [(row.bus, PHASES.index(p)) for row in self.buses for p in row.phases.split()]

    @cached_property
    def node_index(self) -> dict[tuple[str, int], int]:
        """Place of each node."""
        return {node: i for i, node in enumerate(self.nodes)}

    @cached_property
    def islanded(self) -> Phases:
        """The tables of an island: less the shunts that open there, with the taps of islands."""
        shunts = tuple(each for each in self.shunts if each.island != "no")
        units = tuple(
            unit if unit.island_tap is None else replace(unit, to_tap=unit.island_tap)
            for unit in self.transformers
        )
        if (shunts, units) == (self.shunts, self.transformers):
            return self
        return replace(self, shunts=shunts, transformers=units)

    def in_parts(self, of_bus: Mapping[str, int], islands: Collection[int]) -> Phases:
        """The tables without what joins parts, those of islands with their shunts and taps.

        ``of_bus`` has the number of the part of each bus, and ``islands`` those that are islands.
        """
        alone = {bus for bus, number in of_bus.items() if number in islands}
        of_islands = self.islanded
        shunts = [row for row in self.shunts if row.bus not in alone or row.island != "no"]
        units = zip(self.transformers, of_islands.transformers, strict=True)
        kept = [own if unit.to_bus in alone else unit for unit, own in units]

        def inside(row: PhaseLine | PhaseTransformer) -> bool:
            return of_bus[row.from_bus] == of_bus[row.to_bus]

        return replace(
            self,
            lines=tuple(filter(inside, self.lines)),
            transformers=tuple(filter(inside, kept)),
            shunts=tuple(shunts),
        )

    def within(self, buses: Collection[str], source: str) -> Phases:
        """The tables of a part at some buses, that of its source, an asset, first."""
        first = self.connection(source).bus
        own = [row for row in self.buses if row.bus in buses]
        return replace(
            self,
            buses=tuple(sorted(own, key=lambda row: row.bus != first)),
            lines=tuple(row for row in self.lines if row.from_bus in buses),
            transformers=tuple(row for row in self.transformers if row.from_bus in buses),
            shunts=tuple(row for row in self.shunts if row.bus in buses),
            connections=tuple(row for row in self.connections if row.bus in buses),
        )

    @cached_property
    def by_bus(self) -> dict[str, PhaseBus]:
        """Rows of the buses by their names."""
        return {row.bus: row for row in self.buses}

    @cached_property
    def measured(self) -> tuple[tuple[str, str], ...]:
        """Bus and phase of each voltage that has limits; a pair of phases on three wires."""
        found: list[tuple[str, str]] = []
        for row in self.buses:
            own = sorted(row.phases.split())
            between = row.limits == LINES and len(own) > 1
            found += [(row.bus, word) for word in (_pairs(own) if between else own)]
        return tuple(found)

    def connection(self, asset: str) -> PhaseConnection:
        """The connection of an asset; parts of a customer (``name/2``) have that of the whole."""
        known = self._connections
        return known[asset] if asset in known else known[asset.rpartition("/")[0]]

    def column(self, assets: Iterable[Any]) -> dict[str, Any]:
        """Coils of assets as a column of a table; none of a balanced feeder."""
        return {"phases": [self.connection(str(name)).coils for name in assets]} if self else {}

    def formers(self, batteries: Batteries) -> Flags:
        """Batteries that can form an island, (B,): those chosen to that have all three phases."""
        return np.asarray(batteries.formers & self.complete(batteries))

    def complete(self, batteries: Batteries) -> Flags:
        """Batteries with all three phases, (B,)."""
        found = [self.connection(str(name)).three_coils for name in batteries.id]
        return np.array(found, dtype=bool)

    @cached_property
    def _connections(self) -> dict[str, PhaseConnection]:
        return {row.id: row for row in self.connections}

    def _wrong(self) -> list[Problem]:
        """Names, phases and coils that there are not."""
        problems, known = self._buses_wrong()
        for i, line in enumerate(self.lines):
            for name in ("from_bus", "to_bus"):
                bus = getattr(line, name)
                problems += self._phases_at(known, "lines", i, name, bus, line.phases)
        for i, unit in enumerate(self.transformers):
            problems += self._transformer_wrong(known, i, unit)
        for table in ("shunts", "connections"):
            for i, row in enumerate(getattr(self, table)):
                problems += self._coils_at(known, table, i, "bus", row.bus, row.coils)
        return problems

    def _buses_wrong(self) -> tuple[list[Problem], dict[str, set[int]]]:
        """Faults of the table of buses, and the phases of the buses without fault."""
        problems: list[Problem] = []
        known: dict[str, set[int]] = {}
        for i, row in enumerate(self.buses):
            words = row.phases.split()
            if not words or not set(words) <= set(PHASES) or len(set(words)) < len(words):
                problems.append(
                    self.wrong("buses", i, "phases", row.phases, "must name phases a, b and c")
                )
                continue
            if row.bus in known:
                problems.append(self.wrong("buses", i, "bus", row.bus, "is there twice"))
            known[row.bus] = {PHASES.index(word) for word in words}
        if not problems and (not self.buses or len(known[self.buses[0].bus]) < 3):
            problems.append(self.wrong("buses", 0, "phases", "", SOURCE_LACKS))
        return problems, known

    def _transformer_wrong(
        self, known: dict[str, set[int]], i: int, unit: PhaseTransformer
    ) -> list[Problem]:
        """Faults of a transformer's coils."""
        problems = []
        for end in ("from", "to"):
            bus, coils = getattr(unit, f"{end}_bus"), getattr(unit, f"{end}_coils")
            problems += self._coils_at(known, "transformers", i, f"{end}_bus", bus, coils)
        if problems:
            return problems
        count = len(coils_of(unit.from_coils))
        if len(coils_of(unit.to_coils)) == count:
            return []
        reason = f"must have {count} coils, as from_coils"
        return [self.wrong("transformers", i, "to_coils", unit.to_coils, reason)]

    def _coils_at(
        self, known: dict[str, set[int]], table: str, i: int, name: str, bus: str, words: str
    ) -> list[Problem]:
        """Faults of coils at a bus."""
        try:
            coils = coils_of(words)
        except ValueError:
            column = name.replace("bus", "coils")
            return [
                self.wrong(
                    table, i, column, words, "must be words of one or two phases, as `a b` or `ab`"
                )
            ]
        phases = sorted({end for coil in coils for end in coil if end is not None})
        return self._phases_at(known, table, i, name, bus, phases)

    def _phases_at(
        self, known: dict[str, set[int]], table: str, i: int, name: str, bus: str, phases: list[int]
    ) -> list[Problem]:
        """A bus that is not there, or lacks a phase."""
        if bus not in known:
            return [self.wrong(table, i, name, bus, "is not a bus of phase_buses.csv")]
        lacking = [PHASES[phase] for phase in phases if phase not in known[bus]]
        if not phases:
            return [self.wrong(table, i, "r_aa_ohm", "", "a line must have a phase")]
        if lacking:
            return [
                self.wrong(
                    table, i, name, bus, f"has no phase {' and '.join(lacking)}, which is used here"
                )
            ]
        return []

    def wrong(self, table: str, i: int, name: str, value: object, what: str) -> Problem:
        """A mistake in a row of a table."""
        rows = self.rows.get(table)
        return Problem(
            f"phase_{table}.csv",
            what,
            "Correct the row, or the phases of the bus in phase_buses.csv.",
            row=rows[i] if rows and i < len(rows) else i,
            field=name,
            value=value,
        )


BALANCED = Phases()
"""The phases of a balanced feeder."""


def check_phases(phases: Phases, scenario: Any) -> None:
    """Refuse phases that are not those of buses and assets, or that the source does not reach."""
    problems = [*_places(phases, scenario.network), *_connected(phases, scenario)]
    problems = problems or [*_unreached(phases), *_formers(phases, scenario)]
    if problems:
        raise InputError(problems)


def _places(phases: Phases, network: Network) -> Iterator[Problem]:
    """Buses at none of the network's, and the network's without any."""
    if phases.buses[0].at != network.slack_bus:
        yield phases.wrong(
            "buses", 0, "at", phases.buses[0].at, f"must be the slack bus, {network.slack_bus}"
        )
    for i, row in enumerate(phases.buses):
        if row.at not in network.bus_index:
            yield phases.wrong("buses", i, "at", row.at, "is not a bus of lines.csv")
    for bus in sorted({*network.buses} - {row.at for row in phases.buses}, key=str):
        yield Problem(
            "phase_buses.csv",
            "is not there, and lines.csv has it",
            "Give a row for it, or remove its line.",
            field="at",
            value=bus,
        )


def _connected(phases: Phases, scenario: Any) -> Iterator[Problem]:
    """Assets without a connection, or with one at another bus, and connections of none."""
    customers = scenario.customers
    buses = dict(zip(customers.id, customers.bus, strict=True))
    buses |= dict(zip(scenario.batteries.id, scenario.batteries.bus, strict=True))
    for units in (scenario.pv, *units_of(scenario).values()):
        buses |= dict(zip(units.id, units.buses(customers), strict=True))
    known: set[str] = set()
    for i, row in enumerate(phases.connections):
        if row.id in known:
            yield phases.wrong("connections", i, "id", row.id, "is there twice")
        known.add(row.id)
        at = phases.by_bus[row.bus].at
        own = buses.get(row.id, at)
        if own != at:
            yield phases.wrong(
                "connections", i, "bus", row.bus, f"is at bus {at}, and {row.id} at bus {own}"
            )
    for asset in buses:
        if asset not in known and str(asset).rpartition("/")[0] not in known:
            yield Problem(
                "phase_connections.csv",
                "has no row",
                "Give its bus, coils and kv.",
                field="id",
                value=asset,
            )


def _unreached(phases: Phases) -> Iterator[Problem]:
    """Nodes that no line and no transformer joins to the source."""
    index = phases.node_index
    pairs = [
        (index[line.from_bus, phase], index[line.to_bus, phase])
        for line in phases.lines
        for phase in line.phases
    ]
    for unit in phases.transformers:
        ends = [
            index[bus, end]
            for bus, words in ((unit.from_bus, unit.from_coils), (unit.to_bus, unit.to_coils))
            for coil in coils_of(words)
            for end in coil
            if end is not None
        ]
        pairs += [(ends[0], end) for end in ends[1:]]
    first, second = np.array(pairs, dtype=int).reshape(-1, 2).T
    graph = sp.coo_array((np.ones(len(first)), (first, second)), shape=(len(index), len(index)))
    _, part = connected_components(graph, directed=False)
    reached = {part[index[phases.buses[0].bus, phase]] for phase in range(3)}
    places = {row.bus: i for i, row in enumerate(phases.buses)}
    for (bus, phase), i in index.items():
        if part[i] not in reached:
            yield phases.wrong(
                "buses",
                places[bus],
                "phases",
                phases.buses[places[bus]].phases,
                f"has phase {PHASES[phase]}, which the source does not reach",
            )


def _formers(phases: Phases, scenario: Any) -> Iterator[Problem]:
    """Batteries and units of kinds that are to form an island and lack a phase."""
    units = forming_kinds(scenario).items()
    words = {"battery": scenario.batteries, **{KINDS[kind].sign: each for kind, each in units}}
    named = [(word, each.id[each.grid_forming]) for word, each in words.items()]
    for word, name in ((word, name) for word, names in named for name in names):
        own = phases.connection(str(name))
        if not own.three_coils:
            i = phases.connections.index(own)
            yield phases.wrong(
                "connections",
                i,
                "coils",
                own.coils,
                f"must be three: {word} {name} is to form the grid of an island",
            )
