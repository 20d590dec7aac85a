"""Reasons of customers off supply, solved again: ``python -m experiments.reasons``.

On random days reasons are drawn, and each window is solved again from the recorded state, with the
customer before all others. A reason is true if that plan is worth no more than the one of the run.
If it calls a limit too small for the customer, this is on supply, at no loss to those who are, once
the limit is out of the way.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import typer
from numpy.random import Generator

from experiments.random_days import small_day
from experiments.seeds import STUDIES, FirstSeed, Results
from experiments.tables import markdown_table, write_pages
from vppres.control.converged import ConvergedPlanner
from vppres.control.planner import OnePass
from vppres.core.arrays import Floats
from vppres.core.errors import VppresError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.explain.day import steps_of
from vppres.explain.reasons import why_not_served
from vppres.explain.recorded import Recorded
from vppres.explain.step import Reason, Step
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution

PLENTY = 5.0
SHORT = "not enough"
BOTH = "stored energy and battery power"
LIMITS = ("energy", "power", "inverter", "voltage", "grid")


@dataclass(frozen=True)
class Checked:
    """A reason and whether it holds."""

    seed: int
    step: int
    customer: str
    rule: str
    mode: str
    driver: str
    words: str
    wrong: str


def day_of(seed: int) -> tuple[Scenario, RunOptions, Generator]:
    """A random day, its rule and its mode."""
    rng = np.random.default_rng([seed, 39])
    rule = ("weights", "strict")[seed % 2]
    mode = ("paper", "physical")[seed // 2 % 2]
    return small_day(rng, seed), RunOptions(priority=rule, mode=mode, horizon_h=5.0), rng


def checked(seed: int, most: int) -> list[Checked]:
    """Some reasons of a day, checked."""
    day, options, rng = day_of(seed)
    run = run_day(day, options)
    actions = [
        (step, int(customer)) for step in steps_of(run) for customer in np.flatnonzero(~step.served)
    ]
    drawn = rng.permutation(len(actions))[:most]
    return [_checked(seed, options, *actions[i]) for i in sorted(drawn.tolist())]


def _checked(seed: int, options: RunOptions, step: Step, customer: int) -> Checked:
    reason = why_not_served(step, customer)
    return Checked(
        seed,
        step.t,
        str(step.site.customers.id[customer]),
        str(options.priority),
        str(options.mode),
        str(reason.driver),
        reason.words,
        what_is_wrong(step, customer, reason),
    )


def what_is_wrong(step: Step, customer: int, reason: Reason) -> str:
    """Why a reason does not hold; empty if it does."""
    recorded = step.recorded
    if reason.driver in ("dark", "fallback", "mismatch"):
        return ""
    gain = _gain_of_run(recorded, step.t)
    forced = _solved(recorded, step.t, recorded.site, {customer: 1})
    on = forced is not None and bool(forced.dispatch.served[0, customer])
    tolerance = 1e-3 * float(recorded.site.customers.weight.min())
    if on and forced is not None and _gain(recorded.site, forced) > gain + tolerance:
        return "a plan with the customer is worth more"
    if reason.driver in LIMITS and (SHORT in reason.words or "does not allow" in reason.words):
        limit = "energy and power" if BOTH in reason.words else str(reason.binding)
        return _with_plenty(step, customer, limit, gain)
    if reason.driver == "unexplained":
        return "there is none"
    return ""


def _with_plenty(step: Step, customer: int, limit: str, gain: float) -> str:
    """Whether the customer is on supply at no loss, once a limit is out of the way."""
    recorded = step.recorded
    site = _without_limit(recorded.site, limit)
    held = {int(c): 1 for c in np.flatnonzero(step.served)} | {customer: 1}
    plan = _solved(recorded, step.t, site, held, limit)
    if plan is None or not plan.dispatch.served[0, list(held)].all():
        return f"off with plenty of {limit} too"
    if _gain(recorded.site, plan) < gain:
        return f"others lose with plenty of {limit}"
    return ""


def _without_limit(site: Site, limit: str) -> Site:
    """The site with a limit five times as large, or voltages that are free."""
    b = site.batteries
    if limit == "energy":
        return replace(site, batteries=replace(b, energy_kwh=PLENTY * b.energy_kwh))
    if limit == "energy and power":
        return _without_limit(_without_limit(site, "energy"), "power")
    if limit == "power":
        more = {name: PLENTY * getattr(b, name) for name in ("p_max_kw", "s_max_kva")}
        return replace(site, batteries=replace(b, **more))
    if limit == "inverter":
        pv = replace(site.pv, s_max_kva=PLENTY * site.pv.s_max_kva)
        return replace(site, batteries=replace(b, s_max_kva=PLENTY * b.s_max_kva), pv=pv)
    if limit == "voltage":
        return replace(site, network=replace(site.network, v_min_pu=0.5, v_max_pu=1.5))
    return site


def _solved(
    recorded: Recorded, t: int, site: Site, first: dict[int, int], limit: str = ""
) -> WindowSolution | None:
    """The window of a step again, some customers before all others in it; None without a plan."""
    seen = recorded.observation(t)
    weight = site.customers.weight.copy()
    weight[list(first)] += weight.sum() * seen.forecast.load_kw.shape[0] * bool(first)
    site = replace(site, customers=replace(site.customers, weight=weight))
    if limit.startswith("energy"):
        stored = seen.soc / PLENTY + (1.0 - 1.0 / PLENTY) * site.batteries.soc_max
        seen = replace(seen, soc=np.minimum(stored, site.batteries.soc_max))
    if limit == "grid":
        forecast = seen.forecast
        free = np.where(forecast.grid_limit_kw > 0.0, np.inf, 0.0)
        seen = replace(seen, forecast=replace(forecast, grid_limit_kw=free))
    solver = WindowSolver(site)
    planner: Any = OnePass(solver)
    if recorded.options["mode"] == "physical":
        planner = ConvergedPlanner(solver, float(recorded.options["headroom"]))
    try:
        solution: WindowSolution = planner.plan(seen)
    except VppresError:
        return None
    return solution


@cache
def _gain_of_run(recorded: Recorded, t: int) -> float:
    """Service and curtailment of the window as it is solved without any wish."""
    plan = _solved(recorded, t, recorded.site, {})
    assert plan is not None
    return _gain(recorded.site, plan)


def _gain(site: Site, solution: WindowSolution) -> float:
    """Service and curtailment of a plan by the weights of the run, in weighted customer hours."""
    served: Floats = solution.dispatch.served @ site.customers.weight
    lost = site.weights.lambda_curt * solution.dispatch.pv_curtailed_kw.sum()
    return float(served.sum() - lost) * site.dt_h


def main(
    reasons: int = 300, first_seed: FirstSeed = 0, most: int = 4, results: Results = STUDIES
) -> None:
    """Check drawn reasons of random days by solving again."""
    begin = time.process_time()
    found: list[Checked] = []
    seed = first_seed
    while len(found) < reasons:
        found += checked(seed, most)
        seed += 1
    wrong = [one for one in found if one.wrong]
    rows = [
        (driver, str(count), str(sum(one.driver == driver for one in wrong)))
        for driver, count in sorted(Counter(one.driver for one in found).items())
    ]
    text = markdown_table(("driver", "reasons", "wrong"), rows)
    record = {"reasons": [asdict(one) for one in found], "seeds": [first_seed, seed]}
    write_pages(results, "reasons", "Reasons checked by solving again", text, record)
    typer.echo(
        f"{text}\n\n{len(found)} reasons, {len(wrong)} wrong, {time.process_time() - begin:.0f} s"
    )
    for one in wrong:
        typer.echo(one)
    raise typer.Exit(int(bool(wrong)))


if __name__ == "__main__":
    typer.run(main)
