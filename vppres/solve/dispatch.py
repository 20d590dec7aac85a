"""A supply schedule becomes a dispatch: its cheapest, then the one that the tie-breakers prefer.

One MIP at a usual gap leaves cost and reactive power undecided, so each term is solved to its own
precision with the terms above it held (``docs/method.md``, *Lexicographic levels*).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats
from vppres.model.data import WindowData
from vppres.model.numerics import POLYGON_SIDES, cost_scale, disc_sides
from vppres.model.terms import evaluate
from vppres.model.violations import broken, with_flows
from vppres.solve.cache import ModelCache
from vppres.solve.certificate import (
    COST_GAP_GBP,
    NO_OWN_VALUES,
    Candidate,
    OwnValues,
    cost_gap_gbp,
)
from vppres.solve.deadline import HALF, Deadline, Stopwatch
from vppres.solve.fleet.relaxation import fleet_problem
from vppres.solve.forms import Form, sheet_of, sheet_of_draws, window_problem
from vppres.solve.limits import run_within_limits
from vppres.solve.netting import eased_soc, net_modes
from vppres.solve.network.cheapest import CheapestDispatch
from vppres.solve.network.program import NetworkProgram
from vppres.solve.network.reactive import LeastReactive
from vppres.solve.phases import MORE_ROOM, near_to
from vppres.solve.programs import GAP_SHARE
from vppres.solve.result import Outcome, Status
from vppres.solve.solvers import NO_ANSWER, run, run_conic, solve_by_highs
from vppres.solve.task import WindowTask
from vppres.solve.tie_breakers import TieBreakers

NOTHING: Mapping[str, Floats] = MappingProxyType({})

FINER = 4
"""Times as many sides of polygons where usual ones decide: a sixteenth of the error."""

DISPATCH_GAP_GBP = 1e-4
"""Gap of a dispatch's cost: far below any price difference that a dispatch could exploit."""

HELD_REL = 1e-6
HELD_ABS = 1e-5
"""How much the tie-breakers may worsen cost (GBP) and curtailment (kWh): what interior points need
to have an inside at all."""

