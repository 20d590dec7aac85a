"""Scenario folders: what is written is read back equal, in any format; whole or absent."""

from __future__ import annotations

import json
import tomllib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.pages import attribute_table_markdown
from tests.support.refusals import refusal
from tests.support.tiny_day import tiny_scenario
from vppres.core.errors import InputError
from vppres.io import (
    find_scenario,
    packaged_scenarios,
    read_scenario,
    scenario_digest,
    schema,
    write_scenario,
)
from vppres.io.editor import json_schema
from vppres.io.python_door import check_scenario
from vppres.io.schema import PhaseConnectionRow
from vppres.io.tables import Table, read_rows
from vppres.kinds.customer.data import SwitchingRules
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.fairness import Fairness, Interruption
from vppres.scenario.faults import LineFault
from vppres.scenario.network import BUS_DRAWS, LINE_DEFAULTS, Network
from vppres.scenario.scenario import ControllerDefaults, ObjectiveWeights, Scenario
from vppres.scenario.timegrid import TimeGrid

ROOT = Path(__file__).parents[2]
SERIES = ("load_kw", "pv_kw", "price_gbp_per_kwh", "temperature_c", "grid_limit_kw")


def assert_equal(a: Scenario, b: Scenario) -> None:
    """Every value of two scenarios, without going through the digest."""
    for name in SERIES:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for table in ("customers", "pv", "batteries"):
        for f in fields(getattr(a, table)):
            mine, other = (getattr(getattr(s, table), f.name) for s in (a, b))
            np.testing.assert_array_equal(mine, other)
    for name in (
        "buses",
        "from_bus",
        "to_bus",
        "r_ohm",
        "x_ohm",
        *LINE_DEFAULTS,
        *BUS_DRAWS,
        "island",
    ):
        np.testing.assert_array_equal(getattr(a.network, name), getattr(b.network, name))
    for name in schema.NetworkSection.model_fields:
        owners = (a, b) if name == "export_limit_kw" else (a.network, b.network)
        assert getattr(owners[0], name) == getattr(owners[1], name)
    for name in ("name", "title", "grid", "tiers", "objective", "controller"):
        assert getattr(a, name) == getattr(b, name)


def round_trip(scenario: Scenario, folder: Path) -> Scenario:
    write_scenario(scenario, folder)
    return read_scenario(folder)


