"""The study of two trees: both answer the same windows, and the table has them side by side."""

from __future__ import annotations

import pandas as pd

from benchmarks.ablation import CERTIFY_S
from benchmarks.cases import cases
from benchmarks.two_trees import HERE, TREES, rows_of, table


def row(tree: str, status: str, cpu_s: float, group: str = "large") -> dict[str, object]:
    """How a window ended by a tree."""
    cost = {"cost_gbp": 100.0, "cost_gap_gbp": 0.05}
    return {"group": group, "tree": tree, "status": status, "cpu_s": cpu_s, **cost}


def test_the_table_has_both_trees_of_each_group() -> None:
    before, after = TREES
    rows = pd.DataFrame(
        [
            row(before, "optimal", 2.0),
            row(after, "optimal", CERTIFY_S + 2.0),
            row(before, "gap_open", 1.0, group="long"),
            row(after, "optimal", 0.5, group="long"),
        ]
    )
    lines = table(rows).set_index("windows of")
    assert lines.loc["large", "certified"] == "1 / 0"
    assert lines.loc["long", "certified"] == "0 / 1"
    assert lines.loc["all", "certified"] == "1 / 1"
    assert lines.loc["all", "total s"] == "3.0 / 10.5"
    assert list(lines["windows"]) == [1, 1, 2]


def test_a_tree_beside_itself_gives_the_same() -> None:
    chosen = [case for case in cases() if case.name in ("random 1", "physical stressed 2")]
    pairs = list(rows_of(chosen, HERE, done={"random 1"}))
    (rows,) = pairs
    assert sorted(row["tree"] for row in rows) == sorted(TREES)
    assert {row["window"] for row in rows} == {"physical stressed 2"}
    assert {row["status"] for row in rows} == {"optimal"}
    assert rows[0]["value"] == rows[1]["value"]
