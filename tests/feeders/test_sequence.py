"""Orders of switch operations: every state in between against power flows written apart."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pandapower as pp
import pandapower.networks as networks
import pytest

from tests.support.own_power_flow import voltages
from tests.support.three_phases import three_phases
from vppres.core.arrays import Flags
from vppres.feeders import import_network
from vppres.feeders.reconfiguration.by_phase import FlowInStates
from vppres.feeders.reconfiguration.loops import switched_network
from vppres.feeders.reconfiguration.meshed import MeshedFlow
from vppres.feeders.reconfiguration.search import ConfigurationLimits
from vppres.feeders.reconfiguration.sequence import SwitchingOrder, safe_order
from vppres.feeders.reconfiguration.states import Formers, SwitchedFeeder
from vppres.physics.phased_sources import assets_of, buses_of
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches

BEST_33 = ("7-8", "9-10", "14-15", "25-29", "32-33")
WIDE = ConfigurationLimits(0.8, 1.2)


@cache
def published() -> SwitchedFeeder:
    """The 33 buses with five ties, none of which may close a loop."""
    feeder = import_network("case33bw")
    limits = ConfigurationLimits(0.9, 1.06)
    return SwitchedFeeder(feeder.network, feeder.switches, *feeder.injection, limits)


def of_ties(feeder: SwitchedFeeder, **columns: object) -> SwitchedFeeder:
    """A feeder whose switches all have some values."""
    count = len(feeder.switches)
    own = {name: np.full(count, value, dtype=object) for name, value in columns.items()}
    return replace(feeder, switches=replace(feeder.switches, **own))


def all_but(feeder: SwitchedFeeder, *opened: str) -> Flags:
    """The configuration in which some branches are open."""
    return ~np.isin(feeder.branches.names, opened)


def present(feeder: SwitchedFeeder) -> Flags:
    """The configuration of the network."""
    return np.arange(len(feeder.branches.names)) < feeder.network.n_lines


def sentences(order: SwitchingOrder) -> list[str]:
    assert order.operations is not None, order.reason
    return [one.sentence for one in order.operations]


@pytest.mark.daily
def test_states_by_phase_are_those_of_the_balanced_feeder(tiny: Scenario) -> None:
    """Three equal phases without coupling: with a loop, without one, and in an island."""
    switches = Switches(["t"], [3], [4], ["tie"], [False], r_ohm=[0.5], x_ohm=[0.4])
    day = three_phases(replace(tiny, switches=switches))
    kw = np.array([50.0, 30.0, 40.0, *np.zeros(len(assets_of(day)) - 3)])
    former, bus = str(day.batteries.id[0]), day.batteries.bus[0]
    held = day.network.bus_index[bus]
    balanced = MeshedFlow(day.network, switches)
    by_phase = FlowInStates(day, [former], kw, 0.3 * kw)
    places = [day.network.bus_index[bus] for bus in buses_of(day)]
    given = -np.bincount(places, kw, day.network.n_buses)
    every = np.ones(4, dtype=bool)
    for closed, reference in (([1, 1, 1, 1], 0), ([1, 1, 0, 1], 0), ([0, 1, 1, 0], held)):
        state = np.array(closed, dtype=bool)
        inside = every if reference == 0 else np.arange(4) > 0
        one, three = (
            flow.solve(inside, state, reference, given, 0.3 * given)
            for flow in (balanced, by_phase)
        )
        np.testing.assert_allclose(three.v_pu, one.v_pu, atol=1e-7)
        np.testing.assert_allclose(three.current_a, one.current_a, atol=1e-4)
        assert three.source_kva == pytest.approx(one.source_kva, abs=1e-2)
        assert three.fullest_kva == pytest.approx(abs(three.source_kva), abs=1e-2)


def test_33_buses_to_their_optimum_over_closed_loops() -> None:
    """pandapower has every state: its lowest voltage, and what the tie carries."""
    feeder = of_ties(published(), parallel_allowed=True)
    now = present(feeder)
    order = safe_order(feeder, now, all_but(feeder, *BEST_33))
    assert order.all_orders and order.operations is not None
    assert [one.closes for one in order.operations] == [True, False] * 4
    net = networks.case33bw()
    rows = {
        frozenset((a + 1, b + 1)): i for i, (a, b) in net.line[["from_bus", "to_bus"]].T.items()
    }
    for one in order.operations:
        row = rows[frozenset(map(int, one.switch.split("-")))]
        net.line.loc[row, "in_service"] = one.closes
        pp.runpp(net, tolerance_mva=1e-9)
        lowest = float(net.res_bus.vm_pu.min())
        bus = int(net.res_bus.vm_pu.idxmin()) + 1
        assert one.margin.value == pytest.approx(lowest - 0.9, abs=1e-8)
        assert f"lowest voltage {lowest:.3f} pu at bus {bus}, margin" in one.sentence
        assert one.interrupted == ()
        if one.closes:
            carried = 1000.0 * net.res_line.i_ka[row]
            assert f"it closes a loop and carries {carried:.0f} A" in one.sentence
    assert order.margin == min(one.margin.value for one in order.operations)


def test_33_buses_to_their_optimum_without_a_loop() -> None:
    """What is opened first loses its supply until its tie is closed, and is named with its time."""
    feeder = of_ties(published(), minutes_to_operate=30.0)
    feeder = replace(feeder, customers={8: ("Bakery",), 9: ("School", "Mill")})
    order = safe_order(feeder, present(feeder), all_but(feeder, *BEST_33))
    assert order.operations is not None
    assert [one.closes for one in order.operations] == [False, True] * 4
    by_name = {one.switch: one for one in order.operations}
    assert by_name["7-8"].interrupted == (8, 9) and by_name["7-8"].minutes == 30.0
    assert by_name["7-8"].sentence.startswith(
        "open 7-8: customers Bakery, School, Mill are without supply for 30 minutes, until 21-8 is "
        "closed; lowest voltage"
    )
    assert "bus 33 is without supply for 30 minutes, until 18-33 is" in by_name["32-33"].sentence
    assert by_name["18-33"].sentence.startswith("close 18-33: it supplies bus 33; lowest")


@pytest.mark.daily
def test_what_a_fault_has_cut_off_comes_back_at_voltages_it_is_used_to() -> None:
    """33 buses go down to 0.913 pu, with the fault to 0.938, with the tie to 0.921; 0.94 is lost."""
    feeder = replace(of_ties(published()), limits=ConfigurationLimits(0.94, 1.06))
    branch = feeder.branches.names.index("6-7")
    faulted = np.arange(len(feeder.branches)) == branch
    closed = present(feeder) & ~faulted
    then = closed | (np.array(feeder.branches.names) == "21-8")
    order = safe_order(replace(feeder, faulted=faulted), closed, then)
    assert order.before.value > order.margin > -0.02
    assert [one.switch for one in order.operations or ()] == ["21-8"]


def test_a_state_that_is_beyond_its_limits_gets_no_worse() -> None:
    """0.913 pu at first and 0.94 allowed: each state is beyond, and nearer than the first."""
    feeder = of_ties(published(), parallel_allowed=True)
    feeder = replace(feeder, limits=ConfigurationLimits(0.94, 1.06))
    order = safe_order(feeder, present(feeder), all_but(feeder, *BEST_33))
    assert order.before.value < order.margin < 0.0
    least = min(order.operations or (), key=lambda one: one.margin.value)
    assert "0.010 pu beyond" in least.sentence
    back = safe_order(feeder, all_but(feeder, *BEST_33), present(feeder))
    assert back.operations is None
    assert back.reason.startswith("The state after all operations is beyond the limits: lowest")


def test_more_than_five_exchanges_are_searched_and_said() -> None:
    """Six rings of a bus each; the loops of all but the first are open."""
    at = np.arange(2, 14)
    lines = Network([1] * 12, at, np.ones(12), np.ones(12), slack_bus=1, base_kv=10.0)
    ties = Switches([f"t{i}" for i in range(6)], at[::2], at[1::2], ["tie"] * 6, [False] * 6,
                    r_ohm=np.ones(6), x_ohm=np.ones(6))  # fmt: skip
    feeder = SwitchedFeeder(lines, ties, -50.0 * np.ones(13), np.zeros(13), WIDE)
    opened = [f"1-{bus}" for bus in at[::2]]
    order = safe_order(feeder, present(feeder), all_but(feeder, *opened))
    assert not order.all_orders and order.operations is not None
    assert [one.closes for one in order.operations] == [False, True] * 6


def ring(**columns: object) -> SwitchedFeeder:
    """Buses 1-2-3 in a row, and two equal ties 1-3 beside each other."""
    net = Network([1, 2], [2, 3], [1.0, 1.0], [1.0, 1.0], slack_bus=1, base_kv=10.0)
    ties = Switches(["t1", "t2"], [1, 3], [3, 1], ["tie"] * 2, [False] * 2,
                    r_ohm=[1.0] * 2, x_ohm=[1.0] * 2, i_max_a=[20.0] * 2)  # fmt: skip
    load = np.array([0.0, -200.0, -200.0])
    return of_ties(SwitchedFeeder(net, ties, load, 0.0 * load, WIDE), **columns)


def test_of_two_parallel_ties_one_is_closed_at_most() -> None:
    feeder = ring(parallel_allowed=True)
    both = safe_order(feeder, present(feeder), np.array([True, False, True, True]))
    assert (both.operations, both.reason) == (
        None,
        "A loop would stay closed after all operations.",
    )
    swapped = safe_order(
        feeder, np.array([True, False, True, False]), np.array([True, False, False, True])
    )
    assert [words.split(";")[0] for words in sentences(swapped)] == [
        "close t2: it closes a loop and carries 6 A",
        "open t1: it opens the loop",
    ]
    apart = ring(parallel_allowed=False)
    opened = safe_order(
        apart, np.array([True, False, True, False]), np.array([True, False, False, True])
    )
    assert [one.switch for one in opened.operations or ()] == ["t1", "t2"]


def test_a_loop_beyond_a_rating_is_not_closed_and_customers_are_interrupted_instead() -> None:
    """Closed, the tie would carry 12 A, and it may 10; behind it bus 3 alone takes 12 A."""
    feeder = ring(parallel_allowed=True, i_max_a=10.0)
    refused = safe_order(feeder, present(feeder), np.array([True, False, True, False]))
    assert refused.operations is None
    assert "t1 at 115." in refused.reason and "of its rating, 15." in refused.reason
    # Ratings left out, the same loop is closed.
    feeder = replace(feeder, limits=ConfigurationLimits(0.8, 1.2, ratings=False))
    order = safe_order(feeder, present(feeder), np.array([True, False, True, False]))
    assert [one.closes for one in order.operations or ()] == [True, False]


def test_a_lock_outranks_all() -> None:
    feeder = ring(parallel_allowed=True, locked="men at work")
    order = safe_order(feeder, present(feeder), np.array([True, False, True, False]))
    assert (order.operations, order.reason) == (None, "t1 is locked: men at work.")
    feeder = ring(parallel_allowed=True, operable=False)
    order = safe_order(feeder, present(feeder), np.array([True, False, True, False]))
    assert (order.operations, order.reason) == (None, "t1 is not operable.")


def test_a_line_with_a_fault_is_never_closed_and_what_is_behind_it_gets_the_tie() -> None:
    """Line 2-3 is out: it is opened, and t1 supplies bus 3 with its cold load."""
    out = np.array([False, True, False, False])
    cold = np.array([0.0, 0.0, 100.0])
    feeder = replace(ring(), faulted=out, cold_kw=cold, cold_kvar=0.0 * cold)
    order = safe_order(feeder, present(feeder), np.array([True, False, True, False]))
    told = sorted(sentences(order))
    assert told[0].startswith("close t1: it supplies bus 3, with 100.0 kW of cold load; ")
    assert told[1].startswith("open 2-3: it has carried nothing since the fault; ")
    back = safe_order(feeder, np.array([True, False, True, False]), present(feeder))
    assert back.operations is None
    assert back.reason == "2-3 cannot be closed: its line, or a bus of it, has a fault."
    heavy = replace(feeder, cold_kw=5.0 * cold)
    order = safe_order(heavy, present(heavy), np.array([True, False, True, False]))
    assert order.operations is None and "t1 at 20" in order.reason
    bus = replace(feeder, faulted=None, bus_out=np.array([False, False, True]))
    order = safe_order(bus, present(bus), np.array([True, False, True, False]))
    assert order.reason == "t1 cannot be closed: its line, or a bus of it, has a fault."


def batteries(*rows: tuple[str, int, float]) -> Formers:
    """Batteries at buses with ratings, which rest."""
    names, buses, ratings = zip(*rows, strict=True)
    none, s_max_kva = np.zeros(len(rows)), np.array(ratings)
    return Formers(names, buses, s_max_kva, -s_max_kva, s_max_kva, none, none)


def test_a_live_island_is_joined_by_a_device_that_compares_both_sides_alone() -> None:
    """Bus 3 is an island, which a battery holds; the grid would come over 2-3 or t1."""
    feeder = replace(ring(), formers=batteries(("B", 3, 300.0)))
    island, joined = np.array([True, False, False, False]), np.array([True, False, True, False])
    refused = safe_order(feeder, island, joined)
    assert refused.operations is None
    assert "close t1 (joins two live parts, and has no sync_check)" in refused.reason
    feeder = of_ties(feeder, sync_check=True)
    (one,) = safe_order(feeder, island, joined).operations or ()
    assert one.at_the_device and one.sentence.startswith(
        "close t1: it joins two live parts, at the device itself when both sides agree; "
    )
    # Two islands as well, where no bus has the grid.
    dark = replace(feeder, grid=False, formers=batteries(("A", 2, 500.0), ("B", 3, 300.0)))
    (one,) = safe_order(dark, island, joined).operations or ()
    assert one.at_the_device
    dark = of_ties(dark, sync_check=False)
    assert safe_order(dark, island, joined).operations is None


@pytest.mark.parametrize(("rating", "held"), [(300.0, True), (150.0, False)])
def test_a_part_is_split_off_only_if_its_former_can_hold_it(rating: float, held: bool) -> None:
    limits = ConfigurationLimits(0.5, 1.5)
    feeder = replace(ring(), formers=batteries(("B", 3, rating)), limits=limits)
    order = safe_order(feeder, present(feeder), np.array([True, False, False, False]))
    if held:
        (told,) = sentences(order)
        assert told.startswith("open 2-3: it splits off an island, which B holds; ")
        assert order.margin == pytest.approx(1 - 200 / 300, abs=1e-3)
    else:
        assert order.operations is None
        assert "B holds the island with 200.0 kW, 0.0 kvar, 33.3% beyond" in order.reason


def test_a_former_holds_no_island_in_between_for_a_while() -> None:
    """Bus 3 changes its way to the grid: it is dark for a while, and is joined to no live part."""
    feeder = replace(ring(), formers=batteries(("B", 3, 300.0)))
    order = safe_order(feeder, present(feeder), np.array([True, False, True, False]))
    assert [one.switch for one in order.operations or ()] == ["2-3", "t1"]
    assert (order.operations or ())[0].interrupted == (3,)


def test_the_voltage_of_the_source_is_in_no_margin() -> None:
    """The grid holds the highest voltage that is allowed, whatever is switched."""
    feeder = replace(ring(parallel_allowed=True), limits=ConfigurationLimits(0.8, 1.0))
    order = safe_order(feeder, present(feeder), np.array([True, False, True, False]))
    assert order.margin > 1e-3
    assert all("highest voltage 0.99" in words for words in sentences(order))


def random_feeder(seed: int) -> tuple[SwitchedFeeder, Flags, Flags]:
    """A feeder with numbers in no order, ratios, charging, and another of its configurations."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 9))
    names = rng.permutation(100)[:n]
    parent = [int(rng.integers(max(0, i - 3), i)) for i in range(1, n)]
    start, end = names[parent], names[1:]
    turned = rng.random(n - 1) < 0.5
    net = Network(
        np.where(turned, end, start),
        np.where(turned, start, end),
        rng.uniform(0.5, 2.0, n - 1),
        rng.uniform(0.3, 2.0, n - 1),
        slack_bus=int(names[0]),
        base_kv=10.0,
        ratio=np.where(rng.random(n - 1) < 0.2, rng.uniform(0.98, 1.02, n - 1), 1.0),
        b_us=rng.uniform(0.0, 300.0, n - 1),
        drawing_bus=names[1:2],
        p_shunt_kw=[20.0],
        q_shunt_kvar=[-30.0],
    )
    tied = {frozenset(pair) for pair in zip(start.tolist(), end.tolist(), strict=True)}
    pairs = [pair for pair in itertools.combinations(names.tolist(), 2) if {*pair} not in tied]
    chosen = rng.permutation(len(pairs))[: int(rng.integers(2, 4))]
    ties = [pairs[i][:: rng.choice([-1, 1])] for i in chosen]
    count = len(ties)
    switches = Switches(
        [f"t{i}" for i in range(count)],
        *(list(side) for side in zip(*ties, strict=True)),
        ["tie"] * count,
        [False] * count,
        r_ohm=rng.uniform(0.5, 2.0, count),
        x_ohm=rng.uniform(0.3, 2.0, count),
        parallel_allowed=(rng.random(count) < 0.5).tolist(),
        minutes_to_operate=rng.choice([0.0, 10.0, 40.0], count),
    )
    load = rng.uniform(0.0, 600.0, n) * (np.arange(n) > 0)
    feeder = SwitchedFeeder(
        net, switches, -load, -0.4 * load, ConfigurationLimits(0.9, 1.1, ratings=False)
    )
    graph = switched_network(net, switches)
    graph = replace(graph, can_open=np.ones(n - 1, dtype=bool))
    trees = np.concatenate([*graph.configurations(1000)])
    then = np.ones(n - 1 + count, dtype=bool)
    then[trees[rng.integers(len(trees))]] = False
    now = np.arange(n - 1 + count) < n - 1
    if seed % 4 == 0:  # a line is out, and is opened
        out = np.zeros(len(now), dtype=bool)
        out[rng.choice(np.flatnonzero(~then[: n - 1]) if not then[: n - 1].all() else 1)] = True
        feeder = replace(feeder, faulted=out)
    return feeder, now, then


