"""``warnings.csv`` and ``[outage_statistics]``: read, written and digested.

What can be wrong with them stands in bad_scenarios.txt.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from vppres.core.errors import InputError, Problem
from vppres.io import read_scenario, write_scenario
from vppres.io.digest import scenario_digest
from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario

HEADER = (
    "issued_at,onset_earliest,onset_likely,onset_latest,probability,"
    "duration_p10_h,duration_p50_h,duration_p90_h\n"
)


def with_warnings(folder: Path, text: str) -> Path:
    (folder / "warnings.csv").write_text(text, encoding="utf-8")
    return folder


def test_messages_are_read(tiny_folder: Path) -> None:
    rows = (
        "2022-07-19T05:00Z,2022-07-19T10:00Z,2022-07-19T12:00Z,2022-07-19T15:00Z,0.7,2,5,9\n"
        "2022-07-19T14:00+01:00,,2022-07-19T12:00Z,,1,2,4,7\n"
        "2022-07-19T09:00Z,,,,0,,,\n"
    )
    first, update, clear = read_scenario(with_warnings(tiny_folder, HEADER + rows)).warnings
    assert first == OutageWarning(
        pd.Timestamp("2022-07-19T05:00Z"),
        onset_earliest=pd.Timestamp("2022-07-19T10:00Z"),
        onset_likely=pd.Timestamp("2022-07-19T12:00Z"),
        onset_latest=pd.Timestamp("2022-07-19T15:00Z"),
        probability=0.7,
        duration_p10_h=2.0,
        duration_p50_h=5.0,
        duration_p90_h=9.0,
    )
    assert update.issued_at == pd.Timestamp("2022-07-19T13:00Z")
    assert update.onset_earliest is None
    assert clear.all_clear


def test_what_is_written_reads_back_equal(tiny: Scenario, tmp_path: Path) -> None:
    warning = OutageWarning(
        pd.Timestamp("2022-07-19T05:00Z"),
        outage="block 1",
        preset="rota",
        onset_likely=pd.Timestamp("2022-07-19T12:30Z"),
        probability=0.25,
    )
    day = replace(
        tiny,
        warnings=(
            warning,
            replace(warning, outage="block 2", preset="", duration_p50_h=0.1),
            OutageWarning(
                pd.Timestamp("2022-07-19T13:00Z"),
                "crew",
                restored_not_before=pd.Timestamp("2022-07-19T14:00Z"),
                restored_likely=pd.Timestamp("2022-07-19T15:30Z"),
                restored_by=pd.Timestamp("2022-07-19T16:00Z"),
            ),
        ),
        outage_statistics=OutageStatistics(
            "equipment", saifi_per_year=3.0, estimate_p90=2.5, notice_h=1.0, notice_share=0.7
        ),
        controller=ControllerDefaults(
            mode="paper", voltage_limits=HARD, ratings=REPORT, outages="belief"
        ),
    )
    write_scenario(day, tmp_path / "day")
    read = read_scenario(tmp_path / "day")
    assert read.warnings == day.warnings
    assert read.outage_statistics == day.outage_statistics
    assert read.controller == day.controller
    assert scenario_digest(read) == scenario_digest(day)


def test_folders_without_keep_their_digest(tiny: Scenario, tiny_folder: Path) -> None:
    """A default changes no digest, written or not; each of the things that may be absent does."""
    plain = scenario_digest(tiny)
    assert plain == "ec8e16aafe54c59df322e9aa2a789c6194cdc3a0a660dfc95cf920ef0f261cd5"
    assert not (tiny_folder / "warnings.csv").exists()
    warning = OutageWarning(pd.Timestamp("2022-07-19T05:00Z"), probability=0.0)
    changed = [
        replace(tiny, warnings=(warning,)),
        replace(tiny, outage_statistics=OutageStatistics("none")),
        replace(tiny, controller=replace(tiny.controller, outages="likely")),
        replace(tiny, customers=replace(tiny.customers, share_min=np.array([0.5, 1.0, 1.0]))),
    ]
    assert len({plain, *map(scenario_digest, changed)}) == 5


def test_all_mistakes_are_told_at_once(tiny_folder: Path) -> None:
    """Also what contradicts in a row with a cell that cannot be read."""
    header = "issued_at,onset_earliest,onset_likely,probability,duration_p10_h,duration_p50_h\n"
    rows = [
        "yesterday,,2022-07-19T12:00Z,0.7,5,4",
        "2022-07-19T05:00Z,2022-07-19T14:00Z,2022-07-19T12:00Z,1.7,5,4",
        "2022-07-19T05:00Z,2022-07-19T14:00Z,,0.7,5,x",
        "2022-07-19T05:00,,,0.7,,4",
    ]
    with pytest.raises(InputError) as caught:
        read_scenario(with_warnings(tiny_folder, header + "\n".join(rows) + "\n"))
    found = [(p.row, p.field) for p in caught.value.problems if isinstance(p, Problem)]
    assert sorted(found) == [
        (2, "issued_at"),
        (3, "duration_p50_h"), (3, "onset_likely"), (3, "probability"),
        (4, "duration_p50_h"), (4, "onset_likely"),
        (5, "issued_at"),
    ]  # fmt: skip


def test_many_bad_rows_are_folded(tiny_folder: Path) -> None:
    text = HEADER + "yesterday,,,,0,,,\n" * 40
    with pytest.raises(InputError) as caught:
        read_scenario(with_warnings(tiny_folder, text))
    assert len(caught.value.problems) == 1
    assert "(in 40 rows: 2, 3, 4, 5, 6, ...)" in str(caught.value)


@pytest.mark.parametrize("probability", ["0.5", "many"])
def test_time_is_linear_in_rows(tiny_folder: Path, probability: str) -> None:
    row = f"2022-07-19T05:00Z,,2022-07-19T12:00Z,,{probability},,4,\n"

    def used_s(rows: int) -> float:
        folder = with_warnings(tiny_folder, HEADER + rows * row)
        begin = time.process_time()
        with suppress(InputError):
            read_scenario(folder)
        return time.process_time() - begin

    used_s(1)
    # Four times the rows took 16 times as long.
    assert used_s(1200) < 8.0 * used_s(300)
