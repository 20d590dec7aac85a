"""What makes a feeder of a net only on request: opened loops, one grid of several, balanced loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandapower as pp
import pandapower.networks as pp_networks
import pytest

from tests.support.refusals import refusal
from tests.support.small_nets import LINE
from vppres.cli.tables import content_of
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.feeders import import_network
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario, write_new_scenario
from vppres.io.scenario_folder import read_scenario
from vppres.report.run_folder import write_run
from vppres.scenario.remarks import source_words
from vppres.scenario.source import Source

# Some of pandapower's own examples warn while they are built.
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning")


def ring() -> Any:
    """Bus 1 is fed over 4 km directly, and over 1 km and 1 km by way of bus 2."""
    net = pp.create_empty_network()
    pp.create_buses(net, 3, vn_kv=20.0)
    pp.create_ext_grid(net, 0, vm_pu=1.01)
    for start, end, km, name in ((0, 1, 4.0, "long"), (0, 2, 1.0, "east"), (1, 2, 1.0, "west")):
        pp.create_line_from_parameters(net, start, end, length_km=km, name=name, **LINE)
    pp.create_load(net, 1, p_mw=0.3, q_mvar=0.1, name="mill")
    return net


def test_the_branch_with_the_least_current_is_opened() -> None:
    # The long way has twice the impedance of the other and carries a third.
    feeder = import_network(ring(), open_loops=True)
    network = feeder.network
    lines = set(zip(network.from_bus, network.to_bus, strict=True))
    assert lines == {(0, 2), (2, 1)}
    assert feeder.notes[0] == (
        "The net is meshed: to open its 1 loops (--open-loops), those branches are taken out of "
        "service that carry the least current: line 0 (long)."
    )
    assert "Against the mesh, opening moves voltages by at most 0.00" in feeder.notes[1]


def test_lines_of_next_to_no_impedance_leave_the_flow_of_the_mesh() -> None:
    """Beside a micro-ohm at 230 kV the last digits of 80 MW are rounding."""
    net = pp.create_empty_network()
    pp.create_buses(net, 5, vn_kv=230.0)
    pp.create_ext_grid(net, 0, vm_pu=1.01)
    for start, end, ohm in ((0, 1, 20.0), (1, 2, 1e-6), (2, 3, 20.0), (0, 4, 40.0), (4, 3, 10.0)):
        pp.create_line_from_parameters(
            net, start, end, 1.0, r_ohm_per_km=ohm, x_ohm_per_km=ohm, c_nf_per_km=0.0, max_i_ka=9.0
        )
    pp.create_loads(net, [2, 3], p_mw=40.0, q_mvar=10.0)
    feeder = import_network(net, open_loops=True)
    assert feeder.notes[0].endswith("the least current: line 2.")
    assert feeder.opened_pu == pytest.approx(0.017, abs=5e-4)


def test_a_mesh_that_opening_changes_much_is_refused_and_told(tmp_path: Path) -> None:
    net = ring()
    net.load["p_mw"] = 20.0
    feeder = import_network(net, open_loops=True)
    refused = refusal(write_new_scenario, feeder, NewScenarioOptions(), tmp_path / "new")
    moved = "0.011 pu"
    assert f"Causes: opened loops (--open-loops), {moved}" in refused
    write_new_scenario(feeder, NewScenarioOptions(accept_deviation=True), tmp_path / "new")
    words = f"{moved} by opening its loops"
    assert words in (tmp_path / "new" / "notes.md").read_text()
    assert words in source_words(read_scenario(tmp_path / "new"))[0]


def test_parallel_lines_are_opened_together() -> None:
    net = ring()
    net.line.loc[0, "length_km"] = 12.0
    pp.create_line_from_parameters(net, 0, 1, length_km=12.0, name="beside", **LINE)
    note = import_network(net, open_loops=True).notes[0]
    assert note.endswith("the least current: line 0 (long), line 3 (beside).")


@pytest.mark.nightly
def test_a_published_mesh_is_opened_as_its_authors_did() -> None:
    # Shirmohammadi and Hong on the 33 buses of Baran and Wu: 7, 10, 14, 32 and 37, 140.28 kW.
    net = pp_networks.case33bw()
    net.line["in_service"] = True
    feeder = import_network(net, open_loops=True)
    _, _, names = feeder.notes[0].rstrip(".").rpartition(": ")
    opened = {int(name.removeprefix("line ")) + 1 for name in names.split(", ")}
    assert opened == {7, 10, 14, 32, 37}
    assert feeder.deviation.losses_kw == pytest.approx(140.28, abs=0.01)


@pytest.mark.parametrize("branch", ["east", "line 1"])
def test_branches_named_by_the_user_are_opened_first(branch: str) -> None:
    feeder = import_network(ring(), open_branches=[branch], open_loops=True)
    assert feeder.notes == ()
    assert feeder.network.from_bus[feeder.network.to_bus.tolist().index(2)] == 1


# Several grids


def two_grids() -> Any:
    """Two feeders with a grid each, and an open tie between them."""
    net = ring()
    net.line.loc[0, "in_service"] = False
    pp.create_buses(net, 2, vn_kv=20.0)
    pp.create_ext_grid(net, 3, vm_pu=1.01, name="north")
    pp.create_line_from_parameters(net, 3, 4, length_km=1.0, name="far", **LINE)
    pp.create_load(net, 4, p_mw=0.2, name="farm")
    return net


@pytest.mark.parametrize("word", ["north", "3"])
def test_one_grid_is_chosen(word: str) -> None:
    feeder = import_network(two_grids(), slack=word)
    assert feeder.network.slack_bus == 3
    assert set(feeder.network.buses) == {3, 4}
    assert feeder.notes == (
        "The grid connection is ext_grid 1 (north) (--slack); no longer feeding, and out of "
        "service: ext_grid 0.",
        "Without supply or out of service, and left out: bus 0, 1, 2.",
        "Left out with their buses: load 0 (mill), 300 kW.",
    )


def test_all_grids_are_joined() -> None:
    feeder = import_network(two_grids(), slack="all")
    assert feeder.p_load_kw.sum() == pytest.approx(500.0)
    assert "2 external grids hold the same voltage and are joined" in feeder.notes[0]
    assert feeder.deviation.v_max_pu < 1e-6


@pytest.mark.parametrize("word", [None, "plant"])
def test_a_generator_can_be_the_grid_connection(word: str | None) -> None:
    net = two_grids()
    net.ext_grid = net.ext_grid.iloc[:0]
    pp.create_gen(net, 0, p_mw=0.0, vm_pu=1.03, slack=word is None, name="plant")
    feeder = import_network(net, slack=word)
    assert feeder.network.slack_bus == 0
    assert feeder.network.v_slack_pu == 1.03
    assert feeder.notes[0] == "Gen 0 (plant) is taken as the grid connection."
    assert len(feeder.generators) == 0


# Single phases


def by_phase() -> Any:
    net = ring()
    net.line.loc[0, "in_service"] = False
    pp.create_asymmetric_load(
        net, 2, p_a_mw=0.010, p_b_mw=0.020, p_c_mw=0.030, q_a_mvar=0.006, scaling=0.5
    )
    pp.create_asymmetric_sgen(net, 1, p_a_mw=0.012, name="roof", type="PV")
    return net


def two_levels() -> Any:
    """Two grids that hold different voltages."""
    net = two_grids()
    net.ext_grid.loc[1, "vm_pu"] = 1.0
    return net


def low_voltage(clock: int) -> Any:
    """A transformer and three lines, with loads and a generator of single phases."""
    net = pp.create_empty_network()
    buses = [pp.create_bus(net, 10.0), *(pp.create_bus(net, 0.4) for _ in range(4))]
    pp.create_ext_grid(net, buses[0], vm_pu=1.02)
    zero = {"vk0_percent": 3.8, "vkr0_percent": 1.1, "mag0_percent": 100, "mag0_rx": 0.1}
    pp.create_transformer_from_parameters(
        net, *buses[:2], sn_mva=0.25, vn_hv_kv=10.0, vn_lv_kv=0.4, vkr_percent=1.2, vk_percent=4.0,
        pfe_kw=0.6, i0_percent=0.3, shift_degree=30.0 * clock, vector_group="Dyn",
        si0_hv_partial=0.9, **zero,
    )  # fmt: skip
    for start, end in ((1, 2), (2, 3), (2, 4)):
        pp.create_line_from_parameters(
            net, buses[start], buses[end], 0.15, r_ohm_per_km=0.25, x_ohm_per_km=0.08,
            c_nf_per_km=260.0, max_i_ka=0.25, r0_ohm_per_km=1.0, x0_ohm_per_km=0.32,
            c0_nf_per_km=150.0,
        )  # fmt: skip
    pp.create_load(net, buses[2], p_mw=0.01, q_mvar=0.002)
    pp.create_asymmetric_load(net, buses[3], p_a_mw=0.02, q_a_mvar=0.005, p_b_mw=0.008)
    pp.create_asymmetric_load(net, buses[4], p_a_mw=0.012, p_b_mw=0.003, type="delta")
    pp.create_asymmetric_sgen(net, buses[2], p_a_mw=0.004)
    return net


@pytest.mark.parametrize(
    "clock", [5, *(pytest.param(clock, marks=pytest.mark.nightly) for clock in (1, 11))]
)
def test_single_phases_are_kept_with_the_voltages_of_pandapower(clock: int) -> None:
    feeder = import_network(low_voltage(clock))
    assert feeder.phased.difference_pu is not None
    assert feeder.phased.difference_pu < 1e-6
    coils = {load.connection.id: load.connection.coils for load in feeder.phased.loads}
    assert coils["0"] == "a b c" and coils["0pa"] == "a" and coils["1pbc"] == "bc"
    options = NewScenarioOptions(pv="sized", add_batteries=True)
    day = new_scenario(feeder, options)
    assert day.phases
    assert len(day.customers) == 5


def star_star() -> Any:
    """A vector group that is not known by phase."""
    net = low_voltage(0)
    net.trafo["vector_group"] = "YNyn"
    return net


@pytest.mark.parametrize(("make", "choices", "message"), [
    (ring, {},
        ": is meshed, with 1 loop. The feeder must be radial: let --open-loops open the branches with "
        "the least current, or open one of each loop with --open; the first consist of line 1 (east), "
        "line 0 (long), line 2 (west)."),
    (two_grids, {},
        ": has 2 external grids: ext_grid 0 at bus 0, ext_grid 1 (north) at bus 3. Choose one with "
        "--slack, by its name or its bus; --slack all joins those that hold the same voltage."),
    (two_levels, {"slack": "all"},
        ", slack = all: has grids that hold different voltages: ext_grid 0 1.01 pu, ext_grid 1 (north) "
        "1 pu. Choose one of them."),
    (two_grids, {"slack": "south"},
        ", slack = south: is no external grid of the network. There is ext_grid 0"),
    (by_phase, {},
        ": is not balanced, and its table line lacks r0_ohm_per_km, x0_ohm_per_km, c0_nf_per_km. Give "
        "them, or: the model is balanced: --balance spreads every load over three phases, and says how "
        "far from that the source is."),
    (star_star, {}, ": trafo 0 is YNyn0: Dyn and Yzn"),
])  # fmt: skip
def test_what_needs_a_request_is_refused_by_name(
    make: Callable[[], Any], choices: dict[str, str], message: str
) -> None:
    found = refusal(import_network, make(), **choices)
    assert found.startswith(f"pandapower net{message}")
    assert found == f"pandapower net{message}" or not message.endswith(".")


def test_single_phases_are_spread_with_a_note() -> None:
    feeder = import_network(by_phase(), balance=True)
    load_kw = dict(zip(feeder.network.buses, feeder.p_load_kw, strict=True))
    assert load_kw == pytest.approx({0: 0.0, 1: 300.0, 2: 30.0})
    assert feeder.q_load_kvar.sum() == pytest.approx(103.0)
    assert (feeder.generators.kind.tolist(), feeder.generators.p_kw.tolist()) == (["PV"], [12.0])
    # 12 kW feed in on one phase at bus 1; the load at bus 2 differs by 10 kW.
    assert feeder.notes[0].endswith(
        "Phases draw -7.0, 10.0 and 15.0 kW in all; they differ most at bus 1, by 12.0 kW: "
        "-12.0, 0.0 and 0.0."
    )
    assert feeder.notes[1].startswith("Voltages are compared with the net so balanced, not with ")


def test_phases_that_no_run_knows_are_said_first(tmp_path: Path) -> None:
    feeder = import_network(by_phase(), balance=True)
    rules = NewScenarioOptions(add_batteries=True, accept_deviation=True, step_minutes=360.0)
    write_new_scenario(feeder, rules, tmp_path / "lane")
    day = read_scenario(tmp_path / "lane")
    unknown, unchecked = content_of(day)["remarks"][:2]
    assert unknown.startswith(
        "Phases are not known here: the source is unbalanced (1 loads by phase beside 1 of three"
    )
    assert unchecked.startswith("Not checked: the phases of what forms the island (b1).")
    run = run_day(day, RunOptions(controller="idle", mode="physical"))
    summary = write_run(run, tmp_path / "run", kinds=())
    assert summary["cautions"][0].startswith("The island was blacked out")
    assert summary["cautions"][1:3] == [unknown, unchecked]
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert 0 < page.find(unknown) < page.find("Supply</h3>")
    assert content_of(replace(day, source=Source()))["remarks"][:1] != [unknown]


SINGLE_PHASE = """
new circuit.lane basekv=0.4 pu=1.0 bus1=src phases=3 isc3=1e9 isc1=1e9
new line.main bus1=src bus2=a phases=3 r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0 length=1 units=km
new line.drop bus1=a.2 bus2=b.2 phases=1 r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0
new load.even bus1=a phases=3 kv=0.4 kw=9 kvar=0
new load.house bus1=b.2 phases=1 kv=0.23 kw=4 kvar=1
new load.oven bus1=a.1.3 phases=1 conn=delta kv=0.4 kw=6 kvar=0
set voltagebases=[0.4]
"""


@pytest.mark.nightly
def test_opendss_is_balanced_on_request_only(tmp_path: Path) -> None:
    file = tmp_path / "lane.dss"
    file.write_text(SINGLE_PHASE)
    phased = import_network(file).phased
    coils = {load.connection.id: load.connection.coils for load in phased.loads}
    assert coils == {"even": "a b c", "house": "b", "oven": "ac"}
    feeder = import_network(file, balance=True)
    # The delta load counts half on either of its phases.
    assert (
        "Phases draw 6.0, 7.0 and 6.0 kW in all; they differ most at bus b, by 4.0 kW: "
        "0.0, 4.0 and 0.0." in " ".join(feeder.notes)
    )
    assert feeder.p_load_kw.sum() == pytest.approx(19.0)
