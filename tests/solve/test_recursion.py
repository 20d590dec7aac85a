"""Most service of one battery, step by step: against all sets, and against the search."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from benchmarks.scaling import Case, windows_of
from vppres.core.errors import SolveError
from vppres.model.site import Site
from vppres.solve.fleet.reach import OneBattery
from vppres.solve.fleet.recursion import Losses, fewest_lost, most_units
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, Status, WindowSolution

WEIGHTS = np.array([1, 1, 3])


def one_battery(rng: np.random.Generator) -> OneBattery:
    """A battery that carries some of what three customers draw in three dark steps."""
    return OneBattery(
        stored_kwh=rng.uniform(5.0, 40.0),
        most_kwh=45.0,
        least_kwh=np.full(3, 4.0),
        power_kw=np.full(3, rng.uniform(8.0, 30.0)),
        given_kw=rng.uniform(0.0, 20.0, 3),
        per_charged=0.9,
        per_discharged=1.2,
    )


def carries(one: OneBattery, demand_kw: np.ndarray) -> bool:
    """The same by plain arithmetic."""
    stored = one.stored_kwh
    for t, demand in enumerate(demand_kw):
        spare = one.given_kw[t] - demand
        if spare >= 0.0:
            stored = min(stored + 0.9 * min(spare, one.power_kw[t]), 45.0)
        elif -spare > one.power_kw[t] or stored + 1.2 * spare < 4.0:
            return False
        else:
            stored += 1.2 * spare
    return True


@pytest.mark.parametrize("seed", range(12))
def test_no_set_loses_fewer_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    load_kw = rng.uniform(2.0, 15.0, (3, 3))
    one = one_battery(rng)
    losses = [Losses.of([1, 3], [load[:2], load[2:]], 15) for load in load_kw]
    sets = [np.array(bits).reshape(3, 3) for bits in product((0, 1), repeat=9)]
    carried = [s for s in sets if carries(one, (load_kw * s).sum(axis=1))]
    lost = [int(((1 - s) * WEIGHTS).sum()) for s in carried]
    ways = fewest_lost(one, load_kw.sum(axis=1), losses, 15)
    if not lost:
        assert ways is None
        return
    assert ways is not None
    assert sum(int(step.units[way]) for step, way in zip(losses, ways, strict=True)) == min(lost)
    saved_kw = [step.saved_kw[way] for step, way in zip(losses, ways, strict=True)]
    assert carries(one, load_kw.sum(axis=1) - np.array(saved_kw))
    if min(lost):
        assert fewest_lost(one, load_kw.sum(axis=1), losses, min(lost) - 1) is None


@pytest.mark.daily
@pytest.mark.parametrize("stressed", [False, True])
def test_binaries_and_the_recursion_agree(
    monkeypatch: pytest.MonkeyPatch, nightly: bool, stressed: bool
) -> None:
    """Random windows in two ways: no answer exceeds another's bound."""
    closed = 0
    seeds = range(12 if nightly else 2)
    for seed in seeds:
        case = random_window(seed, stressed)
        solver = WindowSolver(Site.of(case.scenario), limits=SolveLimits(time_s=30.0))
        answers: list[WindowSolution | None] = []
        for step_by_step in (most_units, nothing):
            with monkeypatch.context() as patched:
                patched.setattr("vppres.solve.fleet.masters.most_units", step_by_step)
                try:
                    answers.append(solver.solve(case.data))
                except SolveError:
                    answers.append(None)
        found = [answer for answer in answers if answer is not None]
        assert len(found) in (0, 2), seed
        for one, other in permutations(found, 2):
            assert one.objective <= other.bound + 1e-6 * max(1.0, abs(one.objective)), seed
        closed += all(answer.status == Status.OPTIMAL for answer in found)
    assert 6 * closed >= 5 * len(seeds)


def nothing(*_: object) -> tuple[float, None]:
    """No recursion."""
    return np.inf, None


def test_a_dark_window_of_quarter_hours_is_decided() -> None:
    """A search had three units open after a minute."""
    case = Case(axis="minutes", size=15, time_s=10.0)
    day = case.scenario()
    data = windows_of(case, day)[11]
    assert (data.grid_limit_kw == 0.0).all()
    answer = WindowSolver(Site.of(day), limits=SolveLimits(time_s=10.0)).solve(data)
    assert answer.status == Status.OPTIMAL
    assert answer.gap < 1e-6
