"""What a control room found in one evening, as it was found: no option that came for it is used."""

from __future__ import annotations

import re
from pathlib import Path

import pandapower as pp
import pandas as pd
import pytest

from vppres import NewScenarioOptions, RunOptions, import_network, new_scenario, run_day
from vppres.io import read_scenario
from vppres.scenario.scenario import Scenario

ROOT = Path(__file__).parents[2]
BY_HAND = ROOT / "docs" / "howto" / "by-hand.md"
BLOCK = re.compile(r"```\{code-block\} \w+\n:caption: my-feeder/(\S+)\n\n(.*?)```", re.DOTALL)


def days_outage(start: str, end: str) -> tuple[pd.Timestamp, pd.Timestamp]:
    return pd.Timestamp(f"2025-07-01T{start}Z"), pd.Timestamp(f"2025-07-01T{end}Z")


@pytest.mark.nightly
def test_the_first_example_serves_its_clinic(tmp_path: Path) -> None:
    for name, text in BLOCK.findall(BY_HAND.read_text(encoding="utf-8")):
        (tmp_path / name).write_text(text, encoding="utf-8")
    run = run_day(read_scenario(tmp_path))
    assert run.customers.set_index("id").loc["clinic", "served"].all()


@pytest.mark.nightly
def test_nobody_is_dropped_with_grid_for_a_voltage_of_the_feeder_itself() -> None:
    options = NewScenarioOptions(step_minutes=240.0, outages=(days_outage("00:00", "04:00"),))
    day = new_scenario(import_network("case33bw"), options).between(3, 5)
    run = run_day(day, RunOptions(horizon_h=4.0))
    assert run.customers["served"].all()


def hospital_and_street() -> Scenario:
    """A hospital of 200 kW, eight homes of 10 kW, and a battery that does not reach for all."""
    net = pp.create_empty_network()
    pp.create_buses(net, 10, vn_kv=11.0)
    pp.create_ext_grid(net, 0)
    for bus in range(9):
        pp.create_line_from_parameters(net, bus, bus + 1, 0.1, 0.3, 0.2, 0.0, 1.0)
    pp.create_load(net, 1, 0.2)
    for bus in range(2, 10):
        pp.create_load(net, bus, 0.01)
    net.load["tier"] = ["critical", *["high"] * 8]
    pp.create_storage(net, 1, 0.0, 0.45, max_p_mw=0.3, min_p_mw=-0.3, sn_mva=0.4, soc_percent=100.0)
    outages = (days_outage("12:00", "14:00"),)
    return new_scenario(import_network(net), NewScenarioOptions(outages=outages)).between(12, 14)


@pytest.mark.nightly
def test_no_homes_are_on_before_a_hospital() -> None:
    run = run_day(hospital_and_street(), RunOptions(horizon_h=2.0))
    served = run.customers[run.customers["tier"] == "critical"]["served"]
    assert served.all()
