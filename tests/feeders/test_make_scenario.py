"""A first scenario on an imported feeder: its rules, its refusals, and that it runs."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pandapower.networks as networks
import pandas as pd
import pytest

from tests.support.command_line import call
from tests.support.refusals import refusal
from tests.support.small_nets import buses_in_a_row
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.feeders import ImportedFeeder, import_network
from vppres.feeders.new.options import NewScenarioOptions, parse_outage, parse_start
from vppres.feeders.new.scenario import LOAD_SHAPE, assumptions, new_scenario, write_new_scenario
from vppres.io import read_scenario, scenario_digest

START = NewScenarioOptions().start


@pytest.fixture(scope="module")
def case33() -> ImportedFeeder:
    return import_network("case33bw")


@pytest.fixture(scope="module")
def cigre() -> ImportedFeeder:
    return import_network("cigre-mv-der")


@pytest.fixture(scope="module")
def tagged() -> ImportedFeeder:
    """Four loads; two have a tier, one has no active power, one feeds reactive power."""
    net = buses_in_a_row(6, 11.0)
    for bus, p_mw, q_mvar in ((1, 0.1, 0.05), (2, 0.2, 0.0), (3, 0.0, 0.02), (4, 0.1, -0.02)):
        pp.create_load(net, bus, p_mw=p_mw, q_mvar=q_mvar)
    net.load["tier"] = ["critical", "", "", "low"]
    return import_network(net)


INVENTED = NewScenarioOptions(draw_tiers=True, pv="sized", add_batteries=True)


def test_a_restored_customer_stays_on_supply_for_an_hour(
    tagged: ImportedFeeder, tmp_path: Path
) -> None:
    notes = write_new_scenario(tagged, NewScenarioOptions(step_minutes=15), tmp_path / "mine")
    assert read_scenario(tmp_path / "mine").switching.min_served_h == 1.0
    assert any("1 h on supply for a customer that is restored" in note for note in notes)


def test_normally_open_lines_are_switches(
    case33: ImportedFeeder, tagged: ImportedFeeder, tmp_path: Path
) -> None:
    write_new_scenario(case33, NewScenarioOptions(), tmp_path / "33")
    found = read_scenario(tmp_path / "33").switches
    ends = [*zip(found.from_bus, found.to_bus, strict=True)]
    assert ends == [(21, 8), (9, 15), (12, 22), (18, 33), (25, 29)]  # of the published feeder
    assert found.r_ohm.tolist() == [2.0, 2.0, 2.0, 0.5, 0.5] == found.x_ohm.tolist()
    assert set(found.kind) == {"tie"} and not found.closed.any() and found.movable.all()
    write_new_scenario(tagged, NewScenarioOptions(), tmp_path / "mine")
    assert not (tmp_path / "mine" / "switches.csv").exists()


def test_nothing_is_invented_unasked(case33: ImportedFeeder) -> None:
    day = new_scenario(case33)
    assert (len(day.pv), len(day.batteries), day.tiers) == (0, 0, ("all",))
    assert set(day.customers.weight) == {1.0}
    notes = assumptions(case33, NewScenarioOptions())
    assert (
        "All 32 customers are in one tier, all: the source names none, and none was drawn." in notes
    )
    assert any("Without one no island has a grid." in note for note in notes)
    assert any(note.startswith("No generator:") for note in notes)


def test_what_is_invented_says_so(case33: ImportedFeeder) -> None:
    notes = assumptions(case33, INVENTED)
    assert "Customers: 6 critical, 10 high, 16 low (tiers drawn, seed 0)." in notes
    assert "26 PV systems, 1,562.5 kW (PV invented by size)." in notes
    assert (
        "32 batteries of 2,321.9 kWh and 1,160.9 kW invented, sized by the customers' peak loads."
        in notes
    )


def test_rules_of_size(case33: ImportedFeeder) -> None:
    day = new_scenario(case33, INVENTED)
    peak_kw = case33.p_load_kw[case33.p_load_kw > 0]
    assert {t: int((day.customers.tier == t).sum()) for t in day.tiers} == {
        "critical": 6,
        "high": 10,
        "low": 16,
    }  # 20, 30 and 50 % of 32
    assert len(day.pv) == 26  # 80 % of 32
    owners = day.pv.owner(day.customers)
    assert day.pv.p_max_kw == pytest.approx(0.5 * peak_kw[owners])
    assert (day.pv.s_max_kva >= day.pv.p_max_kw).all()
    assert day.batteries.energy_kwh.sum() == pytest.approx(0.625 * 3715.0)
    assert day.batteries.p_max_kw == pytest.approx(0.5 * day.batteries.energy_kwh)
    assert day.load_kw.max(axis=0) == pytest.approx(peak_kw)
    assert day.load_kvar.max(axis=0).sum() == pytest.approx(2300.0, rel=1e-4)
    assert day.network.v_min_pu == case33.network.v_min_pu
    np.testing.assert_array_equal(day.network.r_ohm, case33.network.r_ohm)


def test_capacitors_that_the_forming_battery_cannot_hold_are_off_in_islands(
    case33: ImportedFeeder,
) -> None:
    """The smaller bank is within the largest inverter's rating, the larger one is not."""
    buses = case33.network.buses[[5, 9]]
    banked = replace(
        case33.network,
        drawing_bus=buses,
        p_shunt_kw=[],
        q_shunt_kvar=[-50.0, -2000.0],
        p_fixed_kw=[],
        q_fixed_kvar=[],
        island=[],
    )
    feeder = replace(case33, network=banked)
    day = new_scenario(feeder, INVENTED)
    assert day.network.buses[~day.network.island].tolist() == [buses[1]]
    assert any(
        note.startswith(f"The capacitors at bus {buses[1]} are switched off in islands")
        for note in assumptions(feeder, INVENTED)
    )
    assert new_scenario(feeder).network.island.all()  # without a battery there is no island


