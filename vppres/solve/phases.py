"""Limits of a window's phases as rows on a problem's columns, made where solutions violate them.

Squared voltages, the former's power by phase and currents are linear in what assets draw, which is
linear in the columns of every problem. Few of these limits bind, and a row of them has a number
for nearly each asset: all at once they take most of the time of a window.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Complexes, Flags, Floats, Wholes
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.data import WindowData
from vppres.model.phases import GRID, REACH, SIDES, PhasedModel, Slopes, phased_model
from vppres.model.site import Site
from vppres.model.statement import DRAWN
from vppres.model.violations import VOLTAGE_TOLERANCE_PU2
from vppres.scenario.assets import NO_POWER_KW
from vppres.solve.deadline import HALF
from vppres.solve.network.rows import PER_PU2, ColumnPowers, Rows
from vppres.solve.selection import Selected

LOW, HIGH = 0, 1
"""Sides of a limit of voltages."""

OF_FORMER, OF_RATING = 2, 3
"""What rows of the former's phases, and of currents that have a rating, have for a side."""

MOST_NEW = 4
"""Voltages of a step and phase, and currents of a step, that get a row at once on a side, those
farthest out first."""

BINDS_PU2 = 2e-5
"""How near its limit a squared voltage of a candidate is that the limit binds: 1e-5 pu."""

MOST_BINDING = 16
"""Voltages of a step and phase that bind a candidate on a side and get a row from the start. Where
limits give way to the feeder without control, a plan near that state has thousands at them."""

NEAR_RATING = 0.03
"""Share of what a phase of the former may carry that the last candidate may stay below it by for
its sides to be rows from the start: passes move it by less."""

OVER = HALF * VOLTAGE_TOLERANCE_PU2
"""By how much a dispatch may miss a limit of the phases: half of what its check allows."""

MORE_ROOM = 4.0 * OVER
"""Share by which a phase of the former may be fuller than a linear problem lets it be, in cones: a
linear solution that uses all that it may has no inside else."""

TOWARDS = np.exp(-2j * np.pi * np.arange(SIDES) / SIDES)
"""Turns of a value by which its real part is what it has towards a side."""

OfSlopes = Callable[[Slopes], Callable[[Wholes], tuple[Any, Any]]]
"""Factors of places, by the slopes of a supply."""


@dataclass(frozen=True, eq=False)
class PhaseRows(Rows):
    """Rows of limits of phases, with what they limit.

    ``steps`` (R,) are those of the rows; ``by_p`` and ``by_q`` (R, D) what a kW and a kvar that an
    asset draws add to them. ``places`` (R,) are voltages, phases or currents, and ``side`` is
    which: ``LOW`` or ``HIGH`` of voltages, ``OF_FORMER`` or ``OF_RATING``.
    """

    steps: Wholes
    places: Wholes
    side: int
    by_p: Floats
    by_q: Floats


