"""The study of days on a cluster: what its digests tell apart."""

from __future__ import annotations

from experiments.studies.cluster import Pass, day_digest, row, tables_digest
from tests.support.made_up_runs import small_run


def test_a_digest_sees_every_value_and_no_time() -> None:
    tables = small_run().tables
    slower = {**tables, "steps": tables["steps"].assign(solve_s=99.0)}
    assert tables_digest(slower) == tables_digest(tables)
    buses = tables["buses"]
    moved = {**tables, "buses": buses.assign(v_ac_pu=buses["v_ac_pu"] + 1e-9)}
    assert tables_digest(moved) != tables_digest(tables)


def test_days_of_two_seeds_are_two_days() -> None:
    """With the same day in every job, equal tables would have said little."""
    assert day_digest(0) != day_digest(1)


def test_a_row_counts_equal_days() -> None:
    loky = Pass({0: "a", 1: "b"}, 60.0, 4.0, 0)
    other = Pass({0: "a", 1: "x"}, 30.0, 5.0, 1)
    assert row("there", other, loky) == ("there", "1 of 2", 1, "4", "2.500")
    assert loky.and_then(other) == Pass({0: "a", 1: "x"}, 90.0, 9.0, 1)
