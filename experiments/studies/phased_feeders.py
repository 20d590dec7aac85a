"""Small random feeders with phases, and a plain statement of their whole problem.

``python -m experiments.studies.phased_feeders --cases 50`` decides a window of each as plans do,
and as one problem with a row for each limit of each node and each side of each phase of the former,
for HiGHS. Inverters' discs are polygons there, around the discs and inside them: what they allow
brackets the optimum.

``python -m experiments.studies.phased_feeders --windows FILE`` decides 24 windows of a circuit, and
prints them as a table; with ``--limit`` beside the whole problem with all of its rows.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cvxpy as cp
import numpy as np
from numpy.random import Generator

from benchmarks.frame.pages import put_table
from benchmarks.frame.random_feeders import WEIGHT, random_network, random_scenario
from experiments.studies.phases import DAYS, LIMIT_S, loop, of_day, say, scenario_of
from vppres.control.converged import ConvergedPlanner
from vppres.core.arrays import Floats
from vppres.core.errors import SolveError
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.priority import site_of
from vppres.day.simulate import Day
from vppres.kinds.table import units_of
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.data import WindowData
from vppres.model.numerics import objective_scale
from vppres.model.parts import at_items
from vppres.model.phases import SIDES, phased_model
from vppres.model.site import Site
from vppres.scenario.assets import Customers, PVSystems
from vppres.scenario.phases import PhaseBus, PhaseConnection, PhaseLine, Phases
from vppres.scenario.scenario import REPORT, ControllerDefaults, Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, Status, WindowSolution

SIDES_OF_INVERTERS = 64
"""Sides of the polygons around and inside the inverters' discs: 0.12 % apart."""

MUTUAL = 0.35
"""Impedance between two phases as a share of a phase's own."""

COILS = ("a", "b", "c", "ab", "bc", "a b", "a b c", "ab bc ca")
WYE = "a b c"


def in_phases(scenario: Scenario, rng: Generator | None = None) -> Scenario:
    """A scenario stated in three phases; with a generator, on phases that it draws.

    The battery that may form an island has all three phases, and its lines have the impedance of
    the balanced feeder in positive sequence.
    """
    net = scenario.network
    own = (net.r_ohm + 1j * net.x_ohm) / (1.0 - MUTUAL)
    shape = np.full((3, 3), MUTUAL) + (1.0 - MUTUAL) * np.eye(3)
    ends = zip(net.from_bus, net.to_bus, own, strict=True)
    lines = [PhaseLine(str(a), str(b), z * shape, np.zeros((3, 3))) for a, b, z in ends]
    buses = [PhaseBus(str(bus), bus, net.base_kv, WYE) for bus in net.bus_index]
    customers = scenario.customers
    at = dict(zip(customers.id, customers.bus, strict=True))
    at |= dict(zip(scenario.batteries.id, scenario.batteries.bus, strict=True))
    at |= dict(zip(scenario.pv.id, scenario.pv.buses(customers), strict=True))
    owner = dict(zip(scenario.pv.id, scenario.pv.customer, strict=True))
    for each in units_of(scenario).values():
        at |= dict(zip(each.id, each.buses(customers), strict=True))
        owned = ~each.connected(customers, np.zeros(len(customers), dtype=bool))
        of = customers.id[each.owner(customers)]
        owner |= dict(zip(np.array(each.id)[owned], of[owned], strict=True))
    coils = dict.fromkeys(at, WYE)
    if rng is not None:
        forming = (scenario.batteries, scenario.gensets)
        fixed = {
            *filter(owner.get, owner),
            *(name for each in forming for name in each.id[each.grid_forming]),
        }
        coils |= {name: str(rng.choice(COILS)) for name in at if name not in fixed}
    rows = []
    for name in at:
        words = coils[owner.get(name) or name]
        between = len(words.split()[0]) > 1
        kv = net.base_kv if between else net.base_kv / np.sqrt(3.0)
        rows.append(PhaseConnection(str(name), str(at[name]), words, kv))
    return replace(scenario, phases=Phases(tuple(buses), tuple(lines), connections=tuple(rows)))


def random_phased(seed: int) -> Scenario:
    """A random day of a few steps on an unbalanced feeder; a battery forms the island."""
    return in_phases(with_a_former(random_scenario(seed)), np.random.default_rng([seed, 44]))


