"""Configurations of a feeder: which of its lines and ties are closed.

A configuration has no loop. Lines and ties together are the *branches*: the lines of the network in
its order, and after them the open switches of the scenario. A line that is out by a fault counts as
it was before: closed, it carries again when it is repaired.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats, Names, Wholes, freeze
from vppres.core.text import named
from vppres.scenario.faults import LineFault, OpenLine, OutOfService
from vppres.scenario.network import LINE_DEFAULTS, BusId, Network
from vppres.scenario.phases import BALANCED, PHASES, PhaseBus, PhaseLine, Phases, PhaseTransformer
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import OF_THE_LINE, SWITCH_DEFAULTS, Switches

LOOPED = "{} closes a loop, and is open in the plan"
LACKS_A_PHASE = "{} lacks a phase, and is open in the plan"
LEFT_OPEN = (LOOPED, LACKS_A_PHASE)
"""Why a switch that is closed is open in a plan, by its name."""


@dataclass(frozen=True, eq=False)
class Branches:
    """Lines and open ties of a feeder, (E,) each."""

    network: Network  #: the lines, in the configuration in which a day begins
    switches: Switches  #: the switches: those on lines, and the ties
    #: The phases; a balanced feeder if not given. A tie has all phases there, or is not moved.
    phases: Phases = BALANCED

    @classmethod
    def of(cls, scenario: Scenario) -> Branches:
        """The branches of a scenario."""
        return cls(scenario.network, scenario.switches, scenario.phases)

    @cached_property
    def ties(self) -> Switches:
        """The open switches."""
        return self.switches.rows(~self.switches.closed)

    def __len__(self) -> int:
        return self.network.n_lines + len(self.ties)

    @cached_property
    def closed(self) -> Flags:
        """The configuration in which a day begins."""
        return freeze(np.arange(len(self)) < self.network.n_lines)

    @cached_property
    def switch(self) -> Wholes:
        """Row of the switch of each branch; -1 for lines without one."""
        net, switches = self.network, self.switches
        on_line = {
            frozenset((switches.from_bus[i], switches.to_bus[i])): int(i)
            for i in np.flatnonzero(switches.closed)
        }
        ends = map(frozenset, zip(net.from_bus, net.to_bus, strict=True))
        of_lines = [on_line.get(pair, -1) for pair in ends]
        return freeze(np.array([*of_lines, *np.flatnonzero(~switches.closed)], dtype=int))

    def of_line(self, name: str) -> Any:
        """A column that lines and open switches have, with the lines' default for switches."""
        more = getattr(self.ties, name, None)
        if more is None:
            more = np.full(len(self.ties), LINE_DEFAULTS[name])
        return np.append(getattr(self.network, name), more)

    def of_moves(self, name: str) -> Any:
        """A column of switches on operations; ``SWITCH_DEFAULTS`` of lines without a switch.

        A fault opens such a line, and a crew closes it.
        """
        values = np.append(getattr(self.switches, name), [SWITCH_DEFAULTS[name]])
        return values[self.switch]

    @cached_property
    def from_bus(self) -> Names:
        """First ends."""
        return np.asarray(self.of_line("from_bus"))

    @cached_property
    def to_bus(self) -> Names:
        """Second ends."""
        return np.asarray(self.of_line("to_bus"))

    @cached_property
    def rating_a(self) -> Floats:
        """Thermal ratings in A, infinite where there is none."""
        return np.asarray(self.of_line("i_max_a"), dtype=float)

    @cached_property
    def ends(self) -> Wholes:
        """Positions of the buses at both ends, (E, 2)."""
        index = self.network.bus_index
        pairs = zip(self.from_bus, self.to_bus, strict=True)
        return np.array([(index[a], index[b]) for a, b in pairs], dtype=int).reshape(-1, 2)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names: those of the switches, or both buses; each names one branch alone."""
        ids = [str(name) for name in self.switches.id]
        taken, found = {*ids}, []
        for i, a, b in zip(self.switch, self.from_bus, self.to_bus, strict=True):
            name = f"{a}-{b}" if i < 0 else ids[i]
            # A tie beside a line is often called as the line would be.
            while i < 0 and name in taken:
                name = f"line {name}"
            taken.add(name)
            found.append(name)
        return tuple(found)

    def movable(self, open_now: Flags, out: OutOfService) -> Flags:
        """Branches that may change their state in a window.

        Those with a switch that is operable and not locked. A line that a fault takes out in the
        window is opened by it, and one that was left open is closed by the crew that repaired it.

        ``open_now`` are branches that are open at its beginning, (E,); ``out`` is in the scenario's
        own order.
        """
        switches, net = self.switches, self.network
        able = np.append(switches.movable, False)[self.switch]
        opened = np.zeros(len(self), dtype=bool)
        opened[: net.n_lines] = out.lines.any(axis=0)
        opened |= open_now & self.closed
        unlocked = np.append(switches.locked == "", True)[self.switch]
        ratio = np.append(net.ratio != 1.0, np.zeros(len(self.ties), dtype=bool))
        found = (able | (opened & unlocked)) & ~ratio
        return np.asarray(found & self.can_close)

    @cached_property
    def can_close(self) -> Flags:
        """Branches that a plan can have closed, (E,): all but ties that lack a phase."""
        found = np.ones(len(self), dtype=bool)
        if self.phases:
            found[self.network.n_lines :] = [ends is not None for ends in self.tie_ends]
        return found

    @cached_property
    def tie_ends(self) -> list[tuple[PhaseBus, PhaseBus] | None]:
        """Buses with three phases and one voltage at the ends of each tie; None without any."""
        complete: dict[BusId, list[PhaseBus]] = {}
        for row in self.phases.buses:
            if len(row.phases.split()) == len(PHASES):
                complete.setdefault(row.at, []).append(row)
        sides = zip(self.ties.from_bus, self.ties.to_bus, strict=True)
        pairs = (product(complete.get(a, ()), complete.get(b, ())) for a, b in sides)
        return [next((p for p in own if p[0].kv == p[1].kv), None) for own in pairs]

    def phases_with(self, there: Flags) -> Phases:
        """The phases with the lines of some branches, (E,); a tie has no coupling of its phases."""
        phases, net = self.phases, self.network
        if not phases:
            return phases
        lines_gone = self.ends[: net.n_lines][~there[: net.n_lines]]
        gone = {frozenset(net.buses[ends]) for ends in lines_gone}
        at = {row.bus: row.at for row in phases.buses}

        def stays(row: PhaseLine | PhaseTransformer) -> bool:
            return frozenset((at[row.from_bus], at[row.to_bus])) not in gone

        lines = [*filter(stays, phases.lines)]
        for tie in np.flatnonzero(there[net.n_lines :]):
            ends = self.tie_ends[tie]
            assert ends is not None  # others are not moved
            z_ohm = complex(self.ties.r_ohm[tie], self.ties.x_ohm[tie])
            z_ohm *= (ends[0].kv / net.base_kv) ** 2
            most_a = float(self.ties.i_max_a[tie]) * net.base_kv / ends[0].kv
            rating = most_a if np.isfinite(most_a) else np.nan
            names = (ends[0].bus, ends[1].bus)
            apart = np.diag([z_ohm] * len(PHASES)).astype(np.complex128)
            lines.append(PhaseLine(*names, apart, np.zeros((3, 3)), rating))
        units = tuple(filter(stays, phases.transformers))
        return replace(phases, lines=tuple(lines), transformers=units)

    def with_states(
        self, read: Mapping[str, bool], before: Flags, out: Flags
    ) -> tuple[Flags, tuple[str, ...]]:
        """The configuration in which the switches are as they are read, the others as before.

        It has no loop, for a loop has no plan: of what would close one a line that is out is left
        open, or else what has closed last. A line without a switch is closed otherwise. Nor is a
        tie closed there that lacks a phase.

        Parameters
        ----------
        read : mapping
            Whether switches are closed, by their names.
        before : array of bool, shape (E,)
            Branches that were closed.
        out : array of bool, shape (E,)
            Branches that faults take out.

        Returns
        -------
        array of bool, shape (E,)
            Branches that are closed.
        tuple of str
            Why those that carry are left open, in words.

        Examples
        --------
        >>> from vppres.io.find import load_scenario
        >>> branches = Branches.of(load_scenario("uk-heatwave-2022"))
        >>> branches.with_states({}, branches.closed, ~branches.closed)[1]
        ()
        """
        states = self.states(before) | dict(read)
        switched = [states.get(name, True) for name in self.names]
        read_closed = np.where(self.switch >= 0, switched, True)
        closed = read_closed & self.can_close
        order = np.lexsort((~before, out))
        joins, _ = forest(self.ends, order[closed[order]], self.network.n_buses)
        left = [(LOOPED, closed & ~joins & ~out), (LACKS_A_PHASE, read_closed & ~self.can_close)]
        words = [why.format(self.names[i]) for why, which in left for i in np.flatnonzero(which)]
        return joins, tuple(words)

    def states(self, closed: Flags) -> dict[str, bool]:
        """Whether each switch is closed in a configuration, by its name."""
        return {
            self.names[branch]: bool(closed[branch]) for branch in np.flatnonzero(self.switch >= 0)
        }

    def moves(self, before: Flags, after: Flags) -> str:
        """Operations between two configurations, in words.

        >>> from vppres.io.find import load_scenario
        >>> branches = Branches.of(load_scenario("uk-heatwave-2022"))
        >>> branches.moves(branches.closed, branches.closed & (np.arange(32) != 5))
        'opened 19-20'
        """
        words = []
        for verb, which in (("closed", after & ~before), ("opened", before & ~after)):
            if which.any():
                words.append(f"{verb} {named([self.names[i] for i in np.flatnonzero(which)])}")
        return ", ".join(words)

    def open_names(self, closed: Flags) -> tuple[str, ...]:
        """Names of the branches that are open."""
        return tuple(self.names[i] for i in np.flatnonzero(~closed))

    def closed_but(self, open_names: Iterable[str]) -> Flags:
        """The configuration in which all are closed but some, by their names."""
        names = set(open_names)
        return np.array([name not in names for name in self.names], dtype=bool)


def out_of_branches(out: OutOfService, ends: Wholes) -> Flags:
    """Branches that faults take out, (W, E), of lines and buses in the order of the day."""
    found: Flags = np.asarray(out.buses[:, ends].any(axis=2))
    found[:, : out.lines.shape[1]] |= out.lines
    return found


def forest(ends: Wholes, branches: Wholes, n_buses: int) -> tuple[Flags, Wholes]:
    """Branches that join two blocks, taken one after another, and the blocks in the end.

    ``branches`` are taken in their order, and ``ends`` are the buses of all, (E, 2).

    Returns
    -------
    array of bool, shape (E,)
        Those that join, the others would close loops.
    array of int, shape (N,)
        Number of the block of each bus: its first bus.

    Examples
    --------
    >>> joins, blocks = forest(np.array([[0, 1], [2, 1], [0, 2]]), np.arange(3), 4)
    >>> joins.tolist(), blocks.tolist()
    ([True, True, False], [0, 0, 0, 3])
    """
    first = list(range(n_buses))
    joins = np.zeros(len(ends), dtype=bool)

    def root(bus: int) -> int:
        while first[bus] != bus:
            first[bus] = first[first[bus]]
            bus = first[bus]
        return bus

    for branch, (a, b) in zip(branches.tolist(), ends[branches].tolist(), strict=True):
        one, other = sorted((root(a), root(b)))
        joins[branch] = one != other
        first[other] = one
    return joins, np.array([root(bus) for bus in range(n_buses)])


def blocks_of(ends: Wholes, closed: Flags, n_buses: int) -> Wholes | None:
    """Number of the block of each bus that closed branches join, (N,); None if they have a loop.

    >>> blocks_of(np.array([[0, 1], [2, 1], [0, 2]]), np.array([True, True, False]), 3).tolist()
    [0, 0, 0]
    >>> blocks_of(np.array([[0, 1], [2, 1], [0, 2]]), np.ones(3, dtype=bool), 3) is None
    True
    """
    joins, blocks = forest(ends, np.flatnonzero(closed), n_buses)
    return blocks if np.array_equal(joins, closed) else None


@dataclass(frozen=True, eq=False)
class Configured:
    """A scenario in a configuration, and where its buses and lines stand in the day's own order."""

    #: The day whose network is a tree with all closed branches. What else the tree needs is open:
    #: lines that are out all day.
    scenario: Scenario
    buses: Wholes  #: position in the tree of each bus of the day, (N,)
    lines: Wholes  #: line of the tree that each branch is; -1 if it is none, (E,)
    sign: Floats  #: -1 where the tree has the branch the other way round, (E,)
    closed: Flags  #: branches that are closed, (E,)

    def at_buses(self, values: Any) -> Any:
        """Values of the tree's buses, (..., N), in the order of the day."""
        return values[..., self.buses]

    def out_of(self, out: OutOfService) -> OutOfService:
        """Lines and buses that are out, from the order of the day to that of the tree."""
        net = self.scenario.network
        lines = np.ones((len(out.lines), net.n_lines), dtype=bool)  # what is open is out
        stands = self.closed & (self.lines >= 0)
        of_day = np.flatnonzero(stands[: out.lines.shape[1]])
        lines[:, self.lines[stands]] = False
        lines[:, self.lines[of_day]] = out.lines[:, of_day]
        buses = np.empty_like(out.buses)
        buses[:, self.buses] = out.buses
        at_bus = buses[:, np.arange(1, net.n_buses)] | buses[:, net.parent]
        return OutOfService(lines | at_bus, buses)

    def at_branches(self, first: Floats, second: Floats | None = None) -> Floats:
        """Flows at the first ends of the tree's lines, (L,), at the first ends of branches, (E,).

        ``second`` are flows that arrive at their second ends, equal to the first if not given. Open
        branches have none.
        """
        arriving = first if second is None else second
        at_end = np.where(self.sign > 0, first[self.lines], -arriving[self.lines])
        return np.where(self.lines >= 0, at_end, 0.0)


