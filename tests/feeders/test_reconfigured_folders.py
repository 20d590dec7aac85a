"""``vppres reconfigure`` on a scenario's folder: its switches, its loads, and what is written."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.support.small_nets import ring
from tests.support.three_phases import three_phases
from vppres.cli.commands import app
from vppres.feeders import import_network
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario, write_new_scenario
from vppres.feeders.reconfiguration.folder import injection_at, step_of, with_configuration
from vppres.feeders.reconfiguration.loops import switched_network
from vppres.feeders.reconfiguration.search import NO_LIMITS, least_loss
from vppres.io import read_scenario, write_scenario
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.faults import LineFault
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches


def reconfigured(*words: str | Path) -> dict[str, Any]:
    """Record of the command."""
    shown = CliRunner().invoke(app, ["reconfigure", *map(str, words), "--quiet", "--json"])
    assert shown.exit_code == 0, shown.output
    found: dict[str, Any] = json.loads(shown.output)
    return found


def everywhere(day: Scenario) -> Switches:
    """The switches of a scenario, and a closed one on each line that has none."""
    net, own = day.network, day.switches
    standing = (
        {frozenset(ends) for ends in zip(own.from_bus, own.to_bus, strict=True)}
        if own.closed.any()
        else set()
    )
    lines = [
        (start, end)
        for start, end in zip(net.from_bus, net.to_bus, strict=True)
        if frozenset((start, end)) not in standing
    ]
    more = Switches(
        [f"S{end}" for _, end in lines],
        *(np.array(side, dtype=object) for side in zip(*lines, strict=True)),
        ["sectionaliser"] * len(lines),
        [True] * len(lines),
    )
    columns = {
        f.name: np.concatenate([getattr(own, f.name), getattr(more, f.name)]) for f in fields(own)
    }
    return Switches(**columns)


def published(tmp_path: Path, name: str, **options: Any) -> dict[str, Any]:
    """Reconfiguration of a published system, from a folder with a switch on every line."""
    day = new_scenario(import_network(name, **options))
    write_scenario(replace(day, switches=everywhere(day)), tmp_path / name)
    return reconfigured(tmp_path / name, "--v-min", "0.1", "--no-ratings")


@pytest.mark.parametrize(("name", "options", "count", "before_kw", "after_kw", "v_min_pu"), [
    # Three sources.
    pytest.param("case16", {"slack": "all"}, 190, 511.436, 466.127, 0.97158, marks=pytest.mark.daily),
    pytest.param("case33bw", {}, 50_751, 202.677, 139.551, 0.93782, marks=pytest.mark.daily),
    # Four configurations are equal: losses are compared, never the sets.
    pytest.param("case69", {}, 407_924, 224.992, 98.605, 0.94947, marks=pytest.mark.nightly),
])  # fmt: skip
def test_the_least_losses_are_those_published(
    name: str,
    options: dict[str, str],
    count: int,
    before_kw: float,
    after_kw: float,
    v_min_pu: float,
    tmp_path: Path,
) -> None:
    found = published(tmp_path, name, **options)
    assert found["configurations"] == count and found["exact"]
    assert found["before"]["losses_kw"] == pytest.approx(before_kw, abs=1e-3)
    assert found["after"]["losses_kw"] == pytest.approx(after_kw, abs=1e-3)
    assert found["after"]["v_min_pu"] == pytest.approx(v_min_pu, abs=1e-5)
    if name == "case16":
        assert found["solved"] == count
        assert (found["close"], found["open"]) == (["5-11", "10-14"], ["S10", "S11"])


@pytest.mark.daily
def test_the_folder_that_is_written_has_the_configuration_found(tmp_path: Path) -> None:
    """Its own power flow has the losses that were told, and it has nothing more to move."""
    folder, out = tmp_path / "16", tmp_path / "out"
    write_new_scenario(import_network("case16", slack="all"), NewScenarioOptions(), folder)
    found = reconfigured(folder, "--any-line", "--out", out)
    assert found["folder"] == str(out)
    assert found["after"]["losses_kw"] == pytest.approx(466.127, abs=1e-3)
    before, after = read_scenario(folder), read_scenario(out)
    flow = ACPowerFlow(after.network).solve(*injection_at(after, step_of(after, None)))
    assert flow.losses_kw == pytest.approx(found["after"]["losses_kw"], abs=1e-5)
    switches = after.switches
    state = dict(zip(switches.id, switches.closed.tolist(), strict=True))
    assert state == {"5-11": True, "10-14": True, "7-16": False, "8-10": False, "9-11": False}
    line = before.network.to_bus.tolist().index(10)
    opened = switches.id.tolist().index("8-10")
    for name in ("r_ohm", "x_ohm", "i_max_a"):
        assert getattr(switches, name)[opened] == getattr(before.network, name)[line]
    again = reconfigured(out, "--any-line", "--out", tmp_path / "again")
    assert (again["open"], again["close"], again["configurations"]) == ([], [], 190)
    for name in ("from_bus", "to_bus", "r_ohm", "x_ohm", "i_max_a", "b_us"):
        once, twice = (
            getattr(read_scenario(each).network, name) for each in (out, tmp_path / "again")
        )
        np.testing.assert_array_equal(once, twice)
    assert after.source.deviation.largest_pu is None and after.source.name == "case16"


def test_faults_stay_with_their_lines(tiny: Scenario) -> None:
    """Of lines 1-2-3-4 and a tie 4-1, 2-3 opens: 3-4 is fed from its other end."""
    net = Network([1, 2, 3], [2, 3, 4], [1.0] * 3, [1.0] * 3, slack_bus=1, base_kv=10.0)
    tie = Switches(["t"], [4], [1], ["tie"], [False], r_ohm=[1.0], x_ohm=[1.0])
    times = tiny.grid.times
    faults = (
        *(LineFault(times[2], times[4], line=bus, known=False) for bus in (2, 3, 4)),
        LineFault(times[2], times[4], bus=3),
    )
    day = replace(tiny, network=net, switches=tie, faults=faults)
    feeder = switched_network(net, tie, (), True)
    best = replace(least_loss(feeder, *injection_at(day, 0), NO_LIMITS).best, opened=(1,))
    changed = with_configuration(day, feeder, best)
    lines = zip(changed.network.from_bus, changed.network.to_bus, strict=True)
    ends = {frozenset(pair) for pair in lines}
    assert ends == {frozenset(pair) for pair in ((1, 2), (3, 4), (4, 1))}
    assert changed.faults == (faults[0], replace(faults[2], line=3), faults[3])


def row_of_three(tiny: Scenario, **columns: Any) -> Scenario:
    """Buses 1-2-3-4 in a row with customers, a switch on 3-4, and a tie from 4 to the grid."""
    net = Network([1, 2, 3], [2, 3, 4], [1.0] * 3, [1.0] * 3, slack_bus=1, base_kv=10.0)
    given = {"minutes_to_operate": [20.0, 10.0], **columns}
    switches = Switches(["t", "s"], [4, 3], [1, 4], ["tie", "sectionaliser"], [False, True],
                        r_ohm=[0.2, np.nan], x_ohm=[0.2, np.nan], **given)  # fmt: skip
    return replace(tiny, network=net, switches=switches)


def order_of(day: Scenario, folder: Path) -> dict[str, Any]:
    """The order of operations that the command has for a folder."""
    write_scenario(day, folder)
    found: dict[str, Any] = reconfigured(folder, "--at", "2022-07-19T12:00Z")["order"]
    return found


def test_the_order_of_operations_interrupts_no_customer_where_a_loop_is_allowed(
    tiny: Scenario, tmp_path: Path
) -> None:
    day = row_of_three(tiny, parallel_allowed=[True, False])
    order = order_of(day, tmp_path / "loop")
    assert [(one["operation"], one["switch"]) for one in order["operations"]] == [
        ("close", "t"),
        ("open", "s"),
    ]
    assert order["least_margin"] == min(one["margin"] for one in order["operations"])
    assert [one["interrupted"] for one in order["operations"]] == [[], []]
    shown = CliRunner().invoke(app, ["reconfigure", str(tmp_path / "loop"), "--quiet"])
    assert "Order of operations:\n1. close t: it closes a loop and carries " in shown.output
    assert "\n2. open s: it opens the loop; lowest voltage 0.998 pu at bus 3," in shown.output


def test_the_order_of_operations_names_the_customers_that_wait(
    tiny: Scenario, tmp_path: Path
) -> None:
    rules = replace(tiny.switching, cold_load_factor=2.0, cold_load_h=1.0)
    day = replace(row_of_three(tiny), switching=rules)
    opened, closed = order_of(day, tmp_path / "dark")["operations"]
    waiting = [str(name) for name in day.customers.id[day.customers.bus == 4]]
    assert (opened["interrupted"], opened["minutes"]) == ([4], 20.0)
    words = f"open s: customer {waiting[0]} is without supply for 20 minutes, until t is closed; "
    assert opened["sentence"].startswith(words)
    load_kw = day.load_kw[2, day.customers.bus == 4].sum()
    assert f"it supplies customer {waiting[0]}, with {load_kw:.1f} kW of cold" in closed["sentence"]


def test_without_an_order_of_operations_the_reason_is_told(tiny: Scenario, tmp_path: Path) -> None:
    """A fault at bus 4: nothing is closed onto it."""
    times = tiny.grid.times
    day = replace(row_of_three(tiny), faults=(LineFault(times[0], times[4], bus=4),))
    order = order_of(day, tmp_path / "fault")
    assert order["operations"] is None and order["least_margin"] is None
    assert order["reason"] == "t cannot be closed: its line, or a bus of it, has a fault."
    shown = CliRunner().invoke(
        app, ["reconfigure", str(tmp_path / "fault"), "--at", "2022-07-19T12:00Z", "--quiet"]
    )
    assert f"There is no order of operations. {order['reason']}" in shown.output


def test_a_battery_that_holds_an_island_behind_a_fault_is_not_joined_by_a_tie(
    tiny: Scenario, tmp_path: Path
) -> None:
    """Behind 2-3 the small battery at bus 4 holds 3 and 4; empty, it does not."""
    times = tiny.grid.times
    day = replace(row_of_three(tiny), faults=(LineFault(times[0], times[4], line=3),))
    order = order_of(day, tmp_path / "live")
    assert order["operations"] is None
    assert "close t (joins two live parts, and has no sync_check)" in order["reason"]
    empty = replace(day.batteries, soc_initial=day.batteries.soc_min)
    order = order_of(replace(day, batteries=empty), tmp_path / "dark")
    told = [one["sentence"] for one in order["operations"]]
    assert any("close t: it supplies customer" in words for words in told)


@pytest.mark.daily
def test_only_operable_switches_that_are_not_locked_move(tmp_path: Path) -> None:
    """Of the ring's three lines two have a switch; each that cannot move leaves one tree less."""
    day = new_scenario(import_network(ring()))
    names = day.switches.id.tolist()
    assert names == ["link", "feeder", "east"]

    def count(**columns: list[Any]) -> int:
        folder = tmp_path / str(len([*tmp_path.iterdir()]))
        write_scenario(replace(day, switches=replace(day.switches, **columns)), folder)
        return int(reconfigured(folder)["configurations"])

    assert count() == 2  # open is the link, or the east; no switch is on the west
    assert count(operable=[True, True, False]) == 1
    assert count(locked=["", "", "repair"]) == 1


