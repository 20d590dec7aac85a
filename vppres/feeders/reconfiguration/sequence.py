"""The order of operations between two configurations, with limits kept in every state in between.

The AC power flow of every state is solved, with closed loops and in islands. An order has at most
one closed loop at a time, and that only at switches that may close one. Of all orders those that
interrupt least come first, of them the one with the largest least margin: states that are reached
by the same operations are one, and of the ways to them only the best is followed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vppres.core.arrays import Flags, Floats, Items, Names, Wholes, no_items
from vppres.core.text import counted, named
from vppres.feeders.reconfiguration.by_phase import FlowInStates
from vppres.feeders.reconfiguration.meshed import MeshedFlow, PartFlow
from vppres.feeders.reconfiguration.search import WITHIN, ConfigurationLimits
from vppres.scenario.configuration import Branches
from vppres.scenario.network import BusId, Network
from vppres.scenario.switches import Switches

MOST_OPERATIONS = 10
"""Operations, those of five exchanges, up to which all orders are compared."""

MOST_STATES = 4
"""States that are followed after each operation where there are more."""

LEAST_MINUTES = 1.0
"""Time that an operation takes at least, by which interruptions are compared."""

MOST_REASONS = 3
"""Operations without a way on that a reason names."""


@dataclass(frozen=True, eq=False)
class Formers(Items):
    """Devices that can hold an island, shape (F,) each."""

    id: Names  #: names
    bus: Names  #: where they are
    #: Rating, and least and largest power that they give.
    s_max_kva: Floats
    p_min_kw: Floats
    p_max_kw: Floats
    #: Set-points, which are part of the injections of their buses.
    p_kw: Floats
    q_kvar: Floats

    @classmethod
    def none(cls) -> Self:
        """No device."""
        return cls(*(no_items() for _ in range(7)))


@dataclass(frozen=True, eq=False)
class SwitchedFeeder:
    """A feeder whose switches are to be operated, and what its states must hold.

    Branches are the lines of the network, in its order, and after them the open switches: ``E``.
    """

    network: Network  #: the feeder as a tree
    switches: Switches  #: its switches
    #: Net injection of every bus, set-points of all devices included, (N,) each.
    p_kw: Floats
    q_kvar: Floats
    limits: ConfigurationLimits  #: limits of voltages, and whether ratings count
    grid: bool = True  #: whether the slack bus has the grid
    #: Devices that can hold an island. One does in between only if it does before or after.
    formers: Formers = field(default_factory=Formers.none)
    faulted: Flags | None = None  #: branches that carry nothing and are not closed, (E,)
    bus_out: Flags | None = None  #: buses that are out themselves, (N,)
    #: What buses that were without supply draw beyond their injections, (N,) each.
    cold_kw: Floats | None = None
    cold_kvar: Floats | None = None
    #: Branches that can be operated; those with an operable switch, or without one, if not given,
    #: (E,).
    movable: Flags | None = None
    #: Names of the customers of a bus.
    customers: Mapping[BusId, Sequence[str]] = field(default_factory=dict)
    by_phase: FlowInStates | None = None  #: power flow by phase of a feeder with phases

    @cached_property
    def branches(self) -> Branches:
        """Its lines and ties."""
        return Branches(self.network, self.switches)

    @cached_property
    def flow(self) -> MeshedFlow | FlowInStates:
        """Solver of its states."""
        return self.by_phase or MeshedFlow(self.network, self.branches.ties)

    @cached_property
    def out(self) -> Flags:
        """Branches that carry nothing though they be closed, (E,)."""
        found = np.zeros(len(self.branches), dtype=bool)
        if self.faulted is not None:
            found |= self.faulted
        if self.bus_out is not None:
            found |= self.bus_out[self.flow.start] | self.bus_out[self.flow.end]
        return found


@dataclass(frozen=True)
class Margin:
    """Distance of a state from one of its limits."""

    value: float  #: in pu of a voltage, or as a share of a rating; below 0 beyond the limit
    words: str  #: what is nearest to the limit


NO_MARGIN = Margin(np.inf, "")


@dataclass(frozen=True)
class Operation:
    """One operation of a switch."""

    switch: str  #: name of the switch, or the buses of a line without one
    branch: int  #: its position among the branches
    closes: bool  #: whether it is closed, not opened
    margin: Margin  #: the least margin of the state after it
    #: Buses that lose their supply for a while, though they have one before and after all
    #: operations.
    interrupted: tuple[BusId, ...]
    minutes: float  #: how long the longest of them is without it
    at_the_device: bool  #: whether it joins two live parts, which the device does when both agree
    sentence: str  #: the operation, what it does, and the margin


@dataclass(frozen=True)
class SwitchingOrder:
    """Operations between two configurations."""

    operations: tuple[Operation, ...] | None  #: in their order; None if there is no order
    reason: str  #: why there is none; empty if there is one
    all_orders: bool  #: whether all orders were compared
    #: The least margin of the state before. Where it is below 0, or during a fault that of the
    #: feeder without it, states may be beyond the limits too, but no further.
    before: Margin

    @property
    def margin(self) -> float:
        """The least margin of all states; infinite without an operation."""
        return min((one.margin.value for one in self.operations or ()), default=np.inf)


def safe_order(feeder: SwitchedFeeder, now: Flags, then: Flags) -> SwitchingOrder:
    """Order of the operations that lead from one configuration to another.

    Branches are closed ``now``, which may have a loop, and ``then``, (E,).

    Examples
    --------
    A ring of three lines: the tie between 2 and 3 is closed, and the line to 3 opened.

    >>> net = Network([1, 1], [2, 3], [1.0, 1.0], [1.0, 1.0], slack_bus=1, base_kv=10.0)
    >>> tie = Switches(["a"], [2], [3], ["tie"], [False], r_ohm=[1.0], x_ohm=[1.0],
    ...                parallel_allowed=[True])
    >>> load = np.array([0.0, -100.0, -100.0])
    >>> ring = SwitchedFeeder(net, tie, load, 0.3 * load, ConfigurationLimits(0.94, 1.06))
    >>> order = safe_order(ring, np.array([True, True, False]), np.array([True, False, True]))
    >>> for one in order.operations:
    ...     print(one.sentence)
    close a: it closes a loop and carries 0 A; lowest voltage 0.999 pu at bus 2, margin 0.059 pu
    open 1-3: it opens the loop; lowest voltage 0.996 pu at bus 3, margin 0.056 pu
    """
    return _Orders(feeder, now, then).best()


@dataclass(frozen=True, eq=False)
class _Topology:
    """Parts of a state: their number by bus, how many loops there are, and their sources.

    A source is the position of a bus, and the row of the former that holds it, None of the grid.
    """

    part: Wholes
    loops: int
    sources: Mapping[int, tuple[int, int | None]]
    live: Flags


@dataclass(frozen=True, eq=False)
class _Checked:
    """Margins of a state, voltages, ratings and formers; None without a power flow."""

    margins: tuple[Margin, Margin, Margin] | None
    current_a: Floats

    @property
    def least(self) -> Margin:
        if self.margins is None:
            return Margin(-np.inf, "no power flow was found")
        return min(self.margins, key=lambda one: one.value)


@dataclass(frozen=True, eq=False)
class _Way:
    """Operations up to a state, and what they cost."""

    done: tuple[int, ...]
    cold: Flags
    interrupted: float
    margin: float

    @property
    def key(self) -> tuple[float, float]:
        """Less is better."""
        return round(self.interrupted, 9), -self.margin


class _Orders:
    """All orders between two configurations of a feeder."""

    def __init__(self, feeder: SwitchedFeeder, now: Flags, then: Flags) -> None:
        self.feeder = feeder
        self.net = feeder.network
        self.now, self.then = now.copy(), then.copy()
        self.branches = np.flatnonzero(now != then)
        self.minutes = feeder.branches.of_moves("minutes_to_operate").astype(float)
        self.may_close_loop = feeder.branches.of_moves("parallel_allowed").astype(bool)
        self.compares = feeder.branches.of_moves("sync_check").astype(bool)
        self.holding = np.ones(len(feeder.formers), dtype=bool)
        self._topologies: dict[frozenset[int], _Topology] = {}
        self._checks: dict[tuple[frozenset[int], bytes], _Checked] = {}
        self.holding = self._holding()
        self._topologies.clear()
        self.first = self.topology(())
        self.last = self.topology(tuple(self.branches.tolist()))
        both = self.first.live & self.last.live
        # A bus without a load counts too, for almost nothing.
        drawn = np.maximum(self.net.p_fixed_kw - feeder.p_kw, 0.0) + 1e-3
        self.missed_kw = np.where(both, drawn, 0.0)

    def _holding(self) -> Flags:
        """Formers that hold an island before or after all operations, (F,)."""
        found = np.zeros(len(self.feeder.formers), dtype=bool)
        for done in ((), tuple(self.branches.tolist())):
            held = [former for _, former in self.topology(done).sources.values()]
            found[[former for former in held if former is not None]] = True
        return found

    def best(self) -> SwitchingOrder:
        """The best order, or why there is none."""
        cold = ~self.first.live
        start = self.check((), cold)
        every = len(self.branches) <= MOST_OPERATIONS
        if refused := next(self._refusals(), None):
            return SwitchingOrder(None, refused, every, start.least)
        floor = self._floor(start)
        if beyond := _beyond(self.check(tuple(self.branches.tolist()), cold), floor):
            reason = f"The state after all operations is beyond the limits: {beyond}."
            return SwitchingOrder(None, reason, every, start.least)
        ways = {frozenset[int](): [_Way((), cold, 0.0, np.inf)]}
        for _ in self.branches:
            blocked: list[str] = []
            found: dict[tuple[frozenset[int], bytes], _Way] = {}
            for way in (way for group in ways.values() for way in group):
                for more in self._next(way, floor, blocked):
                    key = frozenset(more.done), self._cold_key(more.cold)
                    if key not in found or more.key < found[key].key:
                        found[key] = more
            if not found:
                return SwitchingOrder(None, _none_words(blocked), every, start.least)
            kept = sorted(found.values(), key=self._rank)
            ways = {}
            for way in kept if every else kept[:MOST_STATES]:
                ways.setdefault(frozenset(way.done), []).append(way)
        best = min((way for group in ways.values() for way in group), key=lambda one: one.key)
        return SwitchingOrder(tuple(self._told(best)), "", every, start.least)

    def _rank(self, way: _Way) -> tuple[float, float]:
        """Less is better: an interruption that goes on counts for the next operation."""
        missed_kw = self.missed_kw[~self.topology(way.done).live].sum()
        return way.key[0] + round(float(missed_kw) * LEAST_MINUTES, 9), way.key[1]

    def _floor(self, start: _Checked) -> list[float]:
        """Least margins that states may have: 0, or less where the feeder has less as it stands.

        That is now, and during a fault with its own lines and nothing out: what the fault has cut
        off may come back at the voltages that it is used to.
        """
        if start.margins is None:
            return [-np.inf] * 3
        least = [start.margins]
        if self.feeder.grid and self.feeder.out.any():
            own = np.arange(len(self.now)) < self.net.n_lines
            cold = np.zeros(self.net.n_buses, dtype=bool)
            usual = self._checked(own, self._parts(own), cold)
            least += [usual.margins] if usual.margins is not None else []
        kinds = zip(*least, strict=True)
        return [min(0.0, *(one.value for one in kind)) - WITHIN for kind in kinds]

    def _refusals(self) -> Iterator[str]:
        """Why no order can exist, whatever the power flow: locks, faults, loops at the end."""
        locked = self.feeder.branches.of_moves("locked")
        movable = self.feeder.movable
        if movable is None:
            movable = self.feeder.branches.of_moves("operable").astype(bool)
        for branch in self.branches:
            name, closes = self.feeder.branches.names[branch], self.then[branch]
            if locked[branch]:
                yield f"{name} is locked: {locked[branch]}."
            elif closes and self.feeder.out[branch]:
                yield f"{name} cannot be closed: its line, or a bus of it, has a fault."
            elif not movable[branch] and not self.feeder.out[branch]:
                yield f"{name} is not operable."
        if self.last.loops:
            yield "A loop would stay closed after all operations."

    def _next(self, way: _Way, floor: Sequence[float], blocked: list[str]) -> Iterator[_Way]:
        """Ways that go on by one operation; those that may not are noted with the reason."""
        before = self.topology(way.done)
        missed_kw = float(self.missed_kw[~before.live].sum())
        for branch in self.branches.tolist():
            if branch in way.done:
                continue
            done = (*way.done, branch)
            reason = self._rule(before, branch) if self.then[branch] else ""
            if not reason:
                after = self.topology(done)
                cold = way.cold | ~after.live
                checked = self.check(done, cold)
                reason = _beyond(checked, floor)
            if reason:
                blocked.append(f"{self._verb(branch)} ({reason})")
                continue
            minutes = max(self.minutes[branch], LEAST_MINUTES)
            yield _Way(
                done,
                cold,
                way.interrupted + missed_kw * minutes,
                min(way.margin, checked.least.value),
            )

    def _rule(self, before: _Topology, branch: int) -> str:
        """Why a branch may not be closed in a state; empty if it may."""
        a, b = self._ends(branch)
        if before.part[a] == before.part[b]:
            if not self.may_close_loop[branch]:
                return "closes a loop, for which it has no parallel_allowed"
            return "a loop is closed already" if before.loops else ""
        if before.live[a] and before.live[b] and not self.compares[branch]:
            return "joins two live parts, and has no sync_check"
        return ""

    def _ends(self, branch: int) -> tuple[int, int]:
        flow = self.feeder.flow
        return int(flow.start[branch]), int(flow.end[branch])

    def _closed(self, done: Sequence[int]) -> Flags:
        """Branches that carry current after some operations, (E,)."""
        closed = self.now.copy()
        closed[list(done)] = self.then[list(done)]
        return np.asarray(closed & ~self.feeder.out)

    def topology(self, done: tuple[int, ...]) -> _Topology:
        """Parts after some operations."""
        key = frozenset(done)
        if key not in self._topologies:
            self._topologies[key] = self._parts(self._closed(done))
        return self._topologies[key]

    def _parts(self, closed: Flags) -> _Topology:
        """Parts of a state, each with the grid, else its largest former that holds islands."""
        flow, formers, n = self.feeder.flow, self.feeder.formers, self.net.n_buses
        ends = flow.start[closed], flow.end[closed]
        graph = sp.coo_array((np.ones(len(ends[0])), ends), shape=(n, n))
        count, part = connected_components(graph, directed=False)
        sources: dict[int, tuple[int, int | None]] = {}
        for former in np.argsort(-formers.s_max_kva, kind="stable").tolist():
            at = self.net.bus_index[formers.bus[former]]
            lost = self.feeder.bus_out is not None and self.feeder.bus_out[at]
            if self.holding[former] and not lost:
                sources.setdefault(int(part[at]), (at, former))
        if self.feeder.grid:
            sources[int(part[0])] = (0, None)
        live = np.isin(part, [*sources])
        loops = int(closed.sum()) - n + int(count)
        return _Topology(part.astype(int), loops, sources, live)

    def _cold_key(self, cold: Flags) -> bytes:
        return b"" if self.feeder.cold_kw is None else cold.tobytes()

    def check(self, done: tuple[int, ...], cold: Flags) -> _Checked:
        """Margins after some operations, at what buses that were without supply draw then."""
        key = frozenset(done), self._cold_key(cold)
        if key not in self._checks:
            self._checks[key] = self._checked(self._closed(done), self.topology(done), cold)
        return self._checks[key]

    def _checked(self, closed: Flags, state: _Topology, cold: Flags) -> _Checked:
        feeder = self.feeder
        p_kw, q_kvar = feeder.p_kw, feeder.q_kvar
        if feeder.cold_kw is not None:
            p_kw = p_kw - feeder.cold_kw * cold
        if feeder.cold_kvar is not None:
            q_kvar = q_kvar - feeder.cold_kvar * cold
        v_pu, current_a = np.full(self.net.n_buses, np.nan), np.zeros(len(closed))
        of_formers = NO_MARGIN
        for part, (reference, former) in state.sources.items():
            inside = state.part == part
            found = feeder.flow.solve(inside, closed, reference, p_kw, q_kvar)
            if found is None:
                return _Checked(None, current_a)
            v_pu[inside] = found.v_pu[inside]
            v_pu[reference] = np.nan  # a source holds it in every state
            current_a += found.current_a
            if former is not None:
                own = self._of_former(former, found)
                of_formers = min(of_formers, own, key=lambda one: one.value)
        margins = self._of_voltages(v_pu), self._of_ratings(current_a), of_formers
        return _Checked(margins, current_a)

    def _of_voltages(self, v_pu: Floats) -> Margin:
        """Distance of the voltage that is nearest to its limit."""
        limits = self.feeder.limits
        if np.isnan(v_pu).all():
            return Margin(np.inf, "no bus but those of sources is live")
        low, high = int(np.nanargmin(v_pu)), int(np.nanargmax(v_pu))
        below, above = v_pu[low] - limits.v_min_pu, limits.v_max_pu - v_pu[high]
        at, kind, value = (low, "lowest", below) if below <= above else (high, "highest", above)
        words = f"{kind} voltage {v_pu[at]:.3f} pu at bus {self.net.buses[at]}"
        return Margin(float(value), f"{words}, {_margin_words(value, '.3f', ' pu')}")

    def _of_ratings(self, current_a: Floats) -> Margin:
        """Share of its rating that the most loaded branch leaves."""
        loading = current_a / self.feeder.flow.i_max_a
        if not self.feeder.limits.ratings or not loading.any():
            return NO_MARGIN
        at = int(loading.argmax())
        left = float(1.0 - loading[at])
        words = f"{self.feeder.branches.names[at]} at {loading[at]:.1%} of its rating"
        return Margin(left, f"{words}, {_margin_words(left, '.1%', '')}")

    def _of_former(self, row: int, found: PartFlow) -> Margin:
        """Share of its rating that a former is from its nearest limit."""
        own = self.feeder.formers
        s_kva = found.source_kva + complex(own.p_kw[row], own.q_kvar[row])
        rating = float(own.s_max_kva[row])
        left = (
            rating - max(abs(s_kva), found.fullest_kva),
            own.p_max_kw[row] - s_kva.real,
            s_kva.real - own.p_min_kw[row],
        )
        share = float(min(left)) / rating if rating else -np.inf
        words = f"{own.id[row]} holds the island with {s_kva.real:.1f} kW, {s_kva.imag:.1f} kvar"
        return Margin(share, f"{words}, {_margin_words(share, '.1%', '')}")

    def _verb(self, branch: int) -> str:
        return f"{'close' if self.then[branch] else 'open'} {self.feeder.branches.names[branch]}"

    def _told(self, way: _Way) -> Iterator[Operation]:
        """The operations of an order."""
        states = [self.topology(way.done[:count]) for count in range(len(way.done) + 1)]
        cold = ~self.first.live
        for count, branch in enumerate(way.done):
            before, after = states[count], states[count + 1]
            cold = cold | ~after.live
            checked = self.check(way.done[: count + 1], cold)
            gone = before.live & ~after.live
            back: dict[int, list[int]] = {}
            for bus in np.flatnonzero(gone & self.first.live & self.last.live).tolist():
                until = next(k for k in range(count + 1, len(states)) if states[k].live[bus])
                back.setdefault(until, []).append(bus)
            waits = {until: self.minutes[[*way.done[count + 1 : until]]].sum() for until in back}
            a, b = self._ends(branch)
            joins = self.then[branch] and before.part[a] != before.part[b]
            at_the_device = bool(joins and before.live[a] and before.live[b])
            told = [
                f"{self._without(buses)}{_for_minutes(waits[until])} until "
                f"{self.feeder.branches.names[way.done[until - 1]]} is closed"
                for until, buses in back.items()
            ]
            lost = np.flatnonzero(gone & ~self.last.live).tolist()
            told += [self._without(lost)] if lost else []
            effect = self._effect(branch, before, after, checked, cold)
            yield Operation(
                switch=self.feeder.branches.names[branch],
                branch=branch,
                closes=bool(self.then[branch]),
                margin=checked.least,
                interrupted=tuple(self.net.buses[bus] for own in back.values() for bus in own),
                minutes=float(max(waits.values(), default=0.0)),
                at_the_device=at_the_device,
                sentence=f"{self._verb(branch)}: "
                + "; ".join([*filter(None, (effect, *told)), checked.least.words]),
            )

    def _without(self, buses: list[int]) -> str:
        return f"{self._supplied(buses)} {'is' if self._single(buses) else 'are'} without supply"

    def _single(self, buses: list[int]) -> bool:
        return len(self._customers(buses) or buses) == 1

    def _customers(self, buses: Sequence[int]) -> list[str]:
        return [
            name for bus in buses for name in self.feeder.customers.get(self.net.buses[bus], ())
        ]

    def _supplied(self, buses: list[int]) -> str:
        """Customers of some buses, or the buses where none is known."""
        if own := self._customers(buses):
            return f"customer{'s' * (len(own) > 1)} {named(own)}"
        return f"bus{'es' * (len(buses) > 1)} {named(self.net.buses[buses])}"

    def _effect(
        self, branch: int, before: _Topology, after: _Topology, checked: _Checked, cold: Flags
    ) -> str:
        """Effect of an operation in words, without the interruption."""
        a, b = self._ends(branch)
        if self.feeder.out[branch]:
            return "it has carried nothing since the fault"
        if not self.then[branch]:
            return self._opening(before, after, a, b)
        if before.part[a] == before.part[b]:
            if not before.live[a]:
                return "it closes a loop without supply"
            return f"it closes a loop and carries {checked.current_a[branch]:.0f} A"
        if before.live[a] and before.live[b]:
            return "it joins two live parts, at the device itself when both sides agree"
        new = np.flatnonzero(after.live & ~before.live).tolist()
        if not new:
            return "it joins two parts without supply"
        more = "" if self.feeder.cold_kw is None else self._cold_words(new)
        return f"it supplies {self._supplied(new)}{more}"

    def _cold_words(self, buses: list[int]) -> str:
        assert self.feeder.cold_kw is not None
        return f", with {self.feeder.cold_kw[buses].sum():.1f} kW of cold load"

    def _opening(self, before: _Topology, after: _Topology, a: int, b: int) -> str:
        if not before.live[a] and not before.live[b]:
            return "its line has no supply"
        if after.part[a] == after.part[b]:
            return "it opens the loop"
        if not (after.live[a] and after.live[b]):
            return ""
        held = [after.sources[int(after.part[bus])] for bus in (a, b)]
        new = [f for _, f in held if f is not None and f not in _holders(before)]
        islands = named(self.feeder.formers.id[new])
        return f"it splits off an island, which {islands} holds" if new else "it splits an island"


def _holders(state: _Topology) -> set[int]:
    """Formers that hold islands in a state."""
    return {former for _, former in state.sources.values() if former is not None}


def _beyond(state: _Checked, floor: Sequence[float]) -> str:
    """Margins of a state that are too small, in words; empty without any."""
    if state.margins is None:
        return state.least.words
    own = zip(state.margins, floor, strict=True)
    return ", ".join(one.words for one, least in own if one.value < least)


def _for_minutes(minutes: float) -> str:
    return f" for {counted(round(minutes), 'minute')}," if minutes else ""


def _margin_words(value: float, form: str, unit: str) -> str:
    return f"margin {value:{form}}{unit}" if value >= 0.0 else f"{-value:{form}}{unit} beyond"


def _none_words(blocked: list[str]) -> str:
    """Why no operation leads on."""
    unlike = [*dict.fromkeys(blocked)]
    more = len(unlike) - MOST_REASONS
    words = "; ".join(unlike[:MOST_REASONS])
    rest = f"; and {counted(more, 'more')}" if more > 0 else ""
    return f"No order keeps the rules in every state: {words}{rest}."
