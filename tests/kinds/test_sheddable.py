"""Customers in parts: the split itself, a run with it, and the files that say so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.refusals import refusal
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.io import read_scenario, write_scenario
from vppres.scenario.parts import split_sheddable
from vppres.scenario.scenario import Scenario


def in_parts(scenario: Scenario, *steps: int) -> Scenario:
    """The scenario with these parts of its customers."""
    return replace(scenario, customers=replace(scenario.customers, shed_steps=np.array(steps)))


def test_parts_add_up_to_the_customer(tiny: Scenario) -> None:
    split = split_sheddable(in_parts(tiny, 3, 1, 2))
    names = ["hospital/1", "hospital/2", "hospital/3", "shop", "homes/1", "homes/2"]
    assert split.customers.id.tolist() == names
    assert split.customers.weight == pytest.approx([1 / 3] * 3 + [0.1] + [0.01] * 2)
    assert split.customers.bus.tolist() == [2, 2, 2, 3, 4, 4]
    assert split.load_kw[0] == pytest.approx([20.0] * 3 + [40.0] + [25.0] * 2)
    assert split.pv.id.tolist() == ["roof/1", "roof/2", "roof/3", "field/1", "field/2"]
    assert split.pv.customer.tolist() == names[:3] + names[4:]
    assert split.pv.p_max_kw == pytest.approx([10.0] * 3 + [10.0] * 2)
    assert split.pv.s_max_kva == pytest.approx([40 / 3] * 3 + [15.0] * 2)
    assert split.pv_kw.sum(axis=1) == pytest.approx(tiny.pv_kw.sum(axis=1))
    assert (split.customers.shed_steps == 1).all()


def test_parts_have_the_limits_of_their_customer(tiny: Scenario) -> None:
    limits = {"share_min": [1.0, 0.25, 1.0], "max_off_h": [4.0, 3.5, np.nan]}
    limited = replace(tiny, customers=replace(tiny.customers, **limits))
    parts = split_sheddable(in_parts(limited, 1, 2, 1)).customers
    assert parts.least_share.tolist() == [1.0, 0.25, 0.25, 1.0]
    assert parts.longest_off_h.tolist() == [4.0, 3.5, 3.5, np.inf]


def test_whole_customers_are_left_alone(tiny: Scenario) -> None:
    assert split_sheddable(tiny) is tiny


def test_share_of_a_customer_is_that_of_its_parts(tiny: Scenario) -> None:
    run = run_day(in_parts(tiny, 1, 1, 5), RunOptions(horizon_h=2.0))
    summary = summarise(run)
    rows = run.customers[run.customers["id"].str.startswith("homes/")]
    dark = rows["time"].isin(run.steps.loc[run.steps["outage"], "time"])
    assert len(rows) == 5 * 6
    share = rows.loc[dark, "served"].mean()
    assert 0.0 < share < 1.0
    assert summary["served_share_of_customer"] == {"homes": pytest.approx(share)}
    assert summary["options"]["parts"] == {"homes": 5}
    whole = summarise(run_day(tiny, RunOptions(horizon_h=2.0)))
    assert summary["resilience"] > whole["resilience"] + 1e-6
    assert "served_share_of_customer" not in whole


def test_identifier_of_a_part_is_reserved(tiny: Scenario, tmp_path: Path) -> None:
    write_scenario(in_parts(tiny, 1, 3, 1), tmp_path / "parts")
    for name in ("customers.csv", "load_kw.csv", "pv.csv"):
        file = tmp_path / "parts" / name
        file.write_text(file.read_text("utf-8").replace("homes", "shop/3"), encoding="utf-8")
    assert refusal(read_scenario, tmp_path / "parts") == (
        "customers.csv, row 4, id = shop/3: is reserved for a part of shop while customers have "
        "several shed_steps. Choose another identifier."
    )
