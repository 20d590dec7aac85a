"""``switches.csv``: read, written and digested; no run depends on it.

What can be wrong with it stands in bad_scenarios.txt.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.io import read_scenario, write_scenario
from vppres.io.digest import scenario_digest
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches

SWITCHES = Switches(
    id=["T1", "S1", "B1"],
    from_bus=[4, 2, 1],
    to_bus=[3, 3, 2],
    kind=["tie", "sectionaliser", "breaker"],
    closed=[False, True, True],
    operable=[True, False, True],
    locked=["", "", "repair of the drive"],
    r_ohm=[0.3, np.nan, np.nan],
    x_ohm=[-0.1, np.nan, np.nan],
    i_max_a=[120.0, np.inf, np.inf],
    operation_cost=[0.5, 0.0, 0.0],
    max_operations_per_day=[4, np.inf, np.inf],
    minutes_to_operate=[0.0, 45.0, 0.0],
    parallel_allowed=[True, False, False],
    sync_check=[False, False, True],
)


OF_THE_SOLVER = ["solve_s", "solver_s", "compilations"]


def test_what_is_written_reads_back_equal(tiny: Scenario, tmp_path: Path) -> None:
    day = replace(tiny, switches=SWITCHES)
    write_scenario(day, tmp_path / "day")
    read = read_scenario(tmp_path / "day")
    for again in (read, Scenario.from_tables(day.to_tables())):
        for column in fields(SWITCHES):
            found, given = (getattr(each, column.name) for each in (again.switches, SWITCHES))
            assert found.dtype == given.dtype
            np.testing.assert_array_equal(found, given)
    assert read.switches.movable.tolist() == [True, False, False]
    assert scenario_digest(read) == scenario_digest(day) != scenario_digest(tiny)


def test_a_table_of_few_columns_has_the_defaults(tiny_folder: Path) -> None:
    rows = "id,from_bus,to_bus,kind,closed,r_ohm,x_ohm\nT1,3,4,tie,no,0.1,0.2\n"
    (tiny_folder / "switches.csv").write_text(rows, encoding="utf-8")
    one = read_scenario(tiny_folder).switches
    assert (one.from_bus[0], one.operable[0], one.locked[0], one.i_max_a[0]) == (
        3,
        True,
        "",
        np.inf,
    )
    assert (one.max_operations_per_day[0], one.parallel_allowed[0]) == (np.inf, False)


def test_switches_in_memory_have_the_checks_of_the_file(tiny: Scenario) -> None:
    loose = Switches(["S"], [3], [4], ["tie"], [True])
    with pytest.raises(InputError, match=r"id = S: is closed, and no line of lines.csv joins"):
        replace(tiny, switches=loose)


def test_a_cell_is_replaced(tiny: Scenario) -> None:
    day = replace(tiny, switches=SWITCHES).replace("switches", "T1", locked="tree on the line")
    assert day.switches.movable.tolist() == [False, False, False]


def test_ties_of_an_older_folder_are_passed_over(tiny: Scenario, tiny_folder: Path) -> None:
    with (tiny_folder / "scenario.toml").open("a", encoding="utf-8") as settings:
        settings.write('\n[source]\nname = "old"\nties = ["3 to 4"]\n')
    read = read_scenario(tiny_folder)
    assert (read.source.name, len(read.switches)) == ("old", 0)


def test_no_run_depends_on_switches(tiny: Scenario) -> None:
    options = RunOptions(controller="mpc", horizon_h=1)
    plain, switched = (run_day(day, options) for day in (tiny, replace(tiny, switches=SWITCHES)))
    for table in ("steps", "buses", "lines", "customers", "batteries"):
        one, other = (
            getattr(run, table).drop(columns=OF_THE_SOLVER, errors="ignore")
            for run in (plain, switched)
        )
        assert one.equals(other), table