def test_hourly_day_has_the_bundled_shape(case33: ImportedFeeder) -> None:
    day = new_scenario(case33)
    assert day.load_kw.sum(axis=1) / 3715.0 == pytest.approx(LOAD_SHAPE)
    assert np.flatnonzero(day.outage).tolist() == [12, 13, 14, 15, 16, 17]
    assert day.price_gbp_per_kwh[[0, 5, 6, 15, 16, 19, 20]] == pytest.approx(
        [0.20, 0.20, 0.36, 0.36, 0.54, 0.54, 0.36]
    )


def test_two_days_of_quarter_hours_with_two_outages(case33: ImportedFeeder) -> None:
    outages = (
        parse_outage("12:00..18:00", START),
        parse_outage("2025-07-02T06:15Z..2025-07-02T09:00Z", START),
    )
    day = new_scenario(case33, NewScenarioOptions(step_minutes=15, days=2, outages=outages))
    assert day.grid.n_steps == 192
    dark = np.flatnonzero(day.outage)
    assert dark.tolist() == [*range(48, 72), *range(121, 132)]
    # Linear between the middles of the hours: the mean over an hour keeps the day's shape.
    hourly = day.load_kw.reshape(48, 4, -1).mean(axis=1).sum(axis=1) / 3715.0
    assert hourly == pytest.approx(np.tile(LOAD_SHAPE, 2), abs=0.02)
    assert day.load_kw[:96] == pytest.approx(day.load_kw[96:])


def test_what_is_drawn_hangs_on_the_seed(case33: ImportedFeeder) -> None:
    days = [new_scenario(case33, replace(INVENTED, seed=seed)) for seed in (3, 3, 4)]
    digests = [scenario_digest(day) for day in days]
    assert digests[0] == digests[1] != digests[2]


def test_pv_of_the_source(cigre: ImportedFeeder) -> None:
    day = new_scenario(cigre)
    own = cigre.generators
    assert day.pv.counted() == "8 PV systems, 1 wind system"
    assert day.pv.p_max_kw.sum() == pytest.approx(own.p_kw.sum())
    windy = day.pv.kind == "wind"
    assert day.pv.customer[windy].tolist() == ["c7"]
    assert (day.pv_kw[:, windy] == 0.0).all()  # no one knows the wind
    assert day.pv_kw[0, ~windy].sum() == 0.0
    assert len(new_scenario(cigre, NewScenarioOptions(pv="none")).pv) == 0
    sized = new_scenario(cigre, NewScenarioOptions(pv="sized"))
    assert len(sized.pv) == round(0.8 * len(day.customers)) + 1  # the wind stays
    notes = assumptions(cigre, NewScenarioOptions(pv="sized"))
    assert any(
        note.startswith("Generators of the source that --pv sized leaves out") for note in notes
    )


