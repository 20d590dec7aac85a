"""The loops that open switches would close, and the radial configurations that follow from them.

A feeder with K open switches has K independent loops, one for each. Opening K branches gives a
radial configuration if and only if the rows of these branches in the loop matrix are independent.
Branches with the same row up to its sign are in series: of them any one can be open.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes, freeze
from vppres.core.errors import InputError, Problem
from vppres.io.messages import did_you_mean
from vppres.scenario.configuration import Branches
from vppres.scenario.network import Network
from vppres.scenario.switches import Switches

NO_TIE = (
    "Add a line that is normally open: in the network's file one that is out of service or has an "
    "open switch, in a scenario's folder a row of switches.csv."
)


@dataclass(frozen=True, eq=False)
class SwitchedNetwork:
    """A radial feeder with the open switches that could be closed.

    Branches are the lines of the network, in its order, and after them the switches: ``L + K``.

    Examples
    --------
    A ring of three lines of which one is open:

    >>> net = Network([1, 1], [2, 3], [1.0, 1.0], [1.0, 1.0], slack_bus=1, base_kv=10.0)
    >>> tie = Switches(["a"], [2], [3], ["tie"], [False], r_ohm=[1.0], x_ohm=[1.0])
    >>> ring = SwitchedNetwork(net, tie, np.ones(2, dtype=bool))
    >>> ring.count, [block.tolist() for block in ring.configurations(10)]
    (3, [[[0], [1], [2]]])
    """

    network: Network  #: the feeder as it is
    #: The K switches that are open and can be closed, each between two buses of the network.
    ties: Switches
    can_open: Flags  #: lines that can be opened, (L,)
    line_names: tuple[str, ...] = ()

    @property
    def n_loops(self) -> int:
        """Number of open switches, K."""
        return len(self.ties)

    @property
    def present(self) -> Wholes:
        """The branches that are open now, (K,)."""
        return self.network.n_lines + np.arange(self.n_loops)

    @cached_property
    def ends(self) -> tuple[Wholes, Wholes]:
        """Positions of the buses at both ends of each switch, (K,) each."""
        index = self.network.bus_index
        return (
            np.array([index[bus] for bus in self.ties.from_bus], dtype=int),
            np.array([index[bus] for bus in self.ties.to_bus], dtype=int),
        )

    @cached_property
    def loops(self) -> Wholes:
        """Loop matrix, (L + K, K): column k has 1 or -1 for each branch of switch k's loop."""
        down = self.network.downstream.toarray().astype(int)
        start, end = self.ends
        return freeze(np.vstack([down[:, start] - down[:, end], np.eye(self.n_loops, dtype=int)]))

    @cached_property
    def may_open(self) -> Flags:
        """Branches that may be open in a configuration, (L + K,)."""
        own = np.append(self.can_open, np.ones(self.n_loops, dtype=bool))
        return freeze(own & self.loops.any(axis=1))

    @property
    def count(self) -> int:
        """Number of radial configurations, by Kirchhoff's determinant.

        It is that of the loops, whose minors are 0 or ±1 (Cauchy and Binet); from about 1e15 on the
        last digits are rounded.
        """
        rows = self.loops[self.may_open].astype(float)
        return round(float(np.linalg.det(rows.T @ rows))) if self.n_loops else 1

    @cached_property
    def _series(self) -> list[tuple[int, Wholes]]:
        """Groups of branches in series: the loops that they belong to as bits, and the branches."""
        groups: dict[int, list[int]] = {}
        for branch in np.flatnonzero(self.may_open):
            bits = sum(1 << int(loop) for loop in np.flatnonzero(self.loops[branch]))
            groups.setdefault(bits, []).append(int(branch))
        return [(bits, np.array(members)) for bits, members in groups.items()]

    def configurations(self, at_once: int) -> Iterator[Wholes]:
        """All sets of K branches of which the opening leaves a tree, in blocks of shape (T, K)."""
        waiting: list[Wholes] = []
        held = 0
        for groups in _independent([bits for bits, _ in self._series], self.n_loops):
            members = [self._series[group][1] for group in groups]
            total = int(np.prod([len(own) for own in members], dtype=np.int64))
            for first in range(0, total, at_once):
                which = np.arange(first, min(first + at_once, total))
                waiting.append(_products(members, which))
                held += len(which)
                if held >= at_once:
                    yield np.concatenate(waiting)
                    waiting, held = [], 0
        if waiting:
            yield np.concatenate(waiting)

    def exchanges(self, opened: Wholes, place: int) -> Wholes:
        """Configurations that close one open branch, and open another of its loop, (T, K).

        ``place`` is the position among the ``opened``, (K,), of the one that is closed.
        """
        inverse = np.linalg.inv(self.loops[opened].astype(float))
        joined = self.may_open & (np.abs(self.loops @ inverse[:, place]) > 0.5)
        joined[opened] = False
        found = np.tile(opened, (int(joined.sum()), 1))
        found[:, place] = np.flatnonzero(joined)
        return found

    @cached_property
    def ratios(self) -> Floats:
        """Referred voltage at a switch's first end over that at its second, at no load, (K,)."""
        start, end = self.ends
        ratio = self.network.bus_ratio
        return freeze(ratio[end] / ratio[start])


