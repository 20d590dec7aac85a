"""Service of large windows in the network: their feeders by themselves, then sets of so many units.

Feeders that leave the slack bus share balances alone, since no line's voltage drop reaches beyond
the slack bus. Their own searches at the prices of what all share give cuts (``docs/method.md``,
*Service with the network*).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.parts import at_items
from vppres.scenario.network import Network
from vppres.solve.certificate import Candidate
from vppres.solve.deadline import HALF, Deadline
from vppres.solve.fleet.masters import fleet_master
from vppres.solve.levels import Relaxation
from vppres.solve.network.master import NetworkMaster, SearchState
from vppres.solve.network.rows import limited
from vppres.solve.programs import HALF_UNIT, NODES, PROOF, SOLVED, Program, ProgramSolution
from vppres.solve.result import Outcome, Status

TRIES = 12
"""Sets of so many units that are tried in a large window before fewer units are."""

BOUND_OFF = 1e-4
"""Units that a bound on a large window may be off by, which a solver has within its tolerance: what
a search proves gives way by it, and a set that lacks no more is asked for its dispatch."""

PREFERENCE = 0.3
"""Units for which a set may be preferred because it is close to a linear solution. Twice as much
must stay below one unit, or the best set would no longer be told from the next."""

PREFERENCE_LEFT = 0.03
"""Of the units for which a set may be preferred, how many a set may lack that ends a search."""

SHARED = -1
"""Feeder of what belongs to none: the grid's columns, rows over several feeders."""

MOST_LOST = 2.0
"""Units of service by which a feeder's search may fall below its linear problem. Whose service, or
lack of it, would alone cost more is decided beforehand, and no cut takes more than that away."""

GAP = 0.05
"""Units that a feeder's search may leave open."""

SEARCH = MappingProxyType({**PROOF, "mip_heuristic_run_root_reduced_cost": False})
"""How HiGHS searches a feeder: for the bound."""


def feeder_of_buses(network: Network) -> Wholes:
    """Number of the feeder of each bus, (N,), counted from the slack bus, which has none."""
    feeder = np.full(network.n_buses, SHARED)
    count = 0
    for line, parent in enumerate(network.parent):
        if parent == 0:
            feeder[line + 1] = count
            count += 1
        else:
            feeder[line + 1] = feeder[parent]
    return feeder


def feeder_of_rows(rows: sp.csr_array, feeder: Wholes) -> Wholes:
    """Feeder of each row by that of its columns, (m,); ``SHARED`` with several, or with none."""
    entries = feeder[rows.indices]
    found = np.full(rows.shape[0], SHARED)
    full = np.flatnonzero(np.diff(rows.indptr))
    starts = rows.indptr[full]
    lowest = np.minimum.reduceat(entries, starts)
    highest = np.maximum.reduceat(entries, starts)
    found[full] = np.where(lowest == highest, lowest, SHARED)
    return found


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a feeder's search."""

    binaries: Wholes  #: positions among all binaries of those of the feeder
    served: Floats  #: their values in its answer, NaN without one
    raised: float  #: by how much it costs at least more than without binaries


class Feeders:
    """A linear problem over several feeders, and the prices at which its solution joins them.

    ``solution`` is the optimum of the ``program``, with prices of all rows; ``feeder`` has
    ``SHARED`` for a column of none, and ``binaries`` are columns that are to be zero or one.
    """

    def __init__(
        self, program: Program, solution: ProgramSolution, feeder: Wholes, binaries: Wholes
    ) -> None:
        self.program = program
        self.x = solution.x
        self.feeder = feeder
        self.binaries = binaries
        self.rows = sp.csr_array(program.rows)
        self.of_row = feeder_of_rows(self.rows, feeder)
        self.prices = program.allowed(solution.row_dual)
        of_shared = np.where(self.of_row == SHARED, self.prices, 0.0)
        self.cost = np.asarray(program.cost - of_shared @ program.rows)
        self.reduced = np.asarray(program.cost - self.prices @ program.rows)

    @property
    def fractional(self) -> Wholes:
        """Feeders in which a binary is a fraction, in order."""
        values = self.x[self.binaries]
        fraction = np.abs(values - np.round(values)) > SOLVED
        feeders = np.unique(self.feeder[self.binaries[fraction]])
        return np.asarray(feeders[feeders != SHARED])

    def search(self, number: int, deadline: Deadline, most_lost: float = MOST_LOST) -> Found:
        """Search one feeder with its binaries, the shared rows by their prices.

        Whatever departs from what is decided beforehand costs the feeder more than ``most_lost``.
        """
        columns = np.flatnonzero(self.feeder == number)
        rows = np.flatnonzero(self.of_row == number)
        binary = np.isin(columns, self.binaries)
        program = self._own(columns, rows, binary, most_lost)
        least = program.least(self.prices[rows])
        nodes = None if np.isinf(most_lost) else NODES
        solver = program.loaded(GAP, nodes, more=SEARCH)
        found = ProgramSolution.of(solver, deadline)
        of_column = np.zeros(len(self.feeder), dtype=np.int64)
        of_column[self.binaries] = np.arange(len(self.binaries))
        places = of_column[columns[binary]]
        answered = found.status.has_answer
        served = np.round(found.x[binary]) if answered else np.full(len(places), np.nan)
        bound = min(found.bound, least + most_lost)
        raised = bound - BOUND_OFF - least
        return Found(places, served, raised if raised > 0.0 else 0.0)

    def _own(self, columns: Wholes, rows: Wholes, binary: Flags, most_lost: float) -> Program:
        """A feeder's problem; binaries that would cost too much to change are decided."""
        lower = self.program.x_lower[columns].copy()
        upper = self.program.x_upper[columns].copy()
        left = self.reduced[columns]
        decided = binary & (left < -most_lost)
        lower[decided] = upper[decided]
        upper[binary & (left > most_lost)] = 0.0
        return Program(
            self.cost[columns],
            lower,
            upper,
            sp.csc_array(self.rows[rows][:, columns]),
            self.program.lower[rows],
            self.program.upper[rows],
            np.flatnonzero(binary),
        )


