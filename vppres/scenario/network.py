"""The radial network: topological order, incidence, and the checks that make it radial."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import (
    breadth_first_order,
    connected_components,
    minimum_spanning_tree,
)

from vppres.core.arrays import Flags, Floats, Names, Wholes, freeze, no_items
from vppres.core.errors import InputError, Problem
from vppres.core.units import ohm_to_pu2_per_kw, us_to_kw_at_1_pu

BusId = int | str

LINE_DEFAULTS = {"i_max_a": np.inf, "ratio": 1.0, "b_us": 0.0, "g_us": 0.0}
"""Columns that a table of lines may lack, and their values then."""

BUS_DRAWS = ("p_shunt_kw", "q_shunt_kvar", "p_fixed_kw", "q_fixed_kvar")
"""Columns of power that a bus draws without a customer."""

LOW_VOLTAGE_KV = 1.0
"""Highest nominal voltage between lines that counts as low (EN 50160)."""

RATING_CURE = "Give the thermal rating in A, infinite where a line has none."
RATIO_CURE = "Give the voltage in pu at from_bus over that at to_bus, 1 where a line has no tap."

MAX_LOOPS = 20  # that are named; each costs a search of the network
MAX_LOOP_SHOWN = 12  # buses


@dataclass(frozen=True, eq=False)
class Network:
    """A radial feeder.

    Lines may be given in any order and direction; they are kept oriented away from the slack bus
    and sorted so that every line comes after the line that feeds it. Bus 0 of every array is the
    slack bus, and line ``l`` ends at bus ``l + 1``.

    A line with a ratio is an ideal transformer at its ``from_bus`` with impedance and charging
    behind it, as in MATPOWER. Where such a line is turned around, its ratio is inverted and its
    impedance is referred to the other side, which changes nothing that its ends can see.

    In a tree every bus has one cumulative ratio to the slack bus. Voltages over it are *referred*
    to the slack bus: in them no line has a ratio, and impedances, shunts and limits change instead.

    Raises
    ------
    InputError
        If the lines do not form a tree with the slack bus in it, an impedance or a ratio is not
        one that a line can have, or a bus that draws power is not in the network.

    Examples
    --------
    >>> net = Network([2, 2], [1, 3], [0.1, 0.2], [0.05, 0.1], slack_bus=1, base_kv=11.0)
    >>> net.buses.tolist(), net.to_bus.tolist(), net.parent.tolist()
    ([1, 2, 3], [2, 3], [0, 1])

    A transformer that raises the voltage by 5%, given against its direction:

    >>> net = Network([2], [1], [0.1], [0.1], slack_bus=1, base_kv=11.0, ratio=[1.05])
    >>> net.ratio.round(4).tolist(), net.bus_ratio.round(4).tolist()
    ([0.9524], [1.0, 1.05])
    """

    #: Ends of each line, (L,); integers or strings.
    from_bus: Names
    to_bus: Names
    #: Series impedance, (L,); a reactance may be negative, as in a star of three windings.
    r_ohm: Floats
    x_ohm: Floats
    slack_bus: BusId  #: bus of the grid connection
    base_kv: float  #: nominal line-to-line voltage in kV
    v_slack_pu: float = 1.0  #: voltage of the slack bus
    #: Limits that the optimisation holds (paper, Parameter Selection).
    v_min_pu: float = 0.947
    v_max_pu: float = 1.053
    #: Limits that the AC voltages must hold (GB SQSS: 0.94).
    v_min_ac_pu: float = 0.94
    v_max_ac_pu: float = 1.06
    #: Thermal rating, (L,); infinite where a line has none. It is reported, not held.
    i_max_a: Floats = field(default_factory=no_items)
    #: Voltage in pu at ``from_bus`` over that at ``to_bus`` at no load, 1 if not given, (L,).
    ratio: Floats = field(default_factory=no_items)
    #: Charging susceptance and leakage conductance of the whole line in microsiemens, half at each
    #: end, (L,); 0 if not given.
    b_us: Floats = field(default_factory=no_items)
    g_us: Floats = field(default_factory=no_items)
    #: Buses that draw power that no customer owns, (D,); afterwards all buses, shape (N,).
    drawing_bus: Names = field(default_factory=no_items)
    #: Constant admittance at these buses as the power that it draws at 1 pu, line charging left
    #: out, (D,); a capacitor's is negative.
    p_shunt_kw: Floats = field(default_factory=no_items)
    q_shunt_kvar: Floats = field(default_factory=no_items)
    #: Constant power drawn there, (D,).
    p_fixed_kw: Floats = field(default_factory=no_items)
    q_fixed_kvar: Floats = field(default_factory=no_items)
    #: Whether the shunts at these buses stay connected in an island, (D,); all do if not given. One
    #: row of a bus that says no switches off all shunts of the bus.
    island: Flags = field(default_factory=no_items)
    buses: Names = field(init=False)
    parent: Wholes = field(init=False)

    def __post_init__(self) -> None:
        ends = np.asarray(self.from_bus, dtype=object), np.asarray(self.to_bus, dtype=object)
        r = np.asarray(self.r_ohm, float)
        x = np.asarray(self.x_ohm, float)
        given = {name: self._filled(name, len(r)) for name in LINE_DEFAULTS}
        problems = (
            check_radial(ends[0], ends[1], self.slack_bus)
            + _check_impedance(r, x)
            + _check_positive("i_max_a", given["i_max_a"], len(r), np.inf, RATING_CURE)
            + _check_positive("ratio", given["ratio"], len(r), np.finfo(float).max, RATIO_CURE)
            + self._check_drawing({*ends[0], *ends[1]})
        )
        if problems:
            raise InputError(problems)
        order, parent, line_of = _orient(ends[0], ends[1], self.slack_bus)
        ratio = given["ratio"][line_of]
        turned = ends[1][line_of] != order[1:]
        other_side = np.where(turned, ratio**2, 1.0)
        values = {
            "buses": order,
            "parent": parent,
            "from_bus": order[parent],
            "to_bus": order[1:],
            "r_ohm": r[line_of] * other_side,
            "x_ohm": x[line_of] * other_side,
            "i_max_a": given["i_max_a"][line_of],
            "ratio": np.where(turned, 1.0 / ratio, ratio),
            "b_us": given["b_us"][line_of] / other_side,
            "g_us": given["g_us"][line_of] / other_side,
            **self._drawn_at(order),
        }
        for name, value in values.items():
            object.__setattr__(self, name, freeze(value))

    def _filled(self, name: str, n_lines: int) -> Floats:
        """A line's attribute as it was given, or its neutral value."""
        values = np.asarray(getattr(self, name), float)
        return values if len(values) else np.full(n_lines, LINE_DEFAULTS[name])

    def _check_drawing(self, known: set[BusId]) -> list[Problem]:
        """Buses that draw power and are no end of a line, and values that are not one for each."""
        count = len(self.drawing_bus)
        wrong = [
            Problem(
                "buses",
                f"must have one value for each of the {count} buses that draw power",
                "Give the power at nominal voltage, or the constant power, of each of them.",
                field=name,
                value=len(getattr(self, name)),
            )
            for name in (*BUS_DRAWS, "island")
            if len(getattr(self, name)) not in (0, count)
        ]
        return wrong + [
            Problem(
                "buses",
                "is not a bus of the network",
                "Give a bus that a line begins or ends at, or remove the row.",
                row=i,
                field="bus",
                value=bus,
            )
            for i, bus in enumerate(self.drawing_bus)
            # A copy with other lines keeps the names of buses that draw nothing.
            if bus not in known and self._draws(i)
        ]

    def _draws(self, row: int) -> bool:
        """Whether a row of the drawing buses has any power."""
        return any(len(values := getattr(self, name)) and values[row] for name in BUS_DRAWS)

    def _drawn_at(self, order: Names) -> dict[str, Any]:
        """Power that the buses draw by themselves, in the network's order; rows of a bus add up."""
        position = {bus: i for i, bus in enumerate(order)}
        rows = [i for i, bus in enumerate(self.drawing_bus) if bus in position]
        at = np.array([position[self.drawing_bus[i]] for i in rows], dtype=int)
        drawn: dict[str, Any] = {"drawing_bus": order}
        for name in BUS_DRAWS:
            values = np.asarray(getattr(self, name), float)
            drawn[name] = np.zeros(len(order))
            if len(values):
                np.add.at(drawn[name], at, values[rows])
        drawn["island"] = np.ones(len(order), dtype=bool)
        if len(self.island):
            np.logical_and.at(drawn["island"], at, np.asarray(self.island, bool)[rows])
        return drawn

    @property
    def n_buses(self) -> int:
        """Number of buses, the slack bus included."""
        return len(self.buses)

    @property
    def n_lines(self) -> int:
        """Number of lines."""
        return len(self.to_bus)

    @property
    def has_ratings(self) -> bool:
        """Whether any line has a rating."""
        return bool(np.isfinite(self.i_max_a).any())

    @cached_property
    def bus_index(self) -> dict[BusId, int]:
        """Position of each bus identifier."""
        return {bus: i for i, bus in enumerate(self.buses)}

    @cached_property
    def incidence(self) -> sp.csr_array:
        """Flow balance, shape (N, L): +1 where a line arrives at a bus, -1 where it leaves."""
        lines = np.arange(self.n_lines)
        rows = np.concatenate([lines + 1, self.parent])
        signs = np.repeat([1.0, -1.0], self.n_lines)
        return sp.csr_array((signs, (rows, np.tile(lines, 2))), shape=(self.n_buses, self.n_lines))

    @cached_property
    def downstream(self) -> sp.csr_array:
        """Shape (L, N): 1 where a bus is fed through a line; lossless flow = downstream @ load."""
        # Buses come after the bus that feeds them, so the way to each goes on from that one's.
        ways: list[Wholes] = [np.empty(0, dtype=np.int32)]
        for line, above in enumerate(self.parent):
            ways.append(np.append(ways[above], np.int32(line)))
        ends = np.cumsum([0, *map(len, ways)], dtype=np.int32)
        lines = np.concatenate(ways)
        shape = (self.n_lines, self.n_buses)
        return sp.csr_array(sp.csc_array((np.ones(len(lines)), lines, ends), shape=shape))

    @property
    def has_ratios(self) -> bool:
        """Whether any line has a ratio other than 1."""
        return bool((self.ratio != 1.0).any())

    @property
    def has_charging(self) -> bool:
        """Whether any line charges or leaks."""
        return bool(self.b_us.any() or self.g_us.any())

    @property
    def has_draws(self) -> bool:
        """Whether any bus has a shunt or a fixed demand of its own."""
        return any(getattr(self, name).any() for name in BUS_DRAWS)

    @property
    def draws(self) -> bool:
        """Whether the network itself draws power: charging, shunts or fixed demand."""
        return self.has_charging or self.has_draws

    @cached_property
    def islanded(self) -> Network:
        """The network as it is in an island: without the shunts that are switched off there.

        Examples
        --------
        >>> net = Network([1], [2], [0.1], [0.1], slack_bus=1, base_kv=10.0, drawing_bus=[2],
        ...               q_shunt_kvar=[-300.0], island=[False])
        >>> net.islanded.q_shunt_kvar.tolist()
        [0.0, 0.0]
        """
        off = ~self.island
        if not (self.p_shunt_kw[off].any() or self.q_shunt_kvar[off].any()):
            return self
        return replace(
            self,
            p_shunt_kw=np.where(off, 0.0, self.p_shunt_kw),
            q_shunt_kvar=np.where(off, 0.0, self.q_shunt_kvar),
        )

    def drawing_inside(self, buses: Flags, lines: Flags) -> Network:
        """The network whose other buses and lines draw nothing; itself if none does."""
        if not self.draws:
            return self
        at_buses = {name: getattr(self, name) * buses for name in BUS_DRAWS}
        return replace(self, b_us=self.b_us * lines, g_us=self.g_us * lines, **at_buses)

    @cached_property
    def bus_ratio(self) -> Floats:
        """Voltage of each bus in pu over its voltage referred to the slack bus, shape (N,)."""
        found = np.ones(self.n_buses)
        for line, above in enumerate(self.parent):
            found[line + 1] = found[above] / self.ratio[line]
        return freeze(found)

    @cached_property
    def held_pu(self) -> Floats:
        """Voltage at which a source at each bus holds it, shape (N,).

        The grid holds ``v_slack_pu``, and so does a battery that forms an island. Where taps are
        off nominal, that could put buses beyond them outside their limits: there the battery holds
        the middle of what keeps all voltages inside them at no load.
        """
        found = np.full(self.n_buses, self.v_slack_pu)
        if self.has_ratios:
            least = self.v_min_pu / self.bus_ratio.min()
            most = self.v_max_pu / self.bus_ratio.max()
            found[1:] = self.bus_ratio[1:] * (least + most) / 2
        return freeze(found)

    @cached_property
    def referred_r_ohm(self) -> Floats:
        """Series resistance referred to the slack bus, shape (L,)."""
        return freeze(self.r_ohm / self.bus_ratio[1:] ** 2)

    @cached_property
    def referred_x_ohm(self) -> Floats:
        """Series reactance referred to the slack bus, shape (L,)."""
        return freeze(self.x_ohm / self.bus_ratio[1:] ** 2)

    @cached_property
    def r_pu2_per_kw(self) -> Floats:
        """Drop of the referred V² per kW of flow, without the factor 2 of LinDistFlow."""
        return ohm_to_pu2_per_kw(self.referred_r_ohm, self.base_kv)

    @cached_property
    def x_pu2_per_kvar(self) -> Floats:
        """Drop of the referred V² per kvar of flow, without the factor 2 of LinDistFlow."""
        return ohm_to_pu2_per_kw(self.referred_x_ohm, self.base_kv)

    @cached_property
    def u_min_pu2(self) -> Floats:
        """Lower limit of each bus's squared referred voltage, shape (N,)."""
        return freeze((self.v_min_pu / self.bus_ratio) ** 2)

    @cached_property
    def u_max_pu2(self) -> Floats:
        """Upper limit of each bus's squared referred voltage, shape (N,)."""
        return freeze((self.v_max_pu / self.bus_ratio) ** 2)

    def u_pu2(self, v_pu: Floats) -> Floats:
        """Squared referred voltages of voltages in pu, shape (..., N)."""
        return np.asarray((v_pu / self.bus_ratio) ** 2)

    def v_pu(self, u_pu2: Floats) -> Floats:
        """Voltages in pu of squared referred voltages, shape (..., N)."""
        # Linear voltages of a feeder that cannot carry its demand fall below 0.
        return np.asarray(np.sqrt(np.maximum(u_pu2, 0.0)) * self.bus_ratio)

    @cached_property
    def shunt_kw(self) -> Floats:
        """Active power that shunts and leakage draw where every referred voltage is 1, (N,)."""
        return freeze(self._at_one_pu(self.g_us, self.p_shunt_kw))

    @cached_property
    def shunt_kvar(self) -> Floats:
        """Reactive power that shunts and charging draw where every referred voltage is 1, (N,)."""
        return freeze(self._at_one_pu(-self.b_us, self.q_shunt_kvar))

    def _at_one_pu(self, line_us: Floats, at_bus: Floats) -> Floats:
        """Admittances of lines, half at each end, and of buses, as power at 1 pu referred."""
        half = 0.5 * us_to_kw_at_1_pu(line_us, self.base_kv) * self.bus_ratio[1:] ** 2
        drawn = at_bus * self.bus_ratio**2
        np.add.at(drawn, self.parent, half)
        drawn[1:] += half
        return np.asarray(drawn)

    def drawn(self, v_pu: Floats) -> tuple[Floats, Floats]:
        """Power that the network itself draws at voltages in pu, kW and kvar, (..., N) each.

        Examples
        --------
        >>> net = Network([1], [2], [0.1], [0.1], slack_bus=1, base_kv=10.0, b_us=[20.0],
        ...               drawing_bus=[2], p_fixed_kw=[5.0])
        >>> [power.tolist() for power in net.drawn(np.array([1.0, 0.9]))]
        [[0.0, 5.0], [-1.0, -0.81]]
        """
        u = self.u_pu2(v_pu)
        return self.p_fixed_kw + self.shunt_kw * u, self.q_fixed_kvar + self.shunt_kvar * u

    def place(self, bus: Names) -> sp.csr_array:
        """Matrix of shape (N, len(bus)) that sums items onto their buses."""
        rows = [self.bus_index[b] for b in bus]
        return sp.csr_array(
            (np.ones(len(rows)), (rows, np.arange(len(rows)))), shape=(self.n_buses, len(rows))
        )