def in_configuration(day: Scenario, branches: Branches, closed: Flags) -> Configured:
    """The day in a configuration.

    Raises
    ------
    ValueError
        If they have a loop.
    """
    net = day.network
    n_buses = net.n_buses
    if np.array_equal(closed, branches.closed):
        lines = np.where(closed, np.arange(len(branches)), -1)
        return Configured(day, np.arange(n_buses), lines, np.ones(len(branches)), closed)
    chosen = _tree(branches.ends, closed, n_buses)
    columns: dict[str, Any] = {
        name: branches.of_line(name)[chosen]
        for name in ("from_bus", "to_bus", *OF_THE_LINE, *LINE_DEFAULTS)
    }
    tree = replace(net, **columns)
    fed = {
        frozenset(pair): i for i, pair in enumerate(zip(tree.from_bus, tree.to_bus, strict=True))
    }
    lines = np.full(len(branches), -1)
    lines[chosen] = [
        fed[frozenset((branches.from_bus[e], branches.to_bus[e]))] for e in chosen.tolist()
    ]
    turned = tree.from_bus[lines] != branches.from_bus
    changed = replace(
        day,
        network=tree,
        phases=branches.phases_with(np.isin(np.arange(len(branches)), chosen)),
        switches=Switches.none(),
        faults=tuple(_faults_of(day, closed, tree, lines)),
    )
    buses = np.array([tree.bus_index[bus] for bus in net.buses])
    sign = np.where((lines >= 0) & turned, -1.0, 1.0)
    return Configured(changed, buses, lines, sign, closed)


def _tree(ends: Wholes, closed: Flags, n_buses: int) -> Wholes:
    """Closed branches, and the first others that join what they leave apart, in order."""
    order = np.argsort(~closed, kind="stable")
    chosen, _ = forest(ends, order, n_buses)
    if not chosen[closed].all():
        raise ValueError("closed branches have a loop")
    return np.flatnonzero(chosen)


def _faults_of(day: Scenario, closed: Flags, tree: Network, lines: Wholes) -> Iterator[LineFault]:
    """Faults of the tree's lines and of buses, and its open branches."""
    for fault in day.faults:
        if fault.line is None:
            yield fault
            continue
        line = lines[fault.at(day.network) - 1]
        if line >= 0:
            yield replace(fault, line=tree.to_bus[line])
    grid = day.grid
    for branch in np.flatnonzero(~closed & (lines >= 0)):
        yield OpenLine(grid.start, grid.end, line=tree.to_bus[lines[branch]])
