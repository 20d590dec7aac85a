"""Imported networks: their AC power flow is that of the source, and what cannot be is refused."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pandapower.networks as pp_networks
import pytest
import scipy.io

from tests.support.refusals import refusal
from tests.support.small_nets import LINE
from vppres.core.errors import InputError
from vppres.feeders import NAMED, ImportedFeeder, import_network
from vppres.feeders.closeness import NOT_CONVERGED, source_deviation, told_deviation
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario, write_new_scenario
from vppres.io import read_scenario
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.source import SourceDeviation

# Some of pandapower's own examples warn while they are built.
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning")

AGREEMENT = 1e-6
TRAFO = {
    "sn_mva": 1.0,
    "vn_hv_kv": 20.0,
    "vn_lv_kv": 0.4,
    "vkr_percent": 1.0,
    "vk_percent": 5.0,
    "pfe_kw": 0.0,
    "i0_percent": 0.0,
}


@cache
def built_two_buses() -> Any:
    """Bus 0 feeds bus 1 over one line, with 300 kW and 100 kvar at its end."""
    net = pp.create_empty_network()
    pp.create_buses(net, 2, vn_kv=20.0)
    pp.create_ext_grid(net, 0, vm_pu=1.01)
    pp.create_line_from_parameters(net, 0, 1, length_km=4.0, name="feeder", **LINE)
    pp.create_load(net, 1, p_mw=0.3, q_mvar=0.1, name="mill")
    return net


def two_buses() -> Any:
    """A copy to be changed: pandapower takes longer to build one."""
    return deepcopy(built_two_buses())


@cache
def built_every_branch() -> Any:
    """Parallel lines and transformers, three windings, a bus coupler and an impedance."""
    net = two_buses()
    pp.create_buses(net, 6, vn_kv=20.0)  # 2 to 7
    net.bus.loc[[4, 6, 7], "vn_kv"] = 0.4
    net.bus.loc[5, "vn_kv"] = 10.0
    pp.create_line_from_parameters(net, 1, 0, length_km=1.5, parallel=2, **LINE)
    pp.create_switch(net, 1, 2, et="b", closed=True)
    for _ in range(2):
        pp.create_transformer_from_parameters(net, 2, 4, **TRAFO)
    pp.create_transformer3w_from_parameters(
        net, 2, 5, 6, pfe_kw=0.0, i0_percent=0.0,
        vn_hv_kv=20.0, vn_mv_kv=10.0, vn_lv_kv=0.4,
        sn_hv_mva=2.0, sn_mv_mva=1.0, sn_lv_mva=1.0,
        vk_hv_percent=6.0, vk_mv_percent=6.0, vk_lv_percent=6.0,
        vkr_hv_percent=0.9, vkr_mv_percent=0.8, vkr_lv_percent=0.7,
    )  # fmt: skip
    pp.create_impedance(net, 2, 3, rft_pu=0.01, xft_pu=0.02, sn_mva=1.0)
    pp.create_line_from_parameters(net, 4, 7, length_km=0.02, **LINE)
    for bus, p_mw in ((3, 0.2), (4, 0.15), (5, 0.3), (6, 0.1), (7, 0.05)):
        pp.create_load(net, bus, p_mw=p_mw, q_mvar=p_mw / 4, scaling=0.9)
    pp.create_sgen(net, 5, p_mw=0.12, q_mvar=0.01, sn_mva=0.15, type="PV")
    return net


def every_branch() -> Any:
    """A copy to be changed."""
    return deepcopy(built_every_branch())


def cigre_without_charging() -> Any:
    net = pp_networks.create_cigre_network_mv(with_der="pv_wind")
    net.line["c_nf_per_km"] = 0.0
    return net


def solved(net: Any) -> Any:
    """The source's own power flow."""
    pp.runpp(net, calculate_voltage_angles=False, tolerance_mva=1e-9, numba=False)
    return net


