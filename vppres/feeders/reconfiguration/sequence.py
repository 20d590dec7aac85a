"""The order of operations between two configurations, with limits kept in every state in between.

The AC power flow of every state is solved, with closed loops and in islands. An order has at most
one closed loop at a time, and that only at switches that may close one. Of all orders those that
interrupt least come first, of them the one with the largest least margin: states that are reached
by the same operations are one, and of the ways to them only the best is followed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Flags
from vppres.core.text import counted
from vppres.feeders.reconfiguration.states import Margin, States, SwitchedFeeder, Topology, beyond
from vppres.feeders.reconfiguration.told import Operation, Telling

MOST_OPERATIONS = 10
"""Operations, those of five exchanges, up to which all orders are compared."""

MOST_STATES = 4
"""States that are followed after each operation where there are more."""

LEAST_MINUTES = 1.0
"""Time that an operation takes at least, by which interruptions are compared."""

MOST_REASONS = 3
"""Operations without a way on that a reason names."""


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

    >>> from vppres.feeders.reconfiguration.search import ConfigurationLimits
    >>> from vppres.scenario.network import Network
    >>> from vppres.scenario.switches import Switches
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
    return _Orders(States(feeder, now, then)).best()


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

    def __init__(self, states: States) -> None:
        self.states = states
        feeder = self.feeder = states.feeder
        self.minutes = feeder.branches.of_moves("minutes_to_operate").astype(float)
        self.may_close_loop = feeder.branches.of_moves("parallel_allowed").astype(bool)
        self.compares = feeder.branches.of_moves("sync_check").astype(bool)
        both = states.first.live & states.last.live
        # A bus without a load counts too, for almost nothing.
        drawn = np.maximum(feeder.network.p_fixed_kw - feeder.p_kw, 0.0) + 1e-3
        self.missed_kw = np.where(both, drawn, 0.0)

    def best(self) -> SwitchingOrder:
        """The best order, or why there is none."""
        states = self.states
        cold = ~states.first.live
        start = states.check((), cold)
        every = len(states.moves) <= MOST_OPERATIONS
        if refused := next(self._refusals(), None):
            return SwitchingOrder(None, refused, every, start.least)
        floor = states.floor(start)
        if too_far := beyond(states.check(states.all_done, cold), floor):
            reason = f"The state after all operations is beyond the limits: {too_far}."
            return SwitchingOrder(None, reason, every, start.least)
        ways = [_Way((), cold, 0.0, np.inf)]
        for _ in states.moves:
            blocked: list[str] = []
            found: dict[tuple[frozenset[int], bytes], _Way] = {}
            for more in (more for way in ways for more in self._next(way, floor, blocked)):
                key = frozenset(more.done), states.cold_key(more.cold)
                if key not in found or more.key < found[key].key:
                    found[key] = more
            if not found:
                return SwitchingOrder(None, _none_words(blocked), every, start.least)
            kept = sorted(found.values(), key=self._rank)
            ways = kept if every else kept[:MOST_STATES]
        best = min(ways, key=lambda one: one.key)
        told = Telling(states, self.minutes).operations(best.done)
        return SwitchingOrder(tuple(told), "", every, start.least)

    def _rank(self, way: _Way) -> tuple[float, float]:
        """Less is better: an interruption that goes on counts for the next operation."""
        missed_kw = self.missed_kw[~self.states.topology(way.done).live].sum()
        return way.key[0] + round(float(missed_kw) * LEAST_MINUTES, 9), way.key[1]

    def _refusals(self) -> Iterator[str]:
        """Why no order can exist, whatever the power flow: locks, faults, loops at the end."""
        locked = self.feeder.branches.of_moves("locked")
        movable = self.feeder.movable
        if movable is None:
            movable = self.feeder.branches.of_moves("operable").astype(bool)
        for branch in self.states.moves:
            name, closes = self.feeder.branches.names[branch], self.states.then[branch]
            if locked[branch]:
                yield f"{name} is locked: {locked[branch]}."
            elif closes and self.feeder.out[branch]:
                yield f"{name} cannot be closed: its line, or a bus of it, has a fault."
            elif not movable[branch] and not self.feeder.out[branch]:
                yield f"{name} is not operable."
        if self.states.last.loops:
            yield "A loop would stay closed after all operations."

    def _next(self, way: _Way, floor: Sequence[float], blocked: list[str]) -> Iterator[_Way]:
        """Ways that go on by one operation; those that may not are noted with the reason."""
        before = self.states.topology(way.done)
        missed_kw = float(self.missed_kw[~before.live].sum())
        for branch in self.states.all_done:
            if branch in way.done:
                continue
            done = (*way.done, branch)
            reason = self._rule(before, branch) if self.states.then[branch] else ""
            if not reason:
                after = self.states.topology(done)
                cold = way.cold | ~after.live
                checked = self.states.check(done, cold)
                reason = beyond(checked, floor)
            if reason:
                blocked.append(f"{self.states.verb(branch)} ({reason})")
                continue
            minutes = max(self.minutes[branch], LEAST_MINUTES)
            yield _Way(
                done,
                cold,
                way.interrupted + missed_kw * minutes,
                min(way.margin, checked.least.value),
            )

    def _rule(self, before: Topology, branch: int) -> str:
        """Why a branch may not be closed in a state; empty if it may."""
        a, b = self.states.ends(branch)
        if before.part[a] == before.part[b]:
            if not self.may_close_loop[branch]:
                return "closes a loop, for which it has no parallel_allowed"
            return "a loop is closed already" if before.loops else ""
        if before.live[a] and before.live[b] and not self.compares[branch]:
            return "joins two live parts, and has no sync_check"
        return ""


def _none_words(blocked: list[str]) -> str:
    """Why no operation leads on."""
    unlike = [*dict.fromkeys(blocked)]
    more = len(unlike) - MOST_REASONS
    words = "; ".join(unlike[:MOST_REASONS])
    rest = f"; and {counted(more, 'more')}" if more > 0 else ""
    return f"No order keeps the rules in every state: {words}{rest}."