def test_tiers_and_odd_loads_of_the_source(tagged: ImportedFeeder) -> None:
    day = new_scenario(tagged)
    assert day.customers.bus.tolist() == [1, 2, 4]
    assert day.customers.tier.tolist() == ["critical", "low", "low"]
    assert day.customers.power_factor == pytest.approx(
        [2 / np.sqrt(5), 1.0, -5 / np.sqrt(26)], abs=1e-8
    )
    notes = assumptions(tagged, NewScenarioOptions())
    fixed = "Drawn in every step and owned by no customer: bus 3 (0 kW, 20 kvar)."
    assert fixed in notes


@pytest.mark.parametrize(("change", "message"), [
    ({"step_minutes": 7.0}, "options, step_minutes = 7.0: must be at least 1 and divide a day. "
        "Give a step that divides the day, for example 60, 30 or 15."),
    ({"step_minutes": 0.0}, "options, step_minutes = 0.0: must be at least 1 and divide a day. "
        "Give a step that divides the day, for example 60, 30 or 15."),
    ({"step_minutes": "60"}, "options, step_minutes = 60: is not a number. Give one."),
    ({"pv": "all"}, "options, pv = all: is not known. Use one of: existing, sized, none."),
    ({"add_batteries": "no"},
        "options, add_batteries = no: is neither true nor false. Give True or False."),
    ({"days": 0}, "options, days = 0: must lie between 1 and 366. Give the number of days."),
    ({"draw_tiers": True, "tier_shares": (0.5, 0.5, 0.5)},
        "options, tier_shares = (0.5, 0.5, 0.5): must be three shares that add up to 1. Give critical, high "
        "and low, for example 0.2 0.3 0.5."),
    ({"pv": "sized", "pv_share_of_peak": 0.0},
        "options, pv_share_of_peak = 0.0: must lie between 0 and 10. Give "
        "kW of PV per kW of peak load, for example 0.5."),
    ({"add_batteries": True, "battery_kwh_per_peak_kw": -1.0},
        "options, battery_kwh_per_peak_kw = -1.0: must lie between 0 and 100. Give kWh per kW of peak "
        "load, for example 0.625."),
    ({"battery_kwh_per_peak_kw": 0.5},
        "options, battery_kwh_per_peak_kw = 0.5: is given, and nothing is drawn or added that it "
        "could size. Add --add-batteries, or leave it out."),
    ({"seed": -1}, "options, seed = -1: must be at least 0. Give another seed."),
    ({"v_slack_pu": 1.2}, "case33bw, v_slack_pu = 1.2: must lie between 0.947 and 1.053, the "
        "limits of the voltages. Give another one with --v-slack, or correct the source."),
    ({"outages": (parse_outage("18:00..12:00", START),)},
        "options, outage = 2025-07-01T18:00:00+00:00..2025-07-01T12:00:00+00:00: must end after it "
        "begins. The scenario is 2025-07-01T00:00:00+00:00 to 2025-07-02T00:00:00+00:00 in steps of "
        "60 min."),
    ({"outages": (parse_outage("2025-07-03T12:00Z..2025-07-03T13:00Z", START),)},
        "options, outage = 2025-07-03T12:00:00+00:00..2025-07-03T13:00:00+00:00: lies outside the "
        "scenario. The scenario is 2025-07-01T00:00:00+00:00 to 2025-07-02T00:00:00+00:00 in steps of "
        "60 min."),
    ({"step_minutes": 480.0},
        "options, outage = 2025-07-01T12:00:00+00:00..2025-07-01T18:00:00+00:00: begins or ends "
        "inside a step. The scenario is 2025-07-01T00:00:00+00:00 to 2025-07-02T00:00:00+00:00 in "
        "steps of 480 min."),
])  # fmt: skip
def test_options_out_of_range(case33: ImportedFeeder, change: dict[str, Any], message: str) -> None:
    assert refusal(new_scenario, case33, NewScenarioOptions(**change)) == message


