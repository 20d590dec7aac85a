"""Small networks with one odd thing each: the voltages of their own power flow, or its name.

pandapower's power flow of the net as it is says what is right.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from functools import cache
from typing import Any

import numpy as np
import pandapower as pp
import pandas as pd
import pytest
from pandapower.pf.runpp_3ph import runpp_3ph

from vppres.core.errors import InputError, VerificationError
from vppres.feeders import ImportedFeeder, import_network
from vppres.feeders.dss.phases import flow_of_source
from vppres.feeders.new.assets import new_assets
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario
from vppres.physics.phases import PhasedFlow
from vppres.physics.powerflow import ACPowerFlow

AGREEMENT_PU = 1e-6
LINE = {"r_ohm_per_km": 0.3, "x_ohm_per_km": 0.2, "c_nf_per_km": 200.0, "max_i_ka": 0.4}
TRAFO = {
    "sn_mva": 0.63,
    "vn_hv_kv": 20.0,
    "vn_lv_kv": 0.4,
    "vkr_percent": 1.2,
    "vk_percent": 6.0,
    "pfe_kw": 1.2,
    "i0_percent": 0.3,
}
DRAWING = ("load", "ward", "motor", "sgen", "gen")
Change = Callable[[Any], object]


@cache
def _built() -> Any:
    net = pp.create_empty_network()
    pp.create_buses(net, 3, vn_kv=20.0)
    pp.create_buses(net, 2, vn_kv=0.4)
    pp.create_ext_grid(net, 0, vm_pu=1.02)
    pp.create_line_from_parameters(net, 0, 1, 2.0, name="a", **LINE)
    pp.create_line_from_parameters(net, 1, 2, 3.0, name="b", **LINE)
    pp.create_transformer_from_parameters(net, 2, 3, **TRAFO)
    pp.create_line_from_parameters(net, 3, 4, 0.1, name="c", **LINE)
    for bus, p_mw in ((1, 0.4), (2, 0.3), (3, 0.1), (4, 0.05)):
        pp.create_load(net, bus, p_mw, p_mw / 4)
    return net


def street() -> Any:
    """A copy to be changed: two lines at 20 kV, a transformer and a line at 0.4 kV, four loads."""
    return deepcopy(_built())


def apart_pu(net: Any, feeder: ImportedFeeder) -> float:
    """Largest difference of a voltage from the power flow of the net as it is."""
    with np.errstate(invalid="ignore"):  # of a tap at a star point without its angle
        pp.runpp(net, calculate_voltage_angles=True, tolerance_mva=1e-9, numba=False)
    result = ACPowerFlow(feeder.network).solve(*feeder.injection)
    known = net.res_bus["vm_pu"].dropna().index
    assert set(known) <= {*feeder.bus_of}
    at = feeder.network.bus_index
    return max(
        abs(result.v_pu[at[feeder.bus_of[bus]]] - net.res_bus["vm_pu"].at[bus]) for bus in known
    )


def demand_kw(net: Any, buses: list[int]) -> float:
    """What loads, wards, motors and generators draw at some buses, by pandapower's tables."""
    at = {table: net[table][net[table]["bus"].isin(buses)] for table in DRAWING}
    motors = at["motor"]
    p_mw = (at["load"]["p_mw"] * at["load"]["scaling"]).sum() + at["ward"]["ps_mw"].sum()
    p_mw += (motors["pn_mech_mw"] * motors["loading_percent"] / motors["efficiency_percent"]).sum()
    for table in ("sgen", "gen"):
        p_mw -= (at[table]["p_mw"] * at[table]["scaling"]).clip(upper=0.0).sum()
    return 1e3 * float(p_mw)


def tapped(**columns: Any) -> Change:
    """A tap changer on the transformer, with some columns otherwise."""
    usual = {
        "tap_side": "hv",
        "tap_neutral": 0,
        "tap_min": -9,
        "tap_max": 9,
        "tap_step_percent": 1.5,
        "tap_pos": -6,
        "tap_changer_type": "Ratio",
    }

    def change(net: Any) -> None:
        for column, value in (usual | columns).items():
            net.trafo[column] = value

    return change