def check_radial(from_bus: Names, to_bus: Names, slack_bus: BusId) -> list[Problem]:
    """Problems that keep a set of lines from being a tree with the slack bus in it."""
    if len(from_bus) == 0:
        return [Problem("lines", "has no line", "Give at least one line.")]
    names, graph = _graph(from_bus, to_bus)
    if slack_bus not in names:
        return [
            Problem(
                "lines",
                f"no line touches the slack bus {slack_bus}",
                "Correct slack_bus or the lines.",
                field="slack_bus",
                value=slack_bus,
            )
        ]
    problems = [
        Problem(
            "lines",
            "begins and ends at the same bus",
            "Remove the line or correct an end.",
            row=i,
            field="to_bus",
            value=b,
        )
        for i, (a, b) in enumerate(zip(from_bus, to_bus, strict=True))
        if a == b
    ]
    count, label = connected_components(graph, directed=False)
    if count > 1:
        home = label[names[slack_bus]]
        lost = [b for b in names if label[names[b]] != home]
        row = next(i for i, bus in enumerate(from_bus) if label[names[bus]] != home)
        reached = [b for b in names if isinstance(b, str) and label[names[b]] == home]
        alike = [(b, near) for b in lost for near in get_close_matches(str(b), reached, n=1)]
        question = "Are {} and {} one bus? Otherwise add".format(*alike[0]) if alike else "Add"
        problems.append(
            Problem(
                "lines",
                "the network is disconnected: no path from the slack bus "
                f"to bus {', '.join(map(str, lost[:8]))}{' ...' if len(lost) > 8 else ''}",
                f"{question} the missing line or remove these buses.",
                row=row,
            )
        )
    problems += [
        Problem(
            "lines",
            f"closes a loop: {_loop_words(loop)}",
            "The network must be radial: open (remove) one line of the loop.",
            row=row,
            field="to_bus",
            value=to_bus[row],
        )
        for row, loop in islice(find_loops(from_bus, to_bus), MAX_LOOPS)
        if from_bus[row] != to_bus[row]
    ]
    return problems


