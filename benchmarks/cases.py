"""All windows of the project's own tables, one after the other, each made when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial

from benchmarks.feeders import feeder_scenario, with_days, with_step
from benchmarks.frame.random_feeders import Window, random_state, random_window
from benchmarks.hard import HardInstance, read_hard
from benchmarks.instances import Instance, packaged, read_instances, window_data
from benchmarks.scaling import DAYS, windows_of
from benchmarks.scaling import Case as Point
from vppres.control.converged import ConvergedPlanner, dark_steps, physics_of, without_power
from vppres.model.beyond_paper.losses import linearised, lossless
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver

HEADROOM = 0.1
"""Share of the inverters that physical windows keep free, the default of a run."""

LARGE_BUSES = 1021
"""Size of the large feeder: 15 copies of 69 buses."""

LONG_STEPS = (48, 96)
"""Steps of the long windows of hours: two and four outages."""

FINE_MINUTES = (15, 5)
"""Length of a step in the long windows of six hours: 24 and 72 steps."""


@dataclass(frozen=True)
class Case:
    """A window: its group, its name and how it is made."""

    group: str
    name: str
    make: Callable[[], tuple[Site, WindowData]]


def cases() -> Iterator[Case]:
    """All windows, group after group."""
    for instance in read_instances():
        yield Case("packaged day", instance.name, partial(_of_instance, instance))
    for hard in read_hard():
        yield Case("users", hard.name, partial(_of_hard, hard))
    for group, make, counts in (
        ("random", random_window, (100, 100)),
        ("switching rules", ruled_window, (30, 20)),
        ("physical", physical_window, (16, 16)),
    ):
        for stressed, count in zip((False, True), counts, strict=True):
            for seed in range(count):
                name = f"{group} {'stressed ' if stressed else ''}{seed}"
                yield Case(group, name, partial(_of_random, make, seed, stressed))
    for number in range(24):
        yield Case("large", f"large {number}", partial(_of_large, number))
    for steps in LONG_STEPS:
        for number in range(12):
            name = f"{steps} hours {number}"
            yield Case(
                "long", name, partial(_of_point, _of_days, Point("steps", steps, 0.0), number)
            )
    for minutes in FINE_MINUTES:
        for number in range(6):
            name = f"{minutes} min {number}"
            point = Point("minutes", minutes, 0.0)
            yield Case("long", name, partial(_of_point, _of_minutes, point, number))


def sample(found: list[Case], share: dict[str, int]) -> list[Case]:
    """Every N-th window of each group, N by the group's name; all of a group without one."""
    seen: dict[str, int] = {}
    kept = []
    for case in found:
        number = seen.get(case.group, 0)
        seen[case.group] = number + 1
        if number % share.get(case.group, 1) == 0:
            kept.append(case)
    return kept


def _of_instance(instance: Instance) -> tuple[Site, WindowData]:
    """Site and data of a window of the packaged scenario."""
    return Site.of(packaged()), window_data(instance)


def _of_hard(instance: HardInstance) -> tuple[Site, WindowData]:
    """Site and data of a window of the kinds that users bring."""
    return instance.window.site, instance.window.data


def _of_random(
    make: Callable[[int, bool], Window], seed: int, stressed: bool
) -> tuple[Site, WindowData]:
    """Site and data of a random window."""
    case = make(seed, stressed)
    return Site.of(case.scenario), case.data


def ruled_window(seed: int, stressed: bool) -> Window:
    """A random window with random switching rules and a random past."""
    case = random_window(seed, stressed)
    state = random_state(seed, case.scenario)
    data = replace(case.data, switching=state.window(case.data.n_steps))
    return Window(case.scenario, data)


def physical_window(seed: int, stressed: bool) -> Window:
    """A random window with headroom, and losses as at the AC points of its lossless answer."""
    case = random_window(seed, stressed)
    site = Site.of(case.scenario)
    lit = without_power(case.data, dark_steps(site, case.data))
    start = lossless(lit, physics_of(site, lit, HEADROOM))
    planner = ConvergedPlanner(WindowSolver(site))
    points = planner.linearisation.points(start, planner.solver.solve(start).dispatch)
    return Window(case.scenario, linearised(start, site.network, points))


@cache
def _of_days(_: int) -> Scenario:
    """The packaged day several times in a row."""
    return with_days(packaged(), DAYS)


@cache
def _of_minutes(minutes: int) -> Scenario:
    """The packaged day in finer steps."""
    return with_step(packaged(), minutes)


@cache
def _of_buses(buses: int) -> Scenario:
    """The packaged day on a larger feeder."""
    return feeder_scenario(buses)


def _of_large(number: int) -> tuple[Site, WindowData]:
    """Site and data of a window of the large feeder."""
    return _of_point(_of_buses, Point("buses", LARGE_BUSES, 0.0), number)


def _of_point(
    day_of: Callable[[int], Scenario], point: Point, number: int
) -> tuple[Site, WindowData]:
    """Site and data of a window of the scaling study."""
    day = day_of(point.size)
    return Site.of(day), windows_of(point, day)[number]