@pytest.mark.parametrize(
    ("name", "title"),
    [("Oak Hill", "Oak Hill"), ("", "pandapower net"), ("=cmd()", "pandapower net")],
)
def test_the_title_is_the_networks_own_name(name: str, title: str) -> None:
    net = networks.case33bw()
    net.name = name
    made = new_scenario(import_network(net), NewScenarioOptions(days=1))
    assert made.title.startswith(f"{title}: 1 day")


def test_all_wrong_options_at_once(case33: ImportedFeeder) -> None:
    with pytest.raises(InputError) as caught:
        new_scenario(case33, NewScenarioOptions(days=0, seed=-1, v_slack_pu=0.5))
    assert len(caught.value.problems) == 3


def test_feeders_that_cannot_be_a_scenario(tagged: ImportedFeeder) -> None:
    assert refusal(
        new_scenario,
        replace(
            tagged,
            p_load_kw=0.0 * tagged.p_load_kw,
            loads=replace(tagged.loads, tier=np.where(tagged.loads.tier == "low", "hihg", "")),
        ),
    ) == (
        "pandapower net: has no load. Add the loads to the source: each bus with a load becomes a "
        "customer.\npandapower net, tier = hihg: is not a tier (load 3). Did you mean high?"
    )


@pytest.mark.parametrize("text", [
    "12:00",
    "12:00..",
    "25:00..26:00",
    "12:00..2025-07-01T13:00",
    "a..b",
    "1:00..2:00..3:00",
    "NaT..NaT",
])  # fmt: skip
def test_intervals_that_are_none(text: str) -> None:
    assert refusal(parse_outage, text, START) == (
        f"options, outage = {text}: is not an interval of time. Write start..end, for example "
        "12:00..18:00 (first day) or 2025-07-02T06:00Z..2025-07-02T09:00Z."
    )


@pytest.mark.parametrize("text", ["2025-07-01", "noon", ""])
def test_starts_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="is not a date with a time zone"):
        parse_start(text)


def test_clock_times_are_those_of_the_start() -> None:
    start = pd.Timestamp("2025-07-01T00:00:00+02:00")
    assert parse_outage("12:00..24:00", start) == (
        pd.Timestamp("2025-07-01T10:00:00Z"),
        pd.Timestamp("2025-07-01T22:00:00Z"),
    )


def test_folder_reads_back_equal_and_runs(tagged: ImportedFeeder, tmp_path: Path) -> None:
    options = replace(INVENTED, step_minutes=240.0, outages=(parse_outage("12:00..20:00", START),))
    notes = write_new_scenario(tagged, options, tmp_path / "mine")
    day = read_scenario(tmp_path / "mine")
    assert scenario_digest(day) == scenario_digest(new_scenario(tagged, options))
    assert (
        (tmp_path / "mine" / "scenario.toml")
        .read_text(encoding="utf-8")
        .startswith("#:schema ./scenario.schema.json\n")
    )
    text = (tmp_path / "mine" / "notes.md").read_text(encoding="utf-8")
    assert all(f"- {note}\n" in text for note in notes)
    trajectory = run_day(day, RunOptions(horizon_h=4.0))
    assert len(trajectory.steps) == 6
    connected = trajectory.customers[~trajectory.customers["time"].isin(day.grid.times[day.outage])]
    assert connected["served"].all()