class Walked:
    """States of a feeder, by a search of its buses and MATPOWER's equations."""

    def __init__(self, feeder: SwitchedFeeder) -> None:
        net, ties = feeder.network, feeder.switches
        self.feeder = feeder
        self.known: dict[bytes, float] = {}
        ends = [*zip(net.from_bus, net.to_bus, strict=True), *zip(ties.from_bus, ties.to_bus, strict=True)]  # fmt: skip
        self.ends = [(net.bus_index[a], net.bus_index[b]) for a, b in ends]
        z = net.base_kv**2
        none, count = np.zeros(len(ties)), len(self.ends)
        self.branch = np.zeros((count, 13))
        self.branch[:, :2] = self.ends
        self.branch[:, 2] = np.append(net.r_ohm, ties.r_ohm) / z
        self.branch[:, 3] = np.append(net.x_ohm, ties.x_ohm) / z
        self.branch[:, 4] = np.append(net.b_us, none) * 1e-6 * z
        self.branch[:, 8] = np.append(net.ratio, none)
        self.branch[:, 10] = 1.0
        self.minutes = np.append(np.zeros(net.n_lines), ties.minutes_to_operate.astype(float))
        self.parallel = np.append(np.zeros(net.n_lines, bool), ties.parallel_allowed.astype(bool))

    def carrying(self, closed: Flags) -> Flags:
        out = self.feeder.faulted
        return closed if out is None else closed & ~out

    def live(self, closed: Flags) -> set[int]:
        """Buses that the grid reaches."""
        found, left = {0}, [0]
        while left:
            bus = left.pop()
            for branch in np.flatnonzero(self.carrying(closed)):
                if bus in self.ends[branch]:
                    other = sum(self.ends[branch]) - bus
                    if other not in found:
                        found.add(other)
                        left.append(other)
        return found

    def margin(self, closed: Flags) -> float:
        """Distance of the voltages from their limits; no order is refused twice for a state."""
        key = closed.tobytes()
        if key not in self.known:
            try:
                self.known[key] = self._margin(closed)
            except AssertionError:  # it has no solution
                self.known[key] = -np.inf
        return self.known[key]

    def _margin(self, closed: Flags) -> float:
        net, feeder = self.feeder.network, self.feeder
        buses = sorted(self.live(closed))
        bus = np.zeros((len(buses), 13))
        bus[:, 0], bus[:, 1] = buses, 1
        bus[0, 1] = 3
        bus[:, 2], bus[:, 3] = -feeder.p_kw[buses] / 1e3, -feeder.q_kvar[buses] / 1e3
        bus[:, 4], bus[:, 5] = net.p_shunt_kw[buses] / 1e3, -net.q_shunt_kvar[buses] / 1e3
        gen = np.array([[0, 0, 0, 0, 0, 1.0, 1, 1]])
        inside = [b for b in np.flatnonzero(self.carrying(closed)) if self.ends[b][0] in buses]
        v = np.ones(1)
        if len(buses) > 1:
            v = voltages(1.0, bus, gen, self.branch[inside])
        limits = feeder.limits
        v = v[1:]  # the source's is the same in every state
        if not len(v):
            return np.inf
        return float(min(v.min() - limits.v_min_pu, limits.v_max_pu - v.max()))

    def walk(self, now: Flags, then: Flags, order: tuple[int, ...]) -> tuple[float, float] | None:
        """Interruption and least margin of an order, None where a rule or a limit is broken."""
        least = min(0.0, self.margin(now)) - 1e-6
        wanted = self.live(now) & self.live(then)
        closed, missed, margin = now.copy(), 0.0, np.inf
        for branch in order:
            gone = wanted - self.live(closed)
            load = sum(max(0.0, -self.feeder.p_kw[bus]) + 1e-3 for bus in gone)
            missed += load * max(self.minutes[branch], 1.0)
            after = closed.copy()
            after[branch] = then[branch]
            new_loop = self.loops(after) > self.loops(closed)
            if then[branch] and new_loop and (not self.parallel[branch] or self.loops(closed)):
                return None
            closed = after
            margin = min(margin, self.margin(closed))
            if margin < least:
                return None
        return missed, margin

    def loops(self, closed: Flags) -> int:
        """Closed branches beyond a forest."""
        first = [*range(self.feeder.network.n_buses)]
        beyond = 0
        for branch in np.flatnonzero(self.carrying(closed)):
            one, other = (first[bus] for bus in self.ends[branch])
            beyond += one == other
            first = [one if number == other else number for number in first]
        return beyond


@pytest.mark.parametrize("seed", range(24))
def test_no_order_is_better_on_random_feeders(seed: int) -> None:
    """All permutations by another search, other rules and another power flow."""
    feeder, now, then = random_feeder(seed)
    walked = Walked(feeder)
    found = safe_order(feeder, now, then)
    moved = np.flatnonzero(now != then).tolist()
    others = [walked.walk(now, then, each) for each in itertools.permutations(moved)]
    allowed = [each for each in others if each is not None]
    if found.operations is None:
        if "has a fault" not in found.reason:
            assert not allowed, found.reason
        return
    own = walked.walk(now, then, tuple(one.branch for one in found.operations))
    assert sorted(one.branch for one in found.operations) == moved
    best = min(allowed, key=lambda each: (round(each[0], 6), -each[1]))
    assert own == pytest.approx(best, abs=1e-6)
    if moved:
        assert found.margin == pytest.approx(own[1], abs=1e-7)