LONG_BUSES = (10, 20)
"""Buses of a long random feeder: 30 to 60 nodes."""


def long_feeder(seed: int) -> Scenario:
    """A random day of 24 hours on a long unbalanced feeder, with an outage of six hours.

    Every bus but the first has a customer. One of five batteries forms the island, with a tenth of
    the peak load.
    """
    rng = np.random.default_rng([seed, 4444])
    hours = np.arange(24)
    count = int(rng.integers(*LONG_BUSES))
    bus = np.arange(2, count + 2).astype(object)
    tiers = rng.choice(list(WEIGHT), count, p=[0.2, 0.3, 0.5])
    small = random_scenario(seed)
    customers = Customers(
        id=np.array([f"c{i}" for i in range(count)], dtype=object),
        bus=bus,
        tier=tiers,
        weight=np.array([WEIGHT[tier] for tier in tiers]),
        power_factor=rng.uniform(0.9, 1.0, count),
    )
    peak_kw = rng.uniform(20.0, 120.0, count)
    evening = 0.6 + 0.4 * np.exp(-(((hours - rng.uniform(17.0, 20.0)) / 4.0) ** 2))
    load_kw = peak_kw * evening[:, None] * rng.uniform(0.85, 1.0, (24, count))
    owners = np.flatnonzero(rng.random(count) < 0.6)
    pv_max_kw = peak_kw[owners] * rng.uniform(0.4, 1.2, len(owners))
    pv = PVSystems(
        id=np.array([f"p{i}" for i in owners], dtype=object),
        customer=customers.id[owners],
        p_max_kw=pv_max_kw,
        s_max_kva=1.1 * pv_max_kw,
    )
    sun = np.clip(np.sin(np.pi * (hours - 6.0) / 14.0), 0.0, None) * rng.uniform(0.3, 1.0)
    batteries = next(
        b for s in range(seed, seed + 99) if len(b := random_scenario(s).batteries) == 5
    )
    rating = load_kw.sum(axis=1).max() * np.array([0.1, *rng.uniform(0.03, 0.1, 4)])
    sized = replace(
        batteries,
        bus=rng.choice(bus, 5),
        energy_kwh=2.0 * rating,
        p_max_kw=0.9 * rating,
        s_max_kva=rating,
    )
    begin = int(rng.integers(6, 16))
    dark = (hours >= begin) & (hours < begin + 6)
    scenario = replace(
        small,
        name=f"long-{seed}",
        controller=ControllerDefaults(mode="physical"),
        grid=replace(small.grid, step_minutes=60.0, n_steps=24),
        network=random_network(rng, count + 1, customers, peak_kw),
        customers=customers,
        pv=pv,
        batteries=replace(sized, grid_forming=np.arange(5) == 0),
        load_kw=load_kw,
        pv_kw=pv_max_kw * sun[:, None],
        price_gbp_per_kwh=rng.uniform(0.1, 0.5, 24),
        temperature_c=np.full(24, 22.0),
        grid_limit_kw=np.where(dark, 0.0, np.inf),
    )
    return in_phases(scenario, rng)


def with_a_former(scenario: Scenario) -> Scenario:
    """The scenario in physical mode, with its largest battery as the one that forms an island."""
    b = scenario.batteries
    largest = np.arange(len(b)) == (np.argmax(b.s_max_kva) if len(b) else 0)
    mode = ControllerDefaults(mode="physical")
    return replace(scenario, controller=mode, batteries=replace(b, grid_forming=largest))


class Decided(NamedTuple):
    """A window's data, what the method found of it, and the site."""

    site: Site
    data: WindowData
    found: WindowSolution


def decided(scenario: Scenario) -> Decided:
    """The first window of a day over all of its steps, decided at its first linearisation."""
    hours = (scenario.grid.n_steps - 1) * scenario.grid.dt_h
    options = RunOptions(horizon_h=hours).on(scenario)
    site = site_of(scenario, options.as_record())
    solver = WindowSolver(site, limits=options.limits)
    day = Day(scenario, options)
    seen = day.observe(make_controller(scenario, options), 0)
    _, _, data = ConvergedPlanner(solver).begun(seen)
    return Decided(site, data, solver.solve(data))


