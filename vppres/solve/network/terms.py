"""All terms at once in the network: the whole problem with its binaries, without lines and buses.

Voltage limits and tangents of discs are added where a solution violates them, so that a search has
a few hundred of them in place of every line, bus and side of a polygon, and meets the true discs.
``docs/method.md``, *Service with the network*.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.certificate import Candidate
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.dispatch import polished
from vppres.solve.network.cheapest import EXACT_DISC
from vppres.solve.network.program import FINER_DISC, SMALL, NetworkProgram
from vppres.solve.network.reactance import Reactance
from vppres.solve.network.rows import Rows, limited
from vppres.solve.network.rules import rows_of_rules
from vppres.solve.programs import (
    DIRECT,
    GAP_SHARE,
    Program,
    ProgramSolution,
    SetOptions,
    columns_of_alike,
    with_sums,
)
from vppres.solve.result import Outcome, Status
from vppres.solve.task import SMALLER, WindowTask

# Pairs of columns of which one is zero, each with its largest value. (A docstring here would make
# the documentation's builder take the tuple for a signature.)
Turns = tuple[Wholes, Floats, Wholes, Floats]


def all_terms_in_network(task: WindowTask) -> None:
    """Search the whole problem until bound and dispatch meet, each time with the limits found.

    If the dispatch of a set is worth less than its search says, it has violated some limit, and the
    next search knows that.
    """
    if task.own or task.data.load_kw.size > SMALL:
        return
    reactance = task.cache.table(Reactance)
    terms = NetworkTerms(
        task.site, reactance, task.data, rows_of_rules(task.cache, task.data), task.gap_so_far
    )
    known = task.certificate
    while task.goes_on:
        limits = terms.limits
        gap = task.gap_so_far
        outcome, chosen = terms.search(gap, task.deadline)
        known.note("network_terms", outcome)
        if not outcome.status.has_answer:
            known.prove(outcome)
            return
        known.bound_by(outcome.bound)
        known.keep(_carried(task, terms, chosen))
        settled = terms.limits == limits and task.gap_so_far > SMALLER * gap
        if settled or outcome.status != Status.OPTIMAL:
            return


def _carried(task: WindowTask, terms: NetworkTerms, chosen: Floats) -> Candidate | None:
    """The best dispatch of a set and its modes, with the reactive power that it needs."""
    outcome, dispatch = terms.dispatch(chosen, task.answer_by())
    task.certificate.note("network_dispatch", outcome)
    if dispatch is None:
        return None
    data = task.data.for_service(dispatch.served)
    found = Candidate.of(task.site, data, dispatch, np.inf, in_network=False)
    return polished(task, found)


class NetworkTerms(NetworkProgram):
    """The program of a small window with all terms as its cost, and a binary for each turn.

    Parameters
    ----------
    site : Site
        Fixed data.
    reactance : Reactance
        How voltages depend on injections.
    data : WindowData
        The window.
    rules : Rows or None
        Rows of its switching rules.
    unit : float
        What the objective is counted in: about the gap that is asked for.
    """

    def __init__(
        self,
        site: Site,
        reactance: Reactance,
        data: WindowData,
        rules: Rows | None,
        unit: float,
    ) -> None:
        super().__init__(site, reactance, data, rules)
        self.site = site
        self.data = data
        self.unit = unit
        self.lost = site.weights.lambda_curt * site.dt_h * float(data.pv_kw.sum())
        self.program = _with_turns(replace(self.program, cost=self._cost() / unit), self._turns())
        self.found = [rows.wider(len(self.program.cost)) for rows in self.found]
        turns = np.arange(self.model.size, len(self.program.cost))
        by_rules = [self.model.at[name].ravel() for name in ("on", "off", "cold")]
        self.chosen = np.concatenate([self.model.at["x"].ravel(), turns])
        self.whole = np.concatenate([self.chosen, *by_rules])

    def _cost(self) -> Floats:
        """What a unit of each column takes from F, in weighted customer hours; lost sun apart."""
        site = self.site
        at = self.model.at
        dt = site.dt_h
        cost = np.zeros(self.model.size)
        cost[at["x"]] = -site.customers.weight * dt
        sun = site.weights.lambda_curt * dt
        cost[at["P_exp"]] = -sun
        for name, demand in self.model.demands.items():
            np.add.at(cost, at[name][:, site.owner], -sun * demand.own_kw)
        columns, gbp = self.model.price
        cost[columns] += site.weights.lambda_grid * gbp
        if self.data.switching is not None:
            cost[at["off"]] = self.data.switching.price_of_pair
            if self.data.switching.longest_off is not None:
                cost[at["beyond"]] = self.data.switching.longest_off.price
        if self.data.keeps_service:
            cost[at["kept"]] -= 1.0
        return cost

    def _turns(self) -> list[Turns]:
        """Pairs of columns of which one is zero, each with its largest value.

        A battery charges or discharges; a step imports or exports.
        """
        at = self.model.at
        power = self.model.active_kw.ravel()
        batteries = at["P_ch"].ravel(), power, at["P_dch"].ravel(), power
        if not self.data.exporting:
            return [batteries]
        most_in = self.data.grid_p_max_kw(self.site)
        most_out = self.data.export_max_kw(self.site)
        return [batteries, (at["P_grid"][:, 0], most_in, at["P_out"][:, 0], most_out)]

    def search(self, gap: float, deadline: Deadline) -> tuple[Outcome, Floats]:
        """The best value of F with the limits found, and its binaries.

        The linear relaxation is solved before: most limits that ever bind have a violation there.
        """
        watch = Stopwatch()
        linear = self.until_carried(self.loaded(self.program), deadline, FINER_DISC)
        if linear.status != Status.OPTIMAL:
            return linear.outcome(watch.spent_s), np.zeros(0)
        program = limited(replace(self.program, integer=self.whole), self.found)
        alike = columns_of_alike(self.model.at["x"], self.site.customers.weight)
        options = SetOptions.of(self.site, self.data).of_sets
        solver = with_sums(program, alike).loaded(GAP_SHARE * gap / self.unit, more=options)
        found = ProgramSolution.of(solver, deadline)
        outcome = Outcome(
            found.status,
            self.worth(found.value),
            self.worth(found.bound if np.isfinite(found.bound) else linear.value),
            watch.spent_s,
            DIRECT,
        )
        answered = found.status.has_answer
        return outcome, np.round(found.x[self.chosen]) if answered else np.zeros(0)

    def served(self, chosen: Floats) -> Flags:
        """Who is served by chosen binaries, (W, C)."""
        x = self.model.at["x"]
        served: Flags = chosen[: x.size].reshape(x.shape) > 0.5
        return served

    def worth(self, value: float) -> float:
        """F of a value of the program."""
        return -value * self.unit - self.lost

    def dispatch(self, chosen: Floats, deadline: Deadline) -> tuple[Outcome, Dispatch | None]:
        """The best dispatch of a set and its turns within the discs, whose limits are found.

        A set that the discs allow no dispatch with these turns may have one with others. With the
        set its rules are met, and what it draws is known.
        """
        watch = Stopwatch()
        found = self._held(chosen, deadline)
        other = None
        if found.status == Status.INFEASIBLE:
            other = self._with_other_turns(chosen, deadline)
        if other is not None:
            chosen = other
            found = self._held(chosen, deadline)
        served = self.served(chosen)
        if self.data.switching is not None:
            data = replace(self.data.for_service(served), switching=None)
            plain = NetworkTerms(self.site, self.model.reactance, data, None, self.unit)
            return plain.dispatch(chosen, deadline)
        outcome = Outcome(found.status, self.worth(found.value), np.inf, watch.spent_s, DIRECT)
        done = found.status == Status.OPTIMAL
        return outcome, self.model.dispatch(self.columns(found), served) if done else None

    def _held(self, chosen: Floats, deadline: Deadline) -> ProgramSolution:
        """The best dispatch with the first so many of the chosen binaries held."""
        held = self.program.with_held(self.chosen[: len(chosen)], chosen)
        return self.until_carried(self.loaded(held), deadline, EXACT_DISC)

    def _with_other_turns(self, chosen: Floats, deadline: Deadline) -> Floats | None:
        """A set with the turns that prevail where it may do both; None if that fails too."""
        served = chosen[: self.model.at["x"].size]
        both = self._held(served, deadline)
        if both.status != Status.OPTIMAL:
            return None
        turns = [both.x[first] > both.x[second] for first, _, second, _ in self._turns()]
        return np.concatenate([served, *turns]).astype(float)


def _with_turns(program: Program, pairs: list[Turns]) -> Program:
    """The program with a binary for each pair of columns, one of which is zero."""
    for first, most_first, second, most_second in pairs:
        size = len(program.cost)
        count = len(first)
        turn = size + np.arange(count)
        one = np.ones(count)
        # first <= most turn, second <= most (1 - turn)
        columns = np.vstack([np.column_stack([first, turn]), np.column_stack([second, turn])])
        values = np.vstack(
            [np.column_stack([one, -most_first]), np.column_stack([one, most_second])]
        )
        upper = np.append(np.zeros(count), most_second)
        rows = Rows.of(columns, values, -np.inf, upper, size + count)
        wider = sp.csc_array((len(program.lower), count))
        program = replace(
            program,
            cost=np.append(program.cost, np.zeros(count)),
            x_lower=np.append(program.x_lower, np.zeros(count)),
            x_upper=np.append(program.x_upper, one),
            rows=sp.csc_array(sp.hstack([program.rows, wider])),
        ).with_range(rows.matrix.tocsc(), rows.lower, rows.upper)
    return program
