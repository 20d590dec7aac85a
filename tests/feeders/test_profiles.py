"""Series of load and generation from files, SimBench and pandapower's controllers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pandas as pd
import pytest
from pandapower.timeseries import DFData

from tests.support.command_line import call
from tests.support.refusals import refusal
from tests.support.small_nets import buses_in_a_row
from vppres.core.errors import InputError
from vppres.core.text import named
from vppres.feeders import ImportedFeeder, import_network
from vppres.feeders.new.options import NewScenarioOptions, first_day
from vppres.feeders.new.scenario import assumptions, new_scenario
from vppres.io import read_scenario

DAY = pd.date_range("2025-07-01T00:00Z", periods=24, freq="h")
RISING = np.arange(24.0)


def street() -> Any:
    """Three loads at the buses 1, 2 and 2; PV at bus 2, a windmill alone at bus 3, a battery."""
    net = buses_in_a_row(4, 0.4, length_km=0.06)
    for bus, p_mw, name in ((1, 0.01, "bakery"), (2, 0.02, "school"), (2, 0.03, "shop")):
        pp.create_load(net, bus, p_mw=p_mw, name=name)
    pp.create_sgen(net, 2, p_mw=0.04, type="PV", name="roof")
    pp.create_sgen(net, 3, p_mw=0.05, type="WP", name="mill")
    pp.create_storage(net, 1, p_mw=0.0, max_e_mwh=0.02, name="box")
    return net


@pytest.fixture(scope="module")
def feeder() -> ImportedFeeder:
    return import_network(street())


def options(folder: Path | str, **more: Any) -> NewScenarioOptions:
    return NewScenarioOptions(**{"profiles": folder, **more})


def write(folder: Path, name: str, **columns: Any) -> Path:
    frame = pd.DataFrame({"time": [t.isoformat() for t in DAY], **columns})
    frame.to_csv(folder / name, index=False)
    return folder


WAYS: dict[str, Callable[[Path], Any]] = {
    "wide, unit in the columns": lambda f: write(f, "a.csv", bakery_kw=RISING, roof_kw=RISING),
    "wide, in MW": lambda f: write(f, "series_mw.csv", bakery=RISING / 1e3, roof=RISING / 1e3),
    # 1 pu of the bakery is 10 kW, of the roof 40 kW
    "per unit": lambda f: write(f, "a_pu.csv", bakery=RISING / 10, roof=RISING / 40),
    "labels": lambda f: write(f, "a.csv", **{"load 0 [kW]": RISING, "sgen 0 (kW)": RISING}),
    "identifiers": lambda f: write(f, "a.csv", c1_kw=RISING, pv2_kw=RISING),
    "a file for each": lambda f: (
        write(f, "bakery.csv", p_kw=RISING),
        write(f, "roof.csv", kw=RISING),
    ),
    "Parquet": lambda f: (
        pd.DataFrame({"bakery_kw": RISING, "roof_kw": RISING}, DAY)
        .rename_axis("time")
        .to_parquet(f / "a.parquet")
    ),
    "long": lambda f: pd.concat(
        [
            pd.DataFrame({"time": DAY, "id": name, "value_mw": RISING / 1e3})
            for name in ("bakery", "roof")
        ]
    ).to_csv(f / "a.csv", index=False),
}


HALVES = pd.date_range("2025-07-01T00:00Z", periods=48, freq="30min")
LEVELS = np.tile([1.0, 3.0], 24) + np.repeat(RISING, 2)


@pytest.mark.parametrize(("column", "per_kwh"), [
    ("bakery_kWh", 1.0), ("bakery [Wh]", 1000.0), ("bakery_mwh", 0.001), ("bakery", 1.0),
])  # fmt: skip
def test_energy_of_half_hours_becomes_mean_power(
    column: str, per_kwh: float, feeder: ImportedFeeder, tmp_path: Path
) -> None:
    """1 and 3 kWh in the halves of an hour are 4 kW over it."""
    prices = {"price_gbp_per_kwh": 0.3}
    frame = pd.DataFrame({"time": HALVES, column: LEVELS * per_kwh, **prices})
    frame.to_csv(tmp_path / "a.csv", index=False)
    given = options(tmp_path, profile_unit=None if column != "bakery" else "kwh")
    day = new_scenario(feeder, given)
    assert day.load_kw[:, 0] == pytest.approx(4.0 + 2.0 * RISING)
    assert day.price_gbp_per_kwh == pytest.approx(0.3)
    note = "Energy from each time to the next, 30 min later, became mean power: bakery."
    assert note in assumptions(feeder, given)


def test_a_register_of_energy_is_refused(feeder: ImportedFeeder, tmp_path: Path) -> None:
    frame = pd.DataFrame({"time": HALVES, "bakery_kwh": np.cumsum(LEVELS)})
    frame.to_csv(tmp_path / "a.csv", index=False)
    assert refusal(new_scenario, feeder, options(tmp_path)) == (
        "a.csv, column = bakery_kwh: is energy that never falls. It is a meter's register: give "
        "the energy of each interval."
    )


@pytest.mark.parametrize("way", WAYS.values(), ids=list(WAYS))
def test_every_way_says_the_same(way: Any, feeder: ImportedFeeder, tmp_path: Path) -> None:
    way(tmp_path)
    day = new_scenario(feeder, options(tmp_path))
    assert day.load_kw[:, 0] == pytest.approx(RISING)
    assert day.pv_kw[:, list(day.pv.id).index("pv2")] == pytest.approx(RISING)
    assert day.load_kw[:, 1].max() == pytest.approx(50.0)  # school and shop as they were


@pytest.mark.parametrize("frame", [
    pd.DataFrame({"bakery_kw": np.repeat(RISING, 2), "roof_kw": np.repeat(RISING, 2)}),
    pd.DataFrame({"id": np.repeat(["bakery", "roof"], 48), "kw": np.tile(np.repeat(RISING, 2), 2)}),
], ids=["wide", "long"])  # fmt: skip
def test_rows_without_times_have_a_given_length(
    frame: pd.DataFrame, feeder: ImportedFeeder, tmp_path: Path
) -> None:
    frame.to_csv(tmp_path / "a.csv", index=False)
    assert refusal(new_scenario, feeder, options(tmp_path)) == (
        "a.csv: has no column of times. Name it time; the other columns are assets, or id and "
        "value. Without times say how long a row is with --profile-step."
    )
    day = new_scenario(feeder, options(tmp_path, profile_step_minutes=30.0))
    assert day.load_kw[:, 0] == pytest.approx(RISING)
    assert day.pv_kw[:, list(day.pv.id).index("pv2")] == pytest.approx(RISING)


def test_what_all_series_of_a_file_have_alike_is_told_once(
    feeder: ImportedFeeder, tmp_path: Path
) -> None:
    backwards = pd.DataFrame({"time": DAY[::-1], "bakery_kw": RISING, "roof_kw": RISING})
    backwards.to_csv(tmp_path / "a.csv", index=False)
    assert refusal(new_scenario, feeder, options(tmp_path)) == (
        "a.csv, time = 2025-07-01T22:00:00Z: has times that are out of order (bakery, roof). "
        "Sort the rows by time."
    )


def test_elements_behind_a_customer_add_up(feeder: ImportedFeeder, tmp_path: Path) -> None:
    write(tmp_path, "a_kw.csv", school=RISING, shop=2 * RISING, mill=np.full(24, 7.0))
    day = new_scenario(feeder, options(tmp_path))
    assert day.load_kw[:, 1] == pytest.approx(3 * RISING)
    wind = list(day.pv.id).index("wind3")
    assert day.pv_kw[:, wind] == pytest.approx(np.full(24, 7.0))
    notes = assumptions(feeder, options(tmp_path))
    assert "3 series from a_kw.csv; reactive power follows power factors." in notes
    assert "Invented: Load without a series follows one bundled summer day: c1." in notes, notes


@pytest.mark.parametrize("names", [True, False])
def test_every_name_that_the_scenario_gives_is_found(names: bool, tmp_path: Path) -> None:
    net = street()
    pp.create_sgen(net, 1, p_mw=0.02, type="diesel", name="standby")
    feeder = import_network(net, names=names)
    made = new_scenario(feeder)
    mine = [*made.customers.id, *made.pv.id, *made.batteries.id, *made.gensets.id]
    assert ("roof" in mine) is names
    write(tmp_path, "a.csv", **{f"{name} [kW]": RISING for name in mine})
    day = new_scenario(feeder, options(tmp_path))
    assert (day.load_kw == RISING[:, None]).all() and (day.pv_kw == RISING[:, None]).all()
    notes = assumptions(feeder, options(tmp_path))
    sets = named(made.gensets.id)
    assert f"Series of generating sets are not followed, as they are dispatched: {sets}." in notes
    batteries = named(made.batteries.id)
    assert (
        f"Series of batteries are not followed, as batteries are dispatched: {batteries}." in notes
    )


def test_prices_and_temperature_may_be_there(feeder: ImportedFeeder, tmp_path: Path) -> None:
    write(tmp_path, "a.csv", bakery_kw=RISING, price_gbp_per_kwh=RISING / 100, temperature_c=RISING)
    day = new_scenario(feeder, options(tmp_path))
    assert day.price_gbp_per_kwh == pytest.approx(RISING / 100)
    assert day.temperature_c == pytest.approx(RISING)
    assert not any("prices" in note for note in assumptions(feeder, options(tmp_path)))


def test_gaps_are_filled_with_a_note(feeder: ImportedFeeder, tmp_path: Path) -> None:
    write(tmp_path, "a.csv", bakery_kw=[*RISING[:5], "", "NaN", *RISING[7:]])
    day = new_scenario(feeder, options(tmp_path))
    assert day.load_kw[:, 0] == pytest.approx(RISING)
    assert (
        "Missing values of the series lie on a straight line between their neighbours: bakery "
        "(2 values, up to 120 min)." in assumptions(feeder, options(tmp_path))
    )
    assert refusal(new_scenario, feeder, options(tmp_path, max_gap_minutes=60.0)) == (
        "a.csv, bakery: has a gap of 120 min at 2025-07-01T05:00:00Z, and 60 min are filled at most. "
        "Complete the series, choose other days, or allow longer gaps with --max-gap."
    )


def test_series_of_batteries_are_named(feeder: ImportedFeeder, tmp_path: Path) -> None:
    write(tmp_path, "a.csv", box_kw=RISING, bakery_kw=RISING)
    assert "Series of batteries are not followed, as batteries are dispatched: box." in assumptions(
        feeder, options(tmp_path)
    )


@pytest.mark.parametrize(("columns", "message"), [
    ({"bakery": RISING},
        "a.csv: does not say the unit of bakery. End the column's or the file's name in _kw, _mw, "
        "_pu or, for energy, in _kwh, or give --profile-unit."),
    ({"bakry_kw": RISING},
        "a.csv, column = bakry_kw: is neither an asset of the scenario nor an element of the network. Did "
        "you mean bakery?"),
    ({"bakery_kw": -RISING},
        "a.csv, customer = c1: falls to -23 kW at 2025-07-01T23:00:00Z. Demand counts from 0: give "
        "generation as a system of its own."),
    ({"roof_kw": [-0.02, *RISING[1:]]},
        "a.csv, system = pv2: falls to -0.02 kW at 2025-07-01T00:00:00Z. Generation counts from 0: "
        "write 0 where the system draws power."),
    ({"bakery_kvar": RISING},
        "a.csv, column = bakery_kvar: is in kvar, and series are power in kW, MW or pu, or energy "
        "in kWh. Convert it. End the column's or the file's name in _kw, _mw, _pu or, for energy, "
        "in _kwh."),
    ({"roof_mw": RISING},
        "a.csv, system = pv2: reaches 2.3e+04 kW at 2025-07-01T23:00:00Z, and its largest power is 40 kW. Correct the "
        "unit of the series, or the power in the network."),
    ({"bakery_kw": ["much", *RISING[1:]]},
        "a.csv, row 2, bakery_kw = much: is not a number. Correct it, or leave it empty: a gap is "
        "filled, and the notes say so."),
    ({"bakery_kw": RISING, "load 0_kw": RISING},
        "a.csv, column = load 0_kw: has a series already. Keep one series for each element."),
])  # fmt: skip
def test_refusals(
    feeder: ImportedFeeder, tmp_path: Path, columns: dict[str, Any], message: str
) -> None:
    write(tmp_path, "a.csv", **columns)
    assert refusal(new_scenario, feeder, options(tmp_path)) == message


def test_problems_of_one_kind_are_folded(feeder: ImportedFeeder, tmp_path: Path) -> None:
    write(tmp_path, "a.csv", **{f"house {i}_kw": RISING for i in range(197)})
    with pytest.raises(InputError) as caught:
        new_scenario(feeder, options(tmp_path))
    assert len(caught.value.problems) == 10
    assert ", and 187 more." in str(caught.value.problems[-1])


def test_naive_times_on_the_long_day(feeder: ImportedFeeder, tmp_path: Path) -> None:
    """25 values of a day in London, times as its clocks show them: none is shifted or lost."""
    times = pd.date_range("2025-10-25T23:00Z", periods=25, freq="h").tz_convert("Europe/London")
    frame = pd.DataFrame({"time": times.strftime("%Y-%m-%d %H:%M"), "bakery_kw": np.arange(25.0)})
    frame.to_csv(tmp_path / "a.csv", index=False)
    start = first_day(None, "2025-10-26", "Europe/London")
    with pytest.raises(InputError, match="has no time zone"):
        new_scenario(feeder, options(tmp_path, start=start))
    day = new_scenario(feeder, options(tmp_path, start=start, time_zone="Europe/London"))
    assert day.grid.n_steps == 25
    assert day.load_kw[:, 0].tolist() == np.arange(25.0).tolist()
    assert [day.grid.local(t).hour for t in day.grid.times[:4]] == [0, 1, 1, 2]
    # From 12:00 to 18:00 on the clock is 12:00 to 18:00 UTC, as the clocks were put back.
    assert day.grid.times[day.outage][0] == pd.Timestamp("2025-10-26T12:00Z")
    assert day.outage.sum() == 6
    # The price of the evening begins at 16:00 on the clock.
    assert day.price_gbp_per_kwh[[16, 17]].tolist() == [0.36, 0.54]


@pytest.mark.nightly
@pytest.mark.parametrize(("date", "steps"), [("2025-03-30", 23), ("2025-10-26", 25)])
def test_command_makes_a_local_day(date: str, steps: int, tmp_path: Path) -> None:
    (tmp_path / "series").mkdir()
    year = pd.date_range("2025-01-01T00:00Z", "2025-12-31T23:30Z", freq="30min")
    values = year.dayofyear + year.hour / 100.0
    pd.DataFrame({"bakery_kw": values}, year.rename("time")).to_parquet(
        tmp_path / "series" / "a.parquet"
    )
    pp.to_json(street(), str(tmp_path / "net.json"))
    done = call(
        "new", tmp_path / "net.json", tmp_path / "mine", "--date", date,
        "--time-zone", "Europe/London", "--profiles", tmp_path / "series",
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    day = read_scenario(tmp_path / "mine")
    assert (day.grid.n_steps, day.grid.zone) == (steps, "Europe/London")
    utc = day.grid.times.tz_convert("UTC")
    assert day.load_kw[:, 0] == pytest.approx((utc.dayofyear + utc.hour / 100.0).to_numpy())
    assert (day.grid.local(day.grid.times[0]).hour, day.grid.local(day.grid.end).hour) == (0, 0)
    assert call("validate", tmp_path / "mine").exit_code == 0


def controlled(index: pd.Index) -> Any:
    net = street()
    data = DFData(pd.DataFrame({"b": RISING / 1e3, "roof": RISING / 1e3}, index))
    pp.control.ConstControl(
        net, "load", "p_mw", element_index=[0], profile_name=["b"], data_source=data
    )
    pp.control.ConstControl(
        net, "sgen", "p_mw", element_index=0, profile_name="roof", data_source=data
    )
    return net


@pytest.mark.parametrize(("as_file", "index"), [
    pytest.param(False, DAY, marks=pytest.mark.nightly),
    (True, DAY.tz_localize(None)),
    (False, pd.RangeIndex(24)),
], ids=["net", "file", "rows"])  # fmt: skip
def test_controllers_of_constants(as_file: bool, index: pd.Index, tmp_path: Path) -> None:
    net: Any = controlled(index)
    if as_file:
        pp.to_json(net, str(tmp_path / "net.json"))
        net = tmp_path / "net.json"
    feeder = import_network(net)
    assert len(feeder.profiles) == 2
    rows = {"profile_step_minutes": 60.0} if index.dtype == "int64" else {}
    if rows:
        assert refusal(new_scenario, feeder, options("source")) == (
            "ConstControl: has rows without times. Say how long a row is with --profile-step, in "
            "minutes; the first begins with the scenario."
        )
    day = new_scenario(feeder, options("source", time_zone="UTC", **rows))
    assert day.load_kw[:, 0] == pytest.approx(RISING)
    assert day.pv_kw[:, 0] == pytest.approx(RISING)


def test_year_of_simbench_follows_german_clocks() -> None:
    """The form of SimBench's tables, with the hour that is missing in March and comes twice."""
    net = street()
    net.load["profile"] = ["H0", "H0", None]
    net.sgen["profile"] = ["PV1", "WP1"]
    berlin = pd.date_range("2016-03-26T23:00Z", periods=23 * 4, freq="15min").tz_convert(
        "Europe/Berlin"
    )
    clock = berlin.strftime("%d.%m.%Y %H:%M")
    quarter = np.arange(92.0) / 92
    net.profiles = {
        "load": pd.DataFrame({"time": clock, "H0_pload": quarter, "H0_qload": 0.0}),
        "renewables": pd.DataFrame({"time": clock, "PV1": quarter, "WP1": 1 - quarter}),
    }
    feeder = import_network(net)
    chosen = options(
        "source",
        start=first_day(None, "2016-03-27", "Europe/Berlin"),
        time_zone="Europe/Berlin",
        step_minutes=15.0,
    )
    day = new_scenario(feeder, chosen)
    assert day.grid.n_steps == 92
    assert day.load_kw[:, 0] == pytest.approx(10 * quarter, abs=1e-6)
    assert day.pv_kw[:, 0] == pytest.approx(40 * quarter, abs=1e-6)
    assert day.pv_kw[:, 1] == pytest.approx(50 * (1 - quarter), abs=1e-6)


def test_network_without_series(feeder: ImportedFeeder) -> None:
    with pytest.raises(InputError, match="has no series of its own"):
        new_scenario(feeder, options("source"))


def test_scenario_folder_with_offsets_reads_right(tmp_path: Path, feeder: ImportedFeeder) -> None:
    """Times of a folder with the offsets of its clocks, which change within the day."""
    from vppres.io import write_scenario

    start = first_day(None, "2025-10-26", "Europe/London")
    day = new_scenario(feeder, NewScenarioOptions(start=start, time_zone="Europe/London"))
    write_scenario(day, tmp_path / "mine")
    texts = pd.read_csv(tmp_path / "mine" / "load_kw.csv")["time"].tolist()
    assert texts[:3] == [
        "2025-10-26T00:00:00+01:00",
        "2025-10-26T01:00:00+01:00",
        "2025-10-26T01:00:00Z",
    ]
    again = read_scenario(tmp_path / "mine")
    assert (again.grid.times == day.grid.times).all()
    assert again.load_kw.tolist() == day.load_kw.tolist()
    assert again.outage.tolist() == day.outage.tolist()