def plainly(site: Site, data: WindowData, inside: bool) -> float:
    """The most that F can be without its tie-breakers, with all rows stated at once.

    -inf if there is no dispatch. It is scaled: a GBP weighs a millionth of a customer, and what a
    kWh costs would be lost in HiGHS's tolerance.
    """
    problem = plain_problem(site, data, inside)
    scale = objective_scale(site)
    scaled = cp.Problem(cp.Maximize(scale * problem.objective.expr), problem.constraints)
    scaled.solve(solver=cp.HIGHS, mip_rel_gap=0.0, mip_abs_gap=1e-7 * scale)
    return -np.inf if scaled.value is None else float(scaled.value) / scale


def plain_problem(
    site: Site, data: WindowData, inside: bool, sides: int = SIDES_OF_INVERTERS
) -> cp.Problem:
    """The whole problem of a window but its tie-breakers, with so many sides for inverters."""
    b, pv, customers = site.batteries, site.pv, site.customers
    W, C, P, B = data.n_steps, len(customers), len(pv), len(b)
    x = cp.Variable((W, C), boolean=True)
    exported = cp.Variable((W, P), nonneg=True)
    charge, discharge = (cp.Variable((W, B), nonneg=True) for _ in range(2))
    charging = cp.Variable((W, B), boolean=True)
    energy = cp.Variable((W, B))
    q_pv, q_batt = cp.Variable((W, P)), cp.Variable((W, B))
    imported, q_grid = cp.Variable(W, nonneg=True), cp.Variable(W)
    own = cp.multiply(data.self_limit_kw(site), x[:, site.owner])
    through = own + exported
    net = charge - discharge
    most = data.active_max_kw(b)
    before = (
        cp.vstack([(b.energy_kwh * data.soc)[None, :], energy[:-1]])
        if W > 1
        else ((b.energy_kwh * data.soc)[None, :])
    )
    stored = cp.multiply(charge, np.tile(data.eta_charge, (W, 1))) - cp.multiply(
        discharge, np.tile(1.0 / data.eta_discharge, (W, 1))
    )
    physics = data.physics
    assert data.drawn
    kvar = data.load_kw * customers.q_per_p
    rows = [
        through <= data.pv_kw,
        charge <= cp.multiply(most, charging),
        discharge <= cp.multiply(most, 1 - charging),
        energy == before + site.dt_h * stored,
        energy >= data.soc_min(b) * b.energy_kwh,
        energy <= np.tile(b.soc_max * b.energy_kwh, (W, 1)),
        imported <= np.minimum(data.grid_p_max_kw(site), 1e6),
        cp.abs(q_grid) <= data.grid_q_max_kvar(site),
        imported + cp.sum(exported, axis=1) >= cp.sum(charge, axis=1),
        imported + cp.sum(through, axis=1)
        == cp.sum(net, axis=1)
        + cp.sum(cp.multiply(data.load_kw, x), axis=1)
        + data.drawn.kw.sum(axis=1),
        q_grid + cp.sum(q_pv, axis=1) + cp.sum(q_batt, axis=1)
        == cp.sum(cp.multiply(kvar, x), axis=1) + data.drawn.kvar.sum(axis=1),
        *_discs(through, q_pv, np.tile(pv.s_max_kva, (W, 1)), inside, sides),
        *_discs(net, q_batt, b.s_max_kva - physics.headroom_kw, inside, sides),
    ]
    p = cp.hstack([cp.multiply(data.load_kw, x), -through, net])
    q = cp.hstack([cp.multiply(kvar, x), -q_pv, -q_batt])
    rows += phase_rows(site, data, p, q)
    rows += part_rows(site, data, x, exported, (charge, discharge), p, q)
    w = site.weights
    curtailed = cp.sum(data.pv_kw - through)
    worth = (
        cp.sum(x @ customers.weight)
        - w.lambda_grid * (data.price_gbp_per_kwh @ imported)
        - w.lambda_curt * curtailed
    )
    return cp.Problem(cp.Maximize(site.dt_h * worth), rows)