class ServiceCuts:
    """Cuts on the service of sets that are carried: ``units @ x <= most + gain @ x``.

    ``able`` is 1 for who may be served.
    """

    def __init__(self, units: Floats, able: Floats) -> None:
        self.units = units
        self.able = able
        self.gains: list[Floats] = []
        self.most_units: list[float] = []
        self.first_left: Floats = np.zeros(len(units))
        self.raised: Floats = np.zeros(len(units))
        self.by_feeders = 0.0

    def add(self, left: Floats, most: float) -> float:
        """Add a bound ``most - left @ x``; returns its largest value.

        What supplying a customer costs is left out but for the first: such rows are searched
        faster.
        """
        if not self.gains:
            self.first_left = left
        self.gains.append(np.maximum(-left, 0.0))
        self.most_units.append(most + SOLVED)
        return most + float(self.gains[-1].sum())

    @property
    def first(self) -> float:
        """The first bound on all sets."""
        return self.most_units[0] + float(self.gains[0].sum()) - self.by_feeders

    def lower(self, raised: Floats, total: float) -> None:
        """Lower the first bound by what feeders' own searches take from it.

        ``raised`` is what the search of each customer's feeder takes, zero without one, and
        ``total`` the sum over the feeders. A departure from the linear solution costs a feeder that
        much for nothing, since its search has seen all of them.
        """
        self.raised = raised
        self.by_feeders = total
        gain = self.gains[0]
        searched = raised > 0.0
        self.gains.append(np.where(searched, 0.0, gain))
        self.most_units.append(self.most_units[0] + float(gain[searched].sum()) - total)

    def with_units(
        self, units: float, shares: Floats, held: Floats, deadline: Deadline
    ) -> ProgramSolution:
        """A set of just so many units; infeasible where no set that is carried has them.

        Whose service or lack of it would alone cost too much by the first bound is decided.
        ``held`` decides the customers that it supplies where it is not NaN: of others nothing is
        proven then.
        """
        away = 1.0 - shares
        spare = self.first - units + self.raised
        program = Program(
            PREFERENCE / max(1.0, float(away.sum())) * away - self.units,
            (self.first_left < -spare).astype(float),
            (self.first_left <= spare) * self.able,
            sp.csc_array(self.units - np.array(self.gains)),
            np.full(len(self.gains), -np.inf),
            np.array(self.most_units),
            np.arange(len(self.units)),
        )
        decided = np.flatnonzero(~np.isnan(held))
        program = program.with_held(decided, held[decided])
        just = sp.csc_array(self.units[None, :])
        limits = np.array([units - HALF_UNIT]), np.array([units + HALF_UNIT])
        solver = program.with_rows(just, *limits).loaded(
            1.0 - 2.0 * PREFERENCE, enough=PREFERENCE_LEFT - units
        )
        return ProgramSolution.of(solver, deadline)


