"""All terms at once, without the network: the relaxation that needs no grid of weights or prices.

``docs/method.md``, *The ladder*.
"""

from __future__ import annotations

from functools import cached_property, partial

import cvxpy as cp
import numpy as np

from vppres.model.numerics import objective_scale
from vppres.solve.blocks import BLOCKS_SHARE, SOON_SHARE, BlockSearch
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.dispatch import keep_dispatch
from vppres.solve.fleet.masters import fleets_of, relaxation_of, search_for_set
from vppres.solve.fleet.matching import exchanged
from vppres.solve.fleet.relaxation import AggregateModel
from vppres.solve.fleet.steady import steady_sets
from vppres.solve.programs import columns_of, compiled
from vppres.solve.result import Outcome, Status
from vppres.solve.solvers import compiled_in_time, run
from vppres.solve.task import WindowTask

GAP_SHARE = 0.8
"""Share of the window's gap that a search may leave open: the levels after it need little."""

MANY = 600
"""Binaries from which on a search takes a second and more."""

SAYS_MORE = 0.1
"""Share of the window's gap by which a lumped battery must raise the bound of shares of customers
to say too much."""


class AllTerms:
    """Searches of a window's relaxation with all terms as weighted, each a rung of the ladder.

    Parameters
    ----------
    task : WindowTask
        The window.
    """

    def __init__(self, task: WindowTask) -> None:
        self.task = task
        self.lumped = fleets_of(task.data)[0]

    # Rungs.

    def shares(self) -> None:
        """Bound by shares of customers, which says how large the objective is."""
        self._by_shares("shares", self.lumped)

    def matched(self) -> None:
        """Customers whose demand takes up the sun of a dark step, bounded by shares of them."""
        outcome, model = self._by_shares("matched", self.lumped)
        if outcome.status != Status.OPTIMAL:
            return
        data = self.task.data
        site = self.task.site
        able = model.p["x_max"].value[0] > 0.5
        given_kw = float(np.minimum(data.pv_kw[0], site.pv.s_max_kva).sum() - data.network_kw[0])
        worth = site.customers.weight + site.weights.lambda_curt * data.load_kw[0]
        keep_dispatch(self.task, exchanged(worth * able, data.load_kw[0], given_kw)[None, :])

    def search(self) -> None:
        """Served set and bound, to the gap of F."""
        self._search_until(self.task.search)

    def soon(self) -> None:
        """The same, should it end soon."""
        self._search_until(self.task.search.part(SOON_SHARE))

    def after_blocks(self) -> None:
        """The same, begun with a set that was improved a few steps at a time."""
        self._improve_in_blocks()
        if self.task.goes_on:
            self.search()

    # The fleet.

    def _search_until(self, deadline: Deadline) -> None:
        """Search by a deadline, with every battery where a lumped one says too much.

        That is asked after a search with the lumped one, or before it where that takes seconds.
        Where batteries would waste energy, their modes come next, and no other search.
        """
        task = self.task
        if task.data.load_kw.size >= MANY:
            self.lumped = self.lumped and not self._lumped_says_too_much
        search = partial(self._search, deadline=deadline)
        task.search_to_its_gap(task.gap_so_far, GAP_SHARE, search)
        again = task.goes_on and not task.certificate.wasteful
        if again and self.lumped and self._lumped_says_too_much:
            self.lumped = False
            task.search_to_its_gap(task.gap_so_far, GAP_SHARE, search)

    @cached_property
    def _lumped_says_too_much(self) -> bool:
        """Whether shares of customers are worth less with every battery than with all as one.

        Then the best sets of the lumped battery have no dispatch.
        """
        if len(fleets_of(self.task.data)) == 1 or self.task.site.batteries.idle:
            return False
        of_lumped, _ = self._by_shares("shares", lumped=True)
        of_every, _ = self._by_shares("shares", lumped=False)
        return of_lumped.bound - of_every.bound > SAYS_MORE * self.task.gap_so_far

    # Problems.

    def _by_shares(self, stage: str, lumped: bool) -> tuple[Outcome, AggregateModel]:
        """Bound by shares of customers, with the solved model."""
        task = self.task
        known = task.certificate
        model = relaxation_of(task.cache, task.data, integer=False, lumped=lumped)
        model.fill(task.data)
        outcome = run(model.problem, task.spec, 0.0, task.search.left_s, objective_scale(task.site))
        known.note(stage, outcome)
        known.prove(outcome)
        if outcome.status == Status.OPTIMAL:
            known.bound_by(outcome.bound)
        return outcome, model

    def _of_customers(self) -> AggregateModel:
        """The relaxation of whole customers."""
        task = self.task
        model = relaxation_of(task.cache, task.data, integer=True, lumped=self.lumped)
        model.fill(task.data)
        return model

    def _search(self, gap: float, deadline: Deadline) -> bool:
        """One search to a gap, or to a deadline; whether it ended."""
        task = self.task
        known = task.certificate
        model = self._of_customers()
        scale = objective_scale(task.site)
        first = None if known.best is None else known.best.dispatch.served
        outcome = search_for_set(
            model, model.problem, task.spec, gap, deadline.left_s, scale, first
        )
        known.note("aggregate", outcome)
        if not outcome.status.has_answer:
            known.prove(outcome)
            return False
        known.bound_by(outcome.bound)
        keep_dispatch(task, np.asarray(model.x.value) > 0.5)
        return outcome.status == Status.OPTIMAL

    def _improve_in_blocks(self) -> None:
        """Improve the best set a few steps at a time, or one that the rules allow at once."""
        task = self.task
        known = task.certificate
        model = self._of_customers()
        rules = task.data.switching
        assert rules is not None and model.switching is not None
        if not compiled_in_time(model.problem, cp.HIGHS, task.search):
            return
        watch = Stopwatch()
        program, first = compiled(model.problem)
        service, *follow = (
            columns_of(first, v.name(), v.shape) for v in (model.x, *model.switching.follow)
        )
        gap = task.gap_so_far * objective_scale(task.site)
        deadline = task.search.part(BLOCKS_SHARE)
        blocks = BlockSearch(program, service, follow, rules, gap, deadline)
        best = known.best
        found = blocks.improved(
            steady_sets(task.site, task.data) if best is None else [best.dispatch.served]
        )
        if found is not None:
            known.note("blocks", found.outcome(watch.spent_s))
            keep_dispatch(task, found.x[service] > 0.5)