def with_parts(what: str, *places: Any, **values: Any) -> Change:
    """An element that pandapower creates."""
    return lambda net: getattr(pp, f"create_{what}")(net, *places, **values)


def three_windings(net: Any, **columns: Any) -> None:
    """A transformer with three windings and a tap, a load at each of the two lower voltages."""
    mv, lv = pp.create_bus(net, 10.0), pp.create_bus(net, 0.4)
    sides = ("hv", "mv", "lv")
    pp.create_transformer3w_from_parameters(
        net, 2, mv, lv, pfe_kw=1.0, i0_percent=0.2,
        **{f"vn_{side}_kv": kv for side, kv in zip(sides, (20.0, 10.0, 0.4), strict=True)},
        **{f"sn_{side}_mva": mva for side, mva in zip(sides, (2.0, 1.0, 1.0), strict=True)},
        **{f"vk_{side}_percent": 6.0 for side in sides},
        **{f"vkr_{side}_percent": 0.8 for side in sides},
        tap_side="mv", tap_neutral=0, tap_pos=2, tap_min=-2, tap_max=2, tap_step_percent=2.5,
        tap_changer_type="Ratio",
    )  # fmt: skip
    pp.create_load(net, mv, 0.2, 0.05)
    pp.create_load(net, lv, 0.1, 0.02)
    for column, value in columns.items():
        net.trafo3w[column] = value


def changed(table: str, row: int, **values: Any) -> Change:
    """Other values in a row of a table."""

    def change(net: Any) -> None:
        for column, value in values.items():
            net[table].loc[row, column] = value

    return change


def spur(*, length_km: float = 5.0, opened: str = "") -> Change:
    """A line from bus 2 to a new bus; one of its ends may be open."""

    def change(net: Any) -> None:
        end = pp.create_bus(net, 20.0)
        line = pp.create_line_from_parameters(net, 2, end, length_km, **LINE)
        if opened:
            pp.create_switch(net, {"near": 2, "far": end}[opened], line, "l", closed=False)

    return change


def coupled(**switch: Any) -> Change:
    """A bus behind a switch between buses, with a load."""

    def change(net: Any) -> None:
        bus = pp.create_bus(net, 20.0)
        pp.create_load(net, bus, 0.2, 0.05)
        pp.create_switch(net, 2, bus, "b", **switch)

    return change


def beside(what: str, **values: Any) -> Change:
    """A new bus with a load behind a branch from bus 2."""

    def change(net: Any) -> None:
        bus = pp.create_bus(net, values.pop("vn_kv", 20.0))
        getattr(pp, f"create_{what}")(net, 2, bus, **values)
        pp.create_load(net, bus, 0.1, 0.03)

    return change


def renumbered(net: Any) -> None:
    pp.toolbox.reindex_buses(net, {0: 1007, 1: 3, 2: 999_999, 3: 42, 4: 0})
    net.line.index = [7, 19, 101]
    net.load.index = [5, 6, 70, 8]
    net.trafo.index = [33]


def island(net: Any) -> None:
    first, last = pp.create_buses(net, 2, 20.0)
    pp.create_line_from_parameters(net, first, last, 1.0, **LINE)
    pp.create_load(net, last, 0.1, name="hut")


def tap_table(net: Any) -> None:
    tapped(tap_changer_type="Tabular", tap_pos=-2)(net)
    net.trafo[["id_characteristic_table", "tap_dependency_table"]] = [0, True]
    net["trafo_characteristic_table"] = pd.DataFrame(
        {
            "id_characteristic": [0, 0],
            "step": [-2, 0],
            "voltage_ratio": [0.95, 1.0],
            "angle_deg": [0.0, 0.0],
            "vk_percent": [5.0, 6.0],
            "vkr_percent": [1.1, 1.2],
        }
    )


def shared_bus(net: Any) -> None:
    pp.create_gen(net, 2, 0.2, vm_pu=1.03)
    pp.create_gen(net, 2, 0.1, vm_pu=1.03)


def all_named(name: str) -> Change:
    def change(net: Any) -> None:
        for table in ("bus", "load", "line", "trafo"):
            net[table]["name"] = name

    return change


