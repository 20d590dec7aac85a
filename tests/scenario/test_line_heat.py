"""Impedances or a voltage that fit no conductor are told, and those of sound feeders are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pandapower.networks as networks
import pytest
from typer.testing import CliRunner

from vppres.cli.commands import app
from vppres.feeders import NAMED, import_network
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario, write_new_scenario
from vppres.feeders.published import case16
from vppres.io.find import load_scenario, packaged_scenarios
from vppres.scenario.line_heat import MOST_W_PER_M, heat_w_per_m, hot_lines
from vppres.scenario.remarks import doubtful_units
from vppres.scenario.scenario import Scenario


@pytest.mark.daily
def test_per_unit_impedances_read_as_ohm_are_told(tmp_path: Path) -> None:
    """The 16 buses with their pu of 100 MVA and 23 kV as ohm at 12.66 kV, as a case file has it."""
    net = case16()
    net.line[["r_ohm_per_km", "x_ohm_per_km"]] *= 100.0 / 23.0**2
    net.bus["vn_kv"] = 12.66
    notes = write_new_scenario(
        import_network(net, slack="all"), NewScenarioOptions(), tmp_path / "16"
    )
    words = (
        "lines.csv: at the largest demand a phase loses 31.4 W a metre or more where losses are, by "
        "the ratio of r_ohm to x_ohm; cables bear up to 20. Are the impedances per unit, or "
        "mis-scaled, or is base_kv = 12.66 too low? The numbers of lines.csv are ohm."
    )
    assert words in notes
    shown = CliRunner().invoke(app, ["validate", str(tmp_path / "16")])
    assert shown.exit_code == 0
    assert words in " ".join(shown.output.split())


@pytest.mark.parametrize("name", sorted(NAMED))
def test_named_networks_are_sound(name: str) -> None:
    slack = "all" if name == "case16" else None
    assert heat_w_per_m(new_scenario(import_network(name, slack=slack))) < MOST_W_PER_M / 2


@pytest.mark.parametrize("name", packaged_scenarios())
def test_packaged_scenarios_are_sound(name: str) -> None:
    assert heat_w_per_m(load_scenario(name)) < MOST_W_PER_M / 2


@pytest.mark.daily
@pytest.mark.parametrize("name", ["create_kerber_dorfnetz", "create_cigre_network_lv"])
def test_low_voltage_feeders_are_sound(name: str) -> None:
    feeder = import_network(getattr(networks, name)(), slack="all", open_loops=True)
    assert heat_w_per_m(new_scenario(feeder)) < MOST_W_PER_M / 2


def test_a_demand_of_another_unit_is_told_alone(tiny: Scenario) -> None:
    """Demand of W read as kW makes lines hot too; the question is about the demand."""
    day = replace(tiny, load_kw=tiny.load_kw * 1000.0)
    assert hot_lines(day)
    assert [words.partition(",")[0] for words in doubtful_units(day)] == ["load_kw.csv"]
