"""Where a feeder comes from, in the files, on the terminal and in the digest; islands without a battery."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.command_line import call
from tests.support.tiny_day import tiny_scenario
from vppres.core.errors import InputError
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.feeders import import_network
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import write_new_scenario
from vppres.io import read_scenario, scenario_digest, write_scenario
from vppres.physics.uncontrolled import without_control
from vppres.plant.island import NO_FORMER
from vppres.scenario.priority import STRICT
from vppres.scenario.remarks import darkness, doubtful_units, former_words, remarks, source_words
from vppres.scenario.scenario import ControllerDefaults, Priority, Scenario
from vppres.scenario.source import MAX_NOTE_LENGTH, MAX_NOTES, Source, SourceDeviation

SOURCE = Source(
    "my grid.json",
    "pandapower",
    ("Two transformers are merged.", "Batteries were drawn: 28 MWh."),
    SourceDeviation(no_load_pu=2e-14, as_given_pu=0.0012),
)


@pytest.fixture
def made() -> Scenario:
    """The tiny day as if it were made from a net."""
    tiny = tiny_scenario()
    return replace(tiny, source=SOURCE, grid=replace(tiny.grid, zone="Europe/London"))


def without_power(scenario: Scenario, kw: float) -> Scenario:
    """The scenario with batteries of hardly any power."""
    n = len(scenario.batteries)
    small = replace(scenario.batteries, p_max_kw=np.full(n, kw), s_max_kva=np.full(n, kw))
    return replace(scenario, batteries=small)


def test_source_and_zone_come_back_from_the_folder(made: Scenario, tmp_path: Path) -> None:
    write_scenario(made, tmp_path / "made")
    read = read_scenario(tmp_path / "made")
    assert read.source == SOURCE
    assert read.source.deviation.largest_pu == 0.0012
    assert read.grid.zone == "Europe/London"
    assert scenario_digest(read) == scenario_digest(tiny_scenario())


def test_folder_without_source_has_none(tmp_path: Path) -> None:
    write_scenario(tiny_scenario(), tmp_path / "plain")
    text = (tmp_path / "plain" / "scenario.toml").read_text(encoding="utf-8")
    assert "[source]" not in text
    assert "zone" not in text
    assert not read_scenario(tmp_path / "plain").source


def test_words_of_strangers_are_made_fit_for_a_scenario(tmp_path: Path) -> None:
    notes = [f"note {i}" for i in range(MAX_NOTES + 5)]
    source = Source.of("net\x1b[2J", "kind", ["a\nb", "x" * (MAX_NOTE_LENGTH + 1), *notes])
    assert source.name == "net\\x1b[2J"
    assert source.notes[0] == "a b"
    assert len(source.notes[1]) <= MAX_NOTE_LENGTH
    assert source.notes[-1] == "8 more notes are left out."
    write_scenario(replace(tiny_scenario(), source=source), tmp_path / "of")
    assert read_scenario(tmp_path / "of").source == source


def test_validate_shows_the_source_and_where_its_notes_are(made: Scenario, tmp_path: Path) -> None:
    write_scenario(made, tmp_path / "made")
    text = call("validate", str(tmp_path / "made")).stdout
    assert "islands in paper mode." in text
    assert "- Made from my grid.json (pandapower). Voltages differ" in text
    assert "1e-6 pu at no load, 0.0012 pu as given." in text
    assert "[source] in scenario.toml has 2 notes on the import." in text
    assert "Batteries were drawn" not in text  # new has said so, and the folder keeps it
    found = json.loads(call("validate", str(tmp_path / "made"), "--json").stdout)["content"]
    assert found["source"]["kind"] == "pandapower"
    assert found["remarks"] == [*source_words(made), *remarks(made)]


def test_notes_of_an_import_are_of_the_import_in_a_folder_that_was_edited(tmp_path: Path) -> None:
    feeder = import_network("case33bw")
    folder = tmp_path / "mine"
    write_new_scenario(feeder, NewScenarioOptions(), folder)
    (folder / "batteries.csv").write_text(
        "id,bus,energy_kwh,p_max_kw,s_max_kva,grid_forming\ndepot,18,500,250,280,yes\n"
    )
    text = call("validate", str(folder)).stdout
    assert "0 PV systems, 1 battery," in text
    assert "- In an island depot at bus 18" in text
    assert "No battery" not in text
    read = read_scenario(folder)
    assert read.source.notes and not any(note.startswith("At import") for note in read.source.notes)


def test_run_keeps_the_source_and_does_not_repeat_its_notes(made: Scenario, tmp_path: Path) -> None:
    write_scenario(made, tmp_path / "made")
    folder = tmp_path / "run"
    done = call(
        "run", str(tmp_path / "made"), "--controller", "idle", "--no-figures", "--no-explain",
        "--out", str(folder),
    )  # fmt: skip
    assert "Two transformers are merged." not in done.stdout
    assert read_scenario(folder / "scenario").source == SOURCE


def test_island_without_a_battery_is_dark_and_says_so() -> None:
    day = without_power(tiny_scenario(), 1e-3)
    assert "No battery has the power" in darkness(day, "physical")
    assert "no supply in the 2 steps" in darkness(day, "physical")
    assert "a real island would be blacked out" in darkness(day, "paper")
    assert darkness(tiny_scenario(), "physical") == ""
    for controller in ("mpc", "idle"):
        run = run_day(day, RunOptions(controller, mode="physical"))
        assert summarise(run)["resilience"] == 0.0
        dark = run.steps[run.steps["outage"]]
        assert (dark["dark_reason"] == NO_FORMER).all()
        assert not run.customers.loc[run.customers["time"].isin(dark["time"]), "served"].any()


def test_a_little_power_forms_the_grid() -> None:
    assert without_power(tiny_scenario(), 2e-3).batteries.formers.any()


def test_mode_is_the_scenarios_unless_it_is_given() -> None:
    day = tiny_scenario()
    physical = replace(day, controller=ControllerDefaults(mode="physical"))
    assert ControllerDefaults().mode == "physical"
    for scenario, options, mode in (
        (day, RunOptions("idle"), "paper"),
        (physical, RunOptions("idle"), "physical"),
        (physical, RunOptions("idle", mode="paper"), "paper"),
    ):
        run = run_day(scenario, options)
        assert run.options["mode"] == mode
        assert set(run.steps["mode"]) == {mode}


def test_the_battery_that_forms_the_island_is_named() -> None:
    tiny = tiny_scenario()
    assert former_words(tiny) == ""  # islands of paper mode have no former
    default = former_words(tiny, "physical")
    assert default.startswith("In an island big at bus ")
    assert "no battery is marked grid_forming in batteries.csv, and its inverter is" in default
    # Powers of customers add as vectors, their apparent powers do not.
    power = tiny.load_kw + 1j * tiny.load_kvar
    assert f"The largest demand is {abs(power.sum(axis=1)).max():,.1f} kVA." in default
    assert default in remarks(tiny, "physical")
    chosen = replace(tiny.batteries, grid_forming=np.array([False, True]))
    named = former_words(replace(tiny, batteries=chosen), "physical")
    assert named.startswith("In an island small at bus ")
    assert "is marked" not in named
    connected = replace(tiny, grid_limit_kw=np.full(tiny.grid.n_steps, np.inf))
    assert former_words(connected, "physical") == ""


def test_tiers_that_are_not_named_from_the_most_important_one_are_told() -> None:
    tiny = tiny_scenario()
    assert remarks(tiny) == []
    backwards = replace(tiny, tiers=tuple(reversed(tiny.tiers)))
    (words,) = remarks(backwards)
    assert words.endswith("if that is not meant.")
    assert "more than any of tier" in words
    # Strict order goes by names, but resilience weighs.
    assert remarks(replace(backwards, priority=Priority(STRICT))) == [words]


def test_a_tier_in_python_moves_its_weight() -> None:
    tiny = tiny_scenario()
    moved = tiny.replace("customers", "homes", tier="critical")
    moved = moved.replace("customers", "shop", tier="low")
    assert moved.customers.tier.tolist() == ["critical", "low", "critical"]
    assert moved.customers.weight.tolist() == [1.0, 0.02, 1.0]
    assert remarks(moved) == []
    # The weight alone stays behind where a table is replaced by hand, which is told.
    alone = replace(tiny.customers, tier=["critical", "high", "critical"])
    (words,) = remarks(replace(tiny, customers=alone))
    assert "'high' weighs 0.1, more than homes of tier 'critical' (0.02)" in words
    with pytest.raises(InputError, match="tier = vital: is not a tier"):
        tiny.replace("customers", "homes", tier="vital")
    with pytest.raises(InputError, match="house"):
        tiny.replace("customers", "house", tier="low")


@pytest.mark.parametrize(("factors", "words"), [
    ({}, []),
    ({"load_kw": 1000.0}, [
        "load_kw.csv, homes: the median customer's largest demand is 55,000 kW at 11 kV. Is the "
        "file in W? Its numbers are kW."]),
    ({"energy_kwh": 0.001}, [
        "batteries.csv, big (and 1 more): energy_kwh = 0.1 holds p_max_kw = 50 for 0.002 h. Is "
        "the energy in MWh, or the power in W?"]),
    ({"p_max_kw": 0.001}, [
        "batteries.csv, big (and 1 more): energy_kwh = 100 holds p_max_kw = 0.05 for 2,000 h. Is "
        "the energy in Wh, or the power in MW?"]),
])  # fmt: skip
def test_sizes_that_suggest_another_unit_are_remarked(
    factors: dict[str, float], words: list[str]
) -> None:
    tiny = tiny_scenario()
    b = tiny.batteries
    own = {name: getattr(b, name) * factors.get(name, 1.0) for name in ("energy_kwh", "p_max_kw")}
    day = replace(
        tiny,
        load_kw=tiny.load_kw * factors.get("load_kw", 1.0),
        batteries=replace(b, **own),
    )
    assert doubtful_units(day) == words
    assert [one for one in remarks(day) if one in words] == words


def test_a_demand_that_the_lines_cannot_carry_asks_for_units() -> None:
    tiny = tiny_scenario()
    said = without_control(replace(tiny, load_kw=tiny.load_kw * 1000.0))
    assert said[-1] == (
        "Without control the AC power flow has no solution in 4 of 4 steps with grid: customers will "
        "be switched off with the grid on. Check the units: load_kw.csv is in kW (at most 159,000 kW "
        "in all), lines.csv in ohm of the whole line."
    )
