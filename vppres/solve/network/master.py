"""Service and cost in the network, for windows in which it forbids the fleet's optimum."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import highspy
import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.data import WindowData
from vppres.model.numerics import cost_scale
from vppres.model.parts import at_items
from vppres.model.site import Site
from vppres.solve.certificate import Candidate
from vppres.solve.deadline import HALF, Deadline, Stopwatch
from vppres.solve.dispatch import cheapest_by_rows
from vppres.solve.fleet.relaxation import weight_grid, whole_price
from vppres.solve.levels import Relaxation
from vppres.solve.network.cheapest import EXACT_DISC
from vppres.solve.network.program import DISC, NetworkProgram
from vppres.solve.network.rows import Rows, limited
from vppres.solve.programs import (
    DIRECT,
    HALF_UNIT,
    NODES,
    SOLVED,
    WHOLE_GAP,
    Program,
    ProgramSolution,
    begin_with,
    columns_of_alike,
    search_options,
    with_sums,
)
from vppres.solve.result import Outcome, Status
from vppres.solve.sizes import is_large
from vppres.solve.task import WindowTask

DISCS = (DISC, EXACT_DISC)
"""Shares by which a set that is tried may exceed discs, one after the other."""


def applies(site: Site, data: WindowData) -> bool:
    """Whether a window has this form: weights and the price of switching on a grid.

    Service is counted in whole units here, so none of it may be later service. With rules all sets
    come from the search with binaries.
    """
    unit = weight_grid(site.customers.weight * site.dt_h)
    if unit == 0.0 or data.keeps_service:
        return False
    if data.switching is None:
        return True
    return whole_price(data, unit) and not is_large(site, data.n_steps)


@dataclass
class SearchState:
    """The set last tried, the bound on all, and the best set that is carried, in units.

    ``shares`` is how far customers are served by the last linear solution.
    """

    tried: Floats
    bound: float
    shares: Floats
    best: Floats | None = None
    most: float = -np.inf

    def closed(self) -> bool:
        """Whether the best set has as much as the bound."""
        return self.most >= self.bound

    def take(self, found: ProgramSolution) -> None:
        """The next set to try, and what its search proves."""
        if found.status == Status.INFEASIBLE:
            self.bound = self.most
        elif found.status.has_answer:
            self.tried = np.round(found.x)
        self.bound = max(self.most, min(self.bound, float(np.floor(SOLVED - found.bound))))

    def improve(self, carried: Floats, units: float) -> None:
        """Keep a set that is carried if it is the best."""
        if units > self.most:
            self.best = carried
            self.most = units


class NetworkMaster(Relaxation):
    """The relaxation in the network of one window."""

    stage = "network_"
    is_last = True

    def __init__(self, task: WindowTask) -> None:
        super().__init__(task, task.deadline)
        site, data = self.site, self.data
        self.network = NetworkProgram(self.cache, data)
        self.model = self.network.model
        units = np.round(site.customers.weight * site.dt_h / self.unit)
        self.units: Floats = np.tile(units, data.n_steps)
        self.pair = 0.0
        self.beyond: Floats = np.zeros(0)
        if data.switching is not None:
            self.pair = float(np.round(data.switching.price_of_pair / self.unit))
            self.beyond = np.round(data.switching.longest_off.price / self.unit)

    @cached_property
    def root(self) -> tuple[highspy.Highs, ProgramSolution]:
        """Most service of shares of customers, and the solver that found it."""
        solver = self.network.loaded(self.network.with_cost(*self.lack))
        if self.network.is_large:
            self.network.start(solver)
        return solver, self._until_carried(solver, self.deadline)

    @cached_property
    def able(self) -> Floats:
        """1 for who may be served, (W * C,): not in dead parts."""
        at_bus = at_items(self.data.parts.dead, self.site.customer_bus)
        return np.where(at_bus, 0.0, 1.0).ravel()

    @property
    def most_units(self) -> float:
        """Service that no set exceeds, in units; infinite where it was not found."""
        root = self.root[1]
        return float(np.floor(SOLVED - root.bound)) if root.status == Status.OPTIMAL else np.inf

    @property
    def searches_cost(self) -> bool:  # type: ignore[override]
        """Whether a search for a cheaper set is worth its time.

        Rows of phases make nodes slow: a search for a set that is cheaper by a hundredth takes as
        long as all the rest there, so that one that is certified stays.
        """
        return not self.data.phased or not self.task.certificate.certified

    def service(self, gap: float) -> tuple[Outcome, Flags | None]:
        """Most service in whole units, as if curtailment were free: it counts with the cost.

        Sets are tried, at most as good as the bound says, until one is carried in full.
        """
        watch = Stopwatch()
        deadline = self.deadline.part(HALF)
        x = self.model.at("x_served")
        root = self.root[1]
        if root.status != Status.OPTIMAL:
            return root.outcome(watch.spent_s), None
        known = SearchState(self.able, self.most_units, self._shares(root))
        self._close(known, deadline)
        if known.best is None:
            ended = Status.INFEASIBLE if known.closed() else Status.NO_ANSWER
            return Outcome(ended, np.nan, np.nan, watch.spent_s, DIRECT), None
        if known.closed():
            status = Status.OPTIMAL
        else:
            status = Status.TIME_LIMIT if deadline.passed else Status.GAP_OPEN
        outcome = Outcome(status, known.most, known.bound, watch.spent_s, DIRECT)
        return outcome, known.best.reshape(x.shape) > 0.5

    def _close(self, known: SearchState, deadline: Deadline) -> None:
        """Try sets until the best has as much as the bound, or nothing improves any more.

        A search with binaries has the limits that had a price in a linear solution so far: most of
        the others never bind, and make every node slower. Its set goes to the linear problem in
        which no customer is supplied beyond it. What that serves in full is carried, and its prices
        forbid the set if that is less than all. So do those of a proof that the network carries
        nothing without customers beyond the set, as in an island whose voltages rise without load.
        A set that closes the search, and the best at its end, is put to the true discs.
        """
        binding = self._priced(self.network.program, self.root[1])
        while not known.closed() and not deadline.passed:
            known.take(self._searched(binding, known.bound, known.best, deadline))
            if known.closed():
                if known.best is None:
                    return
                known.tried, known.best, known.most = known.best, None, -np.inf
            linear = self._tried(known.tried, known.most, known.bound)
            priced = np.union1d(binding, self._priced(self.network.program, linear))
            if linear.status == Status.OPTIMAL:
                known.improve(*self._carried(linear))
            elif linear.status != Status.INFEASIBLE or len(priced) == len(binding):
                break
            binding = priced
        if known.best is not None and not known.closed():
            linear = self._tried(known.best, -np.inf)
            if linear.status == Status.OPTIMAL:
                known.most = -np.inf
                known.improve(*self._carried(linear))

    def carries(self, served: Flags) -> bool:
        """Whether the relaxation in the network serves a set in full."""
        if self.root[1].status != Status.OPTIMAL:
            return True
        wanted = served.ravel().astype(float)
        linear = self._until_carried(self._at_most(wanted), self.deadline)
        done = linear.status == Status.OPTIMAL
        return not done or bool(self.units @ self._in_full(linear) >= self.units @ wanted)

    def _at_most(self, served: Floats) -> highspy.Highs:
        """The solver of the root, by which no customer is supplied beyond a schedule."""
        solver = self.root[0]
        x = self.model.at("x_served").ravel()
        solver.changeColsBounds(len(x), x.astype(np.int32), np.zeros(len(x)), served)
        return solver

    def _tried(self, served: Floats, enough: float, goal: float = -np.inf) -> ProgramSolution:
        """Most service if no customer is supplied beyond a schedule.

        It need not be known where no more units than enough are served in full. From the goal on
        discs are the true ones.
        """
        solver = self._at_most(served)
        for over in DISCS:
            linear = self._until_carried(solver, self.deadline, over, worth=enough)
            if linear.status != Status.OPTIMAL or self.units @ self._in_full(linear) < goal:
                break
        return linear

    def _shares(self, linear: ProgramSolution) -> Floats:
        """How far customers are served by a linear solution."""
        return np.asarray(linear.x[self.model.at("x_served").ravel()])

    def _in_full(self, linear: ProgramSolution) -> Floats:
        """Customers that a linear solution serves in full."""
        return np.asarray(np.floor(linear.x[self.model.at("x_served").ravel()] + SOLVED))

    def _carried(self, linear: ProgramSolution) -> tuple[Floats, float]:
        """Customers that a linear solution serves in full, and their worth in units."""
        carried = self._in_full(linear)
        units = float(self.units @ carried)
        rules = self.data.switching
        if rules is None:
            return carried, units
        served = carried.reshape(self.data.load_kw.shape) > 0.5
        if rules.broken(served).any():
            return carried, -np.inf
        return carried, units - float(np.round(rules.price(served) / self.unit))

    @property
    def lack(self) -> tuple[Wholes, Floats]:
        """Columns of service and of what rules cost, and what of them is minimised, in units."""
        off = self.model.at("y_off").ravel()
        columns = [self.model.at("x_served").ravel(), off, self.model.at("beyond").ravel()]
        beyond = np.tile(self.beyond, self.data.n_steps)
        return np.concatenate(columns), np.concatenate(
            [-self.units, np.full(len(off), self.pair), beyond]
        )

    def _searched(
        self, binding: Wholes, at_most: float, best: Floats | None, deadline: Deadline
    ) -> ProgramSolution:
        """Search with binaries and some of the limits in the network, until so many units.

        With rules it begins with the best set that is known. Without, prices find sets that are as
        good, and a search that begins with one took half as long again.
        """
        x = self.model.at("x_served")
        rows = [Rows.joined(self.network.found).part(binding)] if len(binding) else []
        counted = self._counted(self.network.with_cost(*self.lack), rows)
        solver = counted.loaded(
            WHOLE_GAP, enough=HALF_UNIT - at_most, more=search_options(self.site, self.data)
        )
        if best is not None and self.data.switching is not None:
            begin_with(solver, x, best)
        found = ProgramSolution.of(solver, deadline)
        return replace(found, x=found.x[x.ravel()] if found.status.has_answer else found.x)

    def _counted(self, program: Program, rows: list[Rows]) -> Program:
        """A program with limits, binaries, and how many of each weight are served."""
        x = self.model.at("x_served")
        alike = columns_of_alike(x, self.site.customers.weight)
        return with_sums(replace(limited(program, rows), integer=x.ravel()), alike)

    @staticmethod
    def _priced(program: Program, linear: ProgramSolution) -> Wholes:
        """Which limits in the network, behind a program's rows, have a price in its solution."""
        return np.flatnonzero(linear.row_dual[len(program.lower) :])

    def counted(self, best: Candidate) -> tuple[float, float]:
        """Service of a dispatch, and its cost with that of curtailment, in GBP."""
        curtailed = self.site.weights.lambda_curt * best.terms.f3
        return best.service + curtailed, best.terms.f2 + cost_scale(self.site) * curtailed

    def least_cost(self, units_min: float, everyone: bool) -> Outcome:
        """Lower bound on the cost of all sets with so many units, in GBP.

        Limits that have a price there become known: most of what a search without them finds would
        violate them. Those that other solutions violate on the way would only slow it.
        """
        watch = Stopwatch()
        before = self.network.limits
        program = self._enough(units_min)
        found = self._until_carried(self.network.loaded(program), self.deadline)
        if found.status == Status.OPTIMAL and self.network.limits > before:
            kept = np.union1d(np.arange(before), self._priced(program, found))
            self.network.found = [Rows.joined(self.network.found).part(kept)]
        return found.outcome(watch.spent_s)

    def cheaper(
        self, units_min: float, everyone: bool, best: Candidate, gap_gbp: float, deadline: Deadline
    ) -> tuple[Outcome, Flags | None]:
        """Least cost of all sets with so many units, to a gap or until a deadline.

        The search has the limits of the network that are known; whatever it finds is put into all
        of them, which adds some. The set in the answer is cheaper than the best.
        """
        watch = Stopwatch()
        x = self.model.at("x_served")
        known_gbp = self.counted(best)[1]
        cheapest = None
        size = -1
        bound = -np.inf
        program, options = self._enough(units_min), search_options(self.site, self.data)
        while known_gbp - bound > gap_gbp and not deadline.passed and self.network.limits > size:
            size = self.network.limits
            counted = self._counted(program, self.network.found)
            solver = counted.loaded(0.5 * gap_gbp, NODES, more=options)
            begin_with(solver, x, best.dispatch.served if cheapest is None else cheapest)
            found = ProgramSolution.of(solver, deadline)
            if np.isfinite(found.bound):
                bound = max(bound, found.bound)
            if not found.status.has_answer:
                break
            served = np.round(found.x[x])
            carried = self._until_carried(
                self.network.loaded(self.network.of_set(served)), self.deadline
            )
            if carried.status == Status.OPTIMAL and carried.value < known_gbp:
                known_gbp = carried.value
                cheapest = served > 0.5
            if carried.status == Status.OPTIMAL and found.status != Status.OPTIMAL:
                break  # another search would not end either
        ended = Status.TIME_LIMIT if deadline.passed else Status.GAP_OPEN
        status = Status.OPTIMAL if known_gbp - bound <= gap_gbp else ended
        return Outcome(status, known_gbp, bound, watch.spent_s, DIRECT), cheapest

    def keep(self, served: Flags, charges: Flags | None = None) -> None:
        """Keep a set's cheapest dispatch, with the tie-breakers if they find one, if it is best."""
        answer_by, network = self.task.answer_by(), self.network
        found = cheapest_by_rows(self.task, served, answer_by, charges, network=network)[1]
        self.task.certificate.keep(found)

    def _enough(self, units_min: float) -> Program:
        """Least cost of so many units, rounded up to a whole number."""
        units_min = float(np.ceil(units_min - SOLVED))
        columns, lack = self.lack
        size = len(self.network.program.cost)
        enough = Rows.of(columns[None, :], -lack, units_min - SOLVED, np.inf, size)
        return self.network.program.with_rows(enough.matrix.tocsc(), enough.lower)

    def _until_carried(
        self,
        solver: highspy.Highs,
        deadline: Deadline,
        over: float = DISC,
        worth: float = -np.inf,
    ) -> ProgramSolution:
        """Solve with the limits that are violated, or until so few units are served in full."""

        def is_enough(found: ProgramSolution) -> bool:
            return bool(self.units @ self._in_full(found) <= worth)

        return self.network.until_carried(solver, deadline, over, enough=is_enough)