SERVICE_HELD_REL = 1e-7
"""The same of what weighs as much as service: curtailment, and the page's own term. As much again
is what interior points may miss it by."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """A solve for a dispatch: its outcome, and the dispatch if there is one.

    ``both_kw``, (W,), is what was imported and exported at the same time before it was netted.
    """

    outcome: Outcome
    dispatch: Dispatch | None
    both_kw: Floats = field(default_factory=lambda: np.zeros(1))
    own: OwnValues = NO_OWN_VALUES


# From a supply schedule to a candidate.


def keep_dispatch(
    task: WindowTask,
    served: Flags,
    network: bool = False,
    before: Dispatch | None = None,
    charges: Flags | None = None,
    keeps_turns: bool = False,
) -> None:
    """Keep the dispatch of a supply schedule if it is the best so far.

    A relaxation without binaries may serve what the switching rules forbid: nothing to find then.
    """
    rules = task.data.switching
    if rules is None or not rules.broken(served).any():
        task.certificate.keep(
            dispatch_of(task, served, network, before, charges, keeps_turns=keeps_turns)
        )


def dispatch_of(
    task: WindowTask,
    served: Flags,
    network: bool = True,
    before: Dispatch | None = None,
    charges: Flags | None = None,
    keeps_turns: bool = False,
    fleet: bool = True,
) -> Candidate | None:
    """Cheapest dispatch of a supply schedule, by the first way that has one.

    Where the ``network`` must carry it and batteries' turns would have to be searched for, those of
    the plan ``before`` are tried first: others were never worth more by the gap, and took as long
    to find as the set. With ``keeps_turns`` there is no dispatch but with them; ``charges`` says
    which batteries charge where they waste energy, (W, B), in a window with phases. With ``fleet``
    the cost without the network is tried first, since most networks carry it.

    Where the network is not asked, and batteries would waste energy, their modes are left to what
    decides them with the service; those of next to no power waste next to nothing, whatever their
    modes. A window with phases or ratings gets its rows as they are needed. With phases the
    tie-breakers take longer than all else, so that they are left to ``settle``.
    """
    if not network:
        return cheapest(task, served, modes_later=not task.site.batteries.idle)
    if task.by_rows:
        if charges is None and before is not None:
            charges = before.charge_kw > before.discharge_kw
        kept = before if keeps_turns else None
        outcome, found = cheapest_by_rows(task, served, task.answer_by(HALF), charges, kept)
        if found or keeps_turns or outcome.status == Status.INFEASIBLE:
            return found
    elif keeps_turns:
        found = _with_turns(task, before)
        return found and carried(task, found, tie_breakers)
    elif fleet and not task.sheet.statement.minds_network:
        found = cheapest(task, served, modes_later=before is not None)
        if before is not None and task.certificate.wasteful:
            found = _with_turns(task, before) or cheapest(task, served)
        if found is None:
            return None
        in_network = carried(task, found, tie_breakers)
        if in_network is not None:
            return in_network
    found = cheapest(task, served, network=True)
    return found and carried(task, found)


def _with_turns(task: WindowTask, before: Dispatch | None) -> Candidate | None:
    """Cheapest dispatch without the network of a plan's set with its binaries.

    Where it earns to import and export at once, the step's direction would have to be held too.
    """
    data = task.data
    prices = data.price_gbp_per_kwh, data.grid_limit_kw
    both_ways = data.export and data.export.earns_both_ways(*prices)
    if before is None or len(task.site.batteries) == 0 or both_ways:
        return None
    known = task.sheet.statement.held(task.data, before).values
    switched = {name: np.asarray(known[name]) for name in task.sheet.own_whole if name in known}
    turns = {"delta": (before.charge_kw > before.discharge_kw).astype(float)}
    return cheapest(task, before.served, modes=turns | switched)


def cheapest_by_rows(
    task: WindowTask,
    served: Flags,
    deadline: Deadline,
    charges: Flags | None = None,
    kept: Dispatch | None = None,
    network: NetworkProgram | None = None,
) -> tuple[Outcome, Candidate | None]:
    """Cheapest dispatch of a supply schedule in the network, whose limits are rows as needed.

    With the schedule its rules are met, and what it draws is known. ``network`` has limits that are
    known; with rules they are those of another demand.
    """
    site, known = task.site, task.certificate
    if network is None or task.data.switching is not None:
        way = CheapestDispatch.of_set(task.cache, task.data, served)
    else:
        way = CheapestDispatch(site, task.data, network)
    outcome, dispatch = way.of(served, deadline, charges, kept)
    known.note("network_dispatch", outcome)
    if dispatch is None:
        return outcome, None
    data = task.data.for_service(served)
    dispatch, fits = net_modes(site, data, dispatch)
    if not fits:  # batteries must take turns
        return outcome, None
    found = Candidate.of(site, data, dispatch, 0.0, in_network=False)
    # The tie-breakers of a large window take long.
    plain = task.is_large and not task.by_phase
    return outcome, carried(task, found, *((least_reactive_power,) if plain else ()))


def cheapest(
    task: WindowTask,
    served: Flags,
    network: bool = False,
    modes_later: bool = False,
    modes: Mapping[str, Floats] = NOTHING,
) -> Candidate | None:
    """Cheapest dispatch of a supply schedule by its cost alone, with binaries held by their names.

    What other ``modes`` leave open of its cost is not known. Sets on and off, and the like, are
    first those of the fleet as one battery: a search with every battery takes much longer, and
    mostly ends at the same. They stay if the fleet's bound leaves no more of the cost open than a
    search for cost may.
    """
    level = CostLevel(task, served, network, modes_later)
    if modes:
        level.curtailed_gap_gbp = 0.0
        return level.candidate(modes, -np.inf)
    if not network and sheet_of(task.cache, level.data).own_whole:
        fleet = fleet_problem(task.cache, level.data, lumped=True, integer=True, goal="dispatch")
        fleet.write(level.data, eased=True)
        fleet.hold(served)
        outcome = run(fleet, task.spec, COST_GAP_GBP, task.answer_by().left_s)
        task.certificate.note("switched", outcome)
        if outcome.status.has_answer:
            found = level.candidate(fleet.own_letters(), outcome.bound)
            if found and found.terms.f2 - found.cost_bound_gbp <= cost_gap_gbp(found.terms.f2):
                return found
        if task.certificate.wasteful:
            return None
    return level.candidate()


class CostLevel:
    """Least cost of a supply schedule: a convex problem, with binaries only where it needs them.

    With the ``network`` discs are cones, or polygons in large windows and for binaries; with
    ``modes_later`` there is no dispatch where batteries waste energy.
    """

    def __init__(
        self, task: WindowTask, served: Flags, network: bool = False, modes_later: bool = False
    ) -> None:
        self.task = task
        self.served = served
        self.network = network
        self.modes_later = modes_later
        # A large network may need long to find that there is none.
        self.deadline = task.answer_by(HALF if network else 1.0)
        self.data = task.data.for_service(served)
        # A curtailed kW is worth 100,000 GBP: the gap of cost would ask for the last microwatt.
        self.curtailed_gap_gbp = (1.0 - GAP_SHARE) * task.gap_to_best * cost_scale(task.site)

    def candidate(
        self, held: Mapping[str, Floats] = NOTHING, least_gbp: float | None = None
    ) -> Candidate | None:
        """The cheapest dispatch with some letters held; none costs less than ``least_gbp``."""
        attempt = self._in_turns(held)
        outcome = attempt.outcome
        self.task.certificate.note("network_cost" if self.network else "cost", outcome)
        if attempt.dispatch is None:
            return None
        slack_gbp = max(outcome.value - (outcome.bound if least_gbp is None else least_gbp), 0.0)
        found = attempt.dispatch, slack_gbp, self.network, attempt.own
        return Candidate.of(self.task.site, self.data, *found)

    def _in_turns(self, held: Mapping[str, Floats]) -> Attempt:
        """The cheapest dispatch in which no battery charges and discharges at once."""
        site, network = self.task.site, self.network
        sides = disc_sides(site, self.data.n_steps) if network else 0
        form = Form("cost", "fixed", "relaxed", sides, network=network)
        attempt = self.solve(form, held=held)
        eased = attempt.outcome.status == Status.INFEASIBLE and not network
        if eased:
            attempt = self.solve(form, held=held, eased=True)
        if attempt.dispatch is None:
            return attempt
        netted, fits = net_modes(site, self.data, attempt.dispatch)
        export = self.data.export
        stands = not export or export.stands_netted(
            self.data.price_gbp_per_kwh, netted, attempt.both_kw, site.dt_h
        )
        if fits and stands:
            return replace(attempt, dispatch=netted)
        curtailing = float(netted.pv_curtailed_kw.sum()) * site.dt_h > HELD_ABS
        if curtailing and not fits and self.modes_later:
            self.task.certificate.wasteful = True
            return replace(attempt, dispatch=None)
        gap_gbp = max(DISPATCH_GAP_GBP, self.curtailed_gap_gbp) if curtailing else DISPATCH_GAP_GBP
        spent_s = attempt.outcome.solve_s
        # A set may need what inscribed polygons of usual sides take away.
        usual = self.task.sides if network else 0
        for polygon_sides in (usual, FINER * usual)[: 2 if usual else 1]:
            integer = replace(form, exclusivity="integer", polygon_sides=polygon_sides)
            attempt = self.solve(integer, gap_gbp, held, eased)
            spent_s = spent_s + attempt.outcome.solve_s
            if attempt.outcome.status != Status.INFEASIBLE:
                break
        return replace(attempt, outcome=replace(attempt.outcome, solve_s=spent_s))

    def solve(
        self,
        form: Form,
        gap_gbp: float = DISPATCH_GAP_GBP,
        held: Mapping[str, Floats] = NOTHING,
        eased: bool = False,
    ) -> Attempt:
        """One solve in a form; the gap is that of a search for modes.

        With ``eased`` each battery may be emptied by as much more as rounding may have taken.
        """
        task, data = self.task, self.data
        if self.deadline.passed:
            return Attempt(NO_ANSWER, None)
        conic = form.network and form.exclusivity == "relaxed"
        if conic and sheet_of(task.cache, data).own_whole:
            conic, form = False, replace(form, polygon_sides=form.polygon_sides or POLYGON_SIDES)
        problem = window_problem(task.cache, data, form, conic)
        problem.fill(data, self.served)
        missed = np.tile(eased_soc(task.site.batteries), (data.n_steps, 1)) if eased else 0.0
        problem.limits = {"battery_soc_min": missed, "battery_reserve": missed}

        def ask(left_s: float) -> Outcome:
            if conic:
                return run_conic(problem, left_s)
            if held:
                return solve_by_highs(problem, Deadline(left_s), gap_gbp, held=held)
            return run(problem, task.spec, gap_gbp, left_s)

        left_s = self.deadline.left_s
        if form.network:
            outcome = run_within_limits(task.site, data, problem, left_s, solve=ask)
        else:
            outcome = ask(left_s)
        if not outcome.status.has_answer:
            return Attempt(outcome, None)
        value = problem.own_value()
        if conic and value:  # interior points end so near to the optimum, on either side
            value -= HELD_REL * (1.0 + abs(value))
        own = OwnValues(value, problem.own_letters())
        return Attempt(outcome, problem.dispatch(self.served), problem.both_ways_kw(), own)


# From a candidate to one that the network carries.

Carriage = tuple[Dispatch, OwnValues]
"""A dispatch in the network, and the values of what only the page has in it."""

Carrier = Callable[[WindowTask, Candidate], Carriage | None]
"""Finds flows, reactive power and voltages for a candidate's service and cost."""