def second_grid(bus: int, **values: Any) -> Change:
    return lambda net: pp.create_ext_grid(net, bus, **values)


def second_transformer(**columns: Any) -> Change:
    return lambda net: pp.create_transformer_from_parameters(net, 2, 3, **TRAFO, **columns)


NO_EFFECT = (
    "Tap positions have no effect in pandapower 3 without tap_side, tap_neutral and "
    "tap_changer_type (at a star point also tap_step_degree), and none here: {}. With them voltages "
    "move by up to {} pu. Give these columns if the positions are real; tap_changer_type is Ratio for "
    "most transformers."
)
UNTOLD = NO_EFFECT.format("trafo 0 (-6)", "0.1")
HELD = "Taken as constant power: generators that hold their voltage in the source"
SWITCHED = (
    "Branches without impedance are closed switches, also in the power flow of the source, which "
    "cannot divide by them: line 1 (b)."
)

# What is odd, and the beginning of the note that names it; empty where nothing is to be said.
RIGHT: dict[str, tuple[Change, str]] = {
    "parallel lines": (changed("line", 1, parallel=2), ""),
    "a parallel line the other way": (with_parts("line_from_parameters", 2, 1, 1.0, **LINE), ""),
    "a shift of 150 degrees": (changed("trafo", 0, shift_degree=150.0), ""),
    "parallel transformers alike in their shift": (second_transformer(), ""),
    "tap changer at the low voltage": (tapped(tap_side="lv"), "Taps stay"),
    "tap changer without its type": (tapped(tap_changer_type=None), UNTOLD),
    "tap changer without its neutral position": (tapped(tap_neutral=np.nan), UNTOLD),
    "tap changer without its side": (tapped(tap_side=None), UNTOLD),
    "tap changer that turns the phase": (tapped(tap_changer_type="Ideal", tap_step_degree=5.0,
        tap_step_percent=np.nan), ""),
    "tap changer across": (tapped(tap_step_degree=60.0), "Taps stay"),
    "second tap changer": (tapped(tap2_side="lv", tap2_neutral=0, tap2_min=-9, tap2_max=9,
        tap2_step_percent=1.0, tap2_pos=3, tap2_changer_type="Ratio"), "Taps stay"),
    "second tap changer without its type": (tapped(tap_pos=0, tap2_side="hv", tap2_neutral=0,
        tap2_step_percent=1.0, tap2_pos=3, tap2_changer_type=None), NO_EFFECT.format("trafo 0 (3)",
        "0.03")),
    "tap changer by a table": (tap_table, "Taps stay"),
    "three windings": (three_windings, "Taps stay"),
    "three windings, tap changer without its type": (lambda net: three_windings(net,
        tap_changer_type=None), NO_EFFECT.format("trafo3w 0 (2)", "0.051")),
    "three windings, tap at the star point": (lambda net: three_windings(net,
        tap_at_star_point=True), NO_EFFECT.format("trafo3w 0 (2)", "0.051")),
    "regulator": (beside("transformer_from_parameters", **TRAFO | {"vn_lv_kv": 20.0}, tap_side="lv",
        tap_neutral=0, tap_min=-16, tap_max=16, tap_pos=12, tap_step_percent=0.625,
        tap_changer_type="Ratio"), "Taps stay"),
    "transformer that steps up": (lambda net: (pp.create_bus(net, 20.0),
        pp.create_transformer_from_parameters(net, 5, 4, **TRAFO), pp.create_load(net, 5, 0.02)),
        ""),
    "transformer of other voltages": (changed("trafo", 0, vn_hv_kv=21.0, vn_lv_kv=0.42), ""),
    "shunt in steps": (with_parts("shunt", 2, -0.1, p_mw=0.01, step=3, max_step=5), ""),
    "shunt of another voltage": (with_parts("shunt", 2, -0.3, vn_kv=22.0), ""),
    "ward": (with_parts("ward", 2, 0.05, 0.02, 0.03, -0.04), ""),
    "impedance with shunts": (beside("impedance", rft_pu=0.01, xft_pu=0.02, sn_mva=1.0, gf_pu=0.01,
        bf_pu=0.02, gt_pu=0.0, bt_pu=0.03), ""),
    "DC line out of service": (with_parts("dcline", 1, 2, 0.05, 1.0, 0.001, 1.01, 1.01,
        in_service=False), ""),
    "line out of service": (changed("line", 2, in_service=False), "Left out with their buses"),
    "bus out of service": (changed("bus", 4, in_service=False), "Left out with their buses"),
    "line open at its far end": (spur(opened="far"), "Open at one end, and kept as shunts"),
    "line open at its near end": (spur(opened="near"), "Without supply"),
    "line to nowhere": (spur(), ""),
    "switch with an impedance": (coupled(z_ohm=0.5), ""),
    "closed switch": (coupled(), "Closed switches make one bus of the buses 2, 5."),
    "open switch": (coupled(closed=False), "Left out with their buses: load 4, 200 kW."),
    "grid with an angle": (changed("ext_grid", 0, va_degree=30.0, vm_pu=1.05), ""),
    "two grids at one bus": (second_grid(0, vm_pu=1.02), ""),
    "generator that holds its voltage": (with_parts("gen", 2, 0.2, vm_pu=1.03), HELD),
    "two of them at a bus": (shared_bus, HELD),
    "generator that draws power": (with_parts("sgen", 2, -0.15, 0.02, name="pump"),
        "Generators that draw power are loads: sgen 0 (pump), 150 kW."),
    "generator that draws power and holds its voltage": (with_parts("gen", 4, -0.05, vm_pu=1.0,
        scaling=0.5), "Generators that draw power are loads: gen 0, 25 kW."),
    "loads that are scaled": (lambda net: net.load.update({"scaling": [0.5, 0.0, 2.0, 1.0]}), ""),
    "motor": (with_parts("motor", 2, 0.1, 0.9, efficiency_percent=95.0, loading_percent=80.0), ""),
    "load that gives power": (with_parts("load", 2, -0.6, 0.1),
        "Drawn in every step and owned by no customer: bus 2"),
    "battery that discharges": (with_parts("storage", 2, -0.1, 1.0, sn_mva=0.2), "Batteries"),
    "island without a source": (island, "Left out with their buses: load 4 (hut), 100 kW."),
    "the same name everywhere": (all_named("Mill"), ""),
    "names in other scripts": (all_named("Łódź 地 Straße"), ""),
    "numbers with gaps": (renumbered, ""),
    "line with leakage": (changed("line", 1, g_us_per_km=20.0), ""),
    "line with a derating": (changed("line", 1, df=0.5), ""),
    "line of no length": (changed("line", 1, length_km=0.0), SWITCHED),
    "line of no impedance": (changed("line", 1, r_ohm_per_km=0.0, x_ohm_per_km=0.0), SWITCHED),
    "line without resistance": (changed("line", 1, r_ohm_per_km=0.0), ""),
    "line with a negative reactance": (changed("line", 1, x_ohm_per_km=-0.1), ""),
    "line without ampacity": (changed("line", 1, max_i_ka=0.0),
        "Without a rating in the source, and here: line 1 (b)."),
    "line derated to nothing": (changed("line", 1, df=0.0),
        "Without a rating in the source, and here: line 1 (b)."),
    "base power of 100 MVA": (lambda net: net.update({"sn_mva": 100.0}), ""),
}  # fmt: skip


