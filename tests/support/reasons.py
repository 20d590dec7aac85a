"""Reasons of customers off supply, solved again.

On random days reasons are drawn, and each window is solved again from the recorded state, with the
customer before all others. A reason is true if that plan is worth no more than the one of the run.
If it calls limits too small for the customer, it is on supply once they are out of the way, at no
loss to those who are; or what others gain is worth as much as its supply.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.random import Generator

from benchmarks.frame.seeds import PATIENT
from experiments.studies.random_days import small_day
from vppres.control.converged import ConvergedPlanner
from vppres.control.planner import OnePass
from vppres.core.arrays import Floats
from vppres.core.errors import VppresError
from vppres.core.units import kva_to_a
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.explain.day import steps_of
from vppres.explain.reason import Reason
from vppres.explain.reasons import why_not_served
from vppres.explain.room import limits_in_full
from vppres.explain.step import Step
from vppres.explain.windows import Windows
from vppres.model.site import Site
from vppres.scenario.scenario import LIMIT, SOFT, Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution

PLENTY = 5.0
TOLERANCE = 1e-3
"""Share of a customer's weight: what solvers leave is far below."""

NOT_IN_FULL = ("not enough", "does not allow", "does not carry", "do not allow")
LIMITS = ("energy", "power", "inverter", "rating", "voltage", "grid")
WEAK = (1.0, 3.0)
"""Impedances of a day with ratings and soft voltage limits, as multiples of the drawn ones."""

RATED_SHARE = 0.4
OF_PEAK = (0.6, 1.3)
"""Ratings of some of its lines, as shares of the current at the peaks of all customers."""


