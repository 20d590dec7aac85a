"""Whole customers whose demand takes up the sun: by exchanges, against all sets."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from tests.support.dispatch_check import check_dispatch
from tests.support.small_windows import CHECKER_TOLERANCE, DARK, two_buses, window, with_pv
from vppres.model.site import Site
from vppres.solve.fleet.matching import exchanged
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import Status


@pytest.mark.parametrize("seed", range(10))
def test_few_customers_are_near_the_best_of_all_sets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    load_kw = rng.uniform(1.0, 20.0, 10)
    worth = 0.1 * load_kw + rng.choice([0.0, 0.02, 0.1, 1.0], 10)
    given_kw = 0.6 * load_kw.sum()
    sets = np.array(list(product((False, True), repeat=10)))
    fits = sets @ load_kw <= given_kw
    best = (sets[fits] @ worth).max()
    served = exchanged(worth, load_kw, given_kw)
    assert load_kw @ served <= given_kw
    assert worth @ served >= 0.99 * best


def test_many_customers_take_up_all_but_a_watt() -> None:
    rng = np.random.default_rng(3)
    load_kw = rng.uniform(1.0, 20.0, 80)
    given_kw = 0.6 * load_kw.sum()
    served = exchanged(load_kw, load_kw, given_kw)
    assert 0.0 <= given_kw - load_kw @ served < 1e-3


def test_nobody_of_no_worth_is_served() -> None:
    assert exchanged(np.array([0.0, 1.0]), np.array([1.0, 2.0]), 9.0).tolist() == [False, True]
    assert not exchanged(np.ones(2), np.array([3.0, 4.0]), 2.0).any()


@pytest.mark.parametrize("seed", range(4))
def test_a_dark_step_without_batteries_agrees_with_the_whole_problem(seed: int) -> None:
    rng = np.random.default_rng(seed)
    load_kw = rng.uniform(1.0, 6.0, 24)
    weight = rng.choice([0.02, 0.1, 1.0], 24)
    scenario = with_pv(two_buses([load_kw.tolist()], weight.tolist(), [DARK]), [50.0])
    data = window(scenario)
    site = Site.of(scenario)
    found = WindowSolver(site).solve(data)
    whole = WindowSolver(site, method="monolithic").solve(data)
    assert "matched[highs]" in found.stages
    assert found.status == Status.OPTIMAL
    assert found.objective <= whole.bound + 1e-6
    assert whole.objective <= found.bound + 1e-6
    assert check_dispatch(scenario, data, found.dispatch).worst[1] < CHECKER_TOLERANCE