@pytest.mark.parametrize("columns", [{"operable": [False, True, True]}, {"locked": ["x", "", ""]}])
def test_without_a_tie_that_can_close_nothing_is_to_be_found(
    columns: dict[str, list[Any]], tmp_path: Path
) -> None:
    day = new_scenario(import_network(ring()))
    write_scenario(replace(day, switches=replace(day.switches, **columns)), tmp_path / "ring")
    shown = CliRunner().invoke(app, ["reconfigure", str(tmp_path / "ring")])
    assert shown.exit_code == 2
    assert "has no open switch that can be closed" in shown.output


def test_the_loads_are_those_of_a_step(tmp_path: Path, tiny: Scenario) -> None:
    """By day the PV power counts too; the largest demand is chosen if no time is given."""
    tie = Switches(["T", "S3"], [3, 2], [4, 3], ["tie", "sectionaliser"], [False, True],
                   r_ohm=[0.5, np.nan], x_ohm=[0.4, np.nan])  # fmt: skip
    day = replace(tiny, switches=tie)
    write_scenario(day, tmp_path / "tiny")
    found = reconfigured(tmp_path / "tiny", "--at", "2022-07-19T12:30Z")
    p_kw = np.array([0.0, -64.0 + 30.0, -42.0, -47.0 + 20.0])
    np.testing.assert_allclose(injection_at(day, 2)[0], p_kw)
    losses = ACPowerFlow(day.network).solve(*injection_at(day, 2)).losses_kw
    assert found["before"]["losses_kw"] == pytest.approx(losses, abs=1e-6)
    assert found["at"] == "2022-07-19T12:00:00Z"
    assert reconfigured(tmp_path / "tiny")["at"] == "2022-07-19T14:00:00Z"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["case16", "--at", "12:00"], "at = 12:00: is for a scenario alone."),
        (["case16", "--out", "x"], "out = x: is for a scenario alone."),
        (["FOLDER", "--slack", "all"], "slack: is for a network alone."),
        (["FOLDER", "--at", "2021-01-01"], "lies outside the scenario's day."),
        (["FOLDER", "--out", "FOLDER"], "Choose another folder"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    words: list[str], message: str, tiny_folder: Path
) -> None:
    words = [str(tiny_folder) if word == "FOLDER" else word for word in words]
    shown = CliRunner().invoke(app, ["reconfigure", *words])
    assert shown.exit_code == 2
    assert message in " ".join(shown.output.split())


def test_a_scenario_with_phases_is_refused(tiny: Scenario, tmp_path: Path) -> None:
    write_scenario(three_phases(tiny), tmp_path / "phased")
    shown = CliRunner().invoke(app, ["reconfigure", str(tmp_path / "phased")])
    assert shown.exit_code == 2
    assert "keeps its phases" in shown.output