def part_rows(
    site: Site,
    data: WindowData,
    x: cp.Variable,
    exported: cp.Variable,
    battery: tuple[cp.Variable, cp.Variable],
    p: cp.Expression,
    q: cp.Expression,
) -> list[cp.Constraint]:
    """The balance of each part behind a line that is out; nothing in those that are dead."""
    parts, at_bus = data.parts, phased_model(site).at_bus_of_assets
    assert data.drawn
    places = [(x, site.customer_bus), (exported, site.pv_bus)]
    places += [(each, site.battery_bus) for each in battery]
    found: list[cp.Constraint] = []
    for t in np.flatnonzero(parts.cut):
        for number in np.unique(parts.of_bus[t])[1:]:
            inside = parts.of_bus[t] == number
            for drawn, own in ((p, data.drawn.kw), (q, data.drawn.kvar)):
                total = float(own[t, inside].sum())
                found.append(cp.sum(drawn[t, np.flatnonzero(inside[at_bus])]) + total == 0.0)
        for letter, place in places:
            dead = np.flatnonzero(at_items(parts.dead[[t]], place)[0])
            if len(dead):
                found.append(letter[t, dead] == 0)
    return found


def _discs(
    p: cp.Expression, q: cp.Expression, radius: Floats, inside: bool, sides: int
) -> list[cp.Constraint]:
    """Polygons in place of discs."""
    reach = np.cos(np.pi / sides) if inside else 1.0
    angles = 2.0 * np.pi * np.arange(sides) / sides
    return [np.cos(a) * p + np.sin(a) * q <= reach * radius for a in angles]


def phase_rows(
    site: Site, data: WindowData, p: cp.Expression, q: cp.Expression
) -> list[cp.Constraint]:
    """Voltages of all nodes, and the former's phases, in all steps with power."""
    model = phased_model(site)
    phased = data.phased
    found: list[cp.Constraint] = []
    for t in np.flatnonzero(lit_steps(data)):
        source = int(model.sources(data)[t])
        supply = model.supplies[max(source, 0)]
        slopes = supply.slopes
        draws = np.ones(p.shape[1])
        draws[supply.devices] = 0.0
        p_t, q_t = cp.multiply(p[t], draws), cp.multiply(q[t], draws)
        by_p, by_q = slopes.of_voltages(np.arange(len(slopes.u_0)))
        u = phased.u_offset[t] + by_p @ p_t + by_q @ q_t
        limited = np.flatnonzero(model.limits_at(data, lit_steps(data))[t])
        found += [u[limited] >= phased.u_min[t][limited], u[limited] <= phased.u_max[t][limited]]
        formed = np.flatnonzero(supply.forms)
        if not len(formed):
            continue
        for angle in 2.0 * np.pi * np.arange(SIDES) / SIDES:
            turn = np.exp(-1j * angle)
            by_p, by_q = (
                np.real(turn * each[formed]) for each in (slopes.former_p, slopes.former_q)
            )
            rest = np.real(turn * phased.former_offset[t, formed])
            room = np.cos(np.pi / SIDES) * phased.room_kva[t, formed]
            found.append(rest + by_p @ p_t + by_q @ q_t <= room)
    return found


def compared(seed: int) -> str:
    """A row of the table; the last word says whether the optimum is met to the gap."""
    scenario = random_phased(seed)
    try:
        site, data, found = decided(scenario)
    except SolveError as error:
        return f"| {seed} | {type(error).__name__} | | | | no answer |"
    inner, outer = plainly(site, data, inside=True), plainly(site, data, inside=False)
    gap = max(5e-3, 1e-4 * abs(found.objective))
    meets = inner - gap <= found.objective <= outer + 1e-6 and found.bound >= inner - 1e-6
    values = f"{found.objective:.6f} | {found.bound:.6f} | {inner:.6f} | {outer:.6f}"
    return f"| {seed} | {values} | {'equal' if meets else 'differs'} |"


WINDOW_HOURS = range(4, 12)
"""Hours at which windows begin on each day of a published feeder, whose outage is from 12 to 18."""

HORIZON_H = 5.0
WEIGHTS = "weights"
FEW_SIDES = 16

BEGIN, END = "<!-- phased windows: begin -->", "<!-- phased windows: end -->"

WINDOW_COLUMNS = (
    "day",
    "begins",
    "hours of outage",
    "F",
    "gap",
    "CPU s",
)
WHOLE_COLUMNS = ("F of the whole problem", "its gap", "its CPU s")