def differences(net: Any, feeder: ImportedFeeder) -> tuple[float, float]:
    """Largest voltage difference in pu, and difference of the losses in kW."""
    result = ACPowerFlow(feeder.network).solve(*feeder.injection)
    v_pu = {bus: result.v_pu[feeder.network.bus_index[b]] for bus, b in feeder.bus_of.items()}
    losses_mw = sum(
        net[f"res_{table}"]["pl_mw"].sum() for table in ("line", "trafo", "trafo3w", "impedance")
    )
    return (
        max(abs(v - net.res_bus.vm_pu[bus]) for bus, v in v_pu.items()),
        abs(result.losses_kw - 1e3 * losses_mw),
    )


@pytest.mark.parametrize("make", [
    every_branch,
    cigre_without_charging,
    pp_networks.case33bw,
    pytest.param(pp_networks.create_cigre_network_lv, marks=pytest.mark.nightly),
])  # fmt: skip
def test_power_flow_is_the_source_s(make: Callable[[], Any]) -> None:
    net = solved(make())
    feeder = import_network(net)
    v_pu, losses_kw = differences(net, feeder)
    assert (v_pu, losses_kw) == pytest.approx((0.0, 0.0), abs=AGREEMENT)
    assert feeder.deviation.v_max_pu < AGREEMENT
    assert str(feeder.deviation).startswith(
        "Voltages are identical to the source's power flow (within 1e-6 pu)."
    )
    assert set(feeder.bus_of) == set(net.bus.index)


def with_everything() -> Any:
    """Taps, charging, leakage, no-load losses, shunts, a ward, an open end, parallel units."""
    net = every_branch()
    net.line["c_nf_per_km"], net.line["g_us_per_km"] = 300.0, 5.0
    net.trafo["i0_percent"], net.trafo["pfe_kw"] = 0.5, 1.5
    net.trafo["tap_side"], net.trafo["tap_changer_type"] = "hv", "Ratio"
    net.trafo[["tap_neutral", "tap_pos", "tap_step_percent"]] = 0, 2, 1.25
    pp.create_shunt(net, 3, p_mw=0.01, q_mvar=-0.2)
    pp.create_ward(net, 3, ps_mw=0.05, qs_mvar=0.01, pz_mw=0.04, qz_mvar=-0.02)
    pp.create_load(net, 3, p_mw=0.2, q_mvar=-0.1)
    pp.create_load(net, 1, p_mw=0.0, q_mvar=0.02, name="reactive")
    net.load = net.load[(net.load["bus"] != 1) | (net.load["p_mw"] == 0.0)]
    line = pp.create_line_from_parameters(
        net, 3, 0, length_km=4.0, name="tie", **LINE | {"c_nf_per_km": 400.0}
    )
    pp.create_switch(net, 0, line, et="l", closed=False)
    return net


def test_taps_charging_and_shunts_are_the_source_s() -> None:
    net = solved(with_everything())
    feeder = import_network(net)
    v_pu, _ = differences(net, feeder)
    assert v_pu < 1e-8
    stated = feeder.deviation
    assert stated.no_load_pu is not None
    assert max(stated.v_max_pu, stated.no_load_pu) < 1e-8
    assert stated.losses_kw == pytest.approx(stated.losses_source_kw, abs=1e-3)
    assert feeder.network.has_ratios and feeder.network.has_charging and feeder.network.has_draws
    reactive = feeder.network.bus_index[1]
    assert feeder.network.q_fixed_kvar[reactive] == pytest.approx(20.0)
    assert feeder.p_load_kw[reactive] == feeder.q_load_kvar[reactive] == 0.0


def test_parallel_transformers_of_different_taps_are_one_two_port() -> None:
    """A current circulates between them."""
    net = two_buses()
    pp.create_bus(net, vn_kv=0.4)
    for ratio in (1.05, 0.975):
        pp.create_transformer_from_parameters(
            net, 1, 2, 0.4, net.bus.vn_kv.at[1], 0.4, 1.0, 4.0, 0.8, 0.3,
            tap_side="hv", tap_neutral=0, tap_pos=1, tap_step_percent=100 * (ratio - 1),
            tap_changer_type="Ratio",
        )  # fmt: skip
    pp.create_load(net, 2, p_mw=0.3, q_mvar=0.1)
    feeder = import_network(solved(net))
    assert differences(net, feeder)[0] < 1e-8


