"""Random windows with ratings and with what no master in the network knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.frame.random_feeders import random_window
from tests.support.sets import random_sets
from tests.support.whole_statement import whole_problem
from vppres.contract.ahead import KindsAhead
from vppres.contract.stored_value import PIECES, StoredValue
from vppres.control.converged import dark_steps, physics_of, without_power
from vppres.core.errors import SolveError
from vppres.core.units import kva_to_a
from vppres.kinds.gensets import GensetState
from vppres.kinds.gensets.physics import SetsAhead
from vppres.model.beyond_paper.losses import lossless
from vppres.model.beyond_paper.ratings import with_ratings
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.scenario.priority import Ranks
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

Case = tuple[Site, WindowData]

PATIENT = SolveLimits(time_s=120.0)
"""Time limit of a window that needs half a second: no busy machine decides what is found."""

SLACK = 1e-5
"""Share of F, and what it is at least, by which solvers may differ."""


def _random(seed: int, mark: int) -> tuple[np.random.Generator, Scenario, WindowData]:
    scenario, data = random_window(seed, stressed=seed % 2 > 0)
    return np.random.default_rng([seed, mark]), scenario, data


def caught_up(seed: int) -> Case:
    """Dimmed customers that catch up."""
    rng, scenario, data = _random(seed, 61)
    count = len(scenario.customers)
    least = np.where(rng.random(count) < 0.5, rng.choice([0.0, 0.3, 0.7], count), 1.0)
    least[rng.integers(count)] = 0.2
    hours = scenario.grid.dt_h * rng.integers(1, 4, count)
    recover_h = np.where((rng.random(count) < 0.7) & (least < 1.0), hours, np.nan)
    customers = replace(scenario.customers, share_min=least, recover_h=recover_h)
    return Site.of(replace(scenario, customers=customers)), data


def with_sets(seed: int) -> Case:
    """Generating sets beside the grid and in islands."""
    rng, scenario, data = _random(seed, 62)
    day = replace(scenario, gensets=random_sets(rng, scenario))
    seen = SetsAhead.of(day, range(data.n_steps), GensetState.at_first(day.gensets))
    return Site.of(day), replace(data, ahead=KindsAhead({"gensets": seen}))


def forming(seed: int) -> Case:
    """Sets with ramps that form the grid of an island."""
    rng, scenario, data = _random(seed, 63)
    sets = random_sets(rng, scenario)
    slow = sets.p_max_kw * rng.uniform(0.2, 0.6, len(sets))
    sets = replace(
        sets,
        grid_forming=np.ones(len(sets), dtype=bool),
        ramp_up_kw_per_h=slow,
        ramp_down_kw_per_h=slow,
    )
    day = replace(scenario, gensets=sets)
    return formed_by_sets(day, data, rng)


def formed_by_sets(day: Scenario, data: WindowData, rng: np.random.Generator) -> Case:
    """An outage from the first or second step on, formed by the sets of a site where they can."""
    outage = np.arange(data.n_steps) >= rng.integers(0, 2)
    seen = SetsAhead.of(day, range(data.n_steps), GensetState.at_first(day.gensets))
    limits = np.where(outage, 0.0, data.grid_limit_kw)
    data = replace(data, grid_limit_kw=limits, ahead=KindsAhead({"gensets": seen}))
    site = Site.of(day)
    data, dark = data.formed(site, dark_steps(site, data), 0.1)
    lit = without_power(data, dark)
    return site, lossless(lit, physics_of(site, lit, 0.1))


def bent(rng: np.random.Generator, data: WindowData, site: Site) -> StoredValue:
    """A random concave value of what a window's fleet holds at its end."""
    b = site.batteries
    energy = np.linspace(b.energy_kwh @ b.soc_min, b.energy_kwh @ b.soc_max, PIECES + 1)
    slope = np.sort(rng.exponential(0.01, PIECES))[::-1]
    worth = np.append(0.0, np.cumsum(slope * np.diff(energy)))
    dark = bool((data.grid_limit_kw <= 0.0).all())
    return StoredValue(energy, worth, 1000.0, dark)


def by_belief(seed: int) -> Case:
    """A value of what is stored at the end; of every other one the tiers are in strict order."""
    rng, scenario, data = _random(seed, 64)
    site = Site.of(scenario)
    b = site.batteries
    if seed % 3:
        data = replace(data, grid_limit_kw=np.zeros(data.n_steps))
    if len(b):
        data = replace(data, stored_value=bent(rng, data, site))
    if seed % 2:
        ranks = Ranks.of(scenario.customers, scenario.tiers, data.n_steps)
        site = site.ranked(ranks, data.n_steps)
    return site, replace(data, open_ended=True)


KINDS: dict[str, Callable[[int], Case]] = {
    "caught-up": caught_up,
    "sets": with_sets,
    "forming": forming,
    "belief": by_belief,
}


def rated(kind: str, seed: int) -> Case | None:
    """A window of a kind, some of whose lines have a rating near what flows without; None: dark."""
    site, data = KINDS[kind](seed)
    rng = np.random.default_rng([seed, 65])
    try:
        free = WindowSolver(site, limits=PATIENT).solve(data).dispatch
    except SolveError:
        return None
    flow_kva = np.hypot(free.p_flow_kw, free.q_flow_kvar).max(axis=0)
    share = rng.uniform(0.5, 1.2, len(flow_kva))
    i_max_a = kva_to_a(share * flow_kva + 1.0, site.network.base_kv)
    some = rng.random(len(flow_kva)) < 0.5
    network = replace(site.network, i_max_a=np.where(some, i_max_a, np.inf))
    return replace(site, network=network, rated=True), data


def verdict(site: Site, data: WindowData) -> list[str]:
    """Faults of a window's answer beside its whole problem; empty if there is none."""
    limited = with_ratings(site, data)
    whole = whole_problem(site, limited)
    scale = SLACK * max(abs(whole.value), 1.0) if np.isfinite(whole.value) else SLACK
    try:
        found = WindowSolver(site, limits=PATIENT).solve(data)
    except SolveError as error:
        return [f"no answer: {error}"] if np.isfinite(whole.value) else []
    value = found.terms.upper_levels(site.weights)
    gap = SolveLimits().gap_at(value)
    told = limited.for_service(found.dispatch.served)
    kept = "line rating" not in broken(site, told, found.dispatch)
    wrong = broken(site, data.for_service(found.dispatch.served), found.dispatch)
    if np.isfinite(whole.value):
        if not kept:
            wrong.append("a rating that could be kept is not")
        if found.bound < whole.value - scale:
            wrong.append(f"bound {found.bound} below {whole.value}")
        if found.status == "optimal" and value < whole.value - gap - scale:
            wrong.append(f"called optimal at {value} below {whole.value}")
    if kept and value > whole.bound + scale:
        wrong.append(f"{value} is more than {whole.bound}")
    return wrong
