"""Which switches of a feeder may move, and what its branches are called."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vppres.core.arrays import Flags
from vppres.core.errors import InputError, Problem
from vppres.feeders.reconfiguration.loops import SwitchedNetwork
from vppres.io.messages import did_you_mean
from vppres.scenario.configuration import Branches
from vppres.scenario.network import Network
from vppres.scenario.switches import Switches

NO_TIE = (
    "Add a line that is normally open: in the network's file one that is out of service or has an "
    "open switch, in a scenario's folder a row of switches.csv."
)


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