def test_next_to_no_impedance_is_a_closed_switch() -> None:
    net = two_buses()
    pp.create_bus(net, vn_kv=net.bus.vn_kv.at[1])
    tiny = LINE | {"r_ohm_per_km": 0.9e-6 * net.bus.vn_kv.at[1] ** 2, "x_ohm_per_km": 0.0}
    pp.create_line_from_parameters(net, 1, 2, length_km=1.0, name="switch", **tiny)
    pp.create_line_from_parameters(net, 2, 1, length_km=1.0, name="beside", **LINE)
    pp.create_load(net, 2, p_mw=0.1)
    feeder = import_network(solved(net))
    assert feeder.bus_of[1] == feeder.bus_of[2]
    assert feeder.notes == (
        "Branches of less than 1e-06 pu (on 1 MVA) count as closed switches, and their ends as one "
        "bus: line 1 (switch), line 2 (beside).",
    )
    assert differences(net, feeder)[0] < 1e-6


def test_a_source_that_does_not_converge_says_so(tmp_path: Path) -> None:
    net = two_buses()
    net.load["p_mw"] = 500.0
    feeder = import_network(net)
    assert feeder.deviation is None
    deviation = source_deviation(feeder, new_scenario(feeder))
    assert deviation == SourceDeviation()
    assert told_deviation(feeder, deviation) == NOT_CONVERGED
    # Most likely its loads are in kW: that stands before everything else.
    notes = write_new_scenario(feeder, NewScenarioOptions(), tmp_path / "kw")
    assert notes[0] == NOT_CONVERGED
    assert not any("Is the file in W?" in note for note in notes)
    assert "First check the units of its loads" in NOT_CONVERGED


def test_what_differs_needs_to_be_accepted(tmp_path: Path) -> None:
    net = two_buses()
    net.line["length_km"] = 13.5
    net.load[["p_mw", "q_mvar"]] *= 15
    net.load["const_z_p_percent"] = net.load["const_z_q_percent"] = 100.0
    feeder = import_network(net)
    assert feeder.deviation.v_max_pu > 0.005
    with pytest.raises(InputError, match=r"loads of constant impedance .* --accept-deviation"):
        write_new_scenario(feeder, NewScenarioOptions(), tmp_path / "refused")
    assert not (tmp_path / "refused").exists()
    accepted = NewScenarioOptions(accept_deviation=True)
    notes = write_new_scenario(feeder, accepted, tmp_path / "accepted")
    assert any(note.startswith("Causes of the difference of ") for note in notes)
    stated = read_scenario(tmp_path / "accepted").source.deviation
    assert stated.as_given_pu == pytest.approx(feeder.deviation.v_max_pu)
    assert stated.no_load_pu == pytest.approx(0.0, abs=1e-9)
    # At no load and at the same powers the feeder is exact: only what the loads draw differs.
    assert stated.worst_hour_pu == pytest.approx(0.0, abs=1e-8)


def test_every_simplification_has_its_note() -> None:
    net = every_branch()
    net.trafo["i0_percent"] = 0.1
    net.trafo["tap_side"], net.trafo["tap_changer_type"] = "hv", "Ratio"
    net.trafo[["tap_neutral", "tap_pos", "tap_step_percent"]] = 0, 2, 1.25
    net.load["const_z_p_percent"] = [100.0] + [0.0] * 5
    pp.create_shunt(net, 3, q_mvar=-0.1)
    pp.create_storage(net, 3, p_mw=0.1, max_e_mwh=0.2)
    pp.create_gen(net, 3, p_mw=0.1, vm_pu=1.0, name="hydro")
    pp.create_bus(net, vn_kv=20.0)
    pp.create_load(net, 8, p_mw=0.1, name="barn")
    pp.create_storage(net, 8, p_mw=0.1, max_e_mwh=0.2, name="barn battery")
    line = pp.create_line_from_parameters(net, 3, 0, length_km=1.0, name="tie", **LINE)
    pp.create_switch(net, 0, line, et="l", closed=False)
    feeder = import_network(net)
    assert feeder.notes == (
        "Without supply or out of service, and left out: bus 8.",
        "Left out with their buses: load 6 (barn), 100 kW.",
        "Left out with their buses: storage 1 (barn battery), 100 kW.",
        "Closed switches make one bus of the buses 1, 2.",
        "Open at one end, and kept as shunts of 0 kvar: line 3 (tie).",
        "The voltage levels 0.4, 10, 20 kV are referred to one by the square of the nominal ratio; "
        "phase shifts have no effect in a radial feeder and are left out.",
        "Taps stay as they are, with the ratio trafo 0 (1.0250), trafo 1 (1.0250).",
        "Taken as constant power: generators that hold their voltage in the source, with 434.1 kvar: "
        "gen 0 (hydro).",
        "Taken as constant power: loads of constant impedance in the source, 300 kW and 0 kvar: "
        "load 0 (mill).",
        "Batteries without a state of charge begin at their lowest: storage 0.",
        "Batteries without an efficiency have 0.95 each way: storage 0.",
    )
    assert 0 < feeder.deviation.v_max_pu < 1e-3
    assert feeder.generators.id.tolist() == ["sgen 0", "gen 0 (hydro)"]
    assert feeder.generators.p_kw == pytest.approx([120.0, 100.0])


