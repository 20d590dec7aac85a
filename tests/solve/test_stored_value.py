"""The value of stored energy in a window: by hand, against the monolith, in every master."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from tests.support.agreement import SHARP, assert_certified
from tests.support.rated_windows import bent
from tests.support.small_windows import DARK, OPEN, battery, two_buses, window, with_pv
from vppres.contract.stored_value import PIECES, StoredValue
from vppres.control.converged import physics_of
from vppres.model.beyond_paper.losses import lossless
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import WindowSolution

GBP_PER_SERVICE = 1000.0


def worth(per_kwh: float, least_kwh: float, most_kwh: float, as_service: bool) -> StoredValue:
    """Each kWh is worth the same, in weighted customer hours."""
    energy = np.linspace(least_kwh, most_kwh, PIECES + 1)
    return StoredValue(energy, per_kwh * (energy - least_kwh), GBP_PER_SERVICE, as_service)


def dark_hour(weights: list[float], load_kw: list[float]) -> Scenario:
    """An hour without grid, and a battery with 42.75 kW for it."""
    day = two_buses([load_kw], weights, [DARK])
    return replace(day, batteries=battery(soc=0.6, p_max_kw=90.0))


def solved(day: Scenario, value: StoredValue, method: str = "decomposed") -> WindowSolution:
    return WindowSolver(Site.of(day), method).solve(replace(window(day), stored_value=value))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("per_kwh", "served"), [(0.01, [1, 1]), (0.03, [1, 0]), (0.1, [0, 0])])
def test_service_is_given_up_for_later_by_hand(
    method: str, per_kwh: float, served: list[int]
) -> None:
    """A kWh at the terminals takes 1/.95 of store: customers are worth .057 and .019 a stored kWh."""
    day = dark_hour([1.2, 0.4], [20.0, 20.0])
    answer = solved(day, worth(per_kwh, 15.0, 85.0, True), method)
    assert answer.dispatch.served[0].tolist() == [bool(x) for x in served]
    kept_kwh = 60.0 - 20.0 * sum(served) / 0.95
    assert answer.dispatch.soc[-1, 0] == pytest.approx(kept_kwh / 100.0, abs=2e-6)
    expected = float(np.array(served) @ [1.2, 0.4]) + per_kwh * (kept_kwh - 15.0)
    assert answer.objective == pytest.approx(expected, abs=2e-5)
    assert answer.status == "optimal"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("gbp_per_kwh", "soc"), [(0.2, 0.15), (0.3, 0.15), (0.33, 0.8)])
def test_energy_is_bought_where_it_is_worth_more_by_hand(
    method: str, gbp_per_kwh: float, soc: float
) -> None:
    """At 0.3 GBP a stored kWh costs .316, and takes .285 off the import where it is drawn."""
    day = two_buses([[60.0]], [1.0], [OPEN])
    day = replace(day, batteries=battery(soc=0.4, p_max_kw=40.0 / 0.95))
    value = worth(gbp_per_kwh / GBP_PER_SERVICE, 15.0, 85.0, False)
    answer = solved(day, value, method)
    expected = 0.4 if gbp_per_kwh == 0.3 else soc
    assert answer.dispatch.soc[-1, 0] == pytest.approx(expected, abs=1e-5)
    assert answer.dispatch.served.all()
    assert answer.status == "optimal"


def test_the_sun_is_kept_rather_than_lost() -> None:
    """30 kW of sun and 20 of demand: what is left is stored, although it is worth little."""
    day = with_pv(dark_hour([1.0], [20.0]), [30.0])
    answer = solved(day, worth(1e-4, 15.0, 85.0, True))
    assert answer.dispatch.soc[-1, 0] == pytest.approx(0.6 + 0.095, abs=1e-5)


@pytest.mark.parametrize("way", ["one-battery", "every-battery"])
def test_every_master_weighs_later_service(
    way: str, nightly: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each finds and proves the same optimum by itself, without the search with all terms."""
    if way == "every-battery":
        monkeypatch.setattr("vppres.solve.ladder.fleets_of", lambda _: (False,))
    monkeypatch.setattr("vppres.solve.ladder.all_terms", lambda _: None)
    rng = np.random.default_rng(4)
    wrong = []
    for seed in range(4 if nightly else 2):
        load = rng.uniform(1.0, 9.0, 30)
        day = two_buses([load], rng.choice([1.0, 0.1, 0.02], 30), [DARK])
        day = replace(day, batteries=battery(soc=0.7, p_max_kw=45.0, count=3, energy_kwh=60.0))
        data = window(day)
        data = replace(
            data, stored_value=bent(np.random.default_rng([seed, 11]), data, Site.of(day))
        )
        answer = WindowSolver(Site.of(day)).solve(data)
        whole = WindowSolver(Site.of(day), "monolithic", limits=SHARP).solve(data)
        near = abs(answer.objective - whole.objective) <= 1e-4 * whole.objective
        if not (near and answer.status == "optimal" and "relaxed" not in " ".join(answer.stages)):
            wrong.append((seed, answer.objective, whole.objective, answer.stages))
    assert not wrong


@pytest.mark.monolith
@pytest.mark.parametrize("physical", [False, True])
def test_certificates_hold_against_the_monolith(nightly: bool, physical: bool) -> None:
    """One step of random feeders, with grid and without, weak ones too."""
    for seed in range(8 if nightly else 3):
        scenario, data = random_window(seed, stressed=seed % 2 == 1)
        site = Site.of(scenario)
        if not len(site.batteries):
            continue
        data = data.first(1)
        if seed % 3:
            data = replace(data, grid_limit_kw=np.zeros(1))
        data = replace(data, stored_value=bent(np.random.default_rng([seed, 11]), data, site))
        if physical:
            data = lossless(data, physics_of(site, data, 0.1))
        assert_certified(site, data)


def test_a_window_that_is_cut_knows_no_value() -> None:
    day = two_buses([[10.0]] * 2, [1.0], [DARK] * 2)
    day = replace(day, batteries=battery(soc=0.5))
    data = replace(window(day), stored_value=worth(0.1, 15.0, 85.0, True))
    assert data.first(1).stored_value is None
    assert data.first(2).stored_value is data.stored_value
