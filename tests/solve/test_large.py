"""Large windows: the same answers by other ways, which need less time and memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.dispatch_check import check_dispatch
from tests.support.injections import in_network
from tests.support.small_windows import window
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.network.buses import Reactance
from vppres.solve.result import Status, WindowSolution

TIME_S = 20.0


def weak(packaged: Scenario) -> tuple[Scenario, WindowData]:
    """A day of so much load that voltages decide who is served, and an evening of it."""
    heavy = replace(packaged, load_kw=packaged.load_kw * 1.6)
    return heavy, window(heavy, slice(18, 22), 0.3)


def solved(day: Scenario, data: WindowData) -> WindowSolution:
    """The window's solution, which must satisfy every equation."""
    answer = WindowSolver(Site.of(day)).solve(data)
    name, worst = check_dispatch(day, data, answer.dispatch).worst
    assert worst < 2e-5, name
    return answer


def test_lines_feed_what_lies_behind_them() -> None:
    """1 - 2 - 3 with 4 behind 2, by hand."""
    r = np.full(3, 0.1)
    net = Network([1, 2, 2], [2, 3, 4], r, r, slack_bus=1, base_kv=11.0)
    expected = [[0.0, 1.0, 1.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    assert net.buses.tolist() == [1, 2, 3, 4]
    assert net.downstream.toarray().tolist() == expected


def test_voltages_without_tables_are_those_with_them(
    packaged: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = Site.of(packaged)
    tables = Reactance(site)
    monkeypatch.setattr("vppres.solve.sizes.WIDE", 0)
    flows = Reactance(site)
    assert flows.tables is None
    rng = np.random.default_rng(4)
    p, q = rng.normal(0.0, 100.0, (2, 3, site.network.n_buses))
    np.testing.assert_allclose(flows.raised(1.0, p, q), tables.raised(1.0, p, q), atol=1e-12)
    rise = rng.normal(0.0, 0.01, (3, site.network.n_lines))
    np.testing.assert_allclose(flows.along(rise), tables.along(rise), atol=1e-12)
    buses = np.arange(site.network.n_buses)
    for held in (0 * buses, buses[::-1]):
        np.testing.assert_allclose(flows.rows(buses, held), tables.rows(buses, held), atol=1e-15)


def test_reactive_power_in_two_parts_proves_the_same(
    packaged: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    heavy, data = weak(packaged)
    site = Site.of(heavy)

    def service() -> tuple[float, float]:
        master = in_network(site, data)
        return master.root[1].value, sum(len(rows.lower) for rows in master.network.found)

    value, tangents = service()
    monkeypatch.setattr("vppres.solve.sizes.LARGE", 0)
    parted, fewer = service()
    # Discs are met to a tolerance only, so the same bound comes out to within it.
    assert parted == pytest.approx(value, rel=1e-5)
    assert fewer < 0.9 * tangents
    answer = solved(heavy, data)
    assert "network_service[highs]" in answer.stages


@pytest.mark.parametrize("hour", [14, 18])
def test_a_huge_window_is_answered_without_the_tie_breakers(
    packaged: Scenario, monkeypatch: pytest.MonkeyPatch, hour: int
) -> None:
    heavy, _ = weak(packaged)
    data = window(heavy, slice(hour, hour + 4), 0.3)
    usual = solved(heavy, data)
    for name in ("LARGE", "WIDE", "HUGE"):
        monkeypatch.setattr(f"vppres.solve.sizes.{name}", 0)
    answer = solved(heavy, data)
    assert not any(stage.startswith("tie_breakers") for stage in answer.stages)
    assert answer.status in (Status.OPTIMAL, Status.GAP_OPEN)
    assert answer.objective <= usual.bound + 1e-6
    assert answer.bound >= usual.objective - 1e-6
    assert answer.gap < 1e-3
