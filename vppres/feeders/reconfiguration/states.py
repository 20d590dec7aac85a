"""States of a feeder between two configurations: their parts, power flow and margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vppres.core.arrays import Flags, Floats, Items, Names, Wholes
from vppres.feeders.reconfiguration.by_phase import FlowInStates
from vppres.feeders.reconfiguration.meshed import MeshedFlow, PartFlow
from vppres.feeders.reconfiguration.search import WITHIN, ConfigurationLimits
from vppres.scenario.configuration import Branches
from vppres.scenario.network import BusId, Network
from vppres.scenario.switches import Switches


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


@dataclass(frozen=True, eq=False)
class Topology:
    """Parts of a state: their number by bus, how many loops there are, and their sources.

    A source is the position of a bus, and the row of the former that holds it, None of the grid.
    """

    part: Wholes
    loops: int
    sources: Mapping[int, tuple[int, int | None]]
    live: Flags


@dataclass(frozen=True, eq=False)
class Checked:
    """Margins of a state, voltages, ratings and formers; None without a power flow."""

    margins: tuple[Margin, Margin, Margin] | None
    current_a: Floats

    @property
    def least(self) -> Margin:
        """The smallest of them."""
        if self.margins is None:
            return Margin(-np.inf, "no power flow was found")
        return min(self.margins, key=lambda one: one.value)


class States:
    """States that operations lead through, from one configuration to another.

    Attributes
    ----------
    moves : ndarray of int
        Branches to be operated, shape (M,); a state is named by those that are ``done``.
    first, last : Topology
        Parts before and after all operations.
    """

    def __init__(self, feeder: SwitchedFeeder, now: Flags, then: Flags) -> None:
        self.feeder = feeder
        self.net = feeder.network
        self.now, self.then = now.copy(), then.copy()
        self.moves = np.flatnonzero(now != then)
        self._topologies: dict[frozenset[int], Topology] = {}
        self._checks: dict[tuple[frozenset[int], bytes], Checked] = {}
        self._holding = np.ones(len(feeder.formers), dtype=bool)
        self._holding = self._held()
        self._topologies.clear()
        self.first = self.topology(())
        self.last = self.topology(self.all_done)

    @property
    def all_done(self) -> tuple[int, ...]:
        """All operations."""
        return tuple(self.moves.tolist())

    def _held(self) -> Flags:
        """Formers that hold an island before or after all operations, (F,)."""
        found = np.zeros(len(self.feeder.formers), dtype=bool)
        for done in ((), self.all_done):
            found[[*holders(self.topology(done))]] = True
        return found

    def ends(self, branch: int) -> tuple[int, int]:
        """Positions of the buses of a branch."""
        flow = self.feeder.flow
        return int(flow.start[branch]), int(flow.end[branch])

    def verb(self, branch: int) -> str:
        """Words for the operation of a branch."""
        return f"{'close' if self.then[branch] else 'open'} {self.feeder.branches.names[branch]}"

    def _closed(self, done: Sequence[int]) -> Flags:
        """Branches that carry current after some operations, (E,)."""
        closed = self.now.copy()
        closed[list(done)] = self.then[list(done)]
        return np.asarray(closed & ~self.feeder.out)

    def topology(self, done: tuple[int, ...]) -> Topology:
        """Parts after some operations."""
        key = frozenset(done)
        if key not in self._topologies:
            self._topologies[key] = self._parts(self._closed(done))
        return self._topologies[key]

    def _parts(self, closed: Flags) -> Topology:
        """Parts of a state, each with the grid, else its largest former that holds islands."""
        flow, formers, n = self.feeder.flow, self.feeder.formers, self.net.n_buses
        ends = flow.start[closed], flow.end[closed]
        graph = sp.coo_array((np.ones(len(ends[0])), ends), shape=(n, n))
        count, part = connected_components(graph, directed=False)
        sources: dict[int, tuple[int, int | None]] = {}
        for former in np.argsort(-formers.s_max_kva, kind="stable").tolist():
            at = self.net.bus_index[formers.bus[former]]
            lost = self.feeder.bus_out is not None and self.feeder.bus_out[at]
            if self._holding[former] and not lost:
                sources.setdefault(int(part[at]), (at, former))
        if self.feeder.grid:
            sources[int(part[0])] = (0, None)
        live = np.isin(part, [*sources])
        loops = int(closed.sum()) - n + int(count)
        return Topology(part.astype(int), loops, sources, live)

    def cold_key(self, cold: Flags) -> bytes:
        """Buses that were without supply, where that changes what they draw."""
        return b"" if self.feeder.cold_kw is None else cold.tobytes()

    def check(self, done: tuple[int, ...], cold: Flags) -> Checked:
        """Margins after some operations, at what buses that were without supply draw then."""
        key = frozenset(done), self.cold_key(cold)
        if key not in self._checks:
            self._checks[key] = self._checked(self._closed(done), self.topology(done), cold)
        return self._checks[key]

    def _checked(self, closed: Flags, state: Topology, cold: Flags) -> Checked:
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
                return Checked(None, current_a)
            v_pu[inside] = found.v_pu[inside]
            v_pu[reference] = np.nan  # a source holds it in every state
            current_a += found.current_a
            if former is not None:
                own = self._of_former(former, found)
                of_formers = min(of_formers, own, key=lambda one: one.value)
        margins = self._of_voltages(v_pu), self._of_ratings(current_a), of_formers
        return Checked(margins, current_a)

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

    def floor(self, start: Checked) -> list[float]:
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


def holders(state: Topology) -> set[int]:
    """Formers that hold islands in a state."""
    return {former for _, former in state.sources.values() if former is not None}


def beyond(state: Checked, floor: Sequence[float]) -> str:
    """Margins of a state that are too small, in words; empty without any."""
    if state.margins is None:
        return state.least.words
    own = zip(state.margins, floor, strict=True)
    return ", ".join(one.words for one, least in own if one.value < least)


def _margin_words(value: float, form: str, unit: str) -> str:
    return f"margin {value:{form}}{unit}" if value >= 0.0 else f"{-value:{form}}{unit} beyond"