def carried(task: WindowTask, found: Candidate, *ways: Carrier) -> Candidate | None:
    """The candidate with a dispatch in the network, by the first way whose answer breaks no row.

    Every answer comes through here: none is one because a solver calls it so. What only minimises
    cost has any reactive power that the discs allow. Its losses would be the next pass's in
    physical mode, and from there it may never agree with AC, so that the usual ways are the
    tie-breakers and the least reactive power. The latter knows the paper's rows alone: with what
    the page adds the dispatch stays as it is then, as it does at first with rows of phases.
    """
    usual = (tie_breakers, as_it_is if task.own else least_reactive_power)
    for way in ways or ((as_it_is, *OF_PHASES) if task.by_phase else usual):
        carriage = way(task, found)
        if carriage is None:
            continue
        # The check knows the paper's families, and none that the page changes.
        if task.sheet.statement.changed or not broken(task.site, found.data, carriage[0]):
            return found.carried_by(task.site, *carriage)
        task.certificate.note("checked", Outcome(Status.INACCURATE, np.nan, np.nan, 0.0))
    return None


def settle(task: WindowTask) -> None:
    """Give the answer to a window with rows of phases its tie-breakers; others have theirs."""
    best = task.certificate.best
    if task.by_phase and best is not None:
        task.certificate.best = carried(task, best, *OF_PHASES) or best


