"""Sets under switching rules that are improved in blocks of steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.hard_days import HardWindow, hard_window
from tests.support.dispatch_check import check_dispatch
from tests.support.programs import knapsack
from tests.support.small_windows import CHECKER_TOLERANCE
from vppres.core.arrays import Flags
from vppres.model.numerics import objective_scale
from vppres.model.site import Site
from vppres.solve.blocks import BlockSearch
from vppres.solve.cache import shared_cache
from vppres.solve.deadline import Deadline
from vppres.solve.fleet.masters import relaxation_of
from vppres.solve.fleet.steady import steady_sets
from vppres.solve.ladder import WindowSolver
from vppres.solve.programs import ProgramSolution, columns_of, compiled
from vppres.solve.result import Outcome, Status

TIME_S = 20.0
SEEDS = (1, 2, 4, 5, 7, 9)
"""Windows with rules that have a dispatch."""

NO_SEARCH = Outcome(Status.NO_ANSWER, np.nan, np.nan, 0.0)


def blocks_of(case: HardWindow, gap: float) -> BlockSearch:
    """The search of a window's relaxation without the network."""
    rules = case.data.switching
    assert rules is not None
    cache = shared_cache(case.site)
    model = relaxation_of(cache, case.data, integer=True, lumped=True)
    model.fill(case.data)
    program, first = compiled(model.problem)
    assert model.switching is not None
    service, *follow = (
        columns_of(first, v.name(), v.shape) for v in (model.x, *model.switching.follow)
    )
    gap *= objective_scale(case.site)
    return BlockSearch(program, service, follow, rules, gap, Deadline(TIME_S))


@pytest.mark.parametrize("seed", SEEDS)
def test_blocks_lead_from_a_poor_set_to_nearly_the_best(seed: int) -> None:
    case = hard_window("rules", seed)
    blocks = blocks_of(case, 1e-4)
    program = blocks.program
    poorest = list(steady_sets(case.site, case.data))[-1:]
    found = blocks.improved(poorest)
    begun = blocks.answer_of(poorest[0])
    assert found is not None
    assert begun is not None
    best = ProgramSolution.of(program.loaded(blocks.gap_abs), Deadline(TIME_S))
    assert best.status == Status.OPTIMAL
    assert best.bound - 1e-6 * abs(best.bound) <= found.value <= begun.value
    assert begun.value - found.value >= 0.9 * (begun.value - best.value)
    left = program.rows @ found.x
    size = 1e-6 * (1.0 + np.abs(program.rows) @ np.abs(found.x))
    assert (left >= program.lower - size).all()
    assert (left <= program.upper + size).all()
    rules = case.data.switching
    assert rules is not None
    assert not rules.broken(found.x[blocks.service] > 0.5).any()


def test_a_set_that_breaks_a_rule_has_no_answer() -> None:
    case = hard_window("rules", 1)
    blocks = blocks_of(case, 1e-4)
    rules = case.data.switching
    assert rules is not None
    flicker = np.zeros(case.data.load_kw.shape, dtype=bool)
    flicker[::2] = True
    assert rules.broken(flicker).any()
    assert blocks.improved([flicker]) is None
    good = next(steady_sets(case.site, case.data))
    assert blocks.improved([flicker, good]) is not None


@pytest.mark.parametrize("seed", range(3))
def test_a_program_of_some_columns_is_the_program_with_the_others_held(seed: int) -> None:
    program = knapsack(seed)
    begun = np.zeros(len(program.cost))
    begun[::4] = ProgramSolution.of(program.loaded(), Deadline(TIME_S)).x[::4]
    free = np.arange(len(begun)) % 4 != 0
    part = program.of_columns(free, begun)
    found = ProgramSolution.of(part.loaded(), Deadline(TIME_S))
    held = replace(
        program,
        x_lower=np.where(free, program.x_lower, begun),
        x_upper=np.where(free, program.x_upper, begun),
    )
    whole = ProgramSolution.of(held.loaded(), Deadline(TIME_S))
    assert len(part.integer) == free.sum()
    assert found.value + program.cost[~free] @ begun[~free] == pytest.approx(whole.value, abs=1e-6)


def test_columns_that_service_decides_have_bounds_of_their_own() -> None:
    """Without them HiGHS's presolve may never end where most of the service is held."""
    blocks = blocks_of(hard_window("rules", 1), 1e-4)
    assert len(blocks.follow) >= 2
    for columns in blocks.follow:
        assert (blocks.program.x_lower[columns] == 0.0).all()
        assert (blocks.program.x_upper[columns] == 1.0).all()


@pytest.mark.parametrize("where", ["fleet", "network"])
def test_where_no_search_ends_blocks_have_an_answer(
    monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    """In the network window 12 is searched at once, since that binds; others without it."""
    case = hard_window("rules", 12)
    scenario = case.day.scenario
    if where == "fleet":
        wide = replace(case.site.network, v_min_pu=0.5, v_max_pu=1.5)
        scenario = replace(scenario, network=wide)
    site = Site.of(scenario)
    whole = WindowSolver(site).solve(case.data)
    monkeypatch.setattr("vppres.solve.fleet.all_terms.search_for_set", lambda *_: NO_SEARCH)
    monkeypatch.setattr(
        "vppres.solve.network.terms.NetworkTerms.search", lambda *_: (NO_SEARCH, [])
    )
    for name in ("worth_an_answer", "worth_the_whole"):
        monkeypatch.setattr(f"vppres.solve.ladder.{name}", lambda _: False)
    cut = WindowSolver(site).solve(case.data)
    stages = [stage.partition("[")[0] for stage in cut.stages]
    assert ("blocks" if where == "fleet" else "network_blocks") in stages
    assert whole.bound >= cut.objective >= 0.95 * whole.objective > 0.0
    served: Flags = cut.dispatch.served
    assert case.data.switching is not None
    assert not case.data.switching.broken(served).any()
    cold = case.data.for_service(served)
    assert check_dispatch(scenario, cold, cut.dispatch).worst[1] < CHECKER_TOLERANCE