def test_impedances_by_hand() -> None:
    # A 1 MVA transformer of 20/0.4 kV with 1 % resistance has 0.01 (20²/1) = 4 ohm at 20 kV; two
    # parallel lines of 0.3 x 1.5 / 2 = 0.225 ohm beside one of 1.2 ohm, all with the same angle.
    net = every_branch()
    before = pp.to_json(net)
    network = import_network(net).network
    assert pp.to_json(net) == before  # the net is left as it was
    r_ohm = dict(
        zip(zip(network.from_bus, network.to_bus, strict=True), network.r_ohm, strict=True)
    )
    assert network.base_kv == 20.0
    assert r_ohm[0, 1] == pytest.approx(0.225 * 1.2 / (0.225 + 1.2))
    assert r_ohm[1, 4] == pytest.approx(4.0 / 2)
    assert r_ohm[4, 7] == pytest.approx(0.3 * 0.02 * (20.0 / 0.4) ** 2)


def test_every_cell_that_is_no_number_is_named_at_once() -> None:
    net = two_buses()
    net.bus["vn_kv"] = [20.0, 0.0]
    net.ext_grid["vm_pu"] = net.line["r_ohm_per_km"] = np.nan
    net.load[["p_mw", "q_mvar", "scaling"]] = np.nan
    pp.create_sgen(net, 1, p_mw=np.nan, name="roof")
    pp.create_storage(net, 1, p_mw=np.nan, max_e_mwh=0.2)
    with pytest.raises(InputError) as caught:
        import_network(net)
    cure = "number. Correct it in the source, or take the element out of service."
    assert str(caught.value).splitlines() == [
        f"pandapower net, {place}: is not a {kind} {cure}"
        for place, kind in (
            ("bus 1, vn_kv = 0.0", "positive"),
            ("ext_grid 0, vm_pu = nan", "positive"),
            ("load 0 (mill), p_mw = nan", "finite"),
            ("load 0 (mill), q_mvar = nan", "finite"),
            ("load 0 (mill), scaling = nan", "finite"),
            ("sgen 0 (roof), p_mw = nan", "finite"),
            ("storage 0, p_mw = nan", "finite"),
            ("line 0 (feeder), r_ohm_per_km = nan", "finite"),
        )
    ]


