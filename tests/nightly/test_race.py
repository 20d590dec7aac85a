"""The windows that users bring, the race against monoliths, and random days."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest

from benchmarks import agreement, findings, race
from benchmarks.hard import HardInstance, read_hard
from benchmarks.hard_days import hard_day
from benchmarks.instances import packaged, read_instances, window_data
from benchmarks.random_days import STEPS, cut, steps_of, summary
from vppres.core.errors import InputError
from vppres.model.site import Site
from vppres.solve.result import SolveLimits

# The table.


@pytest.mark.parametrize("name", ["h001", "h030", "h060"])
def test_a_row_determines_its_window(name: str) -> None:
    row = next(row for row in read_hard() if row.name == name)
    again = HardInstance(**asdict(row)).window.data
    assert np.array_equal(row.window.data.soc, again.soc)
    assert np.array_equal(row.window.data.load_kw, again.load_kw)
    assert row.window.data.n_steps == row.steps
    with pytest.raises(InputError, match="makes a window of t0, steps, buses"):
        _ = replace(row, t0=row.t0 + 1).window


# The race.


def test_slower_is_beyond_twice_the_better_monolith_and_half_a_second() -> None:
    rows = pd.DataFrame(
        {
            "window": list("abcd"),
            "group": "hard",
            "kind": "tight",
            "seconds": [0.4, 2.4, 2.6, 12.0],
            "status": ["optimal", "optimal", "optimal", "optimal"],
            "gap": 0.0,
            "buses": 33,
            "steps": 6,
            "highs_s": [np.nan, 1.0, 1.0, np.inf],
            "scip_s": [np.nan, np.inf, 5.0, np.inf],
        }
    )
    found = race.with_verdict(rows)
    assert found["slower"].tolist() == [False, False, True, False]
    assert found["certified"].tolist() == [True, True, True, False]
    table = race.summary(found)
    assert table["windows"].tolist() == [4, 4]
    assert table["slower"].tolist() == [1, 1]
    bars = findings.race_bars(found)
    assert [bar.met for bar in bars] == [None, False, False]
    assert bars[1].measured == "75.0% of 4"
    section = findings.race_section(found)
    assert section.tables[1]["window"].tolist() == ["c", "d"]


def test_monoliths_run_only_as_long_as_they_can_win(monkeypatch: pytest.MonkeyPatch) -> None:
    instance = read_instances()[2]
    runner = race.Runner("o", "ordinary", "", Site.of(packaged()), window_data(instance))
    quick = race.race(runner)
    assert quick["status"] == "optimal"
    assert "highs_s" not in quick  # a few hundredths of a second: nothing to win
    monkeypatch.setattr(race, "HEAD_START_S", -60.0)
    monkeypatch.setattr(race, "MONOLITHS", ("highs",))
    found = race.race(runner)
    assert found["highs_status"] == "optimal"
    assert found["highs_value"] == pytest.approx(quick["value"], abs=5e-3)


# Random days.


def test_two_days_of_quarter_hours_are_cut_to_their_outage() -> None:
    scenario = hard_day("quarters", 2).scenario
    part = cut(scenario)
    assert part.grid.n_steps == STEPS
    assert part.outage.any() == scenario.outage.any()
    assert cut(part) is part


def test_summary_counts_steps_that_are_left_open() -> None:
    day = {
        "kind": "tight", "seed": 1, "seconds": [0.1, 0.3], "status": ["optimal", "gap_open"],
        "gap": [1e-6, 2e-3], "fallback": ["none", "rule"], "stages": ["a", "b"],
    }  # fmt: skip
    table = summary(steps_of(pd.DataFrame([day, {**day, "kind": "rules", "gap": [0.0, 0.0]}])))
    assert table["kind"].tolist() == ["all", "tight", "rules"]
    assert table["days"].tolist() == [2, 1, 1]
    assert table["open"].tolist() == [1, 1, 0]
    assert table["fallbacks"].tolist() == [2, 1, 1]
    assert table["steps"].tolist() == [4, 2, 2]


# Agreement with a monolith.


@pytest.mark.parametrize(
    ("value", "bound", "agrees"),
    [
        (10.0, 10.0005, True),  # as good, and within each other's bounds
        (9.9995, 10.0, True),  # worse by less than the gap
        (9.99, 10.0, False),  # worse by more than the gap
        (10.002, 10.003, False),  # better than the monolith says is possible
        (9.9995, 9.9996, False),  # its bound excludes what the monolith found
        (np.nan, np.nan, False),  # no answer where the monolith has one
    ],
)
def test_answers_agree_within_the_gap_and_their_bounds(
    value: float, bound: float, agrees: bool
) -> None:
    whole = agreement.Answer("optimal", 10.0, 10.001, 1.0)
    ended = "InfeasibleError" if np.isnan(value) else "optimal"
    ours = agreement.Answer(ended, value, bound, 1.0)
    assert agreement.agree(ours, whole, SolveLimits()) == agrees


def test_a_window_is_compared_by_all_solvers() -> None:
    (runner,) = agreement.small_windows(1, 5001)
    rows = pd.DataFrame([agreement.compare(runner, 10.0)])
    assert rows.loc[0, "agrees"]
    table = agreement.speeds(rows).set_index("solver")
    assert {"highs", "scip"} <= set(table.index)
    assert table.loc["highs", "windows"] == 1
