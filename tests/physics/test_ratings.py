"""Line ratings from import to report: what they are, and the loading that follows from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pandapower.networks as networks
import pandas as pd
import pytest

from tests.support.made_up_runs import small_run, small_scenario
from tests.support.refusals import refusal
from vppres.core.units import kva_to_a
from vppres.day import metrics
from vppres.feeders import import_network
from vppres.io import read_scenario, write_scenario
from vppres.io.digest import scenario_digest
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario

pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning")


def three_lines(i_max_a: list[float]) -> Network:
    """Three lines in a row with these ratings."""
    ohm = [0.1] * 3
    return Network([1, 2, 3], [2, 3, 4], ohm, ohm, slack_bus=1, base_kv=11.0, i_max_a=i_max_a)


def rated_scenario() -> Scenario:
    """The small day; the line to bus 4 has no rating."""
    return replace(small_scenario(), network=three_lines([10.0, 20.0, np.inf]))


def test_lines_have_no_rating_unless_given() -> None:
    assert np.isinf(small_scenario().network.i_max_a).all()
    assert metrics.line_figures(small_run())["line_loading_max"] is None


def test_ratings_follow_their_lines_when_these_are_sorted() -> None:
    net = Network(
        [2, 1], [3, 2], [0.2, 0.1], [0.1, 0.1], slack_bus=1, base_kv=11.0, i_max_a=[30.0, 20.0]
    )
    assert net.to_bus.tolist() == [2, 3]
    assert net.i_max_a.tolist() == [20.0, 30.0]


@pytest.mark.parametrize(("i_max_a", "message"), [
    ([10.0, 0.0, 1.0], "lines, row 1, i_max_a = 0.0: must be positive"),
    ([10.0, np.nan, 1.0], "must be positive. Give the thermal rating in A"),
    ([10.0], "must have one value for each of the 3 lines"),
])  # fmt: skip
def test_a_wrong_rating_is_refused(i_max_a: list[float], message: str) -> None:
    assert message in refusal(three_lines, i_max_a)


def test_a_folder_keeps_ratings_and_an_empty_cell_is_none(tmp_path: Path) -> None:
    day = rated_scenario()
    write_scenario(day, tmp_path / "day")
    assert pd.read_csv(tmp_path / "day" / "lines.csv")["i_max_a"].isna().tolist() == [
        False,
        False,
        True,
    ]
    again = read_scenario(tmp_path / "day")
    assert again.network.i_max_a.tolist() == [10.0, 20.0, np.inf]
    assert scenario_digest(again) == scenario_digest(day) != scenario_digest(small_scenario())


def test_currents_and_loading_by_hand() -> None:
    run = small_run(rated_scenario())
    # 3 kW and 4 kvar in every line; only bus 1 of the arrays is not at 1 pu.
    run = replace(run, lines=run.lines.assign(p_ac_kw=3.0, q_ac_kvar=-4.0))
    full = 5.0 / (np.sqrt(3.0) * 11.0)
    current = metrics.line_current_a(run)
    assert current[0] == pytest.approx([full, full / 0.98, full])
    assert current[3] == pytest.approx([full, full / 0.95, full])
    loading = metrics.line_loading(run)
    assert loading[0, :2] == pytest.approx([full / 10.0, full / 0.98 / 20.0])
    assert np.isnan(loading[:, 2]).all()
    figures = metrics.line_figures(run)
    assert figures["line_current_max_a"] == pytest.approx(full / 0.95)
    assert figures["line_loading_max"] == pytest.approx(full / 10.0)


def test_a_dead_line_carries_no_current() -> None:
    run = small_run(rated_scenario())
    run = replace(
        run, lines=run.lines.assign(p_ac_kw=0.0, q_ac_kvar=0.0), buses=run.buses.assign(v_ac_pu=0.0)
    )
    assert (metrics.line_current_a(run) == 0.0).all()


@pytest.mark.parametrize("source", [
    networks.create_cigre_network_mv,
    pytest.param(networks.simple_mv_open_ring_net, marks=pytest.mark.nightly),
])  # fmt: skip
def test_loading_is_pandapower_s(source: Callable[[], Any]) -> None:
    """Line by line; charging, which the feeder leaves out, is taken from the source too."""
    net = source()
    net.line["c_nf_per_km"] = 0.0
    net.trafo[["pfe_kw", "i0_percent"]] = 0.0
    feeder = import_network(net)
    result = ACPowerFlow(feeder.network).solve(*feeder.injection)
    own = feeder.network
    current = kva_to_a(
        np.hypot(result.p_from_kw, result.q_from_kvar), result.v_pu[own.parent] * own.base_kv
    )
    ends_of = zip(own.from_bus, own.to_bus, strict=True)
    at = {
        frozenset(ends): share for ends, share in zip(ends_of, current / own.i_max_a, strict=True)
    }
    pp.runpp(net, calculate_voltage_angles=False, tolerance_mva=1e-9, numba=False)
    compared = 0
    for row, line in net.line.iterrows():
        ends = frozenset((feeder.bus_of.get(line["from_bus"]), feeder.bus_of.get(line["to_bus"])))
        if ends in at and net.res_line.at[row, "p_from_mw"] != 0.0:
            percent = net.res_line.at[row, "loading_percent"]
            assert at[ends] == pytest.approx(percent / 100.0, abs=1e-6)
            compared += 1
    assert compared >= 3


def test_parallel_lines_are_limited_by_the_first_that_is_full() -> None:
    net = pp.create_empty_network()
    pp.create_buses(net, 2, vn_kv=20.0)
    pp.create_ext_grid(net, 0)
    each = {"length_km": 1.0, "c_nf_per_km": 0.0}
    # A third of the impedance takes three quarters of the current.
    pp.create_line_from_parameters(
        net, 0, 1, r_ohm_per_km=0.3, x_ohm_per_km=0.3, max_i_ka=0.1, **each
    )
    pp.create_line_from_parameters(
        net, 0, 1, r_ohm_per_km=0.1, x_ohm_per_km=0.1, max_i_ka=0.15, **each
    )
    pp.create_load(net, 1, p_mw=0.1)
    assert import_network(net).network.i_max_a == pytest.approx([200.0])


def test_opendss_gives_its_normal_currents(tmp_path: Path) -> None:
    pytest.importorskip("opendssdirect")
    file = tmp_path / "two.dss"
    file.write_text(
        """clear
new circuit.two bus1=a basekv=11 pu=1.0 r1=0 x1=0.0001 r0=0 x0=0.0001
new line.first bus1=a bus2=b length=1 units=km r1=0.2 x1=0.1 r0=0.2 x0=0.1 c1=0 c0=0 normamps=120
new line.second bus1=b bus2=c length=1 units=km r1=0.2 x1=0.1 r0=0.2 x0=0.1 c1=0 c0=0
new load.end bus1=c kv=11 kw=100 kvar=0
set voltagebases=[11]
calcvoltagebases
""",
        encoding="utf-8",
    )
    feeder = import_network(file)
    assert feeder.network.i_max_a.tolist() == pytest.approx([120.0, np.inf])
    assert any("1 of 2 lines have 400 A" in note for note in feeder.notes)
