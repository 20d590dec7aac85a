"""Solves windows: relaxations stage by stage, or the whole problem at once.

``docs/method.md`` explains the stages. Each leaves in the certificate of its ``WindowTask`` what it
found and proved, and the first one at which both meet is the last.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags
from vppres.core.errors import InputError, SolveError
from vppres.model.beyond_paper.ratings import (
    GIVEN,
    MOVED_SHARE,
    has_ratings,
    overloaded,
    with_ratings,
    with_ratings_given,
)
from vppres.model.data import WindowData
from vppres.model.numerics import POLYGON_SIDES
from vppres.model.own_state import giving_way, with_own_state
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.scenario.assets import SOC_ROUNDING
from vppres.solve.apart import falls_apart, solve_apart
from vppres.solve.cache import shared_cache
from vppres.solve.deadline import Deadline
from vppres.solve.dispatch import SERVICE_HELD_REL, keep_dispatch, settle
from vppres.solve.fleet.all_terms import all_terms, require_bounds
from vppres.solve.fleet.masters import fleets_of, master_of
from vppres.solve.fleet.reach import everyone_in_reach
from vppres.solve.fleet.rungs import (
    everyone_served,
    keep_a_steady_set,
    with_modes_of_batteries,
)
from vppres.solve.forms import sheet_of
from vppres.solve.levels import service_then_cost
from vppres.solve.longest_off import solve_with_limits
from vppres.solve.network.decide import (
    decide_at_once,
    enter_network,
    network_master,
)
from vppres.solve.result import SolveLimits, WindowSolution
from vppres.solve.solvers import SolverSpec, find_solver
from vppres.solve.sooner import as_good, is_settled, sooner
from vppres.solve.task import COST_SHARE, NETWORK_RESERVE, WindowTask
from vppres.solve.turns import one_at_a_time
from vppres.solve.whole import least_slack, with_binaries, without_binaries

METHODS = ("decomposed", "monolithic")


class WindowSolver:
    """Solves windows of one site by one method and solver; problems are compiled once.

    Parameters
    ----------
    site : Site
        Fixed data.
    method : {"decomposed", "monolithic"}
        How the supply schedule is found; ``docs/method.md`` proves the certificates.
    solver : str
        Name in the table of solvers. The stages in the network and continuous problems with cones
        do not follow it; the stages of a solution name the solver of each.
    limits : SolveLimits, optional
        Gaps and time limit of a window.
    polygon_sides : int, optional
        Sides of an inverter's polygon for solvers that take no cones with binaries.

    Raises
    ------
    InputError
        If method or solver are unknown, or the solver is not installed.
    """

    def __init__(
        self,
        site: Site,
        method: str = "decomposed",
        solver: str = "highs",
        limits: SolveLimits | None = None,
        polygon_sides: int = POLYGON_SIDES,
    ) -> None:
        if method not in METHODS:
            raise InputError.of(
                "options",
                "is not a known method",
                f"Use one of: {', '.join(METHODS)}.",
                field="method",
                value=method,
            )
        self.method = method
        self.limits = limits or SolveLimits()
        self.spec: SolverSpec = find_solver(solver)
        self.sides = 0 if self.spec.mip_cones else polygon_sides
        self.cache = shared_cache(site)

    @property
    def site(self) -> Site:
        """Fixed data."""
        return self.cache.site

    @property
    def compilations(self) -> int:
        """Problems compiled for the site so far."""
        return self.cache.compilations

    @one_at_a_time
    def solve(self, data: WindowData, within_s: float = math.inf) -> WindowSolution:
        """Solve a window.

        Parameters
        ----------
        data : WindowData
            What changes from window to window.
        within_s : float, optional
            Time that it may take, in s, where that is less than its limit.

        Returns
        -------
        WindowSolution
            The best dispatch, with its bound; status ``TIME_LIMIT`` where time ran out.

        Raises
        ------
        SolveError
            If no dispatch was found: infeasible, unbounded, numerical or out of time.
        """
        deadline = Deadline(self.limits.at_most(within_s).time_s)
        *tighter, data = giving_way(self.site, _with_sound_soc(self.site, data))
        found = self._answer(tighter, data, deadline)
        # Most windows exceed no rating. Where there is no answer within them, they give way.
        for share in GIVEN if self.site.rated else ():
            limited = with_ratings_given(self.site, data, found.dispatch, share)
            if deadline.passed or not overloaded(self.site, limited, found.dispatch).any():
                break
            with suppress(SolveError):
                found = self._answer(tighter, limited, deadline).after(found)
                break
        return self._within_ratings(tighter, data, found, deadline)

    def _within_ratings(
        self, tighter: list[WindowData], data: WindowData, found: WindowSolution, deadline: Deadline
    ) -> WindowSolution:
        """The plan's supply within soft ratings as they are, if it has such a dispatch.

        Without one in the widest limits of voltages there is none in tighter ones.
        """
        if not self.site.soft_ratings:
            return found
        limited = [with_ratings(self.site, each, give_way=False) for each in (data, *tighter)]
        if not overloaded(self.site, limited[0], found.dispatch).any():
            return found
        best = None if deadline.passed else self._kept(limited[0], found, deadline)
        if best is None:
            return found
        others = (self._kept(each, found, deadline) for each in limited[1:] if not deadline.passed)
        return next((other for other in others if other is not None), best)

    def _kept(
        self, data: WindowData, found: WindowSolution, deadline: Deadline
    ) -> WindowSolution | None:
        """A solution with the cheapest dispatch of its supply in a window, None without one."""
        limits = self.limits.at_most(deadline.left_s)
        kept = self._served(data, limits, found.dispatch.served, found.dispatch)
        if kept is None or _dims_more(kept.dispatch, found.dispatch, self.site):
            return None
        return found.carried_by(kept.after(found), *kept.stages)

    def _answer(
        self, tighter: list[WindowData], data: WindowData, deadline: Deadline
    ) -> WindowSolution:
        """The best supply schedule of a window, in the tightest limits in which it has a dispatch.

        A balanced feeder's answer has its tie-breakers, which say whether the network carries it,
        and stays if it breaks none of the tighter limits. With rows of phases a schedule gets them
        only here, and the last part of the time is theirs.
        """
        settles = bool(data.phased) and not sheet_of(self.cache, data).statement.differs
        limits = self.limits.at_most(deadline.left_s)
        found = self._decided(data, limits.within(1.0 - NETWORK_RESERVE) if settles else limits)
        found = self._sooner(data, found, deadline)
        served = found.dispatch.served
        for each in (*tighter, data) if settles else tighter:
            if not settles and not broken(self.site, each.for_service(served), found.dispatch):
                return found
            if deadline.passed and each is not data:
                continue
            kept = self._kept(each, found, deadline)
            if kept is not None:
                return kept
        return found

    def _sooner(
        self, data: WindowData, found: WindowSolution, deadline: Deadline
    ) -> WindowSolution:
        """An equal plan that serves sooner, if there is one, or the plan itself."""
        served = found.dispatch.served
        if is_settled(self.site, data, served) or deadline.passed:
            return found
        task = self._task(data, self.limits.at_most(deadline.left_s))
        if task.is_large:
            return found
        for other in sooner(task, served, found.terms, task.deadline.part(COST_SHARE)):
            kept = self._served(data, self.limits.at_most(deadline.left_s), other)
            if kept is not None and as_good(self.site, kept.terms, found.terms):
                stages = (*task.certificate.stages, *kept.stages)
                better = found.carried_by(kept.after(found), *stages)
                return replace(better, objective=kept.objective)
        return found

    def _decided(self, data: WindowData, limits: SolveLimits) -> WindowSolution:
        """The best supply schedule of a window."""
        if self.method != "decomposed" or sheet_of(self.cache, data).statement.differs:
            return self._solve(data, limits)
        if data.limits_time_off:
            return solve_with_limits(data, limits, self._decided, self._solve)
        if falls_apart(self.site, data):
            return solve_apart(data, limits, self._solve)
        return self._solve(data, limits)

    def _solve(self, data: WindowData, limits: SolveLimits) -> WindowSolution:
        """Solve a window as one problem."""
        task = self._task(data, limits)
        if self.method == "decomposed":
            climb(task)
            keep_a_steady_set(task)
            if worth_an_answer(task):
                without_binaries(task)
        if worth_the_whole(task):
            with_binaries(task)
        return task.solution()

    @one_at_a_time
    def solve_served(
        self,
        data: WindowData,
        served: Flags,
        before: Dispatch | None = None,
        keeps_turns: bool = False,
        within_s: float = math.inf,
    ) -> WindowSolution | None:
        """Cheapest dispatch of a supply schedule in the network, None if it has none; no bound.

        The plan ``before`` is one for that set: its batteries' turns stand where others would have
        to be searched, and with ``keeps_turns`` wherever they allow a dispatch. It takes no longer
        than ``within_s``, or its limit where that is less.
        """
        deadline = Deadline(self.limits.at_most(within_s).time_s)
        sound = _with_sound_soc(self.site, data)
        found = None
        for each in giving_way(self.site, sound):
            limits = self.limits.at_most(deadline.left_s)
            found = self._served(each, limits, served, before, keeps_turns) or found
            if found is not None and (
                before is None or not _dims_more(found.dispatch, before, self.site)
            ):
                return found
        return found

    def _served(
        self,
        data: WindowData,
        limits: SolveLimits,
        served: Flags,
        before: Dispatch | None = None,
        keeps_turns: bool = False,
    ) -> WindowSolution | None:
        """Cheapest dispatch of a supply schedule within a window's limits, None if it has none.

        Ratings that it exceeds are asked for in the time that is left.
        """
        task = self._task(data, limits)
        deadline = task.deadline
        if before is not None and keeps_turns:
            keep_dispatch(task, before.served, True, before, keeps_turns=True)
        if not task.certificate.answered:
            keep_dispatch(task, served, True, before)
        if not task.certificate.answered:
            return None
        settle(task)
        found = task.solution()
        if has_ratings(data) or not self.site.rated:
            return found
        # Soft ratings give way where the supply has no dispatch within them as they are.
        for give_way in (False, True) if self.site.soft_ratings else (True,):
            limited = with_ratings(self.site, data, give_way)
            if deadline.passed or not overloaded(self.site, limited, found.dispatch).any():
                return found
            kept = self._served(limited, limits.at_most(deadline.left_s), served)
            if kept is not None:
                return kept
        if before is None or deadline.passed:
            return found
        if not overloaded(self.site, limited, before, MOVED_SHARE).any():
            return None
        # A plan that exceeded ratings already has no set within them: they give way to it.
        given = with_ratings_given(self.site, data, before, 1.0)
        return self._served(given, limits.at_most(deadline.left_s), served)

    @one_at_a_time
    def fleet_bound(self, data: WindowData, within_s: float = math.inf) -> float:
        """Most that F can be in a window whose network carries everything; infinite if unknown.

        It takes no longer than ``within_s``, or its limit where that is less.
        """
        sound = _with_sound_soc(self.site, data)
        if self.method != "decomposed" or sound.limits_time_off:
            return math.inf
        task = self._task(sound, self.limits.at_most(within_s))
        require_bounds(task)
        if worth_everyone(task):
            everyone_served(task)
        for rung in rungs(task):
            if task.goes_on and not task.search.passed:
                rung()
        return -math.inf if task.certificate.nothing_to_find else task.certificate.bound

    @one_at_a_time
    def least_slack(self, data: WindowData) -> float:
        """Least slack of the squared voltage limits (pu²) that leaves a feasible relaxation.

        Raises
        ------
        SolveError
            If not even free voltages leave one.
        """
        return least_slack(self.site, with_own_state(self.site, data), self.limits.time_s)

    def _task(self, data: WindowData, limits: SolveLimits) -> WindowTask:
        """A window whose time begins now."""
        return WindowTask(data, self.cache, limits, self.spec, self.sides)


def _with_sound_soc(site: Site, data: WindowData) -> WindowData:
    """The window with states of charge at their limits that miss them by rounding.

    A state outside leaves a battery that may not move no dispatch, however little it is.
    """
    inside = np.clip(data.soc, site.batteries.soc_min, site.batteries.soc_max)
    rounding = np.abs(data.soc - inside) <= SOC_ROUNDING
    return replace(data, soc=np.where(rounding, inside, data.soc))


def _dims_more(found: Dispatch, before: Dispatch, site: Site) -> bool:
    """Whether a schedule gets less than with the dispatch before: tighter limits dim none."""
    weight = site.customers.weight
    lost = (before.supplied.astype(float) - found.supplied.astype(float)) @ weight
    return bool(
        lost.sum() > SERVICE_HELD_REL * (1.0 + before.supplied.astype(float) @ weight).sum()
    )


def climb(task: WindowTask) -> None:
    """Relaxations of growing size, each with its bound, until bound and dispatch meet.

    Dispatches are first found without the network; the best one is then put into it.
    """
    require_bounds(task)
    everyone = worth_everyone(task)
    plain = not task.data.physics and task.data.switching is None
    at_once = has_ratings(task.data) or (task.is_wide and not task.data.parts.whole)
    at_once = at_once or (plain and (task.is_huge or (task.is_wide and not everyone)))
    master = network_master(task) if at_once else None
    if master is not None and decide_at_once(task, master):
        return
    if everyone:
        everyone_served(task)
    for rung in rungs(task):
        if task.goes_on and not task.search.passed and not task.certificate.wasteful:
            rung()
    if task.certificate.wasteful and task.goes_on:
        with_modes_of_batteries(task)
    enter_network(task, master)


def worth_everyone(task: WindowTask) -> bool:
    """Whether to try to supply all customers before any search: connected throughout, or in reach.

    Not with your own families or term, which may not want all customers.
    """
    if task.sheet.statement.minds_service:
        return False
    data = task.data
    if (data.grid_limit_kw > 0.0).all() and data.parts.whole:
        return True
    return data.switching is None and everyone_in_reach(task.site, data)


def rungs(task: WindowTask) -> list[Callable[[], None]]:
    """Relaxations without the network, in the order in which they are tried.

    An outage step without batteries has to match PV power with whole customers, and every kW that
    it misses is lost: service cannot be told from curtailment there, and all terms come at once. So
    they do with your own families or term, if these may depend on who is supplied.
    """
    data = task.data
    sunny = (data.pv_kw > 0.0).any(axis=1)
    matched = task.site.batteries.idle and bool((data.dark & sunny).any())
    by_levels = not (matched or task.sheet.statement.minds_service)
    fleets = fleets_of(data) if by_levels else ()
    return [*(partial(_by_levels, task, lumped) for lumped in fleets), partial(all_terms, task)]


def _by_levels(task: WindowTask, lumped: bool) -> None:
    """Service, then cost, by a master that may not apply."""
    master = master_of(task, lumped)
    if master is not None:
        service_then_cost(master)


def worth_an_answer(task: WindowTask) -> bool:
    """Whether the last way to an answer is worth its time: the whole problem without binaries.

    A small window that was decided in the network is searched with binaries at once.
    """
    known = task.certificate
    decided = known.ran("network_service") and (task.is_huge or not task.is_large)
    return not (known.answered or known.nothing_to_find or decided)


def worth_the_whole(task: WindowTask) -> bool:
    """Whether the whole problem is worth its time: not in a large window known in the network.

    There its relaxation says no more than ``network_service``, and its search never ends.
    In a huge one it cannot even be compiled.
    """
    known = task.certificate
    decided = known.ran("network_service")
    enough = task.is_huge or (known.answered and task.is_large)
    return task.goes_on and not (decided and enough)