def windows(file: Path, time_s: float) -> str:
    """A table of a feeder's windows: decided as plans are, and as the whole problem at once.

    Both are at the same linearisation and to the same gap, with tiers weighed against each other.
    The whole problem has a limit in seconds, and polygons of 16 sides around the discs of
    inverters, so that its F may be larger; without a limit it is left out. The last row has how
    many windows are certified, the largest gap, and median and most of the seconds.
    """
    columns = (*WINDOW_COLUMNS, *(WHOLE_COLUMNS if time_s else ()))
    table = [f"| {' | '.join(columns)} |", "| --- " * len(columns) + "|"]
    say("\n".join(table))
    own: list[Own] = []
    for name in DAYS:
        scenario = of_day(scenario_of(file), name)
        options = RunOptions(horizon_h=HORIZON_H, ratings=REPORT, priority=WEIGHTS)
        options = replace(options, limits=SolveLimits(time_s=LIMIT_S)).on(scenario)
        site = site_of(scenario, options.as_record())
        day, controller = Day(scenario, options), make_controller(scenario, options)
        solver = WindowSolver(site, limits=options.limits)
        for hour in WINDOW_HOURS:
            _, _, data = ConvergedPlanner(solver).begun(day.observe(controller, hour))
            dark = int(data.dark.sum())
            own.append(Own.of(solver, data))
            whole = f" | {_as_a_whole(solver, data, own[-1], time_s)}" if time_s else ""
            table.append(f"| {name} | {hour}:00 | {dark} | {own[-1]}{whole} |")
            say(table[-1])
    table.append(_of_all(own) + (" | | | |" if time_s else " |"))
    say(table[-1])
    return "\n".join(table)


def _of_all(own: list[Own]) -> str:
    """How many windows are certified, their largest gap, and median and most of their seconds."""
    certified = sum(each.found.status == Status.OPTIMAL for each in own)
    gap = max(each.found.gap for each in own)
    cpu_s = [each.cpu_s for each in own]
    seconds = f"{np.median(cpu_s):.2f}, at most {max(cpu_s):.2f}"
    return f"| all | {certified} of {len(own)} certified | | | {gap:.1e} | {seconds}"


class Own(NamedTuple):
    """A window as plans decide it, and the CPU seconds that it took."""

    found: WindowSolution
    cpu_s: float

    @classmethod
    def of(cls, solver: WindowSolver, data: WindowData) -> Own:
        """A window that is decided now."""
        began = time.process_time()
        found = solver.solve(data)
        return cls(found, time.process_time() - began)

    def __str__(self) -> str:
        return f"{self.found.objective:.4f} | {self.found.gap:.1e} | {self.cpu_s:.2f}"


def _as_a_whole(solver: WindowSolver, data: WindowData, own: Own, time_s: float) -> str:
    """F, gap and CPU seconds of the whole problem, without the time to state it."""
    problem = plain_problem(solver.site, data, inside=False, sides=FEW_SIDES)
    gap_abs = solver.limits.gap_at(own.found.objective)
    stated, chain, inverse = problem.get_problem_data(cp.HIGHS)
    options = {"mip_rel_gap": 0.0, "mip_abs_gap": gap_abs, "time_limit": time_s, "threads": 1}
    began = time.process_time()
    raw = chain.solve_via_data(problem, stated, solver_opts=options)
    cpu_s = time.process_time() - began
    info = raw["info"]
    if not np.isfinite(info.objective_function_value):
        return f"none | | {cpu_s:.1f}"
    problem.unpack_results(raw, chain, inverse)
    gap = abs(info.objective_function_value - info.mip_dual_bound) / abs(problem.value)
    return f"{problem.value:.4f} | {gap:.1e} | {cpu_s:.1f}"


def main() -> int:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--long", type=int, default=0, help="closed loops on long feeders")
    parser.add_argument("--windows", type=Path, help="a circuit, for its windows")
    parser.add_argument("--limit", type=float, default=0.0, help="seconds for the whole problem")
    parser.add_argument("--page", type=Path, help="page whose table of windows is written anew")
    given = parser.parse_args()
    if given.windows:
        table = windows(given.windows, given.limit)
        if given.page:
            put_table(given.page, table, BEGIN, END)
        return 0
    for seed in range(given.first, given.first + given.long):
        scenario = long_feeder(seed)
        assert scenario.phases
        nodes = 3 * len(scenario.phases.buses)
        say(f"| long {seed}, {nodes} nodes | {loop(scenario, balanced=False)} |")
    if given.long:
        return 0
    sys.stdout.write("| case | F | its bound | plainly, inside discs | around them | |\n")
    sys.stdout.write("| --- " * 6 + "|\n")
    for seed in range(given.first, given.first + given.cases):
        sys.stdout.write(f"{compared(seed)}\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
