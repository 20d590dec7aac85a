"""Methods that solve a window: the monolithic problem, or a decomposition with a certificate."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from vppres.core.arrays import Flags
from vppres.core.errors import InputError, Problem
from vppres.model.data import WindowData
from vppres.model.problem import Form, objective_scale
from vppres.model.site import Site
from vppres.model.terms import evaluate
from vppres.solve.dispatch import POLYGON_SIDES, cost_form, polish, shared_cache, solve_cost
from vppres.solve.fleet.masters import Master, MastersOf, binaries, cost_gap_gbp, counts, fleets_of
from vppres.solve.network.decide import InNetwork, is_large
from vppres.solve.network.master import NetworkMaster, applies
from vppres.solve.result import Outcome, SolveLimits, Status, WindowSolution
from vppres.solve.search import GRACE_S, Candidate, Search
from vppres.solve.slack import least_slack
from vppres.solve.solvers import SolverSpec, find_solver, run, run_conic

METHODS = ("decomposed", "monolithic")
Rung = Callable[[WindowData, Search], None]

LARGE = 1500
"""Buses times steps beyond which the network is asked for its service before the tie-breakers."""


class WindowSolver:
    """Solves windows of one site by one method and solver; problems are compiled once.

    Parameters
    ----------
    site : Site
        Fixed data.
    method : {"decomposed", "monolithic"}
        How the served set is found; ``docs/method.md`` proves the certificates.
    solver : str
        Name in the table of solvers.
    limits : SolveLimits, optional
        Gaps and time limit of a window.
    polygon_sides : int, optional
        Sides of an inverter's polygon for solvers that take no cones with binaries.

    Raises
    ------
    InputError
        If method or solver are unknown, or the solver is not installed.
    """

    def __init__(self, site: Site, method: str = "decomposed", solver: str = "highs",
                 limits: SolveLimits | None = None, polygon_sides: int = POLYGON_SIDES) -> None:
        if method not in METHODS:
            raise InputError(Problem("options", "is not a known method",
                                     f"Use one of: {', '.join(METHODS)}.", field="method",
                                     value=method))
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

    def solve(self, data: WindowData) -> WindowSolution:
        """Solve a window.

        Parameters
        ----------
        data : WindowData
            What changes from window to window.

        Returns
        -------
        WindowSolution
            The best dispatch, with its bound; status ``TIME_LIMIT`` where time ran out.

        Raises
        ------
        SolveError
            If no dispatch was found: infeasible, unbounded, numerical or out of time.
        """
        whole = self.site.customers.weight.sum() * self.site.dt_h * data.n_steps
        search = Search(self.limits, self.limits.absolute(whole))
        if self.method == "decomposed":
            self._decomposed(data, whole, search)
            if search.proof is None and (not search.answered or self._goes_on(data, search)):
                self._relaxed(data, search)
        if self._goes_on(data, search):
            self._full(data, search)
        return self._finish(data, search)

    def solve_served(self, data: WindowData, served: Flags) -> WindowSolution | None:
        """Cheapest dispatch of a served set in the network, None if it has none; no bound."""
        whole = self.site.customers.weight.sum() * self.site.dt_h * data.n_steps
        search = Search(self.limits, self.limits.absolute(whole))
        self._recover(data, served, search, network=True)
        return self._finish(data, search) if search.answered else None

    def least_slack(self, data: WindowData) -> float:
        """Least slack of the squared voltage limits (pu²) that leaves a feasible relaxation.

        Raises
        ------
        SolveError
            If not even free voltages leave one.
        """
        return least_slack(self.site, data, self.limits.time_s)

    def _decomposed(self, data: WindowData, whole: float, search: Search) -> None:
        """Relaxations of growing size, each with its bound, until bound and dispatch meet.

        Dispatches are first found without the network; the best one is then put into it.
        """
        if (data.grid_limit_kw > 0.0).all():
            self._everyone(data, whole, search)
        for rung in self._ladder(data):
            if not search.certified and search.left_s > 0:
                rung(data, search)
        if search.best is not None:
            self._enter_network(data, search)

    def _ladder(self, data: WindowData) -> list[Rung]:
        """Relaxations in the order in which they are tried."""
        fleets = fleets_of(data)
        kinds = [partial(kind, lumped=lumped) for lumped in fleets for kind in (counts, binaries)]
        levels = [partial(self._levels, masters=kind) for kind in kinds]
        return [*levels, partial(self._aggregate, lumped=fleets[0]), self._per_battery]

    def _enter_network(self, data: WindowData, search: Search) -> None:
        """Put the best dispatch into the network, at a higher cost where that is needed."""
        best = search.best
        master = None
        assert best is not None
        if applies(self.site, data):
            master = NetworkMaster(self.site, self.cache.reactance, data, search.left_s)
        large = is_large(self.site, data)
        found = None
        if master is None or not large or master.unit * (master.most_units + 0.5) > best.service:
            found = self._polished(data, best, search)
        if found is None and master is not None:
            polish = None if large else partial(self._polished, data, search=search)
            found = InNetwork(self.cache, data, master, search, polish).decide()
        search.best = found or self._in_network(data, best.dispatch.served, search)

    def _goes_on(self, data: WindowData, search: Search) -> bool:
        """Whether the whole problem is worth its time: not in a large window known in the network.

        There its relaxation says no more than ``network_service``, and its search never ends.
        """
        known = search.answered and any(s.startswith("network_service") for s in search.stages)
        return (not search.certified and search.left_s > 0.0
                and not (known and is_large(self.site, data)))

    def _in_network(self, data: WindowData, served: Flags, search: Search) -> Candidate | None:
        """Cheapest dispatch of a served set in the network, with the true discs."""
        inner = cost_form(self.sides, network=True)
        found = self._cheapest("network_cost", data, served, inner, search)
        return found and (self._polished(data, found, search) or found)

    def _polished(self, data: WindowData, found: Candidate, search: Search) -> Candidate | None:
        """The dispatch that the tie-breakers prefer, None if the network forbids its cost."""
        # What a restoration adds to the demand is known with the service.
        data = data.for_service(found.dispatch.served)
        stage = polish(self.cache, data, found.dispatch, max(search.left_s, GRACE_S))
        search.note("tie_breakers", stage.outcome)
        if stage.dispatch is None:
            return None
        terms = evaluate(self.site, data, stage.dispatch)
        return replace(found, dispatch=stage.dispatch, terms=terms, in_network=True)

    def _cheapest(self, name: str, data: WindowData, served: Flags, form: Form,
                  search: Search) -> Candidate | None:
        """Cheapest dispatch of a served set in a form of the cost level."""
        # A started answer is always finished: recovery gets a moment even when time is up. In a
        # large network it may need long to find that there is none, so it may not take it all.
        time_s = max(search.left_s / 3.0 if form.network else search.left_s, GRACE_S)
        data = data.for_service(served)
        stage = solve_cost(self.cache, data, served, self.spec, form, time_s)
        search.note(name, stage.outcome)
        if stage.dispatch is None:
            return None
        terms = evaluate(self.site, data, stage.dispatch)
        weights = self.site.weights
        value = terms.upper_levels(weights)
        slack = abs(stage.outcome.value - stage.outcome.bound)
        return Candidate(stage.dispatch, terms, value + weights.lambda_grid * terms.f2, value,
                         terms.f2 - slack, form.network)

    def _everyone(self, data: WindowData, whole: float, search: Search) -> None:
        """Serve everyone and curtail nothing: if that is feasible, no search is needed."""
        served = np.ones(data.load_kw.shape, dtype=bool)
        self._recover(data, served, search)
        best = search.best
        if best is not None and whole - best.service <= 1e-6 * search.gap:
            search.service_bound = whole
            search.cost_bound_gbp = best.cost_bound_gbp
            weight = self.site.weights.lambda_grid
            # Any other served set loses at least the smallest weight, or the bound says less.
            loss = self.site.customers.weight.min() * self.site.dt_h
            search.bound = whole - min(weight * best.cost_bound_gbp, loss)

    def _levels(self, data: WindowData, search: Search, masters: MastersOf) -> None:
        """Service first, on the weights' grid, then the cost of all sets that serve as much."""
        master = masters(self.cache, data, self.spec, search.left_s)
        if master is None:
            return
        outcome, served = master.service(0.4 * search.gap / master.unit)
        search.note(f"{master.prefix}service", outcome)
        if served is None:
            search.prove(outcome)
            return
        self._recover(data, served, search)
        best = search.best
        service_bound = master.unit * outcome.bound
        search.bound = min(search.bound, service_bound)  # cost only lowers the objective
        if best is not None and service_bound - best.service <= search.gap:
            search.service_bound = service_bound
            self._cost_level(data, master, search)

    def _cost_level(self, data: WindowData, master: Master, search: Search) -> None:
        """Cheapest set that serves as much, the bound on the cost of all, and so the bound on F.

        A set that serves less than the search admits either has ``S < F`` of the dispatch at hand,
        or costs at least what the linear relaxation says.
        """
        assert search.best is not None
        best = search.best
        weight = self.site.weights.lambda_grid
        unit = master.unit
        admitted = max(best.value, best.service - 0.5 * unit)
        # Within less than one customer of the bound nobody connected can be left out.
        everyone = search.service_bound - admitted < 0.99 * unit
        outcome, served = master.cost((admitted - 1e-9) / unit, everyone, best.terms.f2,
                                      cost_gap_gbp(best.terms.f2))
        search.note(f"{master.prefix}cost_level", outcome)
        if not outcome.status.has_answer:
            return
        search.cost_bound_gbp = max(outcome.bound, 0.0)
        search.bound = search.service_bound - weight * search.cost_bound_gbp
        if admitted > best.value:
            # Costs of sets that serve less: the linear relaxation is enough.
            least, _ = master.cost((best.value - 1e-9) / unit, False, np.inf, np.inf)
            search.note(f"{master.prefix}least_cost", least)
            least_gbp = max(least.bound, 0.0) if least.status.has_answer else 0.0
            search.bound = max(search.bound, admitted - weight * least_gbp)
        search.bound = max(search.bound, best.value)
        if (served is not None and (served != best.dispatch.served).any()
                and outcome.value < best.terms.f2):
            self._recover(data, served, search)

    def _aggregate(self, data: WindowData, search: Search, lumped: bool) -> None:
        """Flags set and bound of the lumped relaxation with all terms as weighted."""
        model = self.cache.aggregate(data, lumped=lumped)
        model.fill(data)
        outcome = run(model.problem, self.spec, 0.8 * search.gap, search.left_s,
                      objective_scale(self.site))
        self._take("aggregate", outcome, model.x.value, data, search)

    def _per_battery(self, data: WindowData, search: Search) -> None:
        """Flags set and bound of the relaxation with every battery but without the network."""
        form = Form("service", "integer", "integer", 0, network=False)
        self._window(form, "per_battery", data, 0.8 * search.gap, search)

    def _relaxed(self, data: WindowData, search: Search) -> None:
        """Bound of the whole problem without binaries, and those it serves in full.

        It is there for networks that forbid what the fleet could do: an answer comes before the
        search with binaries, which may need all the time there is. Where there is no answer yet it
        runs even when time is up.
        """
        form = Form("service", "relaxed", "relaxed", self.sides or POLYGON_SIDES, outer=True)
        model = self.cache.window(form, data)
        model.fill(data)
        outcome = run_conic(model.problem, max(search.left_s, GRACE_S),
                            objective_scale(self.site))
        search.note("relaxed", outcome)
        if outcome.status == Status.OPTIMAL:
            # Interior points end within their tolerance of the optimum, on either side.
            search.bound = min(search.bound, outcome.value + 1e-6 * abs(outcome.value) + 1e-6)
            self._recover(data, model.v.x_served.value > 1.0 - 1e-3, search, network=True)

    def _full(self, data: WindowData, search: Search) -> None:
        """The whole problem. Where discs are polygons, outer ones bound and inner ones answer."""
        form = Form("service", "integer", "integer", self.sides)
        forms = {"full_outer": replace(form, outer=True), "full": form}
        for name, polygons in forms.items() if self.sides else [("full", form)]:
            if not search.certified and search.left_s > 0:
                self._window(polygons, name, data, search.gap, search)

    def _window(self, form: Form, name: str, data: WindowData, gap: float, search: Search) -> None:
        """Solve a master with every battery, and recover its served set."""
        model = self.cache.window(form, data)
        model.fill(data)
        outcome = run(model.problem, self.spec, gap, search.left_s, objective_scale(self.site))
        inner = form.network and form.polygon_sides > 0 and not form.outer
        if inner:
            outcome = replace(outcome, bound=np.inf)
        self._take(name, outcome, model.v.x_served.value, data, search, form.network)

    def _take(self, name: str, outcome: Outcome, x: np.ndarray | None, data: WindowData,
              search: Search, network: bool = False) -> None:
        """Record a master's outcome and bound, and recover a dispatch of its served set."""
        search.note(name, outcome)
        if outcome.status.has_answer and x is not None:
            search.bound = min(search.bound, outcome.bound)
            self._recover(data, np.asarray(x) > 0.5, search, network)
        elif name != "full" or not self.sides:
            search.prove(outcome)

    def _recover(self, data: WindowData, served: Flags, search: Search,
                 network: bool = False) -> None:
        """Cheapest dispatch of a served set; kept if it is the best so far.

        A relaxation without binaries may serve what the switching rules forbid: nothing to find.
        """
        if data.switching is not None and data.switching.broken(served).any():
            return
        found = self._cheapest("cost", data, served, cost_form(0, network=False), search)
        if network and found is not None:
            found = self._polished(data, found, search) or self._in_network(data, served, search)
        if found is not None and (search.best is None or found.value > search.best.value):
            search.best = found

    def _finish(self, data: WindowData, search: Search) -> WindowSolution:
        """The certificate."""
        if search.best is None or not search.answered:
            search.no_answer().require_answer(f"The window of {data.n_steps} steps")
            raise AssertionError("an outcome without answer always raises")
        best = search.best
        weights = self.site.weights
        bound_gbp = max(search.cost_bound_gbp, 0.0)
        # Whatever serves more than the bound on F allows would have to cost more than is possible.
        dearest = float(data.price_gbp_per_kwh @ data.grid_p_max_kw(self.site)) * self.site.dt_h
        service_bound = min(search.service_bound, search.bound + weights.lambda_grid * dearest)
        return WindowSolution(
            dispatch=best.dispatch, terms=best.terms,
            objective=best.terms.total(weights), bound=search.bound,
            status=search.status,
            service_gap=max(service_bound - best.service, 0.0),
            cost_gap_gbp=max(best.terms.f2 - bound_gbp, 0.0),
            solve_s=time.perf_counter() - search.begin, solver_s=search.solver_s,
            stages=tuple(search.stages), loss_kw=data.loss_kw if data.physical else None)
