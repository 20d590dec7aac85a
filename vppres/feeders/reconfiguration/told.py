"""Operations of an order in words: the effect of each, and who is without supply until when."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.core.text import counted, named
from vppres.feeders.reconfiguration.states import Checked, Margin, States, Topology, holders
from vppres.scenario.network import BusId


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


@dataclass(frozen=True, eq=False)
class Telling:
    """Words for the operations between two configurations."""

    states: States  #: the states between them
    minutes: Floats  #: how long each branch takes to operate, (E,)

    def operations(self, done: tuple[int, ...]) -> Iterator[Operation]:
        """The operations of an order."""
        states = self.states
        passed = [states.topology(done[:count]) for count in range(len(done) + 1)]
        cold, buses = ~states.first.live, states.net.buses
        for count, branch in enumerate(done):
            before, after = passed[count], passed[count + 1]
            cold = cold | ~after.live
            checked = states.check(done[: count + 1], cold)
            gone = before.live & ~after.live
            back: dict[int, list[int]] = {}  # by the operation that ends it
            for bus in np.flatnonzero(gone & states.first.live & states.last.live).tolist():
                until = next(k for k in range(count + 1, len(passed)) if passed[k].live[bus])
                back.setdefault(until, []).append(bus)
            waits = {until: self.minutes[[*done[count + 1 : until]]].sum() for until in back}
            a, b = states.ends(branch)
            joins = states.then[branch] and before.part[a] != before.part[b]
            at_the_device = bool(joins and before.live[a] and before.live[b])
            told = [
                f"{self._without(own)}{_for_minutes(waits[until])} until "
                f"{states.feeder.branches.names[done[until - 1]]} is closed"
                for until, own in back.items()
            ]
            lost = np.flatnonzero(gone & ~states.last.live).tolist()
            told += [self._without(lost)] if lost else []
            effect = self._effect(branch, before, after, checked, cold)
            yield Operation(
                switch=states.feeder.branches.names[branch],
                branch=branch,
                closes=bool(states.then[branch]),
                margin=checked.least,
                interrupted=tuple(buses[bus] for own in back.values() for bus in own),
                minutes=float(max(waits.values(), default=0.0)),
                at_the_device=at_the_device,
                sentence=f"{states.verb(branch)}: "
                + "; ".join([*filter(None, (effect, *told)), checked.least.words]),
            )

    def _without(self, buses: list[int]) -> str:
        verb = "is" if len(self._customers(buses) or buses) == 1 else "are"
        return f"{self._supplied(buses)} {verb} without supply"

    def _customers(self, buses: Sequence[int]) -> list[str]:
        return [
            name
            for bus in buses
            for name in self.states.feeder.customers.get(self.states.net.buses[bus], ())
        ]

    def _supplied(self, buses: list[int]) -> str:
        """Customers of some buses, or the buses where none is known."""
        if own := self._customers(buses):
            return f"customer{'s' * (len(own) > 1)} {named(own)}"
        return f"bus{'es' * (len(buses) > 1)} {named(self.states.net.buses[buses])}"

    def _effect(
        self, branch: int, before: Topology, after: Topology, checked: Checked, cold: Flags
    ) -> str:
        """Effect of an operation in words, without the interruption."""
        a, b = self.states.ends(branch)
        if self.states.feeder.out[branch]:
            return "it has carried nothing since the fault"
        if not self.states.then[branch]:
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
        cold_kw = self.states.feeder.cold_kw
        more = "" if cold_kw is None else f", with {cold_kw[new].sum():.1f} kW of cold load"
        return f"it supplies {self._supplied(new)}{more}"

    def _opening(self, before: Topology, after: Topology, a: int, b: int) -> str:
        if not before.live[a] and not before.live[b]:
            return "its line has no supply"
        if after.part[a] == after.part[b]:
            return "it opens the loop"
        if not (after.live[a] and after.live[b]):
            return ""
        held = [after.sources[int(after.part[bus])] for bus in (a, b)]
        new = [f for _, f in held if f is not None and f not in holders(before)]
        islands = named(self.states.feeder.formers.id[new])
        return f"it splits off an island, which {islands} holds" if new else "it splits an island"


def _for_minutes(minutes: float) -> str:
    return f" for {counted(round(minutes), 'minute')}," if minutes else ""