@pytest.mark.parametrize(("change", "message"), [
    (lambda net: pp.create_xward(net, 1, 0.1, 0, 0, 0, r_ohm=1, x_ohm=1, vm_pu=1, name="w"),
        "pandapower net: xward 0 (w) is not supported. Replace it by loads, static generators and "
        "lines, or take it out of service."),
    (lambda net: net.ext_grid.drop(0, inplace=True),
        "pandapower net: has no external grid. Add one at the bus of the grid connection."),
    (lambda net: net.line.__setitem__("in_service", False),
        "pandapower net: has no branch that is in service and supplied. Close a switch or put a line "
        "into service."),
    (lambda net: net.ext_grid.__setitem__("in_service", False),
        "pandapower net: has no external grid. Add one at the bus of the grid connection."),
    (lambda net: net.bus.loc.__setitem__((0, "in_service"), False),
        "pandapower net: ext_grid 0 is at bus 0, which is out of service. Put the bus into service."),
    (lambda net: pp.create_impedance(net, 0, 1, rft_pu=0.1, xft_pu=0.1, rtf_pu=0.2, sn_mva=1.0),
        "pandapower net: impedance 0 differs between its two directions. Give it the same impedance "
        "in both."),
    (lambda net: net.load.__setitem__("bus", 99),
        "pandapower net, load 0 (mill), bus = 99: is not a bus of the net. Correct it in the "
        "source, or take the element out of service."),
    (lambda net: net.line.__setitem__("to_bus", 0),
        "pandapower net: line 0 (feeder) begins and ends at bus 0. Correct its buses, or take it "
        "out of service."),
])  # fmt: skip
def test_refusals_name_the_element(change: Callable[[Any], object], message: str) -> None:
    net = two_buses()
    change(net)
    assert refusal(import_network, net) == message


def test_an_unknown_branch_to_open_is_named() -> None:
    assert refusal(import_network, two_buses(), open_branches=["line 7"]).startswith(
        "pandapower net: has no branch 'line 7' to open. "
    )


def test_loops_of_closed_tie_switches() -> None:
    net = pp_networks.create_cigre_network_mv()
    net.switch["closed"] = True
    with pytest.raises(InputError, match="is meshed, with 3 loops"):
        import_network(net)
    feeder = import_network(net, open_branches=["Line 6-7", "Line 11-4", "Line 14-8"])
    assert feeder.network.n_lines == feeder.network.n_buses - 1 == 14


@pytest.mark.parametrize(
    ("name", "losses_kw", "v_min_pu"),
    [("case33bw", 202.677, 0.91309), ("case69", 224.992, 0.90919)],
)
def test_published_feeders_by_name(name: str, losses_kw: float, v_min_pu: float) -> None:
    feeder = import_network(name)
    result = ACPowerFlow(feeder.network).solve(*feeder.injection)
    assert result.losses_kw == pytest.approx(losses_kw, abs=1e-3)
    assert result.v_pu.min() == pytest.approx(v_min_pu, abs=6e-6)
    assert feeder.network.slack_bus == 1
    assert np.isinf(feeder.network.i_max_a).all()  # a current that no line carries is no rating
    assert feeder.notes == ()