def day_of(seed: int) -> tuple[Scenario, RunOptions, Generator]:
    """A random day, its rule and its mode."""
    rng = np.random.default_rng([seed, 39])
    rule = ("weights", "strict")[seed % 2]
    mode = ("paper", "physical")[seed // 2 % 2]
    day = small_day(rng, seed)
    options = RunOptions(priority=rule, mode=mode, horizon_h=5.0, limits=PATIENT)
    if seed % 5 >= 3:
        day = weak_day(day, rng)
        options = replace(options, voltage_limits=SOFT, ratings=LIMIT)
    return day, options, rng


def weak_day(day: Scenario, rng: Generator) -> Scenario:
    """The day on a weaker feeder, some lines of which have a rating."""
    net = day.network
    peak_kva = np.zeros(net.n_buses)
    np.add.at(
        peak_kva,
        [net.bus_index[bus] for bus in day.customers.bus],
        np.hypot(day.load_kw, day.load_kvar).max(axis=0),
    )
    most_a = kva_to_a(net.downstream @ peak_kva, net.base_kv) * rng.uniform(*OF_PEAK, net.n_lines)
    weaker = rng.uniform(*WEAK)
    rated = rng.random(net.n_lines) < RATED_SHARE
    network = replace(
        net,
        r_ohm=net.r_ohm * weaker,
        x_ohm=net.x_ohm * weaker,
        i_max_a=np.where(rated, most_a, np.inf),
    )
    return replace(day, network=network)


def checked(seed: int, most: int) -> list[str]:
    """Faults of some drawn reasons of a day, one for each; empty where it holds."""
    day, options, rng = day_of(seed)
    run = run_day(day, options)
    actions = [
        (step, int(customer)) for step in steps_of(run) for customer in np.flatnonzero(~step.served)
    ]
    drawn = rng.permutation(len(actions))[:most]
    return [_checked(*actions[i]) for i in sorted(drawn.tolist())]


def _checked(step: Step, customer: int) -> str:
    reason = why_not_served(step, customer)
    wrong = what_is_wrong(step, customer, reason)
    return wrong and f"{step.t}, {step.site.customers.id[customer]}, {reason.words}: {wrong}"


def what_is_wrong(step: Step, customer: int, reason: Reason) -> str:
    """Why a reason does not hold; empty if it does."""
    windows = step.windows
    if reason.driver in ("dark", "fallback", "mismatch"):
        return ""
    gain = _gain_of_run(windows, step.t)
    forced = _solved(windows, step.t, windows.site, {customer: 1})
    on = forced is not None and bool(forced.dispatch.served[0, customer])
    tolerance = TOLERANCE * float(windows.site.customers.weight.min())
    if on and forced is not None and _gain(windows.site, forced) > gain + tolerance:
        return "a plan with the customer is worth more"
    if not len(windows.site.batteries) and reason.driver in ("power", "energy"):
        return _in_reach_of_sun(step, customer)
    if reason.driver in LIMITS and any(words in reason.words for words in NOT_IN_FULL):
        limits = [str(limit) for limit in limits_in_full(step, customer, reason.binding)]
        limits = limits or [str(reason.binding)]
        return _with_plenty(step, customer, limits, gain)
    if reason.driver == "unexplained":
        return "there is none"
    return _not_kept(step, customer) if " kept for " in reason.words else ""


def _not_kept(step: Step, customer: int) -> str:
    """Whether the customer could not be on in the step alone, beside all that are."""
    windows = step.windows
    held = {int(c): 1 for c in np.flatnonzero(step.served)} | {customer: 1}
    plan = _solved(windows, step.t, windows.site, held, alone=True)
    if plan is None or not plan.dispatch.served[0, list(held)].all():
        return "the customer could not be on now, so energy is not kept"
    return ""


def _in_reach_of_sun(step: Step, customer: int) -> str:
    """Whether an island without batteries has what the customer and all that are on need."""
    if "battery" in why_not_served(step, customer).words:
        return "there is no battery"
    on = step.served.copy()
    on[customer] = True
    needed_kw = float(step.load_kw[on].sum())
    given_kw = float(step.scenario.pv_kw[step.t].sum()) + float(step.site.gensets.p_max_kw.sum())
    return "there is power enough" if given_kw >= needed_kw else ""


def _with_plenty(step: Step, customer: int, limits: Sequence[str], gain: float) -> str:
    """Whether the customer, or as much service, is on at no loss once limits are out of the way."""
    windows = step.windows
    site = windows.site
    for limit in limits:
        site = _without_limit(site, limit)
    held = {int(c): 1 for c in np.flatnonzero(step.served)} | {customer: 1}
    weight_h = float(windows.site.customers.weight[customer]) * windows.site.dt_h
    plan = _solved(windows, step.t, site, {}, limits)
    if plan is not None and _gain(windows.site, plan) >= gain + weight_h * (1.0 - TOLERANCE):
        return ""
    plan = _solved(windows, step.t, site, held, limits)
    plenty = " and ".join(limits)
    if plan is None or not plan.dispatch.served[0, list(held)].all():
        return f"off with plenty of {plenty} too"
    if _gain(windows.site, plan) < gain:
        return f"others lose with plenty of {plenty}"
    return ""


def _without_limit(site: Site, limit: str) -> Site:
    """The site with a limit five times as large, or voltages that are free."""
    b = site.batteries
    if limit == "energy":
        return replace(site, batteries=replace(b, energy_kwh=PLENTY * b.energy_kwh))
    if limit == "power":
        more = {name: PLENTY * getattr(b, name) for name in ("p_max_kw", "s_max_kva")}
        return replace(site, batteries=replace(b, **more))
    if limit == "inverter":
        pv = replace(site.pv, s_max_kva=PLENTY * site.pv.s_max_kva)
        return replace(site, batteries=replace(b, s_max_kva=PLENTY * b.s_max_kva), pv=pv)
    if limit == "rating":
        wide = np.full(site.network.n_lines, np.inf)
        return replace(site, network=replace(site.network, i_max_a=wide), rated=False)
    if limit == "voltage":
        return replace(site, network=replace(site.network, v_min_pu=0.5, v_max_pu=1.5))
    return site


def _solved(
    windows: Windows,
    t: int,
    site: Site,
    first: dict[int, int],
    limits: Sequence[str] = (),
    alone: bool = False,
) -> WindowSolution | None:
    """The window of a step again, some customers before all others in it; None without a plan.

    With ``alone`` the window ends with the step.
    """
    seen = windows.observation(t)
    if alone:
        seen = replace(seen, forecast=seen.forecast.first(1))
    weight = site.customers.weight.copy()
    weight[list(first)] += weight.sum() * seen.forecast.load_kw.shape[0] * bool(first)
    site = replace(site, customers=replace(site.customers, weight=weight))
    if "energy" in limits:
        stored = seen.soc / PLENTY + (1.0 - 1.0 / PLENTY) * site.batteries.soc_max
        seen = replace(seen, soc=np.minimum(stored, site.batteries.soc_max))
    if "grid" in limits:
        forecast = seen.forecast
        free = np.where(forecast.grid_limit_kw > 0.0, np.inf, 0.0)
        seen = replace(seen, forecast=replace(forecast, grid_limit_kw=free))
    solver = WindowSolver(site, limits=PATIENT)
    planner: Any = OnePass(solver)
    if windows.recorded.options["mode"] == "physical":
        # Headroom is a share of the rating: it stays what it is in kW.
        share = float(windows.recorded.options["headroom"])
        planner = ConvergedPlanner(solver, share / PLENTY if "power" in limits else share)
    try:
        solution: WindowSolution = planner.plan(seen)
    except VppresError:
        return None
    return solution


@cache
def _gain_of_run(windows: Windows, t: int) -> float:
    """Service and curtailment of the window as it is solved without any wish."""
    plan = _solved(windows, t, windows.site, {})
    assert plan is not None
    return _gain(windows.site, plan)


def _gain(site: Site, solution: WindowSolution) -> float:
    """Service, now and later, and curtailment of a plan, in weighted customer hours of the run."""
    served: Floats = solution.dispatch.served @ site.customers.weight
    lost = site.weights.lambda_curt * solution.dispatch.pv_curtailed_kw.sum()
    return float(served.sum() - lost) * site.dt_h + solution.terms.f7