def _loop_words(loop: list[BusId]) -> str:
    """The buses of a loop; of a long one, its ends."""
    shown = loop if len(loop) <= MAX_LOOP_SHOWN else [*loop[:4], "...", *loop[-4:]]
    return " - ".join(map(str, shown))


def find_loops(from_bus: Names, to_bus: Names) -> Iterator[tuple[int, list[BusId]]]:
    """Lines that close a loop, taken in order, each with the buses of its loop.

    >>> list(find_loops([1, 2, 3, 3], [2, 3, 1, 3]))
    [(2, [1, 2, 3]), (3, [3])]
    """
    if not len(from_bus):
        return
    names, _ = _graph(from_bus, to_bus)
    buses = [*names]
    ends = [(names[a], names[b]) for a, b in zip(from_bus, to_bus, strict=True)]
    pairs, first = np.unique(np.sort(ends, axis=1), axis=0, return_index=True)
    two = pairs[:, 0] != pairs[:, 1]
    # Lines weigh their places: one is in the lightest forest if none before it joins its ends.
    places = sp.coo_array((first[two] + 1.0, pairs[two].T), shape=(len(names),) * 2)
    forest = minimum_spanning_tree(places.tocsr())
    laid = {int(place) - 1 for place in forest.data}
    for row, (start, goal) in enumerate(ends):
        if row not in laid:
            _, before = breadth_first_order(forest, start, directed=False)
            loop = [goal]
            while loop[-1] != start:
                loop.append(int(before[loop[-1]]))
            yield row, [buses[place] for place in loop]


