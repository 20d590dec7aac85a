"""Networks without the buses at which nothing happens: the same optimum, answers on all buses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.feeders import feeder_scenario
from tests.support.dispatch_check import check_dispatch
from tests.support.small_windows import window
from vppres.model.reduction import Reduction
from vppres.model.site import Site
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver


def with_idle_buses(day: Scenario) -> Scenario:
    """The day with each line in two parts of unlike R/X, and a dead end behind each bus."""
    net = day.network
    middle = [f"m{bus}" for bus in net.to_bus]
    dead = [f"d{bus}" for bus in net.to_bus]
    parts = Network(
        np.array([*net.from_bus, *middle, *net.to_bus], dtype=object),
        np.array([*middle, *net.to_bus, *dead], dtype=object),
        np.concatenate([0.2 * net.r_ohm, 0.8 * net.r_ohm, net.r_ohm]),
        np.concatenate([0.7 * net.x_ohm, 0.3 * net.x_ohm, net.x_ohm]),
        slack_bus=net.buses[0],
        base_kv=net.base_kv,
        v_min_pu=net.v_min_pu,
    )
    return replace(day, network=parts)


def test_lines_in_series_become_one_and_dead_ends_go() -> None:
    """1 - 2 - 3 - 4 with 5 behind 2, by hand: customers at 4 only."""
    day = feeder_scenario(33)
    r = np.array([0.1, 0.2, 0.4, 0.8])
    net = Network([1, 2, 3, 2], [2, 3, 4, 5], r, 2.0 * r, slack_bus=1, base_kv=11.0)
    customers = replace(day.customers, bus=np.full(len(day.customers), 4, dtype=object))
    batteries = replace(day.batteries, bus=np.full(len(day.batteries), 4, dtype=object))
    site = Site.of(replace(day, network=net, customers=customers, batteries=batteries))
    found = Reduction.of(site)
    assert found is not None
    assert found.site.network.buses.tolist() == [1, 4]
    assert found.site.network.r_ohm == pytest.approx([0.7])
    assert found.site.network.x_ohm == pytest.approx([1.4])
    offsets = np.array([[1.0, 10.0, 100.0, 1000.0]])  # of the lines to 2, 3, 5 and 4
    assert site.network.to_bus.tolist() == [2, 3, 5, 4]
    assert (offsets @ found.merged.T).tolist() == [[1011.0]]


def test_nothing_is_reduced_where_every_bus_counts() -> None:
    assert Reduction.of(Site.of(feeder_scenario(33))) is None


@pytest.mark.parametrize("hour", [10, 13])
def test_a_reduced_window_has_the_same_optimum(monkeypatch: pytest.MonkeyPatch, hour: int) -> None:
    day = feeder_scenario(33)
    longer = with_idle_buses(day)
    rows = slice(hour, hour + 3)
    plain = WindowSolver(Site.of(day)).solve(window(day, rows, 0.5))
    whole = WindowSolver(Site.of(longer)).solve(window(longer, rows, 0.5))
    monkeypatch.setattr("vppres.solve.task.LARGE", 0)
    data = window(longer, rows, 0.5)
    reduced = WindowSolver(Site.of(longer)).solve(data)
    assert any(stage.startswith("tie_breakers") for stage in reduced.stages)
    for other in (plain, whole):
        assert reduced.objective == pytest.approx(other.objective, abs=1e-7)
        assert reduced.terms.f4 == pytest.approx(other.terms.f4, rel=1e-4)
    assert reduced.dispatch.v_pu.shape == (3, longer.network.n_buses)
    name, worst = check_dispatch(longer, data, reduced.dispatch).worst
    assert worst < 2e-5, name


def test_a_limit_that_only_a_bus_left_out_exceeds_is_seen() -> None:
    longer = with_idle_buses(feeder_scenario(33))
    site = Site.of(longer)
    data = window(longer, slice(13, 15), 0.5)
    reduction = Reduction.of(site)
    assert reduction is not None
    dispatch = WindowSolver(site).solve(data).dispatch
    same = reduction.expanded(data, reduction.reduced(dispatch))
    np.testing.assert_allclose(same.v_pu, dispatch.v_pu, atol=2e-6)
    assert reduction.within_limits(data, same, 1e-6)
    low = same.v_pu.copy()
    low[1, site.network.bus_index["m18"]] = 0.9
    assert not reduction.within_limits(data, replace(same, v_pu=low), 1e-6)
