"""A finished run in the net that it came from: the power flow of the net is that of the record."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pandapower as pp
import pandapower.networks
import pandas as pd
import pytest

import vppres
from tests.support.carried_out import assert_voltages
from vppres.core.errors import InputError
from vppres.day.trajectory import Trajectory
from vppres.feeders import ImportedFeeder
from vppres.report.run_folder import write_run
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario

OUTAGE = (pd.Timestamp("2025-07-01T08:00Z"), pd.Timestamp("2025-07-01T16:00Z"))


def crowded_net() -> Any:
    """A feeder whose elements of every kind the scenario takes over, and a shunt that stays."""
    net = pandapower.networks.case33bw()
    net.line.loc[net.line["in_service"], "c_nf_per_km"] = 0.0
    pp.create_sgen(net, 10, p_mw=0.2, type="PV", name="roof")
    pp.create_sgen(net, 20, p_mw=0.15, type="WP", name="mill")
    pp.create_storage(
        net, 17, p_mw=0.05, max_e_mwh=2.0, sn_mva=1.2, name="old", soc_percent=50.0
    )  # fmt: skip
    return net


def made(net: Any, **options: Any) -> tuple[ImportedFeeder, Scenario]:
    """The feeder of a net, and six steps on it, two of them without grid."""
    feeder = vppres.import_network(net)
    rules = {"step_minutes": 240.0, "draw_tiers": True, "outages": (OUTAGE,), **options}
    return feeder, vppres.new_scenario(feeder, vppres.NewScenarioOptions(**rules))


@cache
def day_of(make: Callable[[], Any], mode: str, **options: Any) -> tuple[ImportedFeeder, Trajectory]:
    """The feeder of a net, and a run on it."""
    feeder, day = made(make(), **options)
    return feeder, vppres.run_day(day, vppres.RunOptions("idle", mode=mode))


def agrees(net: Any, feeder: ImportedFeeder, network: Network, v_pu: Any, import_kw: float) -> None:
    """The net's voltages and what its grid gives are those of the record."""
    assert_voltages(net, feeder, network, v_pu)
    given_kw = 1000 * net.res_ext_grid["p_mw"].sum()
    assert given_kw == pytest.approx(import_kw, abs=0.01)


def put(net: Any, feeder: ImportedFeeder, run: Trajectory, t: int) -> None:
    """Put a step of a run into the net, which agrees with it."""
    network = run.scenario.network
    run.apply_to(net, feeder, run.steps["time"].iloc[t])
    v_pu = run.buses["v_ac_pu"].iloc[t * network.n_buses : (t + 1) * network.n_buses]
    agrees(net, feeder, network, v_pu, run.steps["p_grid_kw"].iloc[t])


def told(net: Any, feeder: ImportedFeeder, reads: Iterable[Mapping[str, bool]]) -> Iterator[int]:
    """Put live steps into the net, each after reading some switches; it agrees with each."""
    options = vppres.NewScenarioOptions(step_minutes=120.0, add_batteries=True)
    day = vppres.new_scenario(feeder, options)
    controller = vppres.Controller.of(day, vppres.RunOptions("idle", mode="physical"))
    soc = dict.fromkeys(day.batteries.id, 0.5)
    for t, read in enumerate(reads):
        step = controller.step(vppres.Measurement(controller.times[t], soc, closed=read))
        step.apply_to(net, feeder)
        agrees(net, feeder, day.network, step.buses["v_ac_pu"], step.import_kw)
        yield t


@pytest.mark.daily
@pytest.mark.parametrize("mode", [pytest.param("paper", marks=pytest.mark.nightly), "physical"])
def test_every_step_agrees_with_the_record(mode: str) -> None:
    net = crowded_net()
    feeder, run = day_of(crowded_net, mode, add_batteries=True)
    for t, outage in enumerate(run.steps["outage"].tolist()):
        put(net, feeder, run, t)
        assert net.ext_grid["in_service"].iloc[0] == (not outage)
    assert not net.load["in_service"].iloc[:32].any()
    for table in (net.sgen, net.storage):
        assert not table.loc[table["vppres"] != "put", "in_service"].any()
    for no_step in ("2025-07-01T08:30Z", "yesterday", "2025-07-01T08:00"):
        with pytest.raises(InputError, match="is not the beginning of a step"):
            run.apply_to(net, feeder, no_step)


@pytest.mark.nightly
def test_a_run_folder_read_back_does_the_same(tmp_path: Path) -> None:
    feeder, run = day_of(crowded_net, "physical", add_batteries=True)
    write_run(run, tmp_path / "run", figures=False)
    put(crowded_net(), feeder, vppres.read_run(tmp_path / "run"), 2)