@pytest.mark.parametrize(("change", "note"), RIGHT.values(), ids=list(RIGHT))
def test_odd_net_has_its_own_voltages(change: Change, note: str) -> None:
    net = street()
    change(net)
    feeder = import_network(net, names=True)
    if note != SWITCHED:  # pandapower divides by zero
        assert apart_pu(net, feeder) < AGREEMENT_PU
    given = feeder.deviation
    assert given.v_max_pu < AGREEMENT_PU
    assert given.losses_kw == pytest.approx(given.losses_source_kw, rel=1e-5)
    assets = new_assets(feeder, NewScenarioOptions())
    notes = [*feeder.notes, *assets.notes]
    assert not note or any(each.startswith(note) for each in notes), notes
    peak_kw = assets.peak_kw.sum() + feeder.network.p_fixed_kw.sum()
    assert peak_kw == pytest.approx(demand_kw(net, [*feeder.bus_of]), abs=1e-3)


def test_net_of_an_older_pandapower_has_the_voltages_of_today() -> None:
    """Pandapower 2 said of a tap changer only whether it shifts phases; today's files are read."""
    net = street()
    tapped(tap_changer_type="Ideal", tap_step_degree=5.0, tap_step_percent=np.nan)(net)
    older = deepcopy(net)
    older.trafo = older.trafo.drop(columns="tap_changer_type").assign(tap_phase_shifter=True)
    older.format_version = "2.14.0"
    assert apart_pu(net, import_network(older, names=True)) < AGREEMENT_PU
    assert "tap_changer_type" not in older.trafo