def tie_breakers(task: WindowTask, found: Candidate, inside: bool = False) -> Carriage | None:
    """The dispatch that the tie-breakers prefer, with service, cost and curtailment held.

    They also decide whether a dispatch that was found without the network can be had in it:
    reactive power, voltages and true discs are all here. Their answer is dropped if it is
    inaccurate or worsens cost or curtailment beyond the tolerance, or curtailment by more than the
    gap leaves, which is less where service and curtailment nearly cancel.

    With ``inside`` a window with phases has more than its rows allow, so that interior points have
    an inside: they may curtail more, and load the former's phases by what a check lets pass.
    """
    site, deadline, dispatch = task.site, task.answer_by(), found.dispatch
    if deadline.passed:
        task.certificate.note("tie_breakers", NO_ANSWER)
        return None
    # More is curtailed at most by what is worth a share of the window's gap.
    worth = site.weights.lambda_curt
    allowed = (1.0 - GAP_SHARE) * task.certificate.limits.gap_at(found.value)
    rest_kwh = allowed / worth if worth > 0.0 else np.inf
    more_kwh = rest_kwh if inside and np.isfinite(rest_kwh) else 0.0
    data = found.data
    if inside:
        room_kva = (1.0 + MORE_ROOM) * data.phased.room_kva
        data = replace(data, phased=replace(data.phased, room_kva=room_kva))
    sheet = sheet_of(task.cache, data)
    terms = evaluate(site, data, dispatch)
    # What the cost has besides is held by itself.
    f2 = terms.f2 - sheet.statement.held(data, dispatch).gbp
    f2_max = f2 + HELD_REL * abs(f2) + HELD_ABS
    missed_kwh = min(SERVICE_HELD_REL * terms.f3 + HELD_ABS, rest_kwh)
    f3_max = terms.f3 + missed_kwh + more_kwh
    # Where nothing is curtailed, PV export is data and its discs are intervals: far smaller.
    beyond = bool((data.pv_kw > site.pv.s_max_kva).any())
    curtailing = terms.f3 + more_kwh > HELD_ABS or beyond
    moves = data.moves is not None
    problem = task.cache.problem(TieBreakers, sheet=sheet, curtailing=curtailing, moves=moves)
    problem.hold(data, dispatch, f2_max, f3_max)
    own = found.own
    problem.hold_own(own.letters, own.value - SERVICE_HELD_REL * (1.0 + abs(own.value)))
    near = near_to(site, data, dispatch)
    outcome = run_within_limits(site, near, problem, deadline.left_s)
    task.certificate.note("tie_breakers", outcome)
    if outcome.status != Status.OPTIMAL:
        return None
    better = problem.dispatch(dispatch.served)
    better = replace(better, soc=data.soc_path(site, better.charge_kw, better.discharge_kw))
    better = with_flows(site, data, better) if problem.in_chains else better
    after = evaluate(site, data, better)
    f2_after = after.f2 - sheet.statement.held(data, better).gbp
    kept = f2_after <= f2_max + HELD_ABS and after.f3 <= f3_max + missed_kwh
    return (better, OwnValues(problem.own_value(), own.letters)) if kept else None


