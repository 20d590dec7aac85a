"""Service and cost of a window by counts: how many of each weight are served in each step.

Customers of equal weight are served cheapest first, so a step needs one whole number for each
weight instead of a binary for each customer. What the fleet can carry enters by cuts on demand, so
the search with whole numbers is small however large the fleet; ``docs/method.md`` has the proof.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import highspy
import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.data import WindowData
from vppres.solve.deadline import HALF, Deadline, Stopwatch
from vppres.solve.fleet.cuts import Cut, Reach
from vppres.solve.fleet.demand import DemandModel
from vppres.solve.fleet.reach import OneBattery
from vppres.solve.fleet.recursion import Losses, fewest_lost, is_too_much
from vppres.solve.programs import (
    DIRECT,
    GAP_SHARE,
    HALF_UNIT,
    NODES,
    PROOF,
    SOLVED,
    WHOLE_GAP,
    Program,
    ProgramSolution,
    add_row,
)
from vppres.solve.result import Outcome, Status

SPARE_CUSTOMERS = 3
"""Customers of the largest weight that a schedule may lose beyond what shares of customers lose: a
linear solution has a fraction for each cut that binds."""


@dataclass(frozen=True, eq=False)
class _Layout:
    """Columns of the master: demand of each step, loss, cost, shares, counts.

    ``step`` and ``customer`` say what a share stands for, ``load_kw`` what it needs, ``count``
    which count it belongs to and ``rank`` how many of that count need less; ``weight`` and
    ``count_step`` say it of the counts.
    """

    n_steps: int
    step: Wholes
    customer: Wholes
    load_kw: Floats
    count: Wholes
    rank: Wholes
    count_step: Wholes
    weight: Wholes

    @classmethod
    def of(cls, units: Wholes, able: Flags, free: Flags, load_kw: Floats) -> _Layout:
        """Shares and counts of the steps in which not all customers are supplied."""
        step, customer = np.nonzero(able & free[:, None] & (units > 0))
        span = int(units.max(initial=0)) + 1
        pairs, count = np.unique(step * span + units[customer], return_inverse=True)
        load = load_kw[step, customer]
        order = np.lexsort((load, count))
        rank = np.empty(len(order), dtype=np.int64)
        first = np.cumsum(np.bincount(count)) - np.bincount(count)
        rank[order] = np.arange(len(order)) - first[count[order]]
        return cls(len(free), step, customer, load, count, rank, pairs // span, pairs % span)

    @property
    def lost(self) -> int:
        """Column of the loss."""
        return self.n_steps

    @property
    def spent(self) -> int:
        """Column of the cost."""
        return self.n_steps + 1

    @property
    def counts(self) -> Wholes:
        """Columns of the counts."""
        return self.n_steps + 2 + len(self.step) + np.arange(len(self.weight))

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.n_steps + 2 + len(self.step) + len(self.weight)

    def rows(self) -> sp.csc_array:
        """Demand of each step less what the shares need, then counts less shares."""
        steps, shares, members = self.n_steps, len(self.step), len(self.weight)
        own = np.stack([self.step, steps + self.count])
        needed = np.stack([-self.load_kw, np.full(shares, -1.0)])
        entries = np.repeat([1, 0, 2, 1], [steps, 2, shares, members])
        return sp.csc_array(
            (
                np.concatenate([np.ones(steps), needed.ravel("F"), np.ones(members)]),
                np.concatenate([np.arange(steps), own.ravel("F"), steps + np.arange(members)]),
                np.append(0, np.cumsum(entries)),
            ),
            shape=(steps + members, self.size),
        )

    def serve(self, served: Flags, counts: Wholes) -> None:
        """Leave out all but so many of each weight, those with the smallest demand."""
        served[self.step, self.customer] = self.rank < counts[self.count]


@dataclass(frozen=True, eq=False)
class _Found:
    """Answer of a master: who is served (W, C), and the point (W + 2,) that the fleet carries."""

    status: Status
    value: float
    bound: float
    served: Flags
    point: Floats


class Counts:
    """The master of service and cost by counts, for one window.

    Parameters
    ----------
    model : DemandModel
        What the fleet can carry.
    data : WindowData
        The window.
    deadline : Deadline
        When service and cost must be done.
    """

    def __init__(self, model: DemandModel, data: WindowData, deadline: Deadline) -> None:
        self.deadline = deadline
        self.unit = model.grid
        model.write(data)
        self.load_kw = data.load_kw
        self.able = model.able
        self.units = model.customer_units
        self.unlimited: Flags = np.isinf(data.grid_limit_kw)
        self.demand_kw = model.load_kw
        self.worst = model.worst()
        self.least = model.least()
        self.whole = model.whole_units
        self.reach = Reach(model)
        self.one = OneBattery.of(model.site, data)
        self.cuts: list[Cut] = []
        self.plain: dict[bytes, tuple[_Layout, Program]] = {}
        self.proven = -np.inf
        self.gap = 0.0

    def service(self, gap: float) -> tuple[Outcome, Flags | None]:
        """Most service in units within a gap; all connected customers are supplied."""
        watch = Stopwatch()
        search = self.deadline.part(HALF)
        free = ~self.unlimited
        self.gap = gap
        found = self._carried(self._most_by_shares(free), self.deadline)
        if found.status == Status.OPTIMAL:
            whole = self._step_by_step(found, free) or self._carried(
                lambda: self._most(free, search), search
            )
            found = whole if whole.status.has_answer else self._rounded(found, free)
        anyway = int((self.able[self.unlimited] * self.units).sum())
        outcome = Outcome(
            found.status, anyway - found.value, anyway - found.bound, watch.spent_s, DIRECT
        )
        return outcome, found.served if found.status.has_answer else None

    def cost(
        self, units_min: float, everyone: bool, known_gbp: float, gap_gbp: float
    ) -> tuple[Outcome, Flags | None]:
        """Least cost in GBP of all sets with so many units.

        Parameters
        ----------
        units_min : float
            Service, f3 as weighted included, in units of the grid.
        everyone : bool
            Whether all connected customers are supplied.
        known_gbp : float
            Cost of a set that is known. If the bound comes within the gap of it, there is nothing
            to look for and no set in the answer.
        gap_gbp : float
            Gap of the search.
        """
        watch = Stopwatch()
        free = ~(self.unlimited & everyone)
        found, near = self._least_at_once(free, units_min, known_gbp, gap_gbp)
        outcome = Outcome(found.status, found.value, found.bound, watch.spent_s, DIRECT)
        none = near or not found.status.has_answer
        return outcome, None if none else found.served

    # Cost, one search for all steps.

    def _least_at_once(
        self, free: Flags, units_min: float, known_gbp: float, gap_gbp: float
    ) -> tuple[_Found, bool]:
        """Least cost of so many units, and whether its bound says that there is no set to find."""
        found = self._carried(self._least_by_shares(free, units_min), self.deadline)
        near = np.isinf(gap_gbp) or found.bound >= known_gbp - gap_gbp
        if found.status != Status.OPTIMAL or near:
            return found, True
        whole = self._carried(lambda: self._least(free, units_min, gap_gbp), self.deadline)
        if whole.status.has_answer:
            return whole, False
        bound = float(np.fmax(found.bound, whole.bound))
        return replace(found, status=Status.TIME_LIMIT, bound=bound), True

    def _carried(self, solve: Callable[[], _Found], deadline: Deadline) -> _Found:
        """Solve, cut off what the fleet cannot carry, and again until it carries the answer.

        A search that ended at its number of nodes would do so with a cut more too.
        """
        while True:
            found = solve()
            if not found.status.has_answer:
                return found
            # A search that was stopped has an answer too, if the fleet carries it.
            status, cut = self.reach.separate(found.point, self.deadline)
            if status != Status.OPTIMAL:
                return replace(found, status=status)
            if cut is None:
                return found
            if deadline.passed or found.status == Status.GAP_OPEN:
                return replace(found, status=Status.NO_ANSWER)
            self.cuts.append(cut)

    def _rounded(self, linear: _Found, free: Flags) -> _Found:
        """The set of a linear solution's counts rounded down: the fleet carries less demand too."""
        units = int((linear.served[free] * self.units).sum())
        bound = max(linear.bound, self.proven)
        value = float(linear.point[-2]) - units
        return replace(linear, status=Status.TIME_LIMIT, value=value, bound=bound)

    # Service, step by step.

    def _step_by_step(self, linear: _Found, free: Flags) -> _Found | None:
        """Most service that one battery can carry, None unless the fleet carries its set.

        Then it still bounds the service.
        """
        layout, _ = self._program(free)
        joined = any(cut.weights[-2] for cut in self.cuts)
        if not self.whole or joined or not len(layout.weight):
            return None
        everyone = int((self.able[free] * self.units).sum())
        lost = int(np.ceil(everyone + linear.bound - self.least[0] - SOLVED))
        most_lost = lost + SPARE_CUSTOMERS * int(layout.weight.max())
        units_of_step = int((self.able * self.units).sum(axis=1).max())
        if is_too_much(layout.n_steps, units_of_step, most_lost):
            return None
        losses = [self._losses(layout, t, most_lost) for t in range(layout.n_steps)]
        found = self._of_one_battery(free, layout, losses, most_lost)
        self.proven = found.value if found else self.least[0] - everyone + most_lost + 1
        if found is None:
            return None
        status, cut = self.reach.separate(found.point, self.deadline)
        if cut is not None:
            self.cuts.append(cut)
        return found if status == Status.OPTIMAL and cut is None else None

    def _of_one_battery(
        self, free: Flags, layout: _Layout, losses: list[Losses], most_lost: int
    ) -> _Found | None:
        """Most service that one battery carries, if it loses no more than so many units."""
        ways = fewest_lost(self.one, self.demand_kw, losses, most_lost)
        if ways is None:
            return None
        left_out = [step.left_out[way] for step, way in zip(losses, ways, strict=True)]
        served = self.able.copy()
        layout.serve(served, np.bincount(layout.count) - np.concatenate(left_out))
        value = self.least[0] - int((served[free] * self.units).sum())
        point = np.append((self.load_kw * served).sum(axis=1), [self.least[0], self.worst[1]])
        return _Found(Status.OPTIMAL, value, value, served, point)

    def _losses(self, layout: _Layout, t: int, most_lost: int) -> Losses:
        """Ways to lose service in a step, so many units at most."""
        counts = np.flatnonzero(layout.count_step == t)
        loads_kw = [layout.load_kw[layout.count == count] for count in counts]
        return Losses.of(layout.weight[counts].tolist(), loads_kw, most_lost)

    # Service, one search for all steps.

    def _most(self, free: Flags, deadline: Deadline) -> _Found:
        """Least of the loss minus the service of all free steps, in units."""
        layout, program = self._of_service(free)
        if not self.whole or any(cut.weights[layout.lost] for cut in self.cuts):
            return self._found(self._search(program, GAP_SHARE * self.gap), layout, deadline)
        # Below one unit a whole number is known; a window of many units needs no such proof.
        gap = max(WHOLE_GAP, GAP_SHARE * self.gap)
        # What fewer cuts have proven holds with more: a schedule that serves as much is the best.
        solver = self._search(program, gap, self.proven + HALF_UNIT)
        found = self._found(solver, layout, deadline)
        if not found.status.has_answer:
            return found
        # Service is whole, so its bound may be rounded.
        self.proven = max(float(np.ceil(found.bound - SOLVED)), self.proven)
        ended = found.value <= self.proven + HALF_UNIT
        status = Status.OPTIMAL if ended else found.status
        return replace(found, bound=self.proven, status=status)

    def _most_by_shares(self, free: Flags) -> Callable[[], _Found]:
        """The same of all free steps by shares of customers, each time with the cuts there are."""
        layout, program = self._of_service(free)
        return self._by_shares(program.loaded_by_shares(), layout)

    def _least(self, free: Flags, units_min: float, gap_gbp: float) -> _Found:
        """Least cost of so many units."""
        layout, program = self._of_cost(free)
        solver = self._search(program, gap_gbp, most_nodes=NODES)
        self._ask_for(units_min, free, layout, solver)
        return self._found(solver, layout, self.deadline)

    def _least_by_shares(self, free: Flags, units_min: float) -> Callable[[], _Found]:
        """The same by shares of customers, each time with the cuts there are."""
        layout, program = self._of_cost(free)
        solver = program.loaded_by_shares()
        self._ask_for(units_min, free, layout, solver)
        return self._by_shares(solver, layout)

    def _ask_for(
        self, units_min: float, free: Flags, layout: _Layout, solver: highspy.Highs
    ) -> None:
        """Add a row: so many units, those of connected steps included."""
        anyway = (self.able[~free] * self.units).sum()
        columns = np.append(layout.counts, layout.lost)
        add_row(solver, columns, np.append(layout.weight, -1.0), units_min - anyway, np.inf)

    def _of_service(self, free: Flags) -> tuple[_Layout, Program]:
        """A program of the loss less the service, in units."""
        layout, program = self._program(free)
        program.cost[layout.lost] = 1.0
        program.cost[layout.counts] = -layout.weight
        program.x_lower[layout.spent] = self.worst[1]
        return layout, program

    def _of_cost(self, free: Flags) -> tuple[_Layout, Program]:
        """A program of the cost."""
        layout, program = self._program(free)
        program.cost[layout.spent] = 1.0
        return layout, program

    def _program(self, free: Flags) -> tuple[_Layout, Program]:
        """Limits of demand, loss and cost, shares and counts; without objective and cuts."""
        key = free.tobytes()
        if key not in self.plain:
            self.plain[key] = self._new_program(free)
        layout, plain = self.plain[key]
        return layout, replace(plain, cost=plain.cost.copy(), x_lower=plain.x_lower.copy())

    def _new_program(self, free: Flags) -> tuple[_Layout, Program]:
        """The same when it is asked for the first time."""
        layout = _Layout.of(self.units, self.able, free, self.load_kw)
        members = np.bincount(layout.count, minlength=len(layout.weight)).astype(float)
        lower = np.zeros(layout.size)
        upper = np.ones(layout.size)
        lower[: layout.n_steps] = np.where(free, 0.0, self.demand_kw)
        upper[: layout.n_steps] = self.demand_kw
        lower[layout.lost : layout.spent + 1] = self.least
        upper[layout.lost : layout.spent + 1] = self.worst
        upper[layout.counts] = members
        most = np.append(np.full(layout.n_steps, np.inf), np.zeros(len(members)))
        return layout, Program(
            np.zeros(layout.size),
            lower,
            upper,
            layout.rows(),
            np.zeros(len(most)),
            most,
            layout.counts,
        )

    def _search(
        self,
        program: Program,
        gap_abs: float,
        enough: float = -np.inf,
        most_nodes: int | None = None,
    ) -> highspy.Highs:
        """A search with the cuts there are; nothing is below ``enough``."""
        solver = program.loaded(gap_abs, most_nodes, enough, PROOF)
        for cut in self.cuts:
            cut.add_to(solver)
        return solver

    def _by_shares(self, solver: highspy.Highs, layout: _Layout) -> Callable[[], _Found]:
        """Asks a solver without whole numbers, each time with the cuts there are."""
        known = 0

        def ask() -> _Found:
            """What it says now; it starts where it ended before."""
            nonlocal known
            for cut in self.cuts[known:]:
                cut.add_to(solver)
            known = len(self.cuts)
            return self._found(solver, layout, self.deadline)

        return ask

    def _found(self, solver: highspy.Highs, layout: _Layout, deadline: Deadline) -> _Found:
        """What a solver finds: of shares of customers only whole ones are served."""
        answer = ProgramSolution.of(solver, deadline)
        served = self.able.copy()
        if answer.status.has_answer:
            layout.serve(served, np.floor(answer.x[layout.counts] + 2.0 * SOLVED))
        return _Found(
            answer.status, answer.value, answer.bound, served, answer.x[: layout.n_steps + 2]
        )
