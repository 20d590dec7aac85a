"""Switches of a feeder: normally open ties, and closed ones that stand on its lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from vppres.core.arrays import Flags, Floats, Items, Names, no_items
from vppres.core.errors import Problem
from vppres.scenario.network import BusId

KINDS = ("tie", "sectionaliser", "breaker")
"""Kinds of switches: between two branches, within a line, and one that breaks faults."""

SWITCH_DEFAULTS = {
    "operable": True,
    "locked": "",
    "r_ohm": np.nan,
    "x_ohm": np.nan,
    "i_max_a": np.inf,
    "operation_cost": 0.0,
    "max_operations_per_day": np.inf,
    "minutes_to_operate": 0.0,
    "parallel_allowed": False,
    "sync_check": False,
}
"""Columns that a table of switches may lack, and their values then."""

OF_THE_LINE = ("r_ohm", "x_ohm", "i_max_a")
"""Columns of an open switch; of a closed one they are those of its line."""


@dataclass(frozen=True, eq=False)
class Switches(Items):
    """Switches, shape (W,) each.

    A closed switch stands on a line of the network, between whose buses it is. An open one is no
    line: closed lines alone are the tree.
    """

    id: Names
    #: Ends; of a closed switch those of its line.
    from_bus: Names
    to_bus: Names
    kind: Names  #: one of :data:`KINDS`
    closed: Flags
    #: Whether it can be moved at all; True if not given.
    operable: Flags = field(default_factory=no_items)
    #: Why it must stay as it is for now; empty if it need not.
    locked: Names = field(default_factory=no_items)
    #: Series impedance of an open switch with its line, referred to the network's voltage; NaN for
    #: a closed one.
    r_ohm: Floats = field(default_factory=no_items)
    x_ohm: Floats = field(default_factory=no_items)
    #: Thermal rating of an open one; infinite where there is none.
    i_max_a: Floats = field(default_factory=no_items)
    #: Price of an operation in weighted customer hours; 0 if not given.
    operation_cost: Floats = field(default_factory=no_items)
    #: Most operations in 24 hours; infinite without a limit.
    max_operations_per_day: Floats = field(default_factory=no_items)
    #: Time from the decision to the new state; 0 if not given.
    minutes_to_operate: Floats = field(default_factory=no_items)
    #: Whether it may close a loop for a while; False if not given.
    parallel_allowed: Flags = field(default_factory=no_items)
    #: Whether it can compare both sides before it closes; False if not given.
    sync_check: Flags = field(default_factory=no_items)

    def __post_init__(self) -> None:
        for name, default in SWITCH_DEFAULTS.items():
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.full(len(self.id), default, dtype=object))
        super().__post_init__()

    @property
    def movable(self) -> Flags:
        """Switches that may change their state: operable, and not locked."""
        return np.asarray(self.operable & (self.locked == ""))


def switch_problems(switches: Switches, from_bus: Names, to_bus: Names) -> Iterator[Problem]:
    """Problems of switches beside the lines between these buses, each with its position as row."""
    known: set[BusId] = {*from_bus, *to_bus}
    lines = {frozenset(ends) for ends in zip(from_bus, to_bus, strict=True)}
    first: dict[frozenset[BusId], str] = {}
    for i, name in enumerate(switches.id):
        ends = {end: getattr(switches, end)[i] for end in ("from_bus", "to_bus")}
        strange = [(end, bus) for end, bus in ends.items() if bus not in known]
        for end, bus in strange:
            yield _problem(i, end, "is not a bus of lines.csv", "Correct the bus.", bus)
        if strange:
            continue
        pair = frozenset(ends.values())
        if len(pair) == 1:
            bus = ends["to_bus"]
            yield _problem(i, "to_bus", "is also its other end", "Correct one of them.", bus)
        elif switches.closed[i]:
            if pair not in lines:
                message = "is closed, and no line of lines.csv joins its buses"
                cure = "Add its line to lines.csv, or open the switch."
                yield _problem(i, "id", message, cure, name)
            elif pair in first:
                message = f"stands on the same line as {first[pair]}"
                yield _problem(i, "id", message, "Give each line one row: its state is one.", name)
            first.setdefault(pair, name)
        yield from _of_its_line(switches, i)


def _of_its_line(switches: Switches, i: int) -> Iterator[Problem]:
    """Values that an open switch lacks, or that a closed one has beside its line."""
    for name in OF_THE_LINE:
        value = float(getattr(switches, name)[i])
        if switches.closed[i] and np.isfinite(value):
            message = "is given for a closed switch"
            yield _problem(i, name, message, "Leave it empty: lines.csv has it.", value)
        elif not switches.closed[i] and np.isnan(value):
            cure = "Give the value that its line has when it is closed."
            yield _problem(i, name, "is not given for an open switch", cure)


def _problem(
    row: int, field: str, message: str, cure: str, value: BusId | float | None = None
) -> Problem:
    return Problem("switches", message, cure, row=row, field=field, value=value)
