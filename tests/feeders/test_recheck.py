"""A run's set-points on the original feeder: voltages per phase, by hand, beside the plan's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import vppres
from tests.support.refusals import refusal
from vppres.feeders.dss.recheck import Recheck, recheck_opendss
from vppres.report.rechecked import recheck_run, summary_of, write_recheck

TIMES = pd.date_range("2025-07-01T00:00Z", periods=3, freq="h")
BUSES = ("src", "a", "b")
BASE_V = 400.0 / np.sqrt(3)
Z_MAIN, Z_DROP = 0.1 + 0.1j, 0.2 + 0.1j  # ohm of each conductor: no coupling, as r0 = r1

# The main line has three phases, the drop phase b alone. Bus a has a load on three phases and one
# between a and c, bus b a house with a load that is an impedance in the file.
LANE = """
new circuit.lane basekv=0.4 pu=1.0 bus1=src phases=3 isc3=1e9 isc1=1e9
new line.main bus1=src bus2=a phases=3 r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0 length=1 units=km
new line.drop bus1=a.2 bus2=b.2 phases=1 r1=0.2 x1=0.1 r0=0.2 x0=0.1 c1=0 c0=0 length=1 units=km
new load.even bus1=a phases=3 kv=0.4 kw=9 kvar=0 vminpu=0.5 vmaxpu=1.5
new load.more bus1=a phases=3 kv=0.4 kw=3 kvar=0 vminpu=0.5 vmaxpu=1.5
new load.house bus1=b.2 phases=1 kv=0.230940 kw=4 kvar=1 model={model} vminpu=0.5 vmaxpu=1.5
new pvsystem.roof bus1=a phases=3 kv=0.4 pmpp=50 kva=60 irradiance=1
set voltagebases=[0.4]
"""


def lane(folder: Path, model: int = 1) -> Path:
    file = folder / "lane.dss"
    file.write_text(LANE.format(model=model))
    return file


def rows(names: list[str], **columns: list[Any]) -> pd.DataFrame:
    """One row for each step and item."""
    index = pd.MultiIndex.from_product([TIMES, names], names=["time", "bus"])
    return pd.DataFrame(columns, index=index).reset_index()


def run(**changes: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Three hours: all served, the house off and PV feeding, and an outage."""
    plan = {"v_ac_pu": [1.0, 0.99, 0.98, 1.0, 1.0, 1.0, np.nan, np.nan, np.nan]}
    return {
        "steps": pd.DataFrame(
            {"time": TIMES, "outage": [False, False, True], "p_grid_kw": [10.0, 0.0, 0.0]}
        ),
        "customers": rows(
            ["a", "b"],
            p_load_kw=[6.0, 3.0, 6.0, 3.0, 6.0, 3.0],
            q_load_kvar=[3.0, 1.5, 3.0, 1.5, 3.0, 1.5],
            served=[True, True, True, False, False, False],
        ),
        "pv": rows(
            ["b"], self_kw=[0.0, 1.0, 0.0], export_kw=[0.0, 1.0, 0.0], q_kvar=[0.0, 0.5, 0.0]
        ),
        "batteries": rows(
            ["a"], charge_kw=[1.5, 0.0, 0.0], discharge_kw=[0.0, 3.0, 0.0], q_kvar=[0.0, 0.0, 0.0]
        ),
        "buses": rows(list(BUSES), **plan),
        **changes,
    }


def by_hand(drawn_at_a: complex, drawn_at_b: complex) -> tuple[float, float]:
    """Voltages of one phase in pu, for powers in VA drawn at the end of each line."""
    a = b = complex(BASE_V)
    for _ in range(100):
        to_b = np.conj(drawn_at_b / b)
        a = BASE_V - Z_MAIN * (np.conj(drawn_at_a / a) + to_b)
        b = a - Z_DROP * to_b
    return abs(a) / BASE_V, abs(b) / BASE_V


def voltage(found: Recheck, step: int, bus: str, phase: str) -> float:
    table = found.voltages
    at = (table["time"] == TIMES[step]) & (table["bus"] == bus) & (table["phase"] == phase)
    return float(table.loc[at, "v_pu"].item())


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Recheck:
    return recheck_opendss(run(), lane(tmp_path_factory.mktemp("lane")))


