"""The study that switches mechanisms of the solver off: its patches meet what they name."""

from __future__ import annotations

import pkgutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from benchmarks.ablation import BASE, SAMPLE, measure, switched_off, table, variants
from benchmarks.cases import Case, cases, sample
from benchmarks.mechanisms import MECHANISMS, SOLVE
from tests.support.small_windows import DARK, battery, two_buses, window
from vppres.model.data import WindowData
from vppres.model.site import Site


def test_every_switch_and_every_source_is_there() -> None:
    for mechanism in MECHANISMS:
        for target, off in mechanism.switches.items():
            assert pkgutil.resolve_name(SOLVE + target) is not off
        for part in mechanism.code:
            assert pkgutil.resolve_name(SOLVE + part) is not None


def test_a_mechanism_is_off_in_its_block_alone() -> None:
    (variant,) = (v for v in variants() if v.name == "recursion")
    target = SOLVE + "fleet.masters.most_units"
    before = pkgutil.resolve_name(target)
    with switched_off(variant):
        assert pkgutil.resolve_name(target)() == (np.inf, None)
    assert pkgutil.resolve_name(target) == before


def test_a_sample_has_every_group() -> None:
    found = list(cases())
    some = sample(found, SAMPLE)
    assert {case.group for case in some} == {case.group for case in found} == set(SAMPLE)
    assert len(some) < len(found) / 4
    assert len({case.name for case in found}) == len(found)


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    """A small window in the dark, as it is and with mechanisms off."""
    scenario = two_buses([[20.0, 15.0]] * 2, [1.0, 0.5], [DARK] * 2)
    scenario = replace(scenario, batteries=battery())

    def make() -> tuple[Site, WindowData]:
        return Site.of(scenario), window(scenario)

    return pd.DataFrame(measure(Case("small", "one", make), variants()))


def test_what_is_entered_is_measured(rows: pd.DataFrame) -> None:
    found = rows.set_index("variant")
    assert found.loc[BASE, "status"] == "optimal"
    assert "equivalent battery first" in found.index
    assert "cuts of feeders" not in found.index
    values = found["value"].dropna()
    assert np.ptp(values) < 1e-4


def test_the_table_counts_what_is_lost(rows: pd.DataFrame) -> None:
    worse = rows.copy()
    off = worse["variant"] == "equivalent battery first"
    worse.loc[off, ["status", "value"]] = ["time_limit", -1.0]
    (line,) = table(worse, [v for v in variants() if v.name == "equivalent battery first"]).to_dict(
        "records"
    )
    assert (line["windows"], line["certified"], line["without"], line["worse"]) == (1, 1, 0, 1)
