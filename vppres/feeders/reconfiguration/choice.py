"""Which switches of a feeder may move, and what its branches are called."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vppres.core.arrays import Flags
from vppres.core.errors import InputError, Problem
from vppres.feeders.reconfiguration.loops import SwitchedNetwork
from vppres.feeders.ties import Ties
from vppres.io.messages import did_you_mean
from vppres.scenario.network import Network

NO_TIE = (
    "Add a line that is normally open: in the network's file one that is out of service or has an "
    "open switch."
)


def switched_network(network: Network, ties: Ties, only: Sequence[str] = ()) -> SwitchedNetwork:
    """The feeder with the switches that may move.

    All open switches may be closed. All lines may be opened but those with a ratio, as studies of
    reconfiguration have it.

    Parameters
    ----------
    network : Network
        The feeder as it is.
    ties : Ties
        Its open switches.
    only : sequence of str, optional
        Names of those that may move, if not all: of switches, and of lines as ``7-8``.

    Raises
    ------
    InputError
        If a name is unknown, or no switch can be closed.
    """
    can_open = network.ratio == 1.0
    if only:
        tie_names, line_names = _names(network, ties)
        _check_known(only, [*tie_names, *line_names])
        ties = ties.rows(_among(tie_names, only))
        can_open = can_open & _among(line_names, only)
    if not len(ties):
        cure = NO_TIE if not only else "Give an open switch with --switch too."
        raise InputError.of("switches", "has no open switch that can be closed", cure)
    return SwitchedNetwork(network, ties, can_open)


def branch_names(feeder: SwitchedNetwork) -> list[str]:
    """Names of the branches: lines by their buses, and switches by their own."""
    ties, lines = _names(feeder.network, feeder.ties)
    return [*lines, *ties]


def _names(network: Network, ties: Ties) -> tuple[list[str], list[str]]:
    """Names of the switches and of the lines."""
    lines = zip(network.from_bus, network.to_bus, strict=True)
    return [str(name) for name in ties.id], [f"{start}-{end}" for start, end in lines]


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