def test_vehicles_machines_and_sets_are_what_a_battery_is(found: Recheck, tmp_path: Path) -> None:
    drawn_kw = [1.5, -3.0, 0.0]
    idle = rows(["a"], charge_kw=[0.0] * 3, discharge_kw=[0.0] * 3, q_kvar=[0.0] * 3)
    each = rows(["a"], p_kw=drawn_kw)  # drawn twice, and given once
    tables = run(batteries=idle, vehicles=each, thermal_loads=each, gensets=each)
    again = recheck_opendss(tables, lane(tmp_path))
    pd.testing.assert_frame_equal(again.voltages, found.voltages)


def test_served_demand_and_charging_are_on_their_phases(found: Recheck) -> None:
    # Bus a: 6 kW and 1.5 kW of charging on three phases; bus b: 3 kW and 1.5 kvar on phase b.
    each = (6e3 + 1.5e3 + 3e3j) / 3
    v_a, v_b = by_hand(each, 3e3 + 1.5e3j)
    assert voltage(found, 0, "a", "b") == pytest.approx(v_a, abs=1e-6)
    assert voltage(found, 0, "b", "b") == pytest.approx(v_b, abs=1e-6)
    alone, _ = by_hand(each, 0j)
    assert voltage(found, 0, "a", "a") == pytest.approx(alone, abs=1e-6)
    assert voltage(found, 0, "a", "c") == pytest.approx(alone, abs=1e-6)


def test_what_is_off_draws_nothing_and_what_is_fed_in_lifts(found: Recheck) -> None:
    v_a, v_b = by_hand((6e3 - 3e3 + 3e3j) / 3, -2e3 - 0.5e3j)
    assert voltage(found, 1, "a", "b") == pytest.approx(v_a, abs=1e-6)
    assert voltage(found, 1, "b", "b") == pytest.approx(v_b, abs=1e-6)
    assert v_b > v_a
    # The circuit's own 50 kW of PV are off: the source delivers load and losses, no more.
    assert found.steps["import_kw"].iloc[1] == pytest.approx(1.0, abs=0.1)
    assert "Switched off, as the run has its own in their place: pvsystem.roof." in found.notes


def test_the_largest_difference_has_its_cause(found: Recheck) -> None:
    worst = found.worst
    assert (worst["bus"], worst["phase"], worst["time"]) == ("b", "b", TIMES[0])
    assert worst["difference_pu"] == pytest.approx(worst["v_pu"] - worst["v_plan_pu"])
    assert found.cause.startswith("Bus b has 1 of three phases: ")
    summary = summary_of(found)
    assert summary["largest"]["bus"] == "b"
    assert summary["phases"]["a"]["buses"] == 2


def test_a_dark_feeder_is_not_compared(found: Recheck) -> None:
    dark = found.voltages[found.voltages["outage"]]
    assert dark["v_pu"].isna().all()
    assert "Dark in the plan, and not compared: 1 steps without grid." in found.notes


@pytest.mark.daily
def test_an_island_is_held_where_its_battery_is(tmp_path: Path) -> None:
    # The battery at bus a carries the 6 kW of its bus at 0.97 pu; the grid's bus follows it.
    lit = run()["buses"]
    lit.loc[lit["time"] == TIMES[2], "v_ac_pu"] = 0.97
    day = run(buses=lit)
    last = {name: frame["time"] == TIMES[2] for name, frame in day.items()}
    customers, batteries = day["customers"], day["batteries"]
    customers.loc[last["customers"] & (customers["bus"] == "a"), "served"] = True
    batteries.loc[last["batteries"], ["discharge_kw", "q_kvar"]] = 6.0, 3.0
    file = lane(tmp_path)
    capacitor = "new capacitor.c bus1=b.2 phases=1 kv=0.230940 kvar=2\n"
    file.write_text(file.read_text().replace("set voltagebases", capacitor + "set voltagebases"))
    found = recheck_opendss(day, file, island_bus="a", opened=["b"])
    for bus in ("src", "a", "b"):
        assert voltage(found, 2, bus, "b") == pytest.approx(0.97, abs=1e-6)
    assert found.steps["import_kw"].iloc[2] == pytest.approx(0.0, abs=1e-3)
    assert voltage(found, 0, "src", "b") == pytest.approx(1.0, abs=1e-6)
    assert any("a source at bus a holds the voltage" in note for note in found.notes)


def plan_at(v_pu: float) -> pd.DataFrame:
    return rows(list(BUSES), v_ac_pu=[v_pu] * 9)


