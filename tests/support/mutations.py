"""Mutated scenario folders: drawn edits of their files, and what a run of one may not claim."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from hypothesis import strategies as st

from vppres.day.trajectory import Trajectory

FILES = (
    "scenario.toml", "lines.csv", "customers.csv", "pv.csv", "batteries.csv", "load_kw.csv",
    "pv_kw.csv", "system.csv",
)  # fmt: skip
SNIPPETS = (
    "", ",", "\n", '"', "'", "=", "[", "]", "-", "0", "1e400", "1e308", "-1e308", "1e-300", "nan",
    "inf", "-1", "9" * 400, "é", "\x00", "\x1b[2J", "\r", "\t", " ", "2022-07-19T10:00:00Z",
    "2022-02-30T10:00:00Z", "now", "time", "id", "true", "1_0", "[[outages]]\n", "[time]\n",
    "\u2028", "\u202e", ";", "hospital", "{", "}", "#", "$\\frac{$", "[/x]", "../../x", "<script>",
    "=1+1", "x" * 300, "\ufeff", "1e6", "-0.5", "0.999999999", "٣",
)  # fmt: skip
ROW_EDITS = ("drop", "repeat", "exchange")
MOST_CUT = 12  # characters that a snippet replaces
# Rounding of the plant's arithmetic and of the power flow; readings have fewer digits.
TOLERANCE_SOC = 1e-6
TOLERANCE_PU = 1e-6

PLACE = st.floats(0, 1)
"""A share of a text's characters, rows or cells, whatever its length."""

WORD = st.sampled_from(SNIPPETS) | st.text(max_size=6)
FACTORS = (-1.0, 0.0, 0.1, 0.5, 0.9, 1.1, 2.0, 10.0, 1e3, 1e9)

Edit = Callable[[str], str]


def _characters(place: float, cut: int, word: str, text: str) -> str:
    """Some characters replaced, anywhere."""
    at = int(place * len(text))
    return text[:at] + word + text[at + cut :]


def _cell(row: float, column: float, factor: float, word: str, text: str) -> str:
    """One cell, or the value of a key, replaced: a number by its multiple."""
    mark = "=" if " = " in text else ","
    rows = text.split("\n")
    at = round(row * (len(rows) - 1))
    cells = rows[at].split(mark)
    place = round(column * (len(cells) - 1))
    try:
        cells[place] = f" {factor * float(cells[place])!r}"
    except ValueError:
        cells[place] = word
    rows[at] = mark.join(cells)
    return "\n".join(rows)


def _row(one: float, other: float, kind: str, text: str) -> str:
    """A row dropped, repeated or exchanged with another."""
    rows = text.splitlines(keepends=True)
    if not rows:
        return text
    i, j = (round(place * (len(rows) - 1)) for place in (one, other))
    if kind == "exchange":
        rows[i], rows[j] = rows[j], rows[i]
    else:
        rows[i : i + 1] = [] if kind == "drop" else [rows[i]] * 2
    return "".join(rows)


EDITS: st.SearchStrategy[list[tuple[str, Edit]]] = st.lists(
    st.tuples(
        st.sampled_from(FILES),
        st.builds(partial, st.just(_characters), PLACE, st.integers(0, MOST_CUT), WORD)
        | st.builds(partial, st.just(_cell), PLACE, PLACE, st.sampled_from(FACTORS), WORD)
        | st.builds(partial, st.just(_row), PLACE, PLACE, st.sampled_from(ROW_EDITS)),
    ),
    min_size=1,
    max_size=3,
)
"""One to three edits of a folder's files: of characters, cells or rows."""


def refuted(run: Trajectory) -> list[str]:
    """Claims of a run's record that its own AC power flow, or arithmetic, refutes."""
    net = run.scenario.network
    found = [
        f"{name}.{column} is not finite"
        for name, columns in (
            ("steps", ["p_grid_kw"]),
            ("batteries", ["soc_start", "soc_end"]),
            ("pv", ["curtailed_kw"]),
        )
        for column in columns
        if not np.isfinite(run.tables[name][column].to_numpy(float)).all()
    ]
    found += _voltages_where_there_are_none(run)
    solved = run.steps["fallback"].eq("none").to_numpy()  # a fallback has no objective
    if not np.isfinite(run.steps["objective"].to_numpy(float)[solved]).all():
        found.append("steps.objective is not finite")
    batteries = run.scenario.batteries
    soc = run.batteries["soc_end"].to_numpy(float).reshape(len(run.steps), -1)
    if (soc < batteries.soc_min - TOLERANCE_SOC).any() or (
        soc > batteries.soc_max + TOLERANCE_SOC
    ).any():
        found.append("a state of charge is outside its limits")
    v = run.buses["v_ac_pu"].to_numpy(float).reshape(len(run.steps), -1)
    within = (v.min(axis=1) >= net.v_min_ac_pu - TOLERANCE_PU) & (
        v.max(axis=1) <= net.v_max_ac_pu + TOLERANCE_PU
    )
    if (run.steps["v_within_ac"].to_numpy(bool) & ~within).any():
        found.append("a voltage is said to be within its limits, and is not")
    return found


def _voltages_where_there_are_none(run: Trajectory) -> list[str]:
    """Steps with voltages although the island is dark, or without although it is not."""
    dark = run.steps["dark"].to_numpy(bool)
    by_step = {
        "steps.v_min_ac_pu": run.steps["v_min_ac_pu"].to_numpy(float),
        "steps.v_max_ac_pu": run.steps["v_max_ac_pu"].to_numpy(float),
        "buses.v_ac_pu": run.buses["v_ac_pu"].to_numpy(float).reshape(len(dark), -1).T,
    }
    found = []
    for name, values in by_step.items():
        if not np.isfinite(values[..., ~dark]).all():
            found.append(f"{name} is not finite")
        if not np.isnan(values[..., dark]).all():
            found.append(f"{name} has a value in a dark island")
    if run.steps["dark_reason"].to_numpy(str)[dark].tolist().count(""):
        found.append("a dark island has no reason")
    return found
