"""The feeder before and after the moments in which switches move or faults begin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.core.arrays import Flags
from vppres.core.text import counted, named
from vppres.day.trajectory import (
    SWITCHED,
    SWITCHING_GAIN,
    SWITCHING_ORDER,
    SWITCHING_WHY,
    Trajectory,
)
from vppres.report.clock import Clock
from vppres.report.one_line import (
    NOT_KNOWN,
    OPEN,
    OUT_OF_SERVICE,
    WITH_GRID,
    BranchStates,
)

MOST_MOMENTS = 3


@dataclass(frozen=True)
class Look:
    """How the feeder looks: classes of its elements as in a step, and in words."""

    words: str  #: when it is, and what is off
    #: A digit for each element, as in :func:`vppres.report.one_line.step_states`.
    bus: str
    tile: str
    line: str
    part: str
    soc: list[int]  #: per cent of each battery
    moved: tuple[int, ...] = ()  #: branches that move

    @property
    def out(self) -> list[int]:
        """Branches that are out."""
        return [i for i, digit in enumerate(self.line) if digit == str(OUT_OF_SERVICE)]


@dataclass(frozen=True)
class FeederMoment:
    """A step in which switches move or a fault begins: why, and in which order."""

    title: str
    why: str
    order: tuple[str, ...]
    before: Look
    after: Look


@dataclass(frozen=True)
class Moments:
    """The moments that matter most, and how many more there are."""

    shown: tuple[FeederMoment, ...]
    left: int

    @property
    def unknown(self) -> bool:
        """Whether a state is shown in which no step was."""
        return any(NOT_KNOWN in moment.before.bus for moment in self.shown)


def moments_of(run: Trajectory, steps: dict[str, Any]) -> Moments:
    """Moments of a run in which switches move, what is worth most first, and in which faults begin.

    ``steps`` are its :func:`vppres.report.one_line.step_states`.
    """
    states = BranchStates.of(run)
    n_steps = len(run.steps)
    moved, gain = np.zeros(n_steps, dtype=bool), np.zeros(n_steps)
    if SWITCHED in run.steps:
        moved = (run.steps[SWITCHED] != "").to_numpy(bool)
        gain = np.nan_to_num(run.steps[SWITCHING_GAIN].to_numpy(float), nan=np.inf)
    begins = (states.out & ~np.vstack([np.zeros_like(states.out[:1]), states.out[:-1]])).any(axis=1)
    found = np.flatnonzero(moved | begins)
    best = found[np.lexsort((found, -gain[found], ~moved[found]))][:MOST_MOMENTS]
    of = _Moments(run, states, steps)
    shown = tuple((of.moved if moved[t] else of.fault)(t) for t in sorted(best.tolist()))
    return Moments(shown, len(found) - len(shown))


@dataclass(frozen=True, eq=False)
class _Moments:
    """Moments of a run, made from its steps."""

    run: Trajectory
    states: BranchStates
    steps: dict[str, Any]

    def moved(self, t: int) -> FeederMoment:
        """Switches that move in a step: before, what is out in it is out already."""
        closed = self.states.before(t)
        which = tuple(np.flatnonzero(self.states.closed[t] != closed).tolist())
        what, why, order = (
            str(self.run.steps[name].iloc[t]) for name in (SWITCHED, SWITCHING_WHY, SWITCHING_ORDER)
        )
        return FeederMoment(
            f"{Clock.of(self.run).at(t)}: {what}",
            f"{why[:1].upper()}{why[1:]}.",
            tuple(f"{each}." for each in order.splitlines()),
            replace(self._unrecorded(t, closed, self.states.out[t]), moved=which),
            replace(self._recorded(t), moved=which),
        )

    def fault(self, t: int) -> FeederMoment:
        """A fault that begins in a step without operations."""
        healthy = np.zeros_like(self.states.out[t])
        before = self._recorded(t - 1) if t else self._unrecorded(t, self.states.before(t), healthy)
        title = f"{Clock.of(self.run).at(t)}: a fault begins"
        words = self._out_words(self.states.out[t])
        return FeederMoment(title, words, (), before, self._recorded(t))

    def _recorded(self, t: int) -> Look:
        """A step as it was."""
        of = {name: self.steps[name][t] for name in ("bus", "tile", "line", "part", "soc")}
        off = int((~self.run.by_step("customers", "served")[t].astype(bool)).sum())
        supply = f"{counted(off, 'customer')} off supply" if off else "all customers supplied"
        cut = self._cut(sum(digit != str(WITH_GRID) for digit in of["part"]))
        return Look(f"Step of {Clock.of(self.run).at(t)}: {cut}, {supply}.", **of)

    def _unrecorded(self, t: int, closed: Flags, out: Flags) -> Look:
        """A state in which no step was: voltages and supply are not known."""
        _, part = self.states.parts_at(closed & ~out, t)
        line = np.where(out, OUT_OF_SERVICE, np.where(closed, 0, OPEN))
        soc = np.rint(100.0 * self._soc_before(t)).astype(int).tolist()
        unknown = NOT_KNOWN * len(part)
        lines, parts = ("".join(map(str, each.tolist())) for each in (line, part))
        words = self._cut(int((part != WITH_GRID).sum()))
        words = f"{self._out_words(out)} {words}." if out.any() else f"{words.capitalize()}."
        return Look(words, unknown, unknown, lines, parts, soc)

    def _out_words(self, out: Flags) -> str:
        names = named([self.states.branches.names[i] for i in np.flatnonzero(out)])
        return f"Out of service: {names}."

    def _soc_before(self, t: int) -> Any:
        if t == 0:
            return self.run.scenario.batteries.soc_initial
        return self.run.by_step("batteries", "soc_end")[t - 1]

    def _cut(self, buses: int) -> str:
        n_buses = self.run.scenario.network.n_buses
        if not buses:
            return "all buses with the grid"
        return f"{buses} of {counted(n_buses, 'bus', 'buses')} without the grid"