@pytest.mark.nightly
def test_in_the_dark_nothing_is_left_on() -> None:
    net = pandapower.networks.case33bw()
    feeder, run = day_of(pandapower.networks.case33bw, "physical")
    run.apply_to(net, feeder, "2025-07-01T12:00Z")
    assert not net.ext_grid["in_service"].any()
    assert net.load.loc[net.load["in_service"], "p_mw"].sum() == 0.0
    put(net, feeder, run, 4)


def test_transformers_and_charging_stay_as_they_are() -> None:
    net = pandapower.networks.simple_four_bus_system()
    feeder, run = day_of(pandapower.networks.simple_four_bus_system, "paper", add_batteries=True)
    for t in range(len(run.steps)):
        put(net, feeder, run, t)


def state_of(net: Any) -> dict[str, list[bool]]:
    columns = {"line": "in_service", "trafo": "in_service", "switch": "closed"}
    return {table: net[table][column].tolist() for table, column in columns.items()}


@pytest.mark.daily
@pytest.mark.parametrize("mode", ["paper", "physical"])
def test_lines_that_are_out_or_open_carry_nothing_and_ties_that_are_closed_do(mode: str) -> None:
    """A fault behind which a battery holds a part, an outage meanwhile, ties that take over."""
    net, start = pandapower.networks.case33bw(), pd.Timestamp("2025-07-01T00:00Z")
    before = state_of(net)
    feeder, day = made(net, add_batteries=True)
    hour = pd.Timedelta(hours=1)
    faults = (
        vppres.LineFault(start + 4 * hour, start + 12 * hour, line=6),
        vppres.LineFault(start + 20 * hour, start + 24 * hour, bus=20),
    )
    options = vppres.RunOptions(horizon_h=8.0, mode=mode, move_switches=True)
    run = vppres.run_day(replace(day, faults=faults), options)
    moved = run.steps["switched"].tolist()
    assert moved[1].startswith("closed ") and moved[5].startswith("closed ")
    for t in (5, 0, 1, 2, 3, 4):
        put(net, feeder, run, t)
        assert (state_of(net) == before) == (t == 0)


def test_set_points_of_switches_that_are_read_are_put_into_the_net() -> None:
    """The net's own switches and branches: a tie of a switch, one of a line, one out of service."""
    net = ringed_net()
    feeder, before = vppres.import_network(net), state_of(net)
    names, starts, ends = (getattr(feeder.switches, n) for n in ("id", "from_bus", "to_bus"))
    at = {str(name): {*pair} for name, *pair in zip(names, starts, ends, strict=True)}
    assert sorted(map(sorted, at.values())) == [[1, 2], [1, 4], [2, 3], [3, 4]]
    tie, open_end, off, closed = (
        next(name for name, pair in at.items() if pair == wanted)
        for wanted in ({3, 4}, {1, 4}, {2, 3}, {1, 2})
    )
    reads = ({}, {closed: False}, {off: True}, {off: False, open_end: True}, {tie: True},
             {open_end: False, tie: False, closed: True})  # fmt: skip
    for t in told(net, feeder, reads):
        assert (state_of(net) == before) == (t in (0, 5))


def ringed_net() -> Any:
    """Five buses: a line with a switch, and ties as an open switch, an open end and a line off."""
    net = pp.create_empty_network()
    buses = [pp.create_bus(net, vn_kv=11.0) for _ in range(5)]
    pp.create_ext_grid(net, buses[0])
    lines = {
        (a, b): pp.create_line_from_parameters(net, a, b, 1.0, 0.4, 0.3, 0.0, 0.4)
        for a, b in ((0, 1), (1, 2), (1, 3), (0, 4), (1, 4), (2, 3))
    }
    pp.create_switch(net, 1, lines[1, 2], et="l", closed=True, name="S12")
    pp.create_switch(net, 4, lines[1, 4], et="l", closed=False, name="T14")
    net.line.loc[lines[2, 3], "in_service"] = False
    pp.create_switch(net, 3, 4, et="b", closed=False, name="T34")
    for bus in buses[1:]:
        pp.create_load(net, bus, p_mw=0.3, q_mvar=0.1)
    return net


def test_capacitors_that_an_island_cannot_hold_are_off_there() -> None:
    """Line 1 joins the grid: what is behind it is an island while its switch is open."""
    net = pandapower.networks.example_simple()
    feeder = vppres.import_network(net)
    states = (True, False, True)
    for t in told(net, feeder, [{"Line 1": is_closed} for is_closed in states]):
        assert net.shunt["in_service"].tolist() == [states[t]]
