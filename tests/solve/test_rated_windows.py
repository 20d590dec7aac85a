"""Ratings of lines in windows that no master in the network decides, beside the whole problem."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.rated_windows import PATIENT, rated, verdict
from tests.support.small_windows import DARK, battery, two_buses, window, with_pv
from vppres.contract.stored_value import PIECES, StoredValue
from vppres.core.units import kva_to_a
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.model.beyond_paper.ratings import limit_kva, with_ratings
from vppres.model.site import Site
from vppres.scenario.network import Network
from vppres.scenario.scenario import LIMIT
from vppres.solve.ladder import WindowSolver
from vppres.solve.limits import run_within_limits
from vppres.solve.network.rows import Rows
from vppres.solve.result import Outcome, Status


@pytest.mark.monolith
@pytest.mark.parametrize(("kind", "seed"), [("sets", 2), ("belief", 1)])
def test_ratings_and_bounds_hold_beside_the_whole_problem(kind: str, seed: int) -> None:
    """Both windows exceed a rating where none is kept."""
    case = rated(kind, seed)
    assert case is not None
    assert verdict(*case) == []


@pytest.mark.daily
def test_no_flow_is_above_its_rating_for_the_sun_that_it_would_carry() -> None:
    """Beside curtailed PV power a flow at half of its check's tolerance is worth 2e-4 of F."""
    case = rated("sets", 39)
    assert case is not None
    site, data = case
    found = WindowSolver(site, limits=PATIENT).solve(data)
    flow_kva = np.hypot(found.dispatch.p_flow_kw, found.dispatch.q_flow_kvar)
    share = flow_kva / limit_kva(with_ratings(site, data))
    assert found.dispatch.pv_curtailed_kw.sum() > 1.0
    assert 1.0 - 1e-6 < share.max() <= 1.0 + 1e-6


def test_the_battery_that_loses_least_discharges_as_far_as_a_rating_allows() -> None:
    """9 kW behind a line of some 5 kVA, in the dark.

    A battery at the customer spends 2 kWh for one, that before the line 1.25: it gives all that the
    line carries. No plan costs anything, and each kWh that is left is worth .01.
    """
    day = two_buses([[9.0]], [1.0], [DARK])
    rating_a = kva_to_a(np.array([100.0, 5.0]), 11.0)
    network = Network([1, 2], [2, 3], [0.01] * 2, [0.01] * 2, 1, base_kv=11.0, i_max_a=rating_a)
    batteries = battery(100.0, 20.0, 20.0, soc=0.5, count=2)
    batteries = replace(batteries, bus=[2, 3], eta_discharge=[0.8, 0.5])
    customers = replace(day.customers, bus=[3])
    day = replace(day, network=network, batteries=batteries, customers=customers)
    energy_kwh = np.linspace(0.0, 200.0, PIECES + 1)
    worth = StoredValue(energy_kwh, 0.01 * energy_kwh, 1000.0, as_service=True)
    site = replace(Site.of(day), rated=True)
    data = replace(window(day), stored_value=worth)
    line_kw = float(limit_kva(with_ratings(site, data))[0, 1])
    found = WindowSolver(site).solve(data)
    assert found.status == "optimal"
    assert found.dispatch.discharge_kw[0] == pytest.approx([line_kw, 9.0 - line_kw], abs=1e-3)
    left_kwh = 100.0 - 1.25 * line_kw - 2.0 * (9.0 - line_kw)
    assert found.objective == pytest.approx(1.0 + 0.01 * left_kwh, abs=1e-4)


@pytest.mark.parametrize("loads_kw", [(10.0, 5.0), (5.0, 10.0)])
def test_of_sets_of_as_much_service_the_network_takes_that_which_curtails_least(
    loads_kw: tuple[float, float],
) -> None:
    """12 kW of sun in an island for customers of 10 and of 5 kW: one of them, and 2 kW are lost.

    Either set has all the service that there can be at no cost, so that bounds on service and cost
    say nothing of the sun that a set loses.
    """
    day = two_buses([[0.0, *loads_kw]], [1.0, 1.0, 1.0], [DARK])
    day = with_pv(replace(day, network=replace(day.network, i_max_a=[100.0])), [12.0])
    site = replace(Site.of(day), rated=True)
    found = WindowSolver(site).solve(with_ratings(site, window(day)))
    assert found.dispatch.pv_curtailed_kw.sum() == pytest.approx(2.0)
    assert found.objective == pytest.approx(2.0 - 0.1 * 2.0)
    assert found.status == Status.OPTIMAL
    assert found.bound == pytest.approx(found.objective)
    assert "network_service[highs]" in found.stages
    assert not any(stage.startswith("full") for stage in found.stages)


def test_limits_that_no_longer_move_a_solution_are_not_looked_for_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A solver leaves the rating of a small line by more than what is looked for, and for ever."""

    class Left:
        near = ()

        def exceeded(self, x: Any) -> list[Rows]:
            row = np.zeros((1, 1), dtype=int)
            return [Rows.of(row, np.ones((1, 1)), 1.0, np.inf, len(x))]

    def solve(left_s: float) -> Outcome:
        rounds.append(left_s)
        problem.x = np.full(2, max(1.0 - 0.1 * len(rounds), 0.7))
        return Outcome(Status.OPTIMAL, 1.0, 1.0, 0.0)

    rounds: list[float] = []
    problem: Any = SimpleNamespace(compile=lambda: None)
    data: Any = SimpleNamespace(phased=None, flow_max_kva=np.ones(1))
    monkeypatch.setattr("vppres.solve.limits.limits_of", lambda *_: Left())
    site: Any = None
    found = run_within_limits(site, data, problem, 0.5, solve=solve)
    assert (found.status, len(rounds), problem.added) == (Status.OPTIMAL, 4, None)


@pytest.mark.parametrize(
    ("outages", "priority", "i_max_kva"),
    [("known", "weights", 5.0), ("known", "strict", 5.0), ("belief", "weights", np.inf)],
)
def test_sun_that_is_lost_leaves_no_gap_open(outages: str, priority: str, i_max_kva: float) -> None:
    """An island with a full battery and 40 kW of sun for 7 kW of customers.

    Most sun is behind the line in the first two, so its rating says how much of it is lost. By
    belief the battery had better keep room for the sun that follows.
    """
    day = two_buses([[3.0, 2.0, 2.0]] * 3, [1.0, 0.9, 0.8], [DARK] * 3)
    rating_a = kva_to_a(np.array([100.0, i_max_kva]), 11.0)
    network = Network([1, 2], [2, 3], [0.01] * 2, [0.01] * 2, 1, base_kv=11.0, i_max_a=rating_a)
    customers = replace(day.customers, bus=[3, 2, 2], tier=["critical", "high", "low"])
    day = replace(with_pv(day, [40.0] * 3), network=network, customers=customers)
    day = replace(day, batteries=battery(20.0, 10.0, 10.0, soc=0.85))
    run = run_day(day, RunOptions(horizon_h=2.0, ratings=LIMIT, outages=outages, priority=priority))
    assert (run.steps["status"] == "optimal").all()
    assert (run.steps["gap_abs"] < 2e-3).all()
    assert run.customers["served"].all()
