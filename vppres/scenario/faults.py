"""Faults of lines and buses, and the parts into which they cut a feeder.

A line that is out carries nothing. What is behind it is a *part* of the feeder of its own, without
the grid.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Wholes, freeze_arrays
from vppres.core.errors import InputError, Problem
from vppres.scenario.network import BusId, Network
from vppres.scenario.timegrid import TimeGrid


@dataclass(frozen=True)
class LineFault:
    """A line or a bus that is out of service, ``end`` not included."""

    #: From when until when. A step that it reaches into is one without the line.
    start: pd.Timestamp
    end: pd.Timestamp
    line: BusId | None = None  #: the bus that the line feeds
    bus: BusId | None = None  #: a bus that is out itself, with all of its lines
    #: Whether plans see it before it begins. Once it has begun they know its end in any case.
    known: bool = True

    def __post_init__(self) -> None:
        if not self.start < self.end:
            message, cure = "does not come after start", "Give the time at which it is repaired."
            raise InputError.of("faults", message, cure, field="end", value=self.end)

    def at(self, network: Network) -> int:
        """Position of its bus: the line of that bus, or the bus itself, is out."""
        bus = self.bus if self.line is None else self.line
        assert bus is not None  # a scenario has no other faults
        return network.bus_index[bus]

    def lines(self, network: Network) -> Flags:
        """Lines that it takes out of service, (L,)."""
        at = self.at(network)
        leaving = (network.parent == at) & (self.line is None)
        return np.asarray((np.arange(network.n_lines) == at - 1) | leaving)

    def name(self, network: Network) -> str:
        """The line, or the bus, in words."""
        if self.line is None:
            return f"bus {self.bus}"
        return line_name(network, self.at(network) - 1)


class OpenLine(LineFault):
    """A line that is only open, in a configuration: it carries as little as one that is out."""


def line_name(network: Network, line: int) -> str:
    """A line by its ends, that towards the grid first.

    >>> line_name(Network([2], [1], [0.1], [0.1], slack_bus=1, base_kv=11.0), 0)
    'line 1-2'
    """
    return f"line {network.from_bus[line]}-{network.to_bus[line]}"


def check_places(faults: Iterable[LineFault], network: Network) -> None:
    """Refuse faults that name no line and no bus of a network, or both.

    Raises
    ------
    InputError
        With all of them.
    """
    behind_grid = set(network.buses[1:].tolist())
    cure = "Give the bus that the line feeds, or the bus that is out itself."
    problems = []
    for row, fault in enumerate(faults):
        given = {name: bus for name in ("line", "bus") if (bus := getattr(fault, name)) is not None}
        if len(given) != 1:
            problems.append(Problem("faults", "names not one place", cure, row=row))
            continue
        [(field, bus)] = given.items()
        if bus not in behind_grid:
            message = "is not a bus behind the grid's"
            problems.append(Problem("faults", message, cure, row, field, bus))
    if problems:
        raise InputError(problems)


@dataclass(frozen=True, eq=False)
class OutOfService:
    """Lines and buses that are out in W steps."""

    lines: Flags  #: lines that carry nothing, (W, L)
    buses: Flags  #: buses at which nothing can be supplied, (W, N)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @classmethod
    def of(
        cls, faults: Iterable[LineFault], network: Network, grid: TimeGrid, steps: range
    ) -> OutOfService:
        """Lines and buses that some faults take out in the steps.

        Examples
        --------
        >>> net = Network([1, 2], [2, 3], [0.1, 0.1], [0.1, 0.1], slack_bus=1, base_kv=11.0)
        >>> noon = pd.Timestamp("2025-07-01T12:00Z")
        >>> hours = TimeGrid(noon, 60.0, 3)
        >>> fault = LineFault(noon, noon + pd.Timedelta(hours=1), bus=2)
        >>> OutOfService.of([fault], net, hours, range(3)).lines.astype(int).tolist()
        [[1, 1], [0, 0], [0, 0]]
        """
        begins = grid.times[steps.start : steps.stop]
        lines = np.zeros((len(begins), network.n_lines), dtype=bool)
        buses = np.zeros((len(begins), network.n_buses), dtype=bool)
        for fault in faults:
            during = np.asarray((begins < fault.end) & (begins + grid.step > fault.start))
            lines |= during[:, None] & fault.lines(network)
            if fault.line is None:
                buses[during, fault.at(network)] = True
        return cls(lines, buses)

    def part(self, steps: slice) -> OutOfService:
        """Some of the steps."""
        return OutOfService(self.lines[steps], self.buses[steps])

    def repaired(self) -> OutOfService:
        """Steps in which nothing is out, as many as these."""
        return OutOfService(np.zeros_like(self.lines), np.zeros_like(self.buses))

    def names(self, network: Network, step: int) -> list[str]:
        """Lines and buses that are out in a step, in words."""
        at = np.flatnonzero(self.buses[step])
        of_buses = np.isin(network.parent, at) | np.isin(np.arange(network.n_lines) + 1, at)
        lines = np.flatnonzero(self.lines[step] & ~of_buses)
        words = [f"bus {network.buses[bus]}" for bus in at]
        return [*words, *(line_name(network, line) for line in lines.tolist())]


def parts_by_bus(network: Network, lines: Flags) -> Wholes:
    """Number of the part of each bus in each step, (W, N): the position of its first bus.

    The part with the grid's bus is 0, each other one is behind the line of its first bus.

    Examples
    --------
    >>> net = Network([1, 2, 2], [2, 3, 4], [0.1] * 3, [0.1] * 3, slack_bus=1, base_kv=11.0)
    >>> parts_by_bus(net, np.array([[False, False, True]])).tolist()
    [[0, 0, 0, 3]]
    """
    number = np.tile(np.arange(network.n_buses), (len(lines), 1))
    for line, above in enumerate(network.parent):
        number[:, line + 1] = np.where(lines[:, line], line + 1, number[:, above])
    return number


def known_faults(
    faults: Iterable[LineFault], now: pd.Timestamp, step: pd.Timedelta
) -> list[LineFault]:
    """Faults that plans of a step know: those known before, and those that have begun."""
    return [fault for fault in faults if fault.known or fault.start < now + step]