OF_PHASES: tuple[Carrier, ...] = (tie_breakers, partial(tie_breakers, inside=True))
"""Shares of dimmed customers at a voltage limit leave the tie-breakers no inside."""


def as_it_is(_: WindowTask, found: Candidate) -> Carriage:
    """The dispatch with the reactive power that it has."""
    return found.dispatch, found.own


def least_reactive_power(task: WindowTask, found: Candidate) -> Carriage:
    """The dispatch with the least reactive power that its active power needs."""
    outcome, dispatch = least_reactive(task.cache, found.data, found.dispatch, task.answer_by())
    task.certificate.note("reactive_power", outcome)
    return dispatch, NO_OWN_VALUES


def least_reactive(
    cache: ModelCache, data: WindowData, dispatch: Dispatch, deadline: Deadline
) -> tuple[Outcome, Dispatch]:
    """Least reactive flows and use of inverters for the active power of a dispatch, step by step.

    A step without an answer, or for which there is no time, keeps the reactive power that it has.
    """
    watch = Stopwatch()
    model = cache.problem(LeastReactive, sheet=sheet_of_draws(cache, data))
    changed = dispatch
    status = Status.OPTIMAL
    solver = "none"
    for t in range(data.n_steps):
        if deadline.passed:
            status = Status.TIME_LIMIT
            break
        model.hold(data, dispatch, t)
        outcome = run_conic(model, deadline.left_s)
        solver = outcome.solver
        if outcome.status == Status.OPTIMAL:
            changed = model.put_into(changed, t)
        else:
            status = outcome.status
    return Outcome(status, np.nan, np.nan, watch.spent_s, solver), changed
