"""Service and cost in the network, for windows in which it forbids the fleet's optimum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import highspy
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.data import WindowData
from vppres.model.parts import at_items
from vppres.model.site import Site
from vppres.solve.cache import ModelCache
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.fleet.relaxation import weight_grid, whole_price
from vppres.solve.network.cheapest import EXACT_DISC, CheapestDispatch
from vppres.solve.network.program import DISC, FINER_DISC, NetworkProgram
from vppres.solve.network.rows import Rows, limited
from vppres.solve.network.sets import SearchState, ServiceCuts
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

DISCS = (DISC, FINER_DISC, EXACT_DISC)
"""The shares one after the other: a set that the second admits may need the little that it does."""


def applies(site: Site, data: WindowData) -> bool:
    """Whether a window has this form: weights and the price of switching on a grid.

    Service is counted in whole units here, so none of it may be later service. With rules all sets
    come from the search with binaries. The power over lines that are out, by which parts of
    feeders with phases are stated, has no limits here.
    """
    unit = weight_grid(site.customers.weight * site.dt_h)
    if unit == 0.0 or data.keeps_service or (data.phased is not None and not data.parts.whole):
        return False
    if data.switching is None:
        return True
    return whole_price(data, unit) and not is_large(site, data.n_steps)


class NetworkMaster:
    """The master in the network of one window.

    By the deadline all must be done but for what gets a deadline of its own.
    """

    def __init__(self, cache: ModelCache, data: WindowData, deadline: Deadline) -> None:
        self.deadline = deadline
        self.cache = cache
        site = cache.site
        self.site = site
        self.data = data
        self.network = NetworkProgram(cache, data)
        self.model = self.network.model
        self.unit = weight_grid(site.customers.weight * site.dt_h)
        units = np.round(site.customers.weight * site.dt_h / self.unit)
        self.units: Floats = np.tile(units, data.n_steps)
        self._dispatched: tuple[Flags, Outcome, Dispatch | None] | None = None
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

    @cached_property
    def least_curtailed_kwh(self) -> float:
        """Least PV energy that a cut feeder curtails with any schedule: all that of dead parts.

        Service is searched as if curtailment were free, and a feeder in one piece seldom needs any.
        """
        if self.data.parts.whole:
            return 0.0
        columns = self.model.at("P_curt").ravel()
        program = self.network.with_cost(columns, np.full(len(columns), self.site.dt_h))
        found = ProgramSolution.of(self.network.loaded(program), self.deadline)
        return max(found.bound, 0.0) if found.status == Status.OPTIMAL else 0.0

    def service(self, deadline: Deadline) -> tuple[Outcome, Flags | None]:
        """Most service in whole units until a deadline, whatever is curtailed for it.

        The linear problem in which no customer is supplied beyond a schedule bounds the service of
        all sets by its value and reduced costs. Sets that satisfy all such inequalities so far are
        tried until one is carried in full. In a large window the best is put to the discs
        themselves.
        """
        watch = Stopwatch()
        x = self.model.at("x_served")
        root = self.root[1]
        if root.status != Status.OPTIMAL:
            return root.outcome(watch.spent_s), None
        cuts = ServiceCuts(self.units, self.able)
        most = self._cut(root, cuts)
        known = SearchState(self.able, float(np.floor(most + SOLVED)), self._shares(root))
        known.improve(*self._carried(root))
        self._close(known, cuts, deadline)
        if known.best is None:
            ended = Status.INFEASIBLE if known.closed() else Status.NO_ANSWER
            return Outcome(ended, np.nan, np.nan, watch.spent_s, DIRECT), None
        if known.closed():
            status = Status.OPTIMAL
        else:
            status = Status.TIME_LIMIT if deadline.passed else Status.GAP_OPEN
        outcome = Outcome(status, known.most, known.bound, watch.spent_s, DIRECT)
        return outcome, known.best.reshape(x.shape) > 0.5

    def _close(self, known: SearchState, cuts: ServiceCuts, deadline: Deadline) -> None:
        """Try sets until the best has as much as the bound, or nothing improves any more.

        With rules the best set is put to the discs themselves, in two steps, where it has no
        dispatch within them: no customer can be left out of it then without breaking them. So it is
        with phases, where the former's disc decides how much is served in an island.
        """
        binding = self._priced(self.root[1])
        for over, finer in pairwise(DISCS):
            binding = self._try_sets(known, cuts, deadline, binding, over)
            plain = self.data.switching is None and self.data.phased is None
            if known.best is None or plain or deadline.passed:
                return
            if self._has_dispatch(known.best):
                return
            carried = self._put_to_discs(known, cuts, finer)
            if carried is None:
                return
            binding = self._also_priced(binding, carried)
        self._try_sets(known, cuts, deadline, binding, finer)

    def _try_sets(
        self,
        known: SearchState,
        cuts: ServiceCuts,
        deadline: Deadline,
        binding: Flags,
        over: float,
    ) -> Flags:
        """Try sets within discs that are exceeded so far; returns the limits that have bound."""
        while not known.closed() and not deadline.passed:
            enough = known.most
            known.take(self._searched(binding, known.bound, known.best, deadline))
            if known.closed():
                break
            linear = self._tried(self.root[0], known.tried, over, enough)
            if linear.status != Status.OPTIMAL:
                break
            self._cut(linear, cuts)
            known.shares = self._shares(linear)
            known.improve(*self._carried(linear))
            # These forbid the set that was tried, if it is not carried in full.
            binding = self._also_priced(binding, linear)
        return binding

    def _also_priced(self, binding: Flags, linear: ProgramSolution) -> Flags:
        """Limits that have bound, and those with a price in a linear solution."""
        priced = self._priced(linear)
        return priced | np.pad(binding, (0, len(priced) - len(binding)))

    def _put_to_discs(
        self, known: SearchState, cuts: ServiceCuts, over: float
    ) -> ProgramSolution | None:
        """Put the best set to discs so near the true ones; the best is what they carry of it then.

        None where that was not solved.
        """
        assert known.best is not None
        carried = self._tried(self.root[0], known.best, over, -np.inf, self.deadline)
        if carried.status != Status.OPTIMAL:
            return None
        self._cut(carried, cuts)
        known.shares = self._shares(carried)
        known.best, known.most = None, -np.inf
        known.improve(*self._carried(carried))
        return carried

    def carries(self, served: Flags) -> bool:
        """Whether the relaxation in the network serves a set in full."""
        solver, root = self.root
        if root.status != Status.OPTIMAL:
            return True
        x = self.model.at("x_served").ravel()
        wanted = served.ravel().astype(float)
        linear = self._tried(solver, wanted, DISC, -np.inf)
        solver.changeColsBounds(len(x), x.astype(np.int32), np.zeros(len(x)), self.able)
        # The limits that were added have no price in the first solution.
        none = np.zeros(solver.getNumRow() - len(root.row_dual))
        self.root = solver, replace(root, row_dual=np.append(root.row_dual, none))
        done = linear.status == Status.OPTIMAL
        return not done or bool(self.units @ self._in_full(linear) >= self.units @ wanted)

    def _tried(
        self,
        solver: highspy.Highs,
        served: Floats,
        over: float,
        worth: float,
        again: Deadline | None = None,
    ) -> ProgramSolution:
        """Most service if no customer is supplied beyond a schedule.

        A solver that gives up begins anew, which takes long, where there is a deadline for it.
        """
        x = self.model.at("x_served").ravel()
        solver.changeColsBounds(len(x), x.astype(np.int32), np.zeros(len(x)), served)
        linear = self._until_carried(solver, self.deadline, over, worth=worth)
        if linear.status == Status.NUMERICAL and again is not None:
            self.network.start(solver)
            linear = self._until_carried(solver, again, over, worth=worth)
        return linear

    def _shares(self, linear: ProgramSolution) -> Floats:
        """How far customers are served by a linear solution."""
        return np.asarray(linear.x[self.model.at("x_served").ravel()])

    def _cut(self, linear: ProgramSolution, cuts: ServiceCuts) -> float:
        """Add what a linear problem proves of all sets; returns its bound on service in units."""
        x = self.model.at("x_served").ravel()
        program = limited(self.network.with_cost(*self.lack), self.network.found)
        worth, left = program.priced(linear.row_dual)
        rest = np.minimum(left * program.x_lower, left * program.x_upper)
        rest[x] = 0.0
        return cuts.add(left[x] * self.able, -worth - float(rest.sum()))

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
        self, binding: Flags, at_most: float, best: Floats | None, deadline: Deadline
    ) -> ProgramSolution:
        """Search with binaries and some of the limits in the network, until so many units.

        With rules it begins with the best set that is known. Without, prices find sets that are as
        good, and a search that begins with one took half as long again.
        """
        x = self.model.at("x_served")
        rows = [Rows.joined(self.network.found).part(binding)] if binding.any() else []
        counted = self._counted(self.network.with_cost(*self.lack), rows)
        solver = counted.loaded(WHOLE_GAP, enough=HALF_UNIT - at_most, more=self._options)
        if best is not None and self.data.switching is not None:
            begin_with(solver, x, best)
        found = ProgramSolution.of(solver, deadline)
        return replace(found, x=found.x[x.ravel()] if found.status.has_answer else found.x)

    @property
    def _options(self) -> Mapping[str, Any]:
        """Options of the searches with binaries."""
        return search_options(self.site, self.data)

    def _counted(self, program: Program, rows: list[Rows]) -> Program:
        """A program with limits, binaries, and how many of each weight are served."""
        x = self.model.at("x_served")
        alike = columns_of_alike(x, self.site.customers.weight)
        return with_sums(replace(limited(program, rows), integer=x.ravel()), alike)

    def _priced(self, linear: ProgramSolution) -> Flags:
        """Which of the limits found so far have a price in a linear solution.

        The others, most of them, make every node of a search slower and seldom bind in one.
        """
        known = len(linear.row_dual) - self.network.limits
        return np.asarray(linear.row_dual[known:] != 0.0)

    def least_cost(self, units_min: float) -> Outcome:
        """Lower bound on the cost of all sets with so many units, in GBP."""
        watch = Stopwatch()
        found = self._until_carried(self.network.loaded(self._enough(units_min)), self.deadline)
        return found.outcome(watch.spent_s)

    def cost_level(
        self,
        units_min: float,
        known: Flags,
        known_gbp: float,
        gap_gbp: float,
        deadline: Deadline,
    ) -> tuple[Outcome, Flags | None]:
        """Least cost of all sets with so many units, to a gap or until a deadline.

        ``known`` is a set of a known cost.
        The search has the limits of the network that are known; whatever it finds is put into all
        of them, which adds some. The set in the answer is cheaper than the known cost.
        """
        watch = Stopwatch()
        x = self.model.at("x_served")
        best = None
        size = -1
        program = self._enough(units_min)
        bound = self._least_by_shares(program, deadline)
        while (
            known_gbp - bound > gap_gbp and not deadline.passed and len(self.network.found) > size
        ):
            size = len(self.network.found)
            counted = self._counted(program, self.network.found)
            solver = counted.loaded(0.5 * gap_gbp, NODES, more=self._options)
            begin_with(solver, x, known if best is None else best)
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
                best = served > 0.5
            if carried.status == Status.OPTIMAL and found.status != Status.OPTIMAL:
                break  # another search would not end either
        ended = Status.TIME_LIMIT if deadline.passed else Status.GAP_OPEN
        status = Status.OPTIMAL if known_gbp - bound <= gap_gbp else ended
        return Outcome(status, known_gbp, bound, watch.spent_s, DIRECT), best

    def _least_by_shares(self, program: Program, deadline: Deadline) -> float:
        """Least cost of shares of customers, in GBP; limits that have a price there become known.

        Most of what a search without them finds would violate them. Those that its other solutions
        violate on the way would only slow it.
        """
        before = self.network.limits
        shares = self._until_carried(self.network.loaded(program), deadline)
        if shares.status != Status.OPTIMAL:
            return -np.inf
        kept = self._priced(shares)
        kept[:before] = True
        if len(kept) > before:
            self.network.found = [Rows.joined(self.network.found).part(kept)]
        return shares.value

    def _enough(self, units_min: float) -> Program:
        """Least cost of so many units."""
        columns, lack = self.lack
        size = len(self.network.program.cost)
        enough = Rows.of(columns[None, :], -lack, units_min - SOLVED, np.inf, size)
        return self.network.program.with_rows(enough.matrix.tocsc(), enough.lower)

    def cheapest(
        self, served: Flags, deadline: Deadline, charges: Flags | None = None
    ) -> tuple[Outcome, Dispatch | None]:
        """Cheapest dispatch of a supply schedule, within the discs.

        With the set its rules are met, and what it draws is known. ``charges`` says which
        batteries charge where they waste energy, (W, B), if that is known.
        """
        last = self._dispatched
        if last is not None and charges is None and (last[0] == served).all():
            return last[1:]
        if self.data.switching is None:
            way = CheapestDispatch(self.site, self.data, self.network)
        else:
            way = CheapestDispatch.of_set(self.cache, self.data, served)
        outcome, dispatch = way.of(served, deadline, charges)
        if outcome.status == Status.OPTIMAL:
            self._dispatched = served, outcome, dispatch
        return outcome, dispatch

    def _has_dispatch(self, best: Floats) -> bool:
        """Whether a set has a dispatch by shares within the discs, which is kept."""
        served = best.reshape(self.model.at("x_served").shape) > 0.5
        return self.cheapest(served, self.deadline)[0].status == Status.OPTIMAL

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