# What is odd, and what the refusal says, where no other file has the message in full.
REFUSED: dict[str, tuple[Change, str]] = {
    "DC line": (with_parts("dcline", 1, 2, 0.05, 1.0, 0.001, 1.01, 1.01),
        "dcline 0 is not supported"),
    "static compensator": (with_parts("ssc", 2, 0.0, 0.5), "ssc 0 is not supported"),
    "low voltage of the grid": (changed("ext_grid", 0, vm_pu=0.9), "v_slack_pu = 0.9: must lie"),
    "parallel transformers of different shifts": (second_transformer(shift_degree=150.0),
        "parallel branches that shift the phase differently: trafo 0 \\(0\\), trafo 1 \\(150\\)"),
    "transformer without impedance": (changed("trafo", 0, vk_percent=0.0, vkr_percent=0.0),
        "trafo 0, vk_percent = 0.0: is no impedance"),
    "transformer of more resistance than impedance": (changed("trafo", 0, vk_percent=1.0,
        vkr_percent=2.0), "trafo 0, vk_percent = 1.0: is no impedance for vkr_percent = 2"),
    "load of more than all shares": (changed("load", 0, const_z_p_percent=60.0,
        const_i_p_percent=60.0),
        "load 0, const_z_p_percent \\+ const_i_p_percent = 120.0: are more than all"),
    "no load": (lambda net: net.load.drop(net.load.index, inplace=True), "has no load"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), REFUSED.values(), ids=list(REFUSED))
def test_odd_net_is_refused_for_what_it_is(change: Change, message: str) -> None:
    net = street()
    change(net)
    with pytest.raises(InputError, match=message):
        new_scenario(import_network(net))


ZERO = {"r0_ohm_per_km": 1.2, "x0_ohm_per_km": 0.8, "c0_nf_per_km": 100.0}
ZERO_OF_TRAFO = {
    "vector_group": "Dyn",
    "shift_degree": 330.0,
    "vk0_percent": 6.0,
    "vkr0_percent": 1.2,
    "mag0_percent": 100.0,
    "mag0_rx": 0.0,
    "si0_hv_partial": 0.9,
}
STRONG = {"s_sc_max_mva": 1e9, "rx_max": 0.1, "x0x_max": 1.0, "r0x0_max": 0.1}


def street_by_phase() -> Any:
    """The street with a house on two phases at its end."""
    net = street()
    for table, columns in (("line", ZERO), ("trafo", ZERO_OF_TRAFO), ("ext_grid", STRONG)):
        for column, value in columns.items():
            net[table][column] = value
    house = {"p_a_mw": 0.01, "p_b_mw": 0.02, "q_a_mvar": 0.001, "q_b_mvar": 0.002}
    pp.create_asymmetric_load(net, 4, **house, name="house")
    return net


def with_zero(change: Change) -> Change:
    """New lines have the zero sequence of the others."""

    def changed_too(net: Any) -> None:
        change(net)
        for column, value in ZERO.items():
            net.line[column] = value

    return changed_too