def test_command_makes_a_valid_folder(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    options = (
        "--step-minutes 15 --days 2 --start 2025-07-01T00:00Z --outage 12:00..18:00 "
        "--outage 2025-07-02T06:00Z..2025-07-02T09:00Z --seed 2"
    )
    done = call(f"new cigre-mv-der {options}", folder)
    assert done.exit_code == 0, done.stderr
    assert "Open at one end, and kept as shunts of 16.41 kvar" in done.stdout
    assert f"Written to {folder}" in done.stdout
    assert read_scenario(folder).grid.n_steps == 192
    assert call("validate", folder).exit_code == 0


@pytest.mark.nightly
def test_command_opens_a_loop_of_a_file(tmp_path: Path) -> None:
    net = pp.networks.create_cigre_network_mv()
    net.switch["closed"] = True
    file = tmp_path / "ring.json"
    pp.to_json(net, str(file))
    refused = call("new", file, tmp_path / "out")
    assert refused.exit_code == 2
    assert "is meshed" in refused.stderr
    assert not (tmp_path / "out").exists()
    opened = "--open 'Line 6-7' --open 'line 13' --open 'line 14'"
    done = call(f"new --from pandapower {opened}", file, tmp_path / "out")
    assert done.exit_code == 0, done.stderr


def test_command_refuses_before_it_works(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("mine")
    done = call("new", "case33bw", tmp_path)
    assert done.exit_code == 2
    assert (tmp_path / "letter.txt").read_text() == "mine"


def test_low_voltage_has_the_limits_of_its_country() -> None:
    feeder = import_network(networks.create_kerber_landnetz_kabel_1())
    for zone, lowest, origin in (
        (None, 0.90, "EN 50160"),
        ("Europe/London", 0.94, "Great Britain"),
    ):
        rules = NewScenarioOptions(time_zone=zone)
        net = new_scenario(feeder, rules).network
        assert (net.v_min_ac_pu, net.v_max_ac_pu) == (lowest, 1.10)
        assert (net.v_min_pu, net.v_max_pu) == (lowest + 0.007, 1.093)
        assert any(origin in note for note in assumptions(feeder, rules))


@cache
def street() -> Any:
    """A lane with two customers on one bus, and a battery; two mills have the same name."""
    net = pp.create_empty_network()
    grid, school, mills = (pp.create_bus(net, 0.4, name=n) for n in ("Substation", "School", None))
    pp.create_ext_grid(net, grid)
    for above, below in ((grid, school), (school, mills)):
        pp.create_line_from_parameters(net, above, below, 0.1, 0.2, 0.08, 0.0, 0.2)
    pp.create_load(net, school, 0.010, 0.002, name="Classrooms")
    pp.create_load(net, school, 0.004, 0.001, name="Kitchen")
    for _ in range(2):
        pp.create_load(net, mills, 0.006, 0.0, name="Mill")
    pp.create_sgen(net, school, 0.005, name="School roof", type="PV")
    pp.create_storage(net, mills, 0.0, 0.020, max_p_mw=0.01, min_p_mw=-0.01, name="Yard battery")
    return net


def test_names_of_the_source_that_no_file_takes_are_changed(tmp_path: Path) -> None:
    net = deepcopy(street())
    net.load["name"] = ["time", "=1+1", "+x", "@x"]
    net.bus["name"] = ["- hill", " 007 ", "nan"]
    write_new_scenario(import_network(net, names=True), NewScenarioOptions(), tmp_path / "street")
    day = read_scenario(tmp_path / "street")
    assert [*day.customers.id] == ["time (load 0)", "1+1", "x (load 2)", "x (load 3)"]
    assert [*day.network.buses] == ["hill", "007", "nan"]


def test_what_one_house_has_has_names_of_its_own() -> None:
    """Sources have names by class; readings and set-points go by name alone."""
    net = deepcopy(street())
    for table in (net.sgen, net.storage):
        table["name"] = "Classrooms"
    made = new_scenario(import_network(net, names=True), NewScenarioOptions())
    assert [*made.pv.id] == ["PV of Classrooms"]
    assert [*made.batteries.id] == ["battery of Classrooms"]


@pytest.mark.nightly
def test_names_of_the_source_and_several_customers_on_a_bus(tmp_path: Path) -> None:
    feeder = import_network(street(), names=True)
    outages = (parse_outage("12:00..16:00", START),)
    options = NewScenarioOptions(step_minutes=240.0, outages=outages)
    write_new_scenario(feeder, options, tmp_path / "street")
    day = read_scenario(tmp_path / "street")
    assert [*map(str, day.network.buses)] == ["Substation", "School", "2"]
    assert [*zip(day.customers.id, day.customers.bus, strict=True)] == [
        ("Classrooms", "School"),
        ("Kitchen", "School"),
        ("Mill (load 2)", "2"),
        ("Mill (load 3)", "2"),
    ]
    assert [*day.pv.id] == ["School roof"] and [*day.pv.customer] == [""]
    assert [*day.batteries.id] == ["Yard battery"]
    by_bus = new_scenario(import_network(street()), options)
    assert [*by_bus.customers.id] == ["c1", "c2"]
    np.testing.assert_allclose(day.load_kw.sum(axis=1), by_bus.load_kw.sum(axis=1))
    np.testing.assert_allclose(day.load_kvar.sum(axis=1), by_bus.load_kvar.sum(axis=1), rtol=1e-6)
    run = run_day(day, RunOptions(horizon_h=4.0))
    assert "Classrooms" in set(run.customers["id"])
    net = deepcopy(street())
    run.apply_to(net, feeder, run.steps["time"].iloc[3])
    assert net.load.loc[net.load["name"] == "Kitchen", "in_service"].any()


def mill_lane(column: str = "tier") -> Any:
    """A care home and homes on one bus, a school and homes on the next, each with its tier."""
    net = buses_in_a_row(3, 0.4, 0.05)
    for bus, p_kw, name in (
        (1, 62.0, "Homes 1-40"),
        (1, 9.0, "Care home"),
        (2, 35.0, "School"),
        (2, 71.0, "Homes 41-90"),
    ):
        pp.create_load(net, bus, p_kw / 1e3, p_kw / 4e3, name=name)
    net.load[column] = ["low", "critical", "high", None]
    return net


@pytest.mark.parametrize("column", ["tier", "Tier ", "priority"])
def test_each_load_of_a_bus_keeps_its_own_tier(column: str, tmp_path: Path) -> None:
    notes = write_new_scenario(
        import_network(mill_lane(column), names=True), NewScenarioOptions(), tmp_path / "lane"
    )
    day = read_scenario(tmp_path / "lane")
    assert dict(zip(day.customers.id, day.customers.tier, strict=True)) == {
        "Homes 1-40": "low",
        "Care home": "critical",
        "School": "high",
        "Homes 41-90": "low",
    }
    assert not any("merge loads" in note for note in notes)


def test_merged_customers_have_the_highest_tier_of_their_loads(tmp_path: Path) -> None:
    notes = write_new_scenario(import_network(mill_lane()), NewScenarioOptions(), tmp_path / "lane")
    day = read_scenario(tmp_path / "lane")
    assert day.customers.tier.tolist() == ["critical", "high"]
    assert (
        "Customers that merge loads of several tiers have the highest: c1 (critical; load 0 (Homes "
        "1-40): low, load 1 (Care home): critical); c2 (high; load 2 (School): high, load 3 (Homes "
        "41-90): low). With --source-names each load is a customer of its own."
    ) in notes


def test_loads_by_phase_keep_their_tiers(tmp_path: Path) -> None:
    net = mill_lane()
    net.line[["r0_ohm_per_km", "x0_ohm_per_km", "c0_nf_per_km"]] = [0.9, 0.6, 0.0]
    pp.create_asymmetric_load(net, 2, p_a_mw=0.004, name="Clinic")
    net.asymmetric_load["tier"] = ["critical"]
    by_phase = new_scenario(import_network(net))
    tiers = dict(zip(by_phase.customers.id, by_phase.customers.tier, strict=True))
    assert tiers["c1"] == "critical" and tiers["c2"] == "high"
    assert [tier for name, tier in tiers.items() if name.startswith("c0p")] == ["critical"]
    spread = new_scenario(import_network(net, balance=True))
    assert spread.customers.tier.tolist() == ["critical", "critical"]


def test_an_unknown_tier_is_refused_with_its_load() -> None:
    net = mill_lane("priority")
    net.load["priority"] = [3, 1, 2, 3]
    with pytest.raises(InputError, match=r"tier = 1: is not a tier \(load 1 \(Care home\)\)"):
        new_scenario(import_network(net))


def test_the_only_customer_has_its_tier() -> None:
    net = buses_in_a_row(2, 11.0)
    pp.create_load(net, 1, p_mw=0.3)
    notes = assumptions(import_network(net), NewScenarioOptions())
    assert "The only customer is in tier 'all': the source names none, and none was drawn." in notes