def test_cigre_with_its_generators_is_imported_in_silence(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        feeder = import_network("cigre-mv-der")
    assert capfd.readouterr() == ("", "")
    assert (feeder.network.n_buses, feeder.network.base_kv) == (15, 20.0)
    assert sorted(set(feeder.generators.kind)) == ["PV", "WP"]
    assert feeder.p_load_kw.sum() == pytest.approx(44742.15)
    assert {"case16", "case33bw", "case69", "cigre-mv", "cigre-mv-der"} == set(NAMED)


def test_pandapower_file_with_tiers_of_its_loads(tmp_path: Path) -> None:
    net = two_buses()
    net.load["tier"] = ["critical"]
    file = tmp_path / "mill.json"
    pp.to_json(net, str(file))
    feeder = import_network(file)
    assert (feeder.name, feeder.tier.tolist()) == ("mill.json", ["", "critical"])


MATPOWER_BUSES = [
    [10, 3, 0, 0, 0, 0, 1, 1, 0, 12.66, 1, 1.1, 0.9],
    [20, 1, 0.3, 0.1, 0, 0, 1, 1, 0, 12.66, 1, 1.1, 0.9],
]
MATPOWER_BRANCHES = [[10, 20, 0.05, 0.04, 0, 0, 0, 0, 0, 0, 1, -360, 360]]
MATPOWER_GENS = [[10, 0, 0, 10, -10, 1, 100, 1, 10, 0] + [0] * 11]


def _matlab(name: str, table: list[list[float]]) -> str:
    rows = ";\n".join("\t".join(map(str, row)) for row in table)
    return f"mpc.{name} = [\n{rows};\n];\n"


MATPOWER_CASE = (
    "function mpc = pair\nmpc.version = '2';\nmpc.baseMVA = 10;\n"
    + _matlab("bus", MATPOWER_BUSES)
    + _matlab("gen", MATPOWER_GENS)
    + _matlab("branch", MATPOWER_BRANCHES)
)


def matpower_m(folder: Path) -> Path:
    file = folder / "pair.m"
    file.write_text(MATPOWER_CASE)
    return file


def matpower_mat(folder: Path) -> Path:
    file = folder / "pair.mat"
    scipy.io.savemat(
        file,
        {
            "mpc": {
                "version": "2",
                "baseMVA": 10.0,
                "bus": np.array(MATPOWER_BUSES, float),
                "gen": np.array(MATPOWER_GENS, float),
                "branch": np.array(MATPOWER_BRANCHES * 2, float),
            }
        },
    )
    return file


@pytest.mark.parametrize(("write", "parallel"), [(matpower_m, 1), (matpower_mat, 2)])
def test_matpower_case(write: Callable[[Path], Path], parallel: int, tmp_path: Path) -> None:
    feeder = import_network(write(tmp_path))
    assert feeder.network.buses.tolist() == [10, 20]
    # 0.05 pu at 12.66 kV and 10 MVA
    assert feeder.network.r_ohm == pytest.approx([0.05 * 12.66**2 / 10 / parallel])
    assert feeder.p_load_kw == pytest.approx([0.0, 300.0])
    assert feeder.deviation.v_max_pu < AGREEMENT


DSS = """
clear
new circuit.mill basekv=11 pu=1.02 bus1=src phases=3 isc3=1e9 isc1=1e9
new line.head bus1=src bus2=a phases=3 r1=0.3 x1=0.2 r0=0.9 x0=0.6 c1=0 c0=0 length=2 units=km
new transformer.t1 phases=3 windings=2 buses=(a b) kvs=(11 0.4) kvas=(500 500) xhl=4 %rs=(.5 .5)
~ %imag=0 %noloadloss=0
new line.tail bus1=b bus2=c phases=3 r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0 length=0.2 units=km
new load.d1 bus1=b phases=3 kv=0.4 kw=100 kvar=30 vminpu=0.5 vmaxpu=1.5
new load.d2 bus1=c phases=3 kv=0.4 kw=20 kvar=3 vminpu=0.5 vmaxpu=1.5
new pvsystem.roof bus1=c phases=3 kv=0.4 pmpp=8 kva=9 irradiance=1
{more}
set voltagebases=[11 0.4]
calcvoltagebases
"""


def dss_file(folder: Path, more: str = "") -> Path:
    file = folder / "mill.dss"
    file.write_text(DSS.format(more=more))
    return file


def test_opendss_agrees_with_opendss(tmp_path: Path) -> None:
    dss = pytest.importorskip("opendssdirect")
    file = dss_file(tmp_path)
    feeder = import_network(file)
    dss.Text.Command(f'redirect "{file}"')
    dss.Text.Command("set tolerance=1e-10 maxiterations=200")
    dss.Text.Command("solve")
    result = ACPowerFlow(feeder.network).solve(*feeder.injection)
    for bus, v_pu in zip(feeder.network.buses, result.v_pu, strict=True):
        dss.Circuit.SetActiveBus(str(bus))
        assert np.mean(dss.Bus.puVmagAngle()[0::2]) == pytest.approx(v_pu, abs=2e-6)
    assert dss.Circuit.Losses()[0] / 1e3 == pytest.approx(result.losses_kw, rel=1e-4)
    assert feeder.generators.kind.tolist() == ["PV"]
    assert feeder.notes[0].startswith("The circuit is taken as balanced: ")


def test_opendss_states_what_single_phases_lose(tmp_path: Path) -> None:
    feeder = import_network(
        dss_file(
            tmp_path,
            "new line.drop bus1=c.1 bus2=d.1 phases=1 r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0\n"
            "new capacitor.bank bus1=a phases=3 kv=11 kvar=50\n",
        ),
        balance=True,
    )
    assert (
        "1 of 3 lines have fewer than three phases; their impedance is raised so that drop and "
        "losses are those of the phases that they have." in feeder.notes
    )
    net = feeder.network
    assert net.q_shunt_kvar[net.bus_index["a"]] == pytest.approx(-50.0, rel=1e-6)


@pytest.mark.nightly
def test_opendss_taps_charging_and_capacitors_are_those_of_its_own_solution(tmp_path: Path) -> None:
    """A balanced circuit has an equivalent that OpenDSS itself agrees with."""
    file = tmp_path / "balanced.dss"
    file.write_text(
        "new circuit.b basekv=20 bus1=s pu=1.02 phases=3 mvasc3=200 mvasc1=200\n"
        "new line.cable bus1=s bus2=a phases=3 r1=0.3 x1=0.25 c1=400 r0=0.3 x0=0.25 c0=400 length=4\n"
        "new transformer.t phases=3 windings=2 buses=[a b] conns=[delta wye] kvs=[20 0.4] "
        "kvas=[630 630] xhl=4 %rs=[0.5 0.5] taps=[1.0 1.025] %noloadloss=0.2 %imag=0.8\n"
        "new regcontrol.rc transformer=t winding=2 vreg=235 band=2 ptratio=1\n"
        "new line.low bus1=b bus2=c phases=3 r1=0.02 x1=0.01 c1=0 r0=0.02 x0=0.01 c0=0\n"
        "new load.d bus1=c phases=3 kv=0.4 kw=300 kvar=100 vminpu=0.5 vmaxpu=1.5\n"
        "new capacitor.k bus1=b phases=3 kv=0.4 kvar=60\nset voltagebases=[20 0.4]\n"
    )
    feeder = import_network(file)
    deviation = source_deviation(feeder, new_scenario(feeder))
    for value in (deviation.no_load_pu, deviation.as_given_pu, deviation.worst_hour_pu):
        assert value is not None and value < 2e-4
    assert feeder.network.has_ratios and feeder.network.draws
    assert any("t at " in note and "(set to 235 V)" in note for note in feeder.notes)


def test_opendss_lines_that_are_open_or_disabled(tmp_path: Path) -> None:
    spur = "new line.spur bus1=a bus2=e phases=3\nnew load.d3 bus1=e phases=3 kv=11 kw=5 kvar=1\n"
    feeder = import_network(dss_file(tmp_path, spur + "open line.tail term=1\ndisable line.spur"))
    assert feeder.network.buses.tolist() == ["src", "a", "b"]
    assert feeder.p_load_kw.sum() == pytest.approx(100.0)
    assert "Left out with their buses: load 1 (d2), load 2 (d3), 25 kW." in feeder.notes


def test_opendss_buses_that_are_numbers(tmp_path: Path) -> None:
    file = tmp_path / "numbers.dss"
    file.write_text(
        "new circuit.n basekv=11 bus1=10 phases=3\n"
        "new line.l bus1=10 bus2=20 phases=3\n"
        "new load.d bus1=20 phases=3 kv=11 kw=50 kvar=10\nset voltagebases=[11]\n"
    )
    # The source has an impedance, and its voltage a bus of its own behind it.
    assert import_network(file).network.buses.tolist() == [21, 10, 20]


@pytest.mark.parametrize(("more", "message"), [
    ("new vsource.second bus1=c phases=3 basekv=0.4",
        "vsource.second is a second source. Keep the circuit's own source and disable the others."),
    ("new isource.x bus1=a phases=3 amps=1",
        "isource.x is not supported. Write 'disable isource.x' at the end of the script."),
    # as the regulators of IEEE 37
    ("new transformer.ra phases=1 windings=2 buses=(b.1.2 f.1.2) conns=(delta delta) "
        "kvs=(0.4 0.4) kvas=(20 20) xhl=1\n"
        "new transformer.rc like=ra buses=(b.3.2 f.3.2)\n"
        "new line.jumper phases=1 bus1=b.2 bus2=f.2 r0=1e-3 r1=1e-3 x0=0 x1=0 c0=0 c1=0",
        "transformer.ra and transformer.rc are an open delta: two units between phases that carry "
        "all three. A balanced model has no such bank: replace both by one transformer of three "
        "phases at the mean of their taps."),
    ("new line.ring bus1=src bus2=d phases=3 r1=1\nnew line.ring2 bus1=d bus2=a phases=3 r1=1",
        "is meshed, with 1 loop. The feeder must be radial: let --open-loops open the branches with "
        "the least current, or open one of each loop with --open; the first consist of line 0 "
        "(head), line 2 (ring), line 3 (ring2)."),
])  # fmt: skip
def test_opendss_refusals(more: str, message: str, tmp_path: Path) -> None:
    found = refusal(import_network, dss_file(tmp_path, more), balance="open delta" in message)
    assert found == f"mill.dss: {message}"


def test_opendss_levels_that_were_not_named(tmp_path: Path) -> None:
    # OpenDSS then takes the nearest of its own list of levels.
    file = dss_file(tmp_path)
    file.write_text(file.read_text().replace("set voltagebases=[11 0.4]", ""))
    assert refusal(import_network, file).splitlines() == [
        f"mill.dss: {element}, whose nominal voltage is {level} kV. Name the levels with 'set "
        "voltagebases=[...]'."
        for element, level in (
            ("vsource.source has 11 kV at bus src", 12.47),
            ("transformer.t1 has 11 kV at bus a", 12.47),
            ("transformer.t1 has 0.4 kV at bus b", 0.48),
        )
    ]


def test_simbench_grid_by_its_code() -> None:
    pytest.importorskip("simbench")
    feeder = import_network("1-LV-rural1--0-sw", source="simbench")
    assert (feeder.network.n_buses, len(feeder.generators)) == (15, 4)
    assert feeder.deviation.v_max_pu < 1e-4


def test_simbench_code_that_does_not_exist() -> None:
    pytest.importorskip("simbench")
    with pytest.raises(InputError, match="network 1-LV-rural9: is not a SimBench code"):
        import_network("1-LV-rural9", source="simbench")


@pytest.mark.parametrize(("name", "text", "message"), [
    ("a.json", "{", "a.json: cannot be read as pandapower JSON ("),
    ("a.json", '{"a": 1}', "a.json: cannot be read as pandapower JSON ("
        "'dict' object has no attribute 'version'). Correct the file, or "
        "choose another format with --from."),
    ("a.m", "function mpc = a\n", "a.m: cannot be read as a MATPOWER case of version 2 ("),
    ("a.mat", "no", "a.mat: cannot be read as a MATPOWER case of version 2 ("),
    ("a.m", MATPOWER_CASE + "mpc.bus(:, 3) = scaled(mpc.bus(:, 3));\n",
        "a.m, row 14: calls 'scaled', which is not evaluated. Load the case in MATPOWER, write "
        "it with savecase, and import that file."),
    ("a.dss", "new nothing.x",
        "a.dss, row 1: 'nothing' is not a class of OpenDSS. Correct it, or remove the element."),
    ("a.dss", "new circuit.x\nnew line.y like=z", "a.dss, row 2: OpenDSS refuses the file ("),
    ("a.dss", "clear", "a.dss: OpenDSS refuses the file ((#301) You must create a new circuit"),
])  # fmt: skip
def test_unreadable_files(name: str, text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    assert refusal(import_network, tmp_path / name).startswith(message)


@pytest.mark.parametrize(("name", "source", "message"), [
    ("case33bx", None,
        "network case33bx: is neither a named network nor a file that can be imported. "),
    ("nowhere.dss", None, "network nowhere.dss: there is no such file. Correct the path."),
    ("case33bw", "cim", "options, from = cim: must be one of pandapower, matpower, opendss, "
        "simbench. Correct the source."),
])  # fmt: skip
def test_unknown_networks(name: str, source: Any, message: str) -> None:
    assert refusal(import_network, name, source).startswith(message)


@pytest.mark.parametrize(("module", "extra", "name", "source"), [
    ("opendssdirect", "opendss", "mill.dss", None),
    ("simbench", "simbench", "1-LV-rural1--0-sw", "simbench"),
])  # fmt: skip
def test_missing_library(
    module: str, extra: str, name: str, source: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("")
    monkeypatch.setitem(sys.modules, module, None)
    assert refusal(import_network, name, source) == (
        f"network: needs the library {module}, which is not installed. Install it with: "
        f"pip install 'vppres[{extra}]'"
    )
