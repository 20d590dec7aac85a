"""Every mistake in a scenario folder gets its own message: file, row, field, value, cure."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings

from tests.support.command_line import call
from tests.support.mutations import EDITS, FILES, Edit, refuted
from tests.support.processor import processor_s_below
from tests.support.refusals import refusal
from tests.support.tiny_day import tiny_scenario
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.feeders import import_network
from vppres.io import find_scenario, read_scenario, scenario_digest, schema, write_scenario
from vppres.io.messages import MAX_PROBLEMS_PER_FILE, MAX_PROBLEMS_PER_KIND
from vppres.io.python_door import check_scenario
from vppres.scenario.network import check_radial
from vppres.scenario.scenario import Scenario

SLOW_S = 10.0
GRID_CURE = "The scenario's steps begin at 2022-07-19T10:00:00Z and last 60 min; there are 6."
FILE_CURE = "Add it, or name another file under [files] in scenario.toml."

# Each paragraph is a mistake: the file and what is wrong with it, the lines that are replaced in it
# ("-") and those that replace them ("+"), and the messages (">"), as whoever reads the folder sees
# them. Lines that replace none come at the end of the file, also of one that is not there yet.
MISTAKES = (Path(__file__).parent / "bad_scenarios.txt").read_text(encoding="utf-8").split("\n\n")


def messages(folder: Path) -> list[str]:
    """What reading a folder complains about."""
    return refusal(read_scenario, folder).split("\n")


def edit(folder: Path, file: str, old: str, new: str) -> None:
    """Replace the first occurrence of a text that must be there."""
    text = (folder / file).read_text(encoding="utf-8")
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1), encoding="utf-8")


def read_parquet(folder: Path, name: str) -> None:
    """Name a Parquet file in place of the CSV file."""
    named = f'[files]\n{name} = "{name}.parquet"\n[controller]'
    edit(folder, "scenario.toml", "[controller]", named)


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.partition("\n")[0])
def test_message(tiny_folder: Path, mistake: str) -> None:
    title, *lines = mistake.strip("\n").split("\n")
    parts = {kind: [line[1:] for line in lines if line[0] == kind] for kind in "-+>"}
    file = title.partition(":")[0]
    if parts["-"]:
        edit(tiny_folder, file, "\n".join(parts["-"]), "\n".join(parts["+"]))
    else:
        with (tiny_folder / file).open("a", encoding="utf-8") as end:
            end.write("\n".join([*parts["+"], ""]))
    assert messages(tiny_folder) == [message.strip() for message in parts[">"]]


def test_negative_grid_limit_is_refused_and_infinite_is_not(tiny_folder: Path) -> None:
    limits = ["inf", "120", "-1", "0", "-inf", "inf"]
    lines = (tiny_folder / "system.csv").read_text(encoding="utf-8").split()
    rows = [f"{line},{cell}" for line, cell in zip(lines, ["grid_limit_kw", *limits], strict=True)]
    (tiny_folder / "system.csv").write_text("\n".join(rows), encoding="utf-8")
    cure = "Give the largest import from the grid (inf, or no such column: no limit) in kW."
    assert messages(tiny_folder) == [
        f"system.csv, row 4, grid_limit_kw = -1: must be at least 0. {cure}",
        f"system.csv, row 6, grid_limit_kw = -inf: is not a finite number. {cure}",
    ]


MISSING = "the file is missing"
WRONG_BYTE = "row 2: is not UTF-8 text (byte 0xe9). Save the file with UTF-8 encoding."


@pytest.mark.parametrize(("file", "content", "message"), [
    *((f"{name}.csv", None, f"{name}.csv: {MISSING}. {FILE_CURE}")
        for name in ("lines", "customers", "load_kw", "pv_kw", "system")),
    ("pv.csv", None, f"pv.csv: {MISSING}, and pv_kw.csv has series of roof, field. {FILE_CURE}"),
    ("scenario.toml", None,
        f"scenario.toml: {MISSING}. A scenario folder needs it: see the page on the scenario "
        "format."),
    ("lines.csv", b"PK\x03\x04\x14\0", "lines.csv: is a spreadsheet, not text. Save its sheet as "
        "lines.csv: CSV, in UTF-8."),
    ("lines.csv", b"from_bus\tto_bus\n1\t2\n", "lines.csv, row 1: has a single column. Separate the "
        "cells with commas, and write decimal points."),
    ("lines.csv", b"", "lines.csv: is empty. Write a header row with column names."),
    ("pv_kw.csv", b"time,roof,field\n", f"pv_kw.csv: has no row. {GRID_CURE}"),
    *((name, b"name,caf\xc3\xa9\nx,caf\xe9\n", f"{name}, {WRONG_BYTE}")
        for name in ("lines.csv", "scenario.toml")),
])  # fmt: skip
def test_whole_files(tiny_folder: Path, file: str, content: bytes | None, message: str) -> None:
    if content is None:
        (tiny_folder / file).unlink()
    else:
        (tiny_folder / file).write_bytes(content)
    assert messages(tiny_folder) == [message]


def test_a_misspelt_file_is_not_left_out_in_silence(tiny_folder: Path) -> None:
    table = tiny_folder / "batteries.csv"
    shutil.copy(table, tiny_folder / "battery.csv")  # an older copy beside the right one
    assert len(read_scenario(tiny_folder).batteries) == 2
    table.unlink()
    assert messages(tiny_folder) == [
        "battery.csv: is not read: it is no file of a scenario. Did you mean batteries.csv? Rename "
        "it, or name it under [files]."
    ]


@pytest.mark.parametrize(("suffix", "cure"), [
    ("parquet", "Name it under [files]."),
    ("xlsx", "Save its sheet as batteries.csv: CSV, in UTF-8."),
])  # fmt: skip
def test_a_table_in_another_format_is_not_left_out_in_silence(
    tiny_folder: Path, suffix: str, cure: str
) -> None:
    (tiny_folder / "batteries.csv").rename(tiny_folder / f"batteries.{suffix}")
    assert messages(tiny_folder) == [
        f"batteries.{suffix}: is not read: it is no file of a scenario. Did you mean batteries.csv? "
        f"{cure}"
    ]


def test_a_run_folder_is_no_scenario(tiny_folder: Path, tmp_path: Path) -> None:
    run = tmp_path / "first"
    shutil.copytree(tiny_folder, run / "scenario")
    (run / "batteries.parquet").touch()
    assert messages(run) == [
        "scenario.toml: the file is missing. This is a run folder: give its copy of the scenario, "
        "first/scenario."
    ]


def test_a_misspelt_bus_of_a_line_is_found() -> None:
    ends = (["grid", "market", "market"], ["markt", "shop", "mill"])
    (problem,) = check_radial(*(np.array(end, dtype=object) for end in ends), "grid")
    assert str(problem) == (
        "lines, row 1: the network is disconnected: no path from the slack bus to bus market, shop, "
        "mill. Are market and markt one bus? Otherwise add the missing line or remove these buses."
    )


def test_broken_parquet(tiny_folder: Path) -> None:
    read_parquet(tiny_folder, "load_kw")
    (tiny_folder / "load_kw.parquet").write_bytes(b"time,hospital\n")
    found = messages(tiny_folder)
    assert len(found) == 1
    assert found[0].startswith("load_kw.parquet: is not a readable Parquet file (")
    assert found[0].endswith("). Write the file again.")


def test_parquet_with_lists_in_its_cells(tiny_folder: Path) -> None:
    frame = pd.read_csv(tiny_folder / "customers.csv")
    frame["bus"] = [[bus] for bus in frame["bus"]]
    frame.to_parquet(tiny_folder / "customers.parquet", index=False)
    read_parquet(tiny_folder, "customers")
    assert messages(tiny_folder)[0] == (
        "customers.parquet, bus: holds lists or tables. Write one number a cell."
    )


def test_what_pandas_notes_in_parquet_files_is_not_needed(tiny_folder: Path) -> None:
    before = read_scenario(tiny_folder)
    table = pa.Table.from_pandas(pd.read_csv(tiny_folder / "customers.csv"))
    note = {b"pandas": b'{"index_columns": ["none"], "column_indexes": 3, "columns": [[1]]}'}
    pq.write_table(table.replace_schema_metadata(note), tiny_folder / "customers.parquet")
    read_parquet(tiny_folder, "customers")
    assert scenario_digest(read_scenario(tiny_folder)) == scenario_digest(before)


@pytest.mark.parametrize("length", [200, 5000])
@pytest.mark.parametrize(
    "ask", [find_scenario, import_network, lambda name: RunOptions(controller=name)]
)
def test_long_names_are_cut_in_messages(ask: Callable[[str], object], length: int) -> None:
    told = refusal(ask, "x" * length)
    assert len(told) < 600 and "x" * 200 in told


def test_parquet_times_without_zone_and_missing_values(tiny_folder: Path) -> None:
    frame = pd.read_csv(tiny_folder / "load_kw.csv", parse_dates=["time"])
    frame["time"] = frame["time"].dt.tz_localize(None)
    frame.loc[2, "shop"] = None
    frame.to_parquet(tiny_folder / "load_kw.parquet", index=False)
    read_parquet(tiny_folder, "load_kw")
    found = messages(tiny_folder)
    assert found[0] == (
        "load_kw.parquet, row 2, time = 2022-07-19 10:00:00: has no time zone. "
        "Add the offset, for example 2022-07-19 10:00:00Z."
    )
    assert (
        "load_kw.parquet, row 4, shop: is empty. Give the demand of the customer if served in kW."
    ) in found
    assert len(found) == 7


def test_missing_folder(tmp_path: Path) -> None:
    folder = tmp_path / "nowhere"
    assert messages(folder) == [
        f"{folder}: there is no such folder. Give the path of a scenario folder."
    ]


def test_file_instead_of_folder(tiny_folder: Path) -> None:
    file = tiny_folder / "scenario.toml"
    assert messages(file) == [f"{file}: is not a folder. Give the path of a scenario folder."]


def test_all_files_are_reported_at_once_by_file_and_row(tiny_folder: Path) -> None:
    edit(tiny_folder, "system.csv", "0.45,33.0", "0.45,hot")
    edit(tiny_folder, "system.csv", "0.3,28.0", "dear,28.0")
    edit(tiny_folder, "lines.csv", "0.4,0.3", "0,0.3")
    edit(tiny_folder, "scenario.toml", "low = 0.02", "low = -1")
    places = [message.split(" = ")[0] for message in messages(tiny_folder)]
    assert places == [
        "scenario.toml, tiers.low",
        "lines.csv, row 3, r_ohm",
        "system.csv, row 2, price_gbp_per_kwh",
        "system.csv, row 7, temperature_c",
    ]


def test_tables_are_checked_even_if_the_scenario_file_cannot_be_read(tiny_folder: Path) -> None:
    (tiny_folder / "scenario.toml").write_text("name = ", encoding="utf-8")
    edit(tiny_folder, "pv.csv", "roof,hospital", "roof,hotel")
    assert [message.split(":")[0] for message in messages(tiny_folder)] == [
        "scenario.toml, row 1",
        "pv.csv, row 2, customer = hotel",
    ]


def test_problems_of_one_kind_are_folded(tiny_folder: Path) -> None:
    rows = "".join(f"{i},{i},high,2\n" for i in range(60))
    (tiny_folder / "customers.csv").write_text(
        "id,bus,tier,power_factor\n" + rows, encoding="utf-8"
    )
    found = [m for m in messages(tiny_folder) if m.startswith("customers.csv")]
    # 60 power factors and 56 buses (0 and 5 to 59) are wrong; each cure of the buses has its line.
    assert found[0] == (
        "customers.csv, row 2, power_factor = 2: must be at most 1 (in 60 rows: 2, 3, 4, 5, 6, ...). "
        "Give the power factor of the load (negative: leading)."
    )
    assert len(found) <= 1 + MAX_PROBLEMS_PER_KIND
    assert "is not a bus of lines.csv (in 46 rows: 16, 17, 18, 19, 20, ...)." in found[-1]
    told = call("validate", str(tiny_folder)).output
    # Two owners of PV systems are missing, and 60 columns of load; three columns are too many.
    assert "181 problems." in " ".join(told.split())


def test_very_many_kinds_of_problems_are_counted(tiny_folder: Path) -> None:
    """Each number of a battery is wrong in five ways."""
    fields = schema.BatteryRow.model_fields
    names = [name for name, field in fields.items() if field.annotation is float]
    ways = ("x", "-1e9", "1e9", "inf", "-inf")
    rows = "".join(f"b{way},2,{','.join([way] * len(names))}\n" for way in ways)
    (tiny_folder / "batteries.csv").write_text(
        f"id,bus,{','.join(names)}\n{rows}", encoding="utf-8"
    )
    found = [text for text in messages(tiny_folder) if text.startswith("batteries.csv")]
    assert len(found) == MAX_PROBLEMS_PER_FILE + 1
    assert found[-1].endswith(" more problems. Fix those above first.")


def test_many_columns_with_wrong_names_are_refused_quickly(tiny_folder: Path) -> None:
    count = 800
    customers = "".join(f"customer_number_{i:05},2,high,0.9\n" for i in range(count))
    (tiny_folder / "customers.csv").write_text(
        "id,bus,tier,power_factor\n" + customers, encoding="utf-8"
    )
    header = "".join(f",customer-nomber-{i:05}" for i in range(count))
    rows = "".join(f"2022-07-19T{hour}:00:00Z{',1' * count}\n" for hour in range(10, 16))
    (tiny_folder / "load_kw.csv").write_text(f"time{header}\n{rows}", encoding="utf-8")
    with processor_s_below(5.0):  # 45 s when every name was compared with every other
        found = [m for m in messages(tiny_folder) if m.startswith("load_kw.csv")]
    assert found[9] == (
        "load_kw.csv, customer_number_00009: the column is missing, and 790 more. "
        "Add one column per customer of customers.csv."
    )
    assert found[-1] == (
        "load_kw.csv, customer-nomber-00009: is not a known column, and 790 more. "
        "Did you mean customer_number_00009?"
    )


def test_a_file_without_end_is_refused_by_its_size(tiny_folder: Path) -> None:
    with (tiny_folder / "load_kw.csv").open("wb") as file:
        file.truncate(200_000_000)
    with processor_s_below(2.0):
        found = messages(tiny_folder)
    assert found == [
        "load_kw.csv: is too large, more than 100 MB. Give longer or fewer steps, or fewer columns."
    ]


SIZES = (
    "is too large, more than 527041 rows, 10001 columns or 10000000 cells. "
    "Give longer or fewer steps, or fewer columns."
)


@pytest.mark.nightly
def test_tables_beyond_any_feeder_are_refused(tiny_folder: Path) -> None:
    (tiny_folder / "load_kw.csv").write_text("time\n" + "x\n" * 527_041, encoding="utf-8")
    (tiny_folder / "pv_kw.csv").write_text("time" + ",x" * 10_001 + "\n", encoding="utf-8")
    (tiny_folder / "customers.csv").write_text(
        "id,bus,tier,power_factor\n" + "a,2,high,0.9\n" * 10_001, encoding="utf-8"
    )
    found = messages(tiny_folder)
    assert found[:1] == [
        "customers.csv: has 10001 rows, more than 10000. Reduce the feeder, or "
        "split it at its substation."
    ]
    assert found[-2:] == [f"load_kw.csv: {SIZES}", f"pv_kw.csv: {SIZES}"]


def test_a_small_parquet_file_with_very_many_rows_is_refused_unread(tiny_folder: Path) -> None:
    file = tiny_folder / "load_kw.parquet"
    pd.DataFrame({"time": np.zeros(600_000), "hospital": 0.0}).to_parquet(file)
    read_parquet(tiny_folder, "load_kw")
    assert file.stat().st_size < 100_000
    assert messages(tiny_folder) == [f"load_kw.parquet: {SIZES}"]


# --- numbers that no equipment has --------------------------------------------------------------


@pytest.mark.parametrize(("table", "field", "value", "message"), [
    ("batteries.csv", "energy_kwh", "1e308", "must be at most 1e+06"),
    ("batteries.csv", "eta_charge", "1e-300", "must be at least 0.01"),
    ("lines.csv", "r_ohm", "1e15", "must be at most 10000"),
    ("lines.csv", "r_ohm", "1e-300", "must be at least 1e-07"),
    ("customers.csv", "weight", "1e308", "must be at most 1e+06"),
    ("customers.csv", "share_min", "1.25", "must be at most 1"),
    ("pv.csv", "p_max_kw", "1e308", "must be at most 1e+06"),
    ("load_kw.csv", "shop", "1e308", "must be at most 1e+06"),
    ("system.csv", "price_gbp_per_kwh", "-1e308", "must be at least -10000"),
])  # fmt: skip
def test_numbers_that_no_equipment_has_are_refused(
    tiny_folder: Path, table: str, field: str, value: str, message: str
) -> None:
    frame = pd.read_csv(tiny_folder / table, dtype=str)
    frame[field] = frame.get(field, "1")
    frame.loc[1, field] = value
    frame.to_csv(tiny_folder / table, index=False)
    found = messages(tiny_folder)
    assert found[0].startswith(f"{table}, row 3, {field} = {value}: {message}. Give the ")


@pytest.mark.parametrize(("change", "message"), [
    ({"load_kw": np.full((6, 3), 1e308)},
        "load_kw, row 0, load_kw = 1e+308: must lie between 0 and 1e+06"),
    ({"price_gbp_per_kwh": np.full(6, np.nan)},
        "system, row 0, price_gbp_per_kwh = nan: must lie between -10000 and 10000"),
    ({"title": "a\x1b[2J"},
        "scenario, title = a\\x1b[2J: holds the character U+001B, which cannot be shown"),
    ({"customers": replace(tiny_scenario().customers, tier=["critcal", "high", "low"])},
        "customers, tier = critcal: is not a tier of the scenario (hospital). Did you mean critical?"),
])  # fmt: skip
def test_python_has_the_same_door_as_files(change: dict[str, Any], message: str) -> None:
    assert (
        refusal(check_scenario, replace(tiny_scenario(), **change))
        .splitlines()[0]
        .startswith(message)
    )


@pytest.mark.parametrize(("soc", "read"), [(0.15 - 1e-7, 0.15), (0.85 + 9e-7, 0.85)])
def test_a_rounding_error_of_the_state_of_charge_is_clipped_with_a_note(
    tiny_folder: Path, soc: float, read: float
) -> None:
    edit(tiny_folder, "batteries.csv", "0.85,0.5,", f"0.85,{soc!r},")
    batteries = read_scenario(tiny_folder).batteries
    assert batteries.soc_initial.tolist() == [0.15, read]
    assert batteries.notes == (
        f"The state of charge of battery small at the start, {soc:.9g}, is a rounding error "
        f"outside its limits: {read} is used.",
    )


@pytest.mark.parametrize("soc", [0.15 - 2e-6, 0.9, float("nan")])
def test_a_state_of_charge_outside_its_limits_is_refused_by_name(soc: float) -> None:
    assert refusal(replace, tiny_scenario().batteries, soc_initial=[0.15, soc]) == (
        f"battery small, soc_initial = {soc}: must lie between soc_min (0.15) and soc_max (0.85). "
        "Correct the state of charge at the start or the limits."
    )


# --- names ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "message"), [
    ('"a\x1b[2J"', "id = a\\x1b[2J: holds the character U+001B, which cannot be shown. "
        "Write it with characters that can be seen."),
    ('"a\nb"', "id = a\\nb: holds the character U+000A, which cannot be shown. "
        "Write it with characters that can be seen."),
    ("a\x00", "id = a\\x00: holds the character U+0000, which cannot be shown. "
        "Write it with characters that can be seen."),
    ("\u202eabc", "id = \\u202eabc: holds the character U+202E, which cannot be shown. "
        "Write it with characters that can be seen."),
    ("=1+1", "id = =1+1: begins with '='. Begin it with another character: spreadsheets take such "
        "a cell for a formula."),
    ("x" * 101, f"id = {'x' * 60}...: is longer than 100 characters. Shorten it."),
])  # fmt: skip
def test_names_that_cannot_be_shown_are_refused(tiny_folder: Path, name: str, message: str) -> None:
    edit(tiny_folder, "batteries.csv", "small,", f"{name},")
    assert messages(tiny_folder) == [f"batteries.csv, row {3 + name.count(chr(10))}, {message}"]


def test_the_name_of_a_tier_and_the_title_are_checked(tiny_folder: Path) -> None:
    edit(tiny_folder, "scenario.toml", "low = 0.02", '"a\\u0000" = 0.02\nlow = 0.02')
    edit(tiny_folder, "scenario.toml", 'title = "', 'title = "\\u001b')
    assert messages(tiny_folder) == [
        "scenario.toml, title = \\x1bFour buses, six hours: holds the character U+001B, which "
        "cannot be shown. Write it with characters that can be seen.",
        "scenario.toml, tiers.a\\x00 = a\\x00: holds the character U+0000, which cannot be shown. "
        "Write it with characters that can be seen.",
    ]


@pytest.fixture(scope="module")
def valid_texts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The files of the tiny folder."""
    folder = tmp_path_factory.mktemp("valid") / "tiny"
    write_scenario(tiny_scenario(), folder)
    return {file: (folder / file).read_text(encoding="utf-8") for file in FILES}


