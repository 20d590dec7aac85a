"""Random feeders with faults and switches, and the best configuration by trying them all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from tests.support.agreement import SHARP
from tests.support.faulted import faulted_day
from vppres import RunOptions
from vppres.contract.observation import Observation
from vppres.core.arrays import Flags
from vppres.core.errors import SolveError
from vppres.day.priority import site_of
from vppres.model.data import WindowData
from vppres.scenario.configuration import Branches, in_configuration
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches
from vppres.solve.ladder import WindowSolver


def switched_day(seed: int, most: int = 5) -> Scenario:
    """A random feeder with a fault, up to three ties, and up to ``most`` switches in all."""
    day = faulted_day(seed)
    rng = np.random.default_rng([seed, 62])
    net = day.network
    near = {frozenset(pair) for pair in zip(net.from_bus, net.to_bus, strict=True)}
    pairs = [
        (int(a), int(b))
        for a in net.buses
        for b in net.buses
        if a < b and frozenset((a, b)) not in near
    ]
    ties = [pairs[i] for i in rng.choice(len(pairs), size=int(rng.integers(1, 4)), replace=False)]
    n_lines = int(rng.integers(0, most - len(ties) + 1))
    lines = rng.choice(net.n_lines, size=min(n_lines, net.n_lines), replace=False)
    ends = [*ties, *((net.from_bus[i], net.to_bus[i]) for i in lines)]
    closed = np.arange(len(ends)) >= len(ties)
    ohm = np.where(closed, np.nan, rng.uniform(0.05, 0.4, len(ends)).round(3))
    switches = Switches(
        id=[f"{a}-{b}" for a, b in ends],
        from_bus=[a for a, _ in ends],
        to_bus=[b for _, b in ends],
        kind=np.where(closed, "sectionaliser", "tie").astype(object),
        closed=closed,
        r_ohm=ohm,
        x_ohm=ohm,
        operation_cost=rng.choice([0.0, 0.001, 0.05], len(ends)),
        locked=rng.choice(["", "", "", "tree on it"], len(ends)).astype(object),
    )
    return replace(day, switches=switches)


def configurations(branches: Branches, movable: Flags) -> Iterator[Flags]:
    """Every state of the movable branches in which closed ones have no loop."""
    free = np.flatnonzero(movable)
    for states in product((False, True), repeat=len(free)):
        closed = branches.closed.copy()
        closed[free] = states
        if not has_loop(branches, closed):
            yield closed


def has_loop(branches: Branches, closed: Flags) -> bool:
    """Whether closed branches have a loop: more of them than their rank."""
    n_buses = branches.network.n_buses
    rows = np.zeros((int(closed.sum()), n_buses))
    for row, (a, b) in zip(rows, branches.ends[closed], strict=True):
        row[a], row[b] = 1.0, -1.0
    return bool(np.linalg.matrix_rank(rows) < len(rows))


def best_by_trying(day: Scenario, options: RunOptions, seen: Observation) -> tuple[float, int]:
    """What the best configuration is worth by the monolith, less its operations, and how many."""
    branches = Branches.of(day)
    out = seen.forecast.out
    movable = branches.movable(~branches.closed, out)
    steps = range(seen.t0, seen.t0 + len(seen.forecast.price_gbp_per_kwh))
    best, tried = -np.inf, 0
    for closed in configurations(branches, movable):
        at = in_configuration(day, branches, closed).scenario
        forecast = replace(seen.forecast, out=at.out_of_service(steps, known_at=seen.t0))
        site = site_of(at, options.as_record())
        data = WindowData.of(replace(seen, forecast=forecast), site, options.centre)
        moved = closed != branches.closed
        moved[: day.network.n_lines] &= ~out.lines[0]
        price = float(branches.of_moves("operation_cost")[moved].sum())
        try:
            found = WindowSolver(site, "monolithic", limits=SHARP).solve(data)
        except SolveError:
            continue
        tried += 1
        best = max(best, found.objective - price)
    return best, tried
