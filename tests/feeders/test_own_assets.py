"""Batteries, generators and motors of the source, and what of them has no counterpart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pandas as pd
import pytest

from tests.support.live_service import client
from tests.support.phased_feeder import STREET, day_of
from tests.support.small_nets import buses_in_a_row
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.feeders import ImportedFeeder, import_network
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import assumptions, new_scenario, write_new_scenario
from vppres.io import read_scenario, write_scenario
from vppres.io.digest import scenario_digest
from vppres.scenario.remarks import NO_FORMER, ONE_FORMER, darkness, former_words, remarks
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service

DARK_MORNING = NewScenarioOptions(
    step_minutes=240.0,
    outages=((pd.Timestamp("2025-07-01T08:00Z"), pd.Timestamp("2025-07-01T16:00Z")),),
)


def feeder_with(*add: Any) -> ImportedFeeder:
    """Three loads behind one another at the buses 1, 2 and 3; whatever else is added to the net."""
    net = buses_in_a_row(5, 11.0)
    for bus in (1, 2, 3):
        pp.create_load(net, bus, p_mw=0.1, q_mvar=0.03)
    for create in add:
        create(net)
    return import_network(net)


def storage(**values: float) -> Any:
    return lambda net: pp.create_storage(net, 2, **{"p_mw": 0.0, "max_e_mwh": np.nan, **values})


BATTERIES: list[tuple[dict[str, float], dict[str, float]]] = [
    # energy and power given: soc limits from the least energy, start from the percentage
    ({"p_mw": 0.0, "max_e_mwh": 0.4, "min_e_mwh": 0.04, "sn_mva": 0.1, "soc_percent": 50.0},
        {"energy_kwh": 400, "p_max_kw": 100, "s_max_kva": 100, "soc_min": 0.1, "soc_initial": 0.5}),
    # no energy: two hours of the power; a start that is unknown is the lowest
    ({"p_mw": 0.05}, {"energy_kwh": 100, "p_max_kw": 50, "s_max_kva": 50, "soc_initial": 0.0}),
    # no power: emptied in two hours
    ({"max_e_mwh": 0.3}, {"energy_kwh": 300, "p_max_kw": 150, "s_max_kva": 150}),
    # the smaller limit of both directions, within the inverter's rating
    ({"max_e_mwh": 0.3, "max_p_mw": 0.2, "min_p_mw": -0.1, "sn_mva": 0.08},
        {"energy_kwh": 300, "p_max_kw": 80, "s_max_kva": 80}),
    # a limit of 0 in one direction says nothing (SimBench)
    ({"max_e_mwh": 0.3, "max_p_mw": 0.0, "min_p_mw": -0.1}, {"p_max_kw": 100}),
]  # fmt: skip


def test_batteries_of_the_source() -> None:
    own = new_scenario(feeder_with(*(storage(**values) for values, _ in BATTERIES))).batteries
    assert own.bus.tolist() == [2] * len(BATTERIES)
    for i, (_, expected) in enumerate(BATTERIES):
        found = {name: float(getattr(own, name)[i]) for name in expected}
        assert found == pytest.approx(expected), own.id[i]


def test_batteries_count_in_the_operating_point() -> None:
    feeder = feeder_with(storage(p_mw=0.05, q_mvar=0.01, max_e_mwh=0.1))
    p_kw, q_kvar = feeder.injection
    assert p_kw.tolist() == pytest.approx([0, -100, -150, -100, 0])
    assert q_kvar.tolist() == pytest.approx([0, -30, -40, -30, 0])
    assert feeder.deviation.v_max_pu < 1e-6


def test_two_batteries_at_a_bus_and_an_invented_one() -> None:
    feeder = feeder_with(storage(max_e_mwh=0.1), storage(max_e_mwh=0.2))
    options = NewScenarioOptions(add_batteries=True)
    day = new_scenario(feeder, options)
    assert day.batteries.id.tolist() == ["b2", "b2_2", "b1", "b2_added", "b3"]
    notes = assumptions(feeder, options)
    assert "2 batteries of 300.0 kWh and 150.0 kW of the source." in notes
    assert any("3 batteries of 187.5 kWh" in note and "invented" in note for note in notes)


def test_generators_by_kind() -> None:
    feeder = feeder_with(
        lambda net: pp.create_sgen(net, 2, p_mw=0.02, sn_mva=0.025, type="PV"),
        lambda net: pp.create_sgen(net, 2, p_mw=0.04, type="WP"),
        lambda net: pp.create_sgen(net, 4, p_mw=0.06, name="Windpark"),
        lambda net: pp.create_sgen(net, 3, p_mw=0.07, type="tidal"),
    )
    day = new_scenario(feeder)
    assert day.pv.id.tolist() == ["pv2", "wind2", "wind4", "tidal3"]
    assert day.pv.customer.tolist() == ["c2", "", "", "c3"]
    assert day.pv.bus.tolist() == [None, 2, 4, None]
    assert day.pv.s_max_kva.tolist() == [25.0, 40.0, 60.0, 70.0]
    assert day.pv.buses(day.customers).tolist() == [2, 2, 4, 3]
    notes = assumptions(feeder, NewScenarioOptions())
    assert (
        "1 PV system, 2 wind systems, 1 tidal system, 190.0 kW (the source's); without a customer, "
        "all exported or curtailed: wind2, wind4." in notes
    )
    assert "Without a series, at their largest power in every step: tidal3." in notes
    assert (
        "Wind without a series gives nothing: wind2, wind4. Give its series with --profiles."
        in (notes)
    )


def test_engines_become_sets_and_fuel_cells_are_named_with_their_size(tmp_path: Path) -> None:
    """What the source does not say is assumed, and told; the folder is read back as it was."""
    feeder = feeder_with(
        lambda net: pp.create_sgen(net, 2, p_mw=0.31, name="CHP diesel 1", type="CHP diesel"),
        lambda net: pp.create_sgen(net, 3, p_mw=0.05, type="wye", name="Genset", min_p_mw=0.02),
        lambda net: pp.create_sgen(net, 3, p_mw=0.03, name="Fuel cell", type="Fuel cell"),
    )
    day = new_scenario(feeder)
    assert len(day.pv) == 0
    sets = day.gensets
    assert sets.id.tolist() == ["chp2", "genset3"] and sets.bus.tolist() == [2, 3]
    assert sets.p_max_kw.tolist() == [310.0, 50.0] and sets.p_min_kw.tolist() == [93.0, 20.0]
    assert sets.litres_per_h_idle.tolist() == pytest.approx([26.0865, 4.2075], abs=1e-3)
    assert sets.tank_litres.tolist() == pytest.approx([818.8, 132.1], abs=0.05)
    write_scenario(day, tmp_path / "day")
    assert scenario_digest(read_scenario(tmp_path / "day")) == scenario_digest(day)
    notes = assumptions(feeder, NewScenarioOptions())
    for words in (
        "Generating sets of the source: chp2, 310 kW; genset3, 50 kW. They run in outages only.",
        "Generating sets that form the grid of an island that no battery forms: genset3.",
        "Generating sets that only follow what forms the grid: chp2.",
        "Assumed for generating sets: a least power of 30% (chp2), 0.246 l/kWh and 0.08415 l/h",
        "left out: sgen 2 (Fuel cell), fuel cell, 30 kW. They are missing in an island.",
        "The 390 kW that generators with a fuel give in the source come from the grid here.",
    ):
        assert any(words in note for note in notes), words


def genset(bus: int, word: str, name: str, **more: Any) -> Any:
    """A generator of 200 kW, with a column of its own where more is given."""

    def create(net: Any) -> None:
        at = pp.create_sgen(net, bus, p_mw=0.2, sn_mva=0.25, type=word, name=name)
        for column, value in more.items():
            net.sgen.loc[at, column] = value

    return create


@pytest.mark.parametrize(("word", "name", "more", "forms"), [
    ("Diesel", "Hospital standby generator", {}, True),
    ("", "Standby set", {}, True),
    ("backup", "", {}, True),
    ("Diesel", "Peak lopper", {"grid_forming": False}, False),
    ("CHP", "Boiler house", {}, False),
    ("CHP", "Boiler house", {"grid_forming": True}, True),
])  # fmt: skip
def test_standby_sets_form_the_grid_unless_the_source_says_otherwise(
    word: str, name: str, more: dict[str, bool], forms: bool
) -> None:
    day = new_scenario(feeder_with(genset(3, word, name, **more)))
    assert day.gensets.grid_forming.tolist() == [forms] and len(day.pv) == 0


def test_a_standby_set_supplies_the_island_of_a_battery_that_is_empty(tmp_path: Path) -> None:
    """The battery comes first; with no energy in it the set starts, and nobody is off for it."""
    feeder = feeder_with(
        genset(3, "Diesel", "Standby"),
        storage(max_e_mwh=0.3, max_p_mw=0.2, sn_mva=0.2, soc_percent=0.0),
    )
    notes = write_new_scenario(feeder, DARK_MORNING, tmp_path / "site")
    day = read_scenario(tmp_path / "site")
    assert day.batteries.grid_forming.tolist() == [True] == day.gensets.grid_forming.tolist()
    assert "Chosen: b2 forms the grid of an island before a generating set does" in " ".join(notes)
    formed = former_words(day)
    assert formed in notes and "Without their energy, it is generating set genset3" in formed
    assert ONE_FORMER not in formed
    run = run_day(day.between(2, 4), RunOptions(horizon_h=8.0))
    assert run.gensets["forms"].all()
    # 300 kW of demand at the peak, a set of 200 kW.
    assert (run.customers.groupby("time")["served"].sum() >= 1).all()


@pytest.mark.parametrize(("added", "words"), [
    ([], NO_FORMER),
    ([storage(max_e_mwh=0.3, max_p_mw=0.2, sn_mva=0.2)], ONE_FORMER),
    ([genset(3, "Diesel", "Standby")], ONE_FORMER),
    ([genset(3, "Diesel", "Standby"), genset(2, "Diesel", "Other")], ""),
])  # fmt: skip
def test_a_site_with_one_former_or_none_is_told_so(
    added: list[Any], words: str, tmp_path: Path
) -> None:
    """By ``new``, ``validate`` and the page of the service."""
    notes = write_new_scenario(feeder_with(*added), DARK_MORNING, tmp_path / "site")
    day = read_scenario(tmp_path / "site")
    service = Service(day, RunOptions(isolate=False))
    with client(service, tmp_path / "state", SetClock(day.grid.start)) as http:
        page = http.get("/v1/site").json()["former"]
    if words == NO_FORMER:
        assert page == NO_FORMER and "No battery can form a grid" in darkness(day)
        assert darkness(day) in notes and darkness(day) in remarks(day)
        return
    for said in (page, " ".join(notes), " ".join(remarks(day))):
        assert (ONE_FORMER in said) == (words == ONE_FORMER)


def test_motor_is_a_load() -> None:
    feeder = feeder_with(
        lambda net: pp.create_motor(
            net, 2, pn_mech_mw=0.09, cos_phi=0.8, efficiency_percent=90.0, loading_percent=50.0
        )
    )
    # 90 kW at half load and 90 % efficiency draw 50 kW; at a power factor of 0.8, 37.5 kvar.
    assert feeder.p_load_kw[feeder.network.bus_index[2]] == pytest.approx(150.0)
    assert feeder.q_load_kvar[feeder.network.bus_index[2]] == pytest.approx(67.5)
    assert feeder.deviation.v_max_pu < 1e-6


def test_flags_and_controllers_are_named() -> None:
    def controlled(net: Any) -> None:
        net.load["controllable"] = [True, False, True]
        pp.create_load(net, 4, p_mw=0.01)
        trafo = pp.control.ConstControl(net, "load", "p_mw", element_index=[0])
        assert trafo.index == 0

    notes = feeder_with(controlled).notes
    assert "Not controllable in the source, and customers like any other: load 1, load 3." in notes
    assert "Controllers of the source do not act: ConstControl 0 (load)." in notes


def test_heat_pumps_are_named_with_their_size() -> None:
    feeder = feeder_with(
        lambda net: pp.create_load(net, 2, p_mw=0.004, name="Heat pump 1"),
        lambda net: pp.create_load(net, 3, p_mw=0.003, type="heatpump"),
        lambda net: pp.create_load(net, 3, p_mw=0.011, name="Wallbox"),
    )
    assert (
        "Heat pumps of 7 kW: plans do not shift their demand in time, and switch them off "
        "with their customers: load 3 (Heat pump 1), load 4." in feeder.notes
    )
    assert any(note.startswith("Charging points of 11 kW") for note in feeder.notes)
    assert feeder.p_load_kw.sum() == pytest.approx(318.0)


@pytest.mark.daily
def test_sets_of_a_feeder_with_phases_keep_their_phases(tmp_path: Path) -> None:
    """One of three phases forms islands, one of a single phase follows; PV is on its owner's."""
    pytest.importorskip("opendssdirect")
    sets = (
        "new generator.diesel1 bus1=m phases=3 kv=0.4 kw=20 pf=0.9\n"
        "new generator.standby2 bus1=n.2 phases=1 kv=0.2309 kw=5\n"
    )
    day = day_of(STREET.replace("set volt", f"{sets}set volt"), tmp_path)
    assert day.gensets.id.tolist() == ["gensetm", "gensetn"]
    assert day.gensets.grid_forming.tolist() == [True, False]
    coils = {row.id: row.coils for row in day.phases.connections}
    assert (coils["gensetm"], coils["gensetn"]) == ("a b c", "b")
    assert all(coils[f"pv{name[1:]}"] == coils[name] for name in day.pv.customer)
    assert day.batteries.id[day.batteries.grid_forming].tolist() == ["bd"]