class LargeMaster(NetworkMaster):
    """The master in the network of a large window, whose searches have no rows of the network."""

    searches_cost = False

    @property
    def _by_fleet(self) -> Relaxation | None:
        """The fleet, which bounds the cost in one piece: rows of the network take long there."""
        return fleet_master(self.task) if self.data.parts.whole else None

    def counted(self, best: Candidate) -> tuple[float, float]:
        """Service and cost of a dispatch as what bounds its cost tells them apart."""
        fleet = self._by_fleet
        return super().counted(best) if fleet is None else fleet.counted(best)

    def least_cost(self, units_min: float, everyone: bool) -> Outcome:
        """Least cost without the network, or of parts in it."""
        fleet = self._by_fleet
        if fleet is None:
            return super().least_cost(units_min, everyone)
        return fleet.least_cost(units_min, everyone=False)

    @cached_property
    def alone(self) -> Flags:
        """Customers in parts beside that with the grid's bus, (W * C,)."""
        return at_items(self.data.parts.beyond, self.site.customer_bus).ravel()

    def _close(self, known: SearchState, deadline: Deadline) -> None:
        """Try sets of as many units as none exceeds, and of fewer where there are none.

        The linear problem in which no customer is supplied beyond a schedule bounds the service of
        all sets by its value and reduced costs: the next set satisfies all such inequalities.
        """
        cuts = ServiceCuts(self.units, self.able)
        known.bound = float(np.floor(self._cut(self.root[1], cuts) + SOLVED))
        held = np.full(len(self.units), np.nan)
        if not known.closed():
            held = self._by_feeders(cuts, deadline)
            known.bound = max(known.most, float(np.floor(cuts.first + SOLVED)))
        known.tried = np.where(np.isnan(held), self.able, held)
        if not known.closed() and self._learns(known, cuts):
            self._reach(known, cuts, held, deadline)

    def _cut(self, linear: ProgramSolution, cuts: ServiceCuts) -> float:
        """Add what a linear problem proves of all sets; returns its bound on service in units."""
        x = self.model.at("x_served").ravel()
        program = limited(self.network.with_cost(*self.lack), self.network.found)
        worth, left = program.priced(_prices_of(program, linear))
        rest = np.minimum(left * program.x_lower, left * program.x_upper)
        rest[x] = 0.0
        return cuts.add(left[x] * self.able, -worth - float(rest.sum()))

    def _by_feeders(self, cuts: ServiceCuts, deadline: Deadline) -> Floats:
        """Lower the first bound by feeders' own searches; returns who is supplied.

        (W * C,), NaN for who is left open. Where a share of a feeder's customers is a fraction,
        the feeder is searched with binaries, once: a second search at the prices of a linear
        problem with its cut takes next to nothing more. A part of a feeder has few customers, and
        may miss a linear problem by any of them.
        """
        x = self.model.at("x_served").ravel()
        held = np.full(len(x), np.nan)
        raised = np.zeros(len(x))
        total = 0.0
        open_ = np.repeat(~self.data.dark, len(self.site.customers)) | self.alone
        of_bus = feeder_of_buses(self.site.network)
        of_column = self.model.feeders(of_bus)[self.model.parts.indices]
        cut = of_bus[1:][self.data.parts.lines.any(axis=0)]
        program = limited(self.network.with_cost(*self.lack), self.network.found)
        root = self.root[1]
        solution = replace(root, row_dual=_prices_of(program, root))
        feeders = Feeders(program, solution, of_column, x)
        end = deadline.part(HALF)
        for number in feeders.fractional:
            if end.passed:
                break
            most_lost = np.inf if number in cut else MOST_LOST
            found = feeders.search(number, end, most_lost)
            places = found.binaries[open_[found.binaries]]
            held[places] = found.served[open_[found.binaries]]
            raised[found.binaries] = found.raised
            total += found.raised
        cuts.lower(raised, total)
        return held

    def _reach(
        self, known: SearchState, cuts: ServiceCuts, held: Floats, deadline: Deadline
    ) -> None:
        """Try sets of as many units as the bound, which falls where none has them.

        Where that cannot be told, sets of fewer units are tried, and the bound stays.
        """
        goal = known.bound
        while goal > known.most and not deadline.passed:
            none_has = self._none_has(goal, known, cuts, held, deadline)
            if none_has and goal == known.bound:
                known.bound = max(known.most, known.bound - 1.0)
            goal -= 1.0

    def _none_has(
        self,
        units: float,
        known: SearchState,
        cuts: ServiceCuts,
        held: Floats,
        deadline: Deadline,
    ) -> bool:
        """Whether it is proven that no set has so many units, after some that might were tried.

        First those that supply with grid, and in parts, the customers that the feeders' searches
        supply: voltages or the part's own balance decide there, in an outage the balance of all
        does. The others follow.
        """
        found = None
        only_parts = [np.where(self.alone, held, np.nan)] if self.alone.any() else []
        for said in (held, *only_parts, np.full(len(held), np.nan)):
            for _ in range(TRIES):
                found = cuts.with_units(units, known.shares, said, deadline)
                if not found.status.has_answer:
                    break
                if (np.round(found.x) == known.tried).all():
                    return False
                known.tried = np.round(found.x)
                done = not self._learns(known, cuts)
                if done or known.most >= units or deadline.passed:
                    return False
        return found is not None and found.status == Status.INFEASIBLE

    def _learns(self, known: SearchState, cuts: ServiceCuts) -> bool:
        """Put the set that is tried into the network; says whether that was solved."""
        linear = self._tried(known.tried, known.most)
        if linear.status != Status.OPTIMAL:
            return False
        self._cut(linear, cuts)
        known.shares = self._shares(linear)
        known.improve(*self._carried(linear))
        wanted = float(self.units @ known.tried)
        if wanted + linear.value < BOUND_OFF:
            known.improve(known.tried, wanted)
        return True


def _prices_of(program: Program, linear: ProgramSolution) -> Floats:
    """Prices of a program's rows in a solution; limits that were added later had none."""
    prices = linear.row_dual
    return np.pad(prices, (0, len(program.lower) - len(prices)))