def mutated(texts: dict[str, str], folder: Path, count: int) -> list[Scenario]:
    """Read mutated copies of a folder; what is accepted comes out, the rest is refused by name."""
    found = list[Scenario]()

    @settings(max_examples=count)
    @given(edits=EDITS)
    def read(edits: list[tuple[str, Edit]]) -> None:
        changed = dict(texts)
        for file, edit in edits:
            changed[file] = edit(changed[file])
        for file, text in changed.items():
            path = folder / file
            path.write_text(text, encoding="utf-8", errors="surrogateescape", newline="")
        with processor_s_below(SLOW_S):
            found.extend(read_or_refused(folder))

    read()
    return found


def read_or_refused(folder: Path) -> list[Scenario]:
    """A folder is read, or refused with places and cures; anything else is an error."""
    try:
        scenario = read_scenario(folder)
    except InputError as error:
        assert all(problem.cure and problem.where for problem in error.problems)
        return []
    assert scenario.load_kw.shape == (scenario.grid.n_steps, len(scenario.customers))
    assert scenario.pv_kw.shape == (scenario.grid.n_steps, len(scenario.pv))
    return [scenario]


@pytest.mark.daily
def test_any_mutation_is_read_or_refused_with_reasons(
    valid_texts: dict[str, str], tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    mutated(valid_texts, tmp_path, pytestconfig.getoption("fuzz"))


@pytest.mark.nightly
def test_what_is_read_of_mutated_folders_runs_to_the_end(
    valid_texts: dict[str, str], tmp_path: Path, nightly: bool
) -> None:
    folders, runs = (1000, 30) if nightly else (40, 1)
    finished = 0
    accepted = mutated(valid_texts, tmp_path, folders)
    assert folders - len(accepted) > 13
    for number, scenario in enumerate(accepted[:runs]):
        options = RunOptions(horizon_h=3.0, mode=("paper", "physical")[number % 2])
        with suppress(InputError):  # refused by name, which is an answer
            assert refuted(run_day(scenario, options)) == []
            finished += 1
    assert finished >= 1


@pytest.mark.parametrize("file", ["lines.csv", "scenario.toml"])
@pytest.mark.parametrize(("kind", "words"), [
    ("folder", "is a folder, not a file"),
    ("pipe", "is a pipe or a device, not a file"),
    ("link", "leads out of the scenario folder, and is not read"),
])  # fmt: skip
def test_what_is_no_file_of_the_folder_is_named(
    tiny_folder: Path, tmp_path_factory: pytest.TempPathFactory, file: str, kind: str, words: str
) -> None:
    path = tiny_folder / file
    elsewhere = path.rename(tmp_path_factory.mktemp("elsewhere") / file)
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(elsewhere)
    assert f"{file}: {words}" in refusal(read_scenario, tiny_folder)


def test_a_link_within_the_folder_is_read(tiny_folder: Path) -> None:
    path = tiny_folder / "lines.csv"
    path.symlink_to(path.rename(tiny_folder / "feeder-17.csv").name)
    read_scenario(tiny_folder)