def test_round_trip(tiny: Scenario, tiny_folder: Path) -> None:
    read = read_scenario(tiny_folder)
    assert_equal(read, tiny)
    assert scenario_digest(read) == scenario_digest(tiny)
    assert [type(bus) for bus in read.customers.bus] == [int, int, int]
    # Nothing stands in the files that the scenario does not have.
    assert not (tiny_folder / "buses.csv").exists()
    header = (tiny_folder / "lines.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == "from_bus,to_bus,r_ohm,x_ohm"


def with_transformer(scenario: Scenario) -> Scenario:
    """A tap, charging, a capacitor, a fixed demand and a leading load."""
    network = replace(
        scenario.network,
        ratio=[1.0, 1.0375, 1.0],
        b_us=[12.5, 0.0, 3.0],
        g_us=[0.0, 1.0, 0.0],
        drawing_bus=[4, 3],
        p_shunt_kw=[],
        q_shunt_kvar=[-300.0, 0.0],
        p_fixed_kw=[0.0, 1.5],
        q_fixed_kvar=[],
        island=[False, True],
    )
    customers = replace(scenario.customers, power_factor=[0.95, -0.9, -1.0])
    return replace(scenario, network=network, customers=customers)


def test_ratios_charging_and_shunts_come_back(tiny: Scenario, tmp_path: Path) -> None:
    scenario = with_transformer(tiny)
    read = round_trip(scenario, tmp_path / "other")
    assert_equal(read, scenario)
    assert scenario_digest(read) == scenario_digest(scenario) != scenario_digest(tiny)
    buses = (tmp_path / "other" / "buses.csv").read_text(encoding="utf-8").splitlines()
    assert buses == ["bus,q_shunt_kvar,p_fixed_kw,island", "3,0.0,1.5,yes", "4,-300.0,0.0,no"]
    assert read.customers.q_per_p[1] == pytest.approx(-np.tan(np.arccos(0.9)))


def test_round_trip_of_everything_that_is_not_a_default(tiny: Scenario, tmp_path: Path) -> None:
    net = tiny.network
    scenario = replace(
        tiny,
        title='A "quoted" title, £ and \\',
        grid=TimeGrid(pd.Timestamp("2022-03-27T00:30:00+01:00"), 7.5, 6),
        network=Network(
            np.array(["gsp", "a 1", "a 1"], object),
            np.array(["a 1", "3", "b"], object),
            net.r_ohm,
            net.x_ohm,
            "gsp",
            20.0,
            0.98,
            0.9,
            1.1,
            0.89,
            1.2,
        ),
        customers=replace(
            tiny.customers,
            bus=["a 1", "3", "b"],
            weight=[3.0, 0.1, 0.02],
            tier=["vital", "high", "high"],
        ),
        batteries=replace(
            tiny.batteries,
            bus=["a 1", "b"],
            t_initial_c=[22.0, np.nan],
            r_theta_c_per_kw=[2.771, 4.486],
            eta_charge=[0.9, 1.0],
        ),
        grid_limit_kw=[120.0, 0.0, np.inf, 0.0, 0.0, 0.0],
        tiers=("vital", "high", "unused"),
        objective=ObjectiveWeights(1e-5, 0.2, 0.0, 1e-300),
        controller=ControllerDefaults("full-horizon", 0.25),
    )
    read = round_trip(scenario, tmp_path / "other")
    assert_equal(read, scenario)
    assert scenario_digest(read) == scenario_digest(scenario)
    document = tomllib.loads((tmp_path / "other" / "scenario.toml").read_text(encoding="utf-8"))
    assert len(document["outages"]) == 2


def of_customers(**columns: object) -> dict[str, object]:
    """The tiny day's customers with these columns."""
    return {"customers": replace(tiny_scenario().customers, **columns)}


DAWN = pd.Timestamp("2022-07-18T04:00Z")
PAST = (
    Interruption(DAWN, DAWN + pd.Timedelta("6h")),
    Interruption(DAWN, DAWN + pd.Timedelta("2h"), "shop"),
    Interruption(DAWN + pd.Timedelta("4h"), DAWN + pd.Timedelta("5h"), "shop"),
)
RULES = SwitchingRules(min_served_h=2.0, max_actions_per_customer=4, stay_restored=True)
BEYOND_THE_PAPER: dict[str, tuple[dict[str, object], str]] = {
    "dimmed": (
        of_customers(share_min=[1.0, 0.25, 1.0], recover_h=[np.nan, 2.0, np.nan]),
        "share_min",
    ),
    "longest off": (of_customers(max_off_h=[4.0, np.nan, 2.0]), "off_h"),
    "own backup": (of_customers(max_off_h=[np.nan] * 3, own_backup_h=[4.0, 1.5, 0.0]), "backup"),
    "parts": (of_customers(shed_steps=[1, 4, 1]), "shed_steps"),
    "rules": ({"switching": RULES}, "switching"),
    "shared": ({"fairness": Fairness(rotation=0.2, turn_h=2.0, minimum_on_h=1.0)}, "rotation"),
    "outages of the past": ({"interruptions": PAST}, "interruption"),
}


@pytest.mark.parametrize("name", BEYOND_THE_PAPER)
def test_what_is_beyond_the_paper_comes_back_and_is_not_there_without(
    name: str, tiny: Scenario, tiny_folder: Path, tmp_path: Path
) -> None:
    changes, word = BEYOND_THE_PAPER[name]
    day = replace(tiny, **changes)
    check_scenario(day)
    read = round_trip(day, tmp_path / "other")
    assert_equal(read, day)
    assert scenario_digest(read) == scenario_digest(day) != scenario_digest(tiny)
    assert not any(word in file.read_text("utf-8") for file in tiny_folder.glob("*.[ct]*"))
    for part in ("switching", "fairness", "interruptions"):
        assert getattr(read, part) == getattr(day, part)


@pytest.mark.nightly
@settings(max_examples=12)
@given(values=st.lists(st.floats(0, 1e6), min_size=18, max_size=18))
def test_numbers_come_back_to_the_last_digit(
    tmp_path_factory: pytest.TempPathFactory, values: list[float]
) -> None:
    scenario = replace(tiny_scenario(), load_kw=np.reshape(values, (6, 3)))
    read = round_trip(scenario, tmp_path_factory.mktemp("numbers") / "s")
    np.testing.assert_array_equal(read.load_kw, scenario.load_kw)


def test_scenario_without_pv_and_batteries(tiny: Scenario, tmp_path: Path) -> None:
    none = {f.name: [] for f in fields(Batteries)}
    bare = replace(
        tiny, pv=PVSystems([], [], [], []), batteries=Batteries(**none), pv_kw=np.empty((6, 0))
    )
    folder = tmp_path / "bare"
    assert_equal(round_trip(bare, folder), bare)
    for file in ("pv.csv", "pv_kw.csv", "batteries.csv"):
        (folder / file).unlink()
    assert_equal(read_scenario(folder), bare)


def test_parquet_gives_the_same_scenario(tiny: Scenario, tiny_folder: Path) -> None:
    names = ["lines", "customers", "pv", "batteries", "load_kw", "pv_kw", "system"]
    for name in names:
        frame = pd.read_csv(tiny_folder / f"{name}.csv")
        if "time" in frame:
            frame["time"] = pd.to_datetime(frame["time"])
            frame = frame.set_index("time")
        frame.to_parquet(tiny_folder / f"{name}.parquet")
        (tiny_folder / f"{name}.csv").unlink()
    with (tiny_folder / "scenario.toml").open("a", encoding="utf-8") as file:
        file.write("[files]\n" + "".join(f'{name} = "{name}.parquet"\n' for name in names))
    read = read_scenario(tiny_folder)
    assert_equal(read, tiny)
    assert scenario_digest(read) == scenario_digest(tiny)


def test_defaults_fill_what_the_files_leave_out(tiny_folder: Path) -> None:
    (tiny_folder / "batteries.csv").write_text(
        "id,bus,energy_kwh,p_max_kw,s_max_kva,soc_min,t_ref_c\nb,2,100,50,60,0.2,\n",
        encoding="utf-8",
    )
    (tiny_folder / "scenario.toml").write_text(
        'name = "short"\ntime = {start = 2022-07-19T10:00:00Z, step_minutes = 60, steps = 6}\n'
        "network = {base_kv = 11, slack_bus = 1}\ntiers = {critical = 2, high = 1, low = 0.5}\n",
        encoding="utf-8",
    )
    read = read_scenario(tiny_folder)
    assert read.title == "short"
    assert read.objective == ObjectiveWeights()
    assert read.controller == ControllerDefaults()
    assert (read.network.v_min_pu, read.network.v_max_pu) == (0.947, 1.053)
    assert (read.network.v_min_ac_pu, read.network.v_max_ac_pu) == (0.94, 1.06)
    assert read.customers.weight.tolist() == [2.0, 1.0, 0.5]
    assert not read.outage.any()
    battery = {f.name: getattr(read.batteries, f.name)[0] for f in fields(Batteries)}
    assert np.isnan(battery.pop("t_initial_c"))
    assert battery == {
        "id": "b", "bus": 2, "energy_kwh": 100.0, "p_max_kw": 50.0, "s_max_kva": 60.0,
        "soc_min": 0.2, "soc_max": 0.85, "soc_initial": 0.2, "eta_charge": 0.95,
        "eta_discharge": 0.95, "r_theta_c_per_kw": 3.5, "c_theta_kwh_per_c": 0.3,
        "alpha_charge_per_c2": 1e-4, "alpha_discharge_per_c2": 1e-4, "r_int_ohm": 0.0035,
        "beta_per_c": 0.003, "u_batt_v": 900.0, "t_ref_c": 25.0, "grid_forming": False,
    }  # fmt: skip


def test_one_named_bus_makes_all_buses_text(tiny_folder: Path) -> None:
    for file in ("lines.csv", "batteries.csv", "customers.csv"):
        text = (tiny_folder / file).read_text(encoding="utf-8")
        (tiny_folder / file).write_text(
            text.replace("2,4,0.5", "2,north,0.5")
            .replace("small,4,", "small,north,")
            .replace("homes,4,", "homes,north,"),
            encoding="utf-8",
        )
    read = read_scenario(tiny_folder)
    assert set(read.network.buses) == {"1", "2", "3", "north"}
    assert read.network.slack_bus == "1"
    assert read.customers.bus.tolist() == ["2", "3", "north"]


def test_series_may_use_another_offset_and_reordered_columns(
    tiny: Scenario, tiny_folder: Path
) -> None:
    frame = pd.read_csv(tiny_folder / "load_kw.csv")
    frame["time"] = [f"2022-07-19 {hour}:00+01:00" for hour in range(11, 17)]
    frame[["homes", "time", "hospital", "shop"]].to_csv(tiny_folder / "load_kw.csv", index=False)
    np.testing.assert_array_equal(read_scenario(tiny_folder).load_kw, tiny.load_kw)


def test_pv_may_exceed_its_rating_by_rounding(tiny_folder: Path) -> None:
    text = (tiny_folder / "pv_kw.csv").read_text(encoding="utf-8")
    (tiny_folder / "pv_kw.csv").write_text(
        text.replace("30.0,20.0", "30.02,20.0"), encoding="utf-8"
    )
    assert read_scenario(tiny_folder).pv_kw.max() == 30.02


def test_spreadsheet_habits_are_read(tiny: Scenario, tiny_folder: Path) -> None:
    """Byte order mark, CR LF, spaces around cells, rows and columns of commas at the end."""
    text = (tiny_folder / "customers.csv").read_text(encoding="utf-8")
    rows = text.replace(",", " , ").replace("\n", ",,\r\n") + ",,,,,\r\n\r\n"
    (tiny_folder / "customers.csv").write_bytes(b"\xef\xbb\xbf" + rows.encode())
    assert_equal(read_scenario(tiny_folder), tiny)


def test_an_unwritable_scenario_is_refused_before_anything_is_written(
    tiny: Scenario, tmp_path: Path
) -> None:
    assert refusal(write_scenario, replace(tiny, name="a b"), tmp_path / "out") == (
        "scenario.toml, name = a b: is not allowed. Give the short name of the scenario: letters, "
        "digits, '-', '_' and '.'."
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "message"), [
    ("time", "is reserved for the time column"), (" homes", "begins or ends with a space"),
])  # fmt: skip
def test_a_name_that_files_change_is_refused_in_python(
    tiny: Scenario, tmp_path: Path, name: str, message: str
) -> None:
    renamed = replace(tiny.customers, id=["hospital", "shop", name])
    pv = replace(tiny.pv, customer=["hospital", name])
    with pytest.raises(InputError, match=message):
        write_scenario(replace(tiny, customers=renamed, pv=pv), tmp_path / "renamed")