class PhaseLimits:
    """Limits of a window's voltages by phase, of its former's phases and of currents."""

    def __init__(self, site: Site, data: WindowData, problem: Selected) -> None:
        self.model = phased_model(site)
        self.data = data
        self.drawn = drawn_by_assets(self.model, data, problem)
        self.phased = data.phased
        self.limited = self.model.limits_at(data, lit_steps(data))
        self.source = np.maximum(self.model.sources(data), GRID)
        self.formed = self.model.formed(data)

    @property
    def near(self) -> list[PhaseRows]:
        """Rows of limits that bound the last candidate or, of the former, nearly did."""
        bound = [self._voltages(side, self.phased.bound[:, side]) for side in (LOW, HIGH)]
        return [*chain(*bound), *self._former(self.phased.former_kva, -NEAR_RATING)]

    def exceeded(self, x: Floats, over: float = OVER) -> list[PhaseRows]:
        """Rows of limits that a solution exceeds by more than so many pu², or such a share."""
        drawn = self.drawn.at(x)
        u, former = self.model.linear(self.data, *drawn)
        u = self.phased.u_offset + u
        sides = ((LOW, self.phased.u_min - u), (HIGH, u - self.phased.u_max))
        worst = [
            self._voltages(side, _farthest(self.model, self.limited, beyond, over, MOST_NEW))
            for side, beyond in sides
        ]
        former = self.phased.former_offset + former
        return [*chain(*worst), *self._former(former, over), *self._rated(drawn, over)]

    def _voltages(self, side: int, which: Flags) -> list[PhaseRows]:
        """Rows of some limits, (W, m), on a side."""
        steps, nodes = np.nonzero(which)
        limit = (self.phased.u_min, self.phased.u_max)[side]
        scale = (PER_PU2, -PER_PU2)[side]
        if not len(steps):
            return []
        by_p, by_q = self._at(steps, nodes, lambda slopes: slopes.of_voltages)
        least = scale * (limit - self.phased.u_offset)[steps, nodes]
        by = scale * by_p.real, scale * by_q.real
        return [self._rows(steps, by, least, nodes, side)]

    def _at(self, steps: Wholes, places: Wholes, of: OfSlopes) -> tuple[Any, Any]:
        """Factors of some places in some steps, with the step's supply, (R, D) each."""
        found = [np.zeros((len(steps), self.drawn.kw.shape[1]), dtype=complex) for _ in range(2)]
        for source in np.unique(self.source[steps]):
            there = self.source[steps] == source
            of_places = of(self.model.supplies[source].slopes)
            for each, values in zip(found, of_places(places[there]), strict=True):
                each[there] = values
        return found[0], found[1]

    def _former(self, kva: Complexes, over: float) -> list[PhaseRows]:
        """Rows of each phase of a former that is beyond its polygon."""
        if not (self.model.formers and self.formed.any()):
            return []
        room = np.maximum(self.phased.room_kva, NO_POWER_KW)
        room = np.where(self.formed, room, np.inf)
        beyond = self._beyond(kva, room) > over
        offset = self.phased.former_offset
        return self._sides(kva, offset, room, lambda slopes: slopes.of_former, beyond, OF_FORMER)

    def _rated(self, drawn: tuple[Floats, Floats], over: float) -> list[PhaseRows]:
        """Rows of the currents farthest beyond their ratings in each step."""
        room = self.phased.current_max
        if not np.isfinite(room).any():
            return []
        offset = self.phased.current_offset
        currents = offset + self.model.currents(self.data, *drawn)
        beyond = self._beyond(currents, room)
        least = -np.sort(-beyond, axis=1)[:, :MOST_NEW][:, -1:]
        farthest = (beyond > over) & (beyond >= least)
        return self._sides(
            currents, offset, room, lambda slopes: slopes.of_currents, farthest, OF_RATING
        )

    @staticmethod
    def _beyond(at: Complexes, room: Floats) -> Floats:
        """How far values are beyond the polygons inside their discs, as a share of these."""
        side = np.round(np.angle(at) * SIDES / (2.0 * np.pi)).astype(int) % SIDES
        return np.asarray(np.real(at * TOWARDS[side]) / (REACH * room) - 1.0)

    def _sides(
        self,
        at: Complexes,
        offset: Complexes,
        room: Floats,
        of: OfSlopes,
        which: Flags,
        kind: int,
    ) -> list[PhaseRows]:
        """Of some discs, (W, k), the side of its polygon that a value is at, and those beside.

        Rows are in shares of what the disc allows.
        """
        steps, places = np.nonzero(which)
        if not len(steps):
            return []
        of_p, of_q = self._at(steps, places, of)
        radius = REACH * np.broadcast_to(room, at.shape)[steps, places]
        side = np.round(np.angle(at[steps, places]) * SIDES / (2.0 * np.pi)).astype(int)
        found = []
        for beside in (0, 1, -1):
            turn = TOWARDS[(side + beside) % SIDES] / radius
            by = -np.real(turn[:, None] * of_p), -np.real(turn[:, None] * of_q)
            least = np.real(turn * offset[steps, places]) - 1.0
            found.append(self._rows(steps, by, least, places, kind))
        return found

    def _rows(
        self, steps: Wholes, by: tuple[Floats, Floats], least: Floats, places: Wholes, side: int
    ) -> PhaseRows:
        """Rows ``by_p @ p + by_q @ q >= least`` of what assets draw in some steps, (R, D) each."""
        matrix, kw, kvar = self.drawn.sums(steps, *by)
        most = np.full(len(steps), np.inf)
        return PhaseRows(matrix, least - kw - kvar, most, steps, places, side, *by)


def drawn_by_assets(model: PhasedModel, data: WindowData, problem: Selected) -> ColumnPowers:
    """Power that assets draw by a problem's columns; the former's power as a source is none."""
    W = data.n_steps
    shown = np.ones((W, len(model.at_bus_of_assets)))
    for t, source in enumerate(model.sources(data)):
        shown[t, model.devices(int(source))] = 0.0
    by_step = np.arange(shown.size).reshape(shown.shape, order="F").ravel()
    mask = sp.diags_array(shown.ravel())
    found = (problem.numbers_of(name) for name in DRAWN)
    (by_kw, kw), (by_kvar, kvar) = (
        (sp.csr_array(mask @ rows[by_step]), shown * known[by_step].reshape(W, -1))
        for rows, known in found
    )
    return ColumnPowers(by_kw, by_kvar, kw, kvar)


def _farthest(model: PhasedModel, limited: Flags, beyond: Floats, over: float, most: int) -> Flags:
    """The voltages farthest beyond a limit in each step and phase, by more than so much, (W, m)."""
    found = np.zeros(beyond.shape, dtype=bool)
    beyond = np.where(limited, beyond, -np.inf)
    for places in model.by_phase:
        order = np.argsort(-beyond[:, places], axis=1, kind="stable")
        worst = places[order[:, :most]]
        np.put_along_axis(found, worst, np.take_along_axis(beyond, worst, axis=1) > over, axis=1)
    return found


def binding(model: PhasedModel, limited: Flags, room: Sequence[Floats]) -> Flags:
    """Limits that bind a candidate, (W, 2, m), of each side by the room that it has there."""
    of_sides = [_farthest(model, limited, -each, -BINDS_PU2, MOST_BINDING) for each in room]
    return np.stack(of_sides, axis=1)


def near_to(site: Site, data: WindowData, dispatch: Dispatch) -> WindowData:
    """A window that knows which limits bind a dispatch in the network too, as far as it has phases.

    These are rows of its next problem from the start.
    """
    phased = data.phased
    if not phased:
        return data
    model = phased_model(site)
    drawn = model.drawn(data, dispatch)
    if np.isnan(drawn).any():
        return data
    u, former = model.linear(data, *drawn)
    u = phased.u_offset + u
    room = np.abs(u - phased.u_min), np.abs(phased.u_max - u)
    limited = model.limits_at(data, lit_steps(data))
    bound = phased.bound | binding(model, limited, room)
    kva = phased.former_offset + former
    return replace(data, phased=replace(phased, bound=bound, former_kva=kva))