THIRD = "Switches have a third of their z_ohm, as in pandapower's power flow by phase: switch 0."
WYE = (
    "Connected in wye here, and left out by pandapower's power flow by phase, which asks for the type "
    "wye or delta: sgen 0."
)
LOST = "Left out, as the feeder keeps its phases and a customer needs active power: "
OUT_OF_SERVICE = "Left out with their buses: load 3, load 4 (house), 80 kW."
BY_PHASE: dict[str, tuple[Change, str]] = {
    "nothing": (lambda net: None, "The grid is held stiff."),
    "switch with an impedance": (coupled(z_ohm=0.5), THIRD),
    "line open at its far end": (with_zero(spur(length_km=8.0, opened="far")), "Open at one end"),
    "transformer open at its low voltage": (lambda net: (pp.create_switch(net, 3, 0, "t",
        closed=False), pp.create_asymmetric_load(net, 2, 0.1)), "Open at one end"),
    "bus out of service": (lambda net: (changed("bus", 4, in_service=False)(net),
        pp.create_asymmetric_load(net, 3, 0.01)), OUT_OF_SERVICE),
    "line of no length": (changed("line", 1, length_km=0.0), SWITCHED),
    "line with leakage": (changed("line", 1, g_us_per_km=20.0), ""),
    "line without ampacity": (changed("line", 1, max_i_ka=np.nan),
        "Without a rating in the source, and here: line 1 (b)."),
    "load in delta": (changed("load", 3, type="delta"), ""),
    "generator of another type": (with_parts("sgen", 4, 0.01, 0.002, type="PV"), WYE),
    "generator that draws power": (with_parts("sgen", 4, -0.01, 0.002, type="wye"),
        "Generators that draw power are loads: sgen 0, 10 kW."),
    "phase of a generator that draws power": (with_parts("asymmetric_sgen", 4, -0.01, 0.005),
        "Generators that draw power are loads: asymmetric_sgen 0, 10 kW."),
    "load that gives power": (with_parts("load", 4, -0.01, 0.002),
        f"{LOST}load 4 (-10 kW, 2 kvar)."),
    "load of reactive power": (with_parts("load", 4, 0.0, 0.02), f"{LOST}load 4 (0 kW, 20 kvar)."),
    "tap changer without its type": (tapped(tap_changer_type=None), NO_EFFECT.format("trafo 0 (-6)",
        "0.1")),
    "grid of little strength": (changed("ext_grid", 0, s_sc_max_mva=100.0),
        "The grid is held stiff. With the short-circuit power of the source voltages move by up to "
        "0.00021 pu."),
    "numbers with gaps": (renumbered, ""),
}  # fmt: skip


@pytest.mark.parametrize(("change", "note"), BY_PHASE.values(), ids=list(BY_PHASE))
def test_odd_net_by_phase_has_its_own_voltages(change: Change, note: str) -> None:
    net = street_by_phase()
    change(net)
    feeder = import_network(net)
    phased = feeder.phased
    assert phased.difference_pu is not None
    assert phased.difference_pu < AGREEMENT_PU
    assets = new_assets(feeder, NewScenarioOptions())
    notes = [*feeder.notes, *assets.notes]
    assert not note or any(each.startswith(note) for each in notes), notes
    flow, p_kw, q_kvar = flow_of_source(phased)
    ours = dict(zip(flow.measured[0], flow.v_pu(flow.solve(p_kw, q_kvar).v), strict=True))
    if note in (SWITCHED, WYE, OUT_OF_SERVICE):
        return  # pandapower has no solution, or one without the generator
    if "short-circuit" in note:
        net.ext_grid["s_sc_max_mva"] = STRONG["s_sc_max_mva"]
    with np.errstate(invalid="ignore"):  # at buses without supply
        runpp_3ph(net, numba=False, tolerance_mva=1e-10, max_iteration=100)
    theirs = net.res_bus_3ph[[f"vm_{phase}_pu" for phase in "abc"]].dropna()
    assert len(theirs) == len(feeder.bus_of)
    for bus, row in theirs.iterrows():
        for phase, value in zip("abc", row, strict=True):
            assert ours[str(feeder.bus_of[bus]), phase] == pytest.approx(value, abs=AGREEMENT_PU)


def test_a_net_by_phase_without_a_solution_here_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """pandapower's power flow has one, and the own one of the phases does not find it."""

    def none_found(*_: object) -> None:
        raise VerificationError("no solution")

    monkeypatch.setattr(PhasedFlow, "solve", none_found)
    with pytest.raises(InputError, match=r"has no solution of its own power flow .* --balance"):
        import_network(street_by_phase())