def _graph(from_bus: Names, to_bus: Names) -> tuple[dict[BusId, int], sp.csr_array]:
    """Bus numbering by first appearance and the adjacency matrix."""
    ends = (bus for line in zip(from_bus, to_bus, strict=True) for bus in line)
    names = {b: i for i, b in enumerate(dict.fromkeys(ends))}
    rows = [names[b] for b in from_bus]
    cols = [names[b] for b in to_bus]
    return names, sp.csr_array((np.ones(len(rows)), (rows, cols)), shape=(len(names),) * 2)


def _orient(from_bus: Names, to_bus: Names, slack_bus: BusId) -> tuple[Names, Wholes, Wholes]:
    """Buses in breadth-first order, parent of each but the first, and the line that feeds it."""
    names, graph = _graph(from_bus, to_bus)
    order, before = breadth_first_order(graph, names[slack_bus], directed=False)
    position = np.empty(len(order), dtype=int)
    position[order] = np.arange(len(order))
    line_between = {
        frozenset((a, b)): i for i, (a, b) in enumerate(zip(from_bus, to_bus, strict=True))
    }
    labels = np.array(list(names), dtype=object)
    line_of = [line_between[frozenset((labels[before[n]], labels[n]))] for n in order[1:]]
    return labels[order], position[before[order[1:]]], np.array(line_of, dtype=int)


def _check_impedance(r_ohm: Floats, x_ohm: Floats) -> list[Problem]:
    """Lines without a resistance above zero, or without a reactance."""
    bad = [("r_ohm", i, r_ohm[i], "must be positive") for i in np.flatnonzero(~(r_ohm > 0))]
    bad += [("x_ohm", i, x_ohm[i], "must be finite") for i in np.flatnonzero(~np.isfinite(x_ohm))]
    return [
        Problem(
            "lines",
            message,
            "Give the series impedance in ohm; join buses that have no impedance between them.",
            row=int(i),
            field=name,
            value=value,
        )
        for name, i, value, message in bad
    ]


def _check_positive(
    name: str, values: Floats, n_lines: int, most: float, cure: str
) -> list[Problem]:
    """Values that are not one positive number, up to the most, for each line."""
    if values.shape != (n_lines,):
        message = f"must have one value for each of the {n_lines} lines"
        return [Problem("lines", message, cure, field=name, value=values.shape)]
    return [
        Problem("lines", "must be positive", cure, row=int(i), field=name, value=values[i])
        for i in np.flatnonzero(~((values > 0) & (values <= most)))
    ]