def switched_network(
    network: Network, switches: Switches, only: Sequence[str] = (), any_line: bool = True
) -> SwitchedNetwork:
    """The feeder with the switches that may move.

    Switches that are not operable, or are locked, stay as they are. Lines with a ratio are not
    opened.

    Those that may move are ``only`` these, of switches by name and of lines as ``7-8``, or all;
    with ``any_line`` lines without a switch too, as studies of reconfiguration have it.

    Raises
    ------
    InputError
        If a name is unknown, or no switch can be closed.
    """
    branches = Branches(network, switches)
    standing, lines = branches.switch[: network.n_lines], branches.names[: network.n_lines]
    movable = np.append(switches.movable, any_line)  # the last is that of lines without a switch
    can_open = (network.ratio == 1.0) & movable[standing]
    ties = switches.rows(~switches.closed & switches.movable)
    if only:
        ends = Branches(network, Switches.none()).names
        _check_known(only, [*map(str, switches.id), *lines, *ends])
        ties = ties.rows(_among([str(name) for name in ties.id], only))
        can_open = can_open & (_among(lines, only) | _among(ends, only))
    if not len(ties):
        cure = NO_TIE if not only else "Give an open switch with --switch too."
        raise InputError.of("switches", "has no open switch that can be closed", cure)
    return SwitchedNetwork(network, ties, can_open, lines)


def branch_names(feeder: SwitchedNetwork) -> list[str]:
    """Names of the branches: by their switches, and of lines without one by their buses."""
    return [*feeder.line_names, *map(str, feeder.ties.id)]


def _among(names: Sequence[str], wanted: Sequence[str]) -> Flags:
    """Which names are wanted; a line has two, one from each end."""
    known = {*wanted, *(_turned(name) for name in wanted)}
    return np.array([name in known for name in names], dtype=bool)


def _turned(name: str) -> str:
    """A line's name from its other end."""
    start, dash, end = name.partition("-")
    return end + dash + start


def _check_known(wanted: Sequence[str], known: Sequence[str]) -> None:
    """Refuse names that are those of no branch."""
    both = {*known, *map(_turned, known)}
    problems = [
        Problem(
            "switches",
            "is no switch and no line of the feeder",
            did_you_mean(name, known, "Give a switch's name, or a line as its two buses: 7-8."),
            field="switch",
            value=name,
        )
        for name in wanted
        if name not in both
    ]
    if problems:
        raise InputError(problems)


def _products(members: list[Wholes], which: Wholes) -> Wholes:
    """Some of all choices of one branch from each group, (T, K)."""
    if not members:
        return np.empty((len(which), 0), dtype=int)
    places = np.unravel_index(which, [len(own) for own in members])
    return np.stack([own[at] for own, at in zip(members, places, strict=True)], axis=1)


def _independent(rows: list[int], rank: int) -> Iterator[tuple[int, ...]]:
    """Sets of ``rank`` rows of bits that are independent over the numbers modulo 2.

    The minors of a loop matrix are 0 or ±1, so this is independence as such.
    """
    # What the rows from each on still reach: a branch of the search that cannot be completed ends.
    behind: list[list[int]] = [[]]
    for row in reversed(rows):
        behind.append(_with(behind[-1], row))
    behind.reverse()

    def chosen(first: int, basis: list[int], taken: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        if len(taken) == rank:
            yield taken
            return
        for row in range(first, len(rows)):
            if _rank(basis, behind[row]) < rank:
                return
            more = _with(basis, rows[row])
            if len(more) > len(basis):
                yield from chosen(row + 1, more, (*taken, row))

    return chosen(0, [], ())


def _with(basis: list[int], row: int) -> list[int]:
    """The basis with a row, unless it depends on it; each element has a highest bit of its own."""
    for one in basis:
        row = min(row, row ^ one)
    return [*basis, row] if row else basis


def _rank(basis: list[int], more: list[int]) -> int:
    """Rank of two bases together."""
    for row in more:
        basis = _with(basis, row)
    return len(basis)