@pytest.mark.nightly
def test_loads_that_follow_the_voltage_are_found_as_the_cause(tmp_path: Path) -> None:
    # An impedance at a source of 0.8 pu draws 64 %, which lifts the voltage of all phases alike.
    even = """
new circuit.lane basekv=0.4 pu=0.8 bus1=src phases=3 isc3=1e9 isc1=1e9
new line.main bus1=src bus2=a phases=3 r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0 length=1 units=km
new load.even bus1=a phases=3 kv=0.4 kw=60 kvar=0 model=2 vminpu=0.3 vmaxpu=1.5
set voltagebases=[0.4]
"""
    file = tmp_path / "even.dss"
    file.write_text(even)
    customers = rows(["a"], p_load_kw=[60.0] * 3, q_load_kvar=[0.0] * 3, served=[True] * 3)
    none = {name: frame.iloc[:0] for name, frame in run().items() if name in ("pv", "batteries")}
    drawn, v = 60e3 / 3, 0.8 * BASE_V
    for _ in range(200):
        v = abs(0.8 * BASE_V - Z_MAIN * drawn / v)
    buses = rows(["src", "a"], v_ac_pu=[0.8, v / BASE_V] * 3)
    found = recheck_opendss(run(customers=customers, buses=buses, **none), file)
    worst = found.worst
    assert worst["difference_pu"] > 0.005
    assert "loads that follow the voltage; with all of them as constant power" in found.cause


@pytest.mark.nightly
def test_small_differences_need_no_cause(tmp_path: Path) -> None:
    off = run()["customers"].assign(served=False)
    none = {name: frame.iloc[:0] for name, frame in run().items() if name in ("pv", "batteries")}
    found = recheck_opendss(run(customers=off, buses=plan_at(1.0), **none), lane(tmp_path))
    assert found.cause == "All differences are below 0.005 pu."


def test_a_run_of_another_feeder_is_refused(tmp_path: Path) -> None:
    customers = run()["customers"].replace({"bus": {"b": "elsewhere"}})
    assert refusal(recheck_opendss, run(customers=customers), lane(tmp_path)) == (
        "lane.dss: has no load at the buses of 1 customers: bus elsewhere. Give the file that the "
        "run's scenario was made from."
    )


BALANCED = """
new circuit.street basekv=0.4 pu=1.0 bus1=src phases=3 isc3=1e6 isc1=1e6
new line.main bus1=src bus2=a phases=3 r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0 length=1 units=km
new line.end bus1=a bus2=b phases=3 r1=0.2 x1=0.1 r0=0.2 x0=0.1 c1=0 c0=0 length=1 units=km
new load.shop bus1=a phases=3 kv=0.4 kw=3 kvar=0 vminpu=0.5 vmaxpu=1.5
new load.mill bus1=b phases=3 kv=0.4 kw=3 kvar=0 vminpu=0.5 vmaxpu=1.5
set voltagebases=[0.4]
"""


@pytest.mark.daily
def test_steps_with_lines_out_are_not_compared_with_a_circuit_that_has_them(
    tmp_path: Path,
) -> None:
    (tmp_path / "street.dss").write_text(BALANCED)
    feeder = vppres.import_network(tmp_path / "street.dss")
    noon = pd.Timestamp("2025-07-01T12:00Z")
    options = vppres.NewScenarioOptions(
        step_minutes=240.0, outages=((noon, noon + pd.Timedelta("4h")),)
    )
    day = vppres.new_scenario(feeder, options)
    fault = vppres.LineFault(noon - pd.Timedelta("4h"), noon, line="b")
    run = vppres.run_day(replace(day, faults=(fault,)), vppres.RunOptions("idle", mode="paper"))
    found = recheck_run(run, tmp_path / "street.dss")
    assert noon - pd.Timedelta("4h") not in set(found.steps["time"]) and len(found.steps) == 5
    what = "in which lines are out or switches stand otherwise than in the script"
    assert found.notes[-1] == f"Not compared: 1 step {what}."
    assert found.voltages["difference_pu"].abs().max() < 1e-4
    written = write_recheck(run, found, tmp_path / "recheck")
    assert written["largest"] is not None
    always = replace(fault, start=day.grid.start, end=day.grid.end)
    run = vppres.run_day(replace(day, faults=(always,)), vppres.RunOptions("idle", mode="paper"))
    with pytest.raises(vppres.InputError, match=f"has only steps {what}"):
        recheck_run(run, tmp_path / "street.dss")