def test_a_scenario_that_is_too_long_to_be_read_is_not_written(
    tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Series have a row for each step, and are as long as the days are."""
    monkeypatch.setattr("vppres.io.schema.MAX_ITEMS", len(tiny.customers) - 1)
    n = len(tiny.customers)
    assert f"customers.csv: has {n} rows, more than {n - 1}. " in refusal(
        write_scenario, tiny, tmp_path / "long"
    )
    assert list(tmp_path.iterdir()) == []


def test_connections_by_phase_may_be_those_of_all_devices_together() -> None:
    """A feeder of 3,891 customers with PV power and batteries has 10,895 of them."""
    rows = pd.DataFrame(
        {"id": [f"d{i}" for i in range(10_895)], "bus": "1", "coils": "a", "kv": 0.24}
    )
    table = Table("phase_connections.csv", rows.astype(str))
    found, problems = read_rows(table, PhaseConnectionRow)
    assert (len(found), problems) == (10_895, [])


# --- digest -------------------------------------------------------------------------------------


@pytest.mark.parametrize("change", [
    {"load_kw": np.full((6, 3), 1.0)},
    {"name": "other"},
    {"tiers": ("high", "critical", "low")},
    {"grid": TimeGrid(pd.Timestamp("2022-07-19T11:00:00Z"), 60.0, 6)},
    {"grid_limit_kw": np.full(6, np.inf)},
    {"objective": ObjectiveWeights(lambda_q=1e-16)},
    {"network": Network(np.array([1, 2, 2]), np.array([2, 3, 4]), np.array([0.3, 0.4, 0.5]),
        np.array([0.2, 0.3, 0.4]), slack_bus=1, base_kv=11.0, v_min_pu=0.95)},
    {"customers": Customers(["hospital", "shop", "homes"], ["2", "3", "4"],
        ["critical", "high", "low"], [1.0, 0.1, 0.02], [0.95, 0.9, 0.98])},
])  # fmt: skip
def test_digest_sees_every_change(tiny: Scenario, change: dict[str, object]) -> None:
    assert scenario_digest(replace(tiny, **change)) != scenario_digest(tiny)


def test_digest_ignores_what_means_nothing(tiny: Scenario) -> None:
    same = replace(
        tiny,
        grid=TimeGrid(pd.Timestamp("2022-07-19T11:00:00+01:00"), 60, 6),
        network=Network(
            np.array([4, 3, 1]),
            np.array([2, 2, 2]),
            np.array([0.5, 0.4, 0.3]),
            np.array([0.4, 0.3, 0.2]),
            slack_bus=1,
            base_kv=11,
        ),
    )
    assert scenario_digest(same) == scenario_digest(tiny)


# --- finding ------------------------------------------------------------------------------------


def test_find_packaged_scenarios() -> None:
    for name in packaged_scenarios():
        assert (find_scenario(name) / "scenario.toml").is_file()


def test_find_by_name_beside_a_folder(tiny_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vppres.io.find._home", lambda: tiny_folder.parent)
    (tiny_folder.parent / "not-a-scenario").mkdir()
    assert packaged_scenarios() == ["tiny"]
    assert find_scenario("tiny") == tiny_folder
    assert find_scenario(tiny_folder) == tiny_folder
    assert find_scenario(str(tiny_folder)) == tiny_folder
    assert refusal(find_scenario, "tinny") == (
        "scenario tinny: is neither a packaged scenario nor a folder. Did you mean tiny?"
    )
    assert refusal(find_scenario, "x") == (
        "scenario x: is neither a packaged scenario nor a folder. "
        "Give the path of a scenario folder. Known: tiny."
    )


# --- one table of attributes --------------------------------------------------------------------


def test_the_page_holds_the_table_of_attributes() -> None:
    page = (ROOT / "docs" / "scenario_format.md").read_text(encoding="utf-8")
    assert page.endswith("\n" + attribute_table_markdown())


def test_the_example_of_the_page_is_read(tiny: Scenario, tiny_folder: Path) -> None:
    page = (ROOT / "docs" / "scenario_format.md").read_text(encoding="utf-8")
    example = page.split("```toml\n")[1].split("```")[0]
    (tiny_folder / "scenario.toml").write_text(example, encoding="utf-8")
    assert_equal(read_scenario(tiny_folder), tiny)


@pytest.mark.parametrize(("model", "frozen"), [
    (schema.CustomerRow, Customers),
    (schema.PVRow, PVSystems),
    (schema.BatteryRow, Batteries),
    (schema.ObjectiveSection, ObjectiveWeights),
    (schema.ControllerSection, ControllerDefaults),
])  # fmt: skip
def test_the_table_has_the_attributes_of_the_data(model: type, frozen: type) -> None:
    assert set(model.model_fields) == {f.name for f in fields(frozen)}


IN_NAMES = {"°C": "c", "°C²": "c2", "µS": "us", "l": "litres", "min": "minutes"}


def end_of_names(unit: str) -> str:
    """How names of attributes in a unit end: GBP/kWh is ``gbp_per_kwh``, 1/°C ``per_c``."""
    above, _, below = unit.partition("/")
    words = [] if above == "1" else [IN_NAMES.get(above, above.lower())]
    words += ["per", IN_NAMES.get(below, below.lower())] if below else []
    return "_".join(words).replace("per_litres", "per_litre")


def test_every_attribute_is_described_and_physical_ones_have_the_unit_of_their_name() -> None:
    """The units are those that any attribute has: a new one counts for all names like it."""
    tables = [model for model in schema.TABLES.values() if model is not schema.FilesSection]
    attributes = [item for model in tables for item in model.model_fields.items()]
    assert all(field.description for _, field in attributes)
    units = {schema.unit(field) for _, field in attributes} - {"", None, "share"}
    ends = {end_of_names(str(unit)): unit for unit in units}
    assert ends.keys() >= {"kw", "kwh", "gbp_per_kwh", "h", "c", "gbp_per_litre", "per_c2"}
    for name, field in attributes:
        found = [end for end in ends if f"_{name}".endswith(f"_{end}")]
        if found:
            assert schema.unit(field) == ends[max(found, key=len)], name


def test_json_schema_states_units_bounds_and_required_keys() -> None:
    definitions = json.loads(json.dumps(json_schema(), allow_nan=False))["$defs"]
    assert definitions["PVRow"]["properties"]["p_max_kw"] == {
        "description": "largest active power",
        "minimum": 0.001,
        "maximum": 1e6,
        "title": "P Max Kw",
        "type": "number",
        "unit": "kW",
    }
    assert definitions["ScenarioFile"]["required"] == ["name", "time", "network", "tiers"]


def test_faults_come_back(tiny: Scenario, tmp_path: Path) -> None:
    noon, hour = pd.Timestamp("2022-07-19T12:00Z"), pd.Timedelta(hours=1)
    faults = (
        LineFault(noon, noon + hour, line=3, known=False),
        LineFault(noon, noon + 2 * hour, bus=4),
    )
    scenario = replace(tiny, faults=faults)
    assert round_trip(scenario, tmp_path / "day").faults == faults
    assert Scenario.from_tables(scenario.to_tables()).faults == faults
    digests = [scenario_digest(day) for day in (scenario, replace(tiny, faults=faults[:1]), tiny)]
    assert len({*digests}) == 3


def test_a_fault_of_nothing_is_refused(tiny: Scenario) -> None:
    noon = pd.Timestamp("2022-07-19T12:00Z")
    for place in ({}, {"line": 3, "bus": 3}, {"line": 1}, {"bus": 9}):
        fault = LineFault(noon, noon + pd.Timedelta(hours=1), **place)
        with pytest.raises(InputError, match=r"is not a bus behind the grid's|names not one place"):
            replace(tiny, faults=(fault,))
