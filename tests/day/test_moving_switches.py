"""Days in which switches move: which, when, and what the record says of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.phased_feeder import CIRCUIT, day_of
from tests.support.switched import switched_day
from tests.support.three_phases import three_phases
from vppres import InputError, RunOptions, read_run, run_day
from vppres.control import operations
from vppres.day.configured import configurations_of
from vppres.day.metrics import resilience, summarise
from vppres.explain.day import explain_day
from vppres.feeders.reconfiguration.sequence import SwitchingOrder
from vppres.feeders.reconfiguration.states import NO_MARGIN
from vppres.io import read_scenario, write_scenario
from vppres.io.find import load_scenario
from vppres.report.events import events_of
from vppres.report.one_line import step_states
from vppres.report.operating_order import shown_orders
from vppres.report.run_folder import render_report, write_run
from vppres.scenario.configuration import Branches, in_configuration
from vppres.scenario.faults import LineFault
from vppres.scenario.phases import Phases
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches

PAPER = RunOptions(mode="paper", horizon_h=3.0, isolate=False)
MOVING = replace(PAPER, move_switches=True)
NOON, HOUR = pd.Timestamp("2022-07-19T12:00Z"), pd.Timedelta(hours=1)


def ties(*pairs: tuple[int, int], ohm: float = 0.5, **columns: object) -> Switches:
    """Open ties between buses."""
    names = [f"{a}-{b}" for a, b in pairs]
    first, second = zip(*pairs, strict=True)
    each = np.full(len(pairs), ohm)
    kinds, closed = ["tie"] * len(pairs), [False] * len(pairs)
    return Switches(names, first, second, kinds, closed, r_ohm=each, x_ohm=each, **columns)


def with_fault(day: Scenario, switches: Switches, **fault: object) -> Scenario:
    """The day without its outage, with a fault from 12:00 to 14:00 and its switches."""
    limit_kw = [np.inf] * day.grid.n_steps
    found = LineFault(NOON, NOON + 2 * HOUR, **fault)
    return replace(day, grid_limit_kw=limit_kw, faults=(found,), switches=switches)


def cut_off(tiny: Scenario, **columns: object) -> Scenario:
    """The homes cut off by a fault, with a battery that forms no grid and a tie from bus 3."""
    stores = replace(tiny.batteries, grid_forming=[True, False])
    return with_fault(replace(tiny, batteries=stores), ties((3, 4), **columns), line=4)


def test_a_tie_takes_over_behind_a_fault(tiny: Scenario, tmp_path: Path) -> None:
    day = cut_off(tiny)
    write_scenario(day, tmp_path / "day")
    run = run_day(read_scenario(tmp_path / "day"), MOVING)
    assert run.customers["served"].all()
    assert (run.customers["off_by_fault"] == "").all()
    assert run.steps["switched"].tolist() == ["", "", "closed 3-4, opened 2-4", "", "", ""]
    assert run.steps["switching_ahead"].tolist()[:2] == ["closed 3-4, opened 2-4"] * 2
    assert run.steps["switches_open"].tolist() == ["3-4"] * 2 + ["2-4"] * 4
    flows = run.lines[run.lines["from_bus"] == 3]["p_ac_kw"].abs() > 1.0
    assert flows.tolist() == [False] * 2 + [True] * 4
    still = run_day(day, PAPER)
    homes = still.customers[still.customers["id"] == "homes"]
    assert homes["served"].tolist() == [True, True, False, False, True, True]


def test_a_tie_that_is_called_as_the_line_beside_it_is_told_apart(
    tiny: Scenario, tmp_path: Path
) -> None:
    """Its name, one with a comma, and buses whose names have capitals, in record and report."""
    switches = replace(ties((2, 4), (3, 4)), id=["2-4", 'north, "old"'], operable=[True, False])
    day = with_fault(tiny, switches, line=4)
    branches = Branches.of(day)
    assert branches.names == ("1-2", "2-3", "line 2-4", "2-4", 'north, "old"')
    run = run_day(day, MOVING)
    assert run.customers["served"].all()
    assert run.steps["switched"].iloc[2] == "closed 2-4, opened line 2-4"
    write_run(run, tmp_path / "run", figures=False)
    found = configurations_of(read_run(tmp_path / "run"))
    assert found is not None
    assert [flags.tolist() for flags in found] == [
        [True, True, True, False, False],
        [True, True, True, False, False],
        *[[True, True, False, True, False]] * 4,
    ]


def test_a_tie_of_three_phases_takes_over_behind_a_fault(tiny: Scenario) -> None:
    run = run_day(three_phases(cut_off(tiny)), replace(MOVING, mode="physical"))
    assert run.customers["served"].all()
    assert run.steps["switched"].tolist() == ["", "", "closed 3-4, opened 2-4", "", "", ""]
    order = run.steps["switching_order"].iloc[2].splitlines()
    assert [one.split(":")[0] for one in order] == ["open 2-4", "close 3-4"]
    assert "lowest voltage" in order[1] and "margin" in order[1]
    assert run.steps["v_error_pu"].max() < 1e-4
    assert not run.nodes["v_ac_pu"].isna().any()


@pytest.mark.daily
def test_a_tie_of_an_unbalanced_feeder_takes_over_behind_a_fault(tmp_path: Path) -> None:
    """The island behind the fault holds all but one, the grid over the tie everyone."""
    day = day_of(CIRCUIT, tmp_path)
    noon = day.grid.start.normalize() + 12 * HOUR
    tie = Switches(["t"], ["r"], ["e"], ["tie"], [False], r_ohm=[0.3], x_ohm=[0.6])
    fault = LineFault(noon, noon + 2 * HOUR, line="e")
    day = replace(day, switches=tie, faults=(fault,)).between(11, 15)
    day = replace(day, grid_limit_kw=np.full(4, np.inf))
    options = RunOptions(horizon_h=2.0, isolate=False)
    still, moved = (run_day(day, replace(options, move_switches=on)) for on in (False, True))
    assert (~still.by_step("customers", "served")).sum(axis=1).tolist() == [0, 1, 1, 0]
    assert still.steps["former"].tolist() == ["", "be", "be", ""]
    assert moved.customers["served"].all()
    assert moved.steps["switched"].tolist() == ["", "closed t, opened m-e", "", ""]
    assert (moved.steps["status"] == "optimal").all()
    assert moved.steps["v_error_pu"].max() < 1e-4
    net = day.network
    assert moved.nodes["v_ac_pu"].between(net.v_min_ac_pu, net.v_max_ac_pu).all()


def test_a_tie_that_lacks_a_phase_is_not_moved(tiny: Scenario) -> None:
    day = three_phases(with_fault(tiny, ties((3, 4)), line=4))
    out = day.out_of_service(range(1))
    branches = Branches.of(day)
    assert branches.movable(~branches.closed, out)[-1]
    bare = tuple(
        replace(row, phases="a" if row.at == 3 else row.phases) for row in day.phases.buses
    )
    lines = tuple(row for row in day.phases.lines if row.to_bus != "3")
    connections = tuple(row for row in day.phases.connections if row.bus != "3")
    phases = Phases(bare, lines, connections=connections)
    assert not replace(branches, phases=phases).movable(~branches.closed, out)[-1]


@pytest.mark.daily
@pytest.mark.parametrize("seed", [0, 5])
def test_three_equal_phases_move_the_same_switches(seed: int) -> None:
    """With inverters that limit nothing."""
    day = switched_day(seed).between(0, 3)
    wide = replace(day.batteries, s_max_kva=np.full(len(day.batteries), 600.0))
    known = tuple(replace(fault, known=True) for fault in day.faults)
    day = replace(day, faults=known, batteries=wide)
    options = replace(MOVING, mode="physical")
    one, three = (run_day(each, options) for each in (day, three_phases(day)))
    assert one.steps["switched"].any()
    for column in ("switched", "switching_ahead"):
        assert three.steps[column].tolist() == one.steps[column].tolist()
    assert three.customers["served"].tolist() == one.customers["served"].tolist()


def test_a_day_without_movable_switches_is_that_of_its_tree(tiny: Scenario) -> None:
    locked = ties((3, 4), locked=["pole on fire"])
    day = with_fault(tiny, locked, line=4)
    runs = [run_day(day, options, steps=3) for options in (PAPER, MOVING)]
    for table in ("steps", "customers", "batteries", "buses", "lines"):
        one, other = (getattr(run, table) for run in runs)
        apart = ["solve_s", "solver_s", "compilations"] if table == "steps" else []
        pd.testing.assert_frame_equal(one.drop(columns=apart), other.drop(columns=apart))


def test_two_live_parts_are_joined_only_by_a_switch_that_compares_them(tiny: Scenario) -> None:
    """The homes are an island from the first step on, and their battery lasts for an hour."""
    able = {"p_max_kw": [50.0, 50.0], "s_max_kva": [60.0, 60.0], "soc_initial": [0.5, 0.85]}
    stores = replace(tiny.batteries, grid_forming=[True] * 2, **able)
    alone = LineFault(tiny.grid.start, tiny.grid.end, line=4)
    for check in (False, True):
        day = with_fault(replace(tiny, batteries=stores), ties((3, 4), sync_check=[check]), line=4)
        run = run_day(replace(day, faults=(alone,)), replace(MOVING, horizon_h=0.0), steps=2)
        assert run.customers[run.customers["id"] == "homes"]["served"].tolist() == [True, check]
        why = "no way leads to switches that may serve more: 3-4 joins two live parts, and has"
        assert check or run.steps["switching_why"].iloc[1] == f"{why} no sync_check"
    assert run.steps["switched"].tolist() == ["", "closed 3-4, opened 2-4"]


def test_words_say_why_no_order_leads_to_what_would_serve_more(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A state in between that is beyond its limits does not say that no switch would serve more."""
    reason = "No order keeps the rules in every state: open 2-4 (highest voltage 1.084 pu)."
    none = SwitchingOrder(None, reason, True, NO_MARGIN)
    monkeypatch.setattr(operations, "safe_order", lambda *_: none)
    run = run_day(cut_off(tiny), MOVING, steps=3)
    assert (run.steps["switched"] == "").all()
    words = f"no way leads to switches that may serve more: {reason}".rstrip(".")
    assert run.steps["switching_why"].iloc[2] == words
    assert run.steps["status"].iloc[2] == "gap_open"


def test_an_operation_pays_its_price_and_a_day_has_so_many(tiny: Scenario) -> None:
    for column, value in (("operation_cost", 10.0), ("max_operations_per_day", 0.0)):
        run = run_day(cut_off(tiny, **{column: [value]}), MOVING)
        assert (run.steps["switched"] == "").all()
        assert not run.customers["served"].all()


def test_words_say_what_an_operation_serves(tiny: Scenario) -> None:
    run = explain_day(run_day(cut_off(tiny), MOVING))
    words = "closing 3-4 serves 1 customer until 14:00"
    assert run.steps["switching_why"].iloc[2] == words
    opens, closes = shown_orders(run)
    assert opens.startswith("19 Jul 12:00: open 2-4: customer homes is without supply until 3-4")
    assert closes.startswith("19 Jul 12:00: close 3-4: it supplies customer homes; lowest voltage")
    sentence = f"Closed 3-4, opened 2-4: {words}."
    told = [(event.t, event.words) for event in events_of(run)]
    assert (2, sentence) in told and (4, "Line 2-4 repaired.") in told
    reasons = run.explanations
    of_steps = reasons[reasons["item"] == "step"]["words"].tolist()
    assert of_steps[2].endswith(sentence)
    assert "Planned ahead: closed 3-4, opened 2-4" in of_steps[1]


def test_the_report_draws_the_feeder_before_and_after_switches_move(tiny: Scenario) -> None:
    """Bus 4 is cut off before, and has the grid over the tie after."""
    run = run_day(cut_off(tiny), MOVING)
    page = render_report(run, summarise(run))
    _, moment = page.split('<div class="moment">')
    assert "<h3>19 Jul 12:00: closed 3-4, opened 2-4</h3>" in moment
    assert "<p>Closing 3-4 serves 1 customer until 14:00.</p>" in moment
    assert moment.index("<li>open 2-4") < moment.index("<li>close 3-4")
    before, after = (each.split("</figure>")[0] for each in moment.split("<figcaption>")[1:3])
    assert "Out of service: 2-4. 1 of 4 buses without the grid." in before
    assert before.count('class="part p1"') == 1 and 'class="line l8 mv"' in before
    assert "all buses with the grid, all customers supplied." in after
    assert 'class="part p1"' not in after and 'class="line l8' not in after
    for each in (before, after):
        assert each.count('<g class="fault">') == 1
        assert each.count('<text class="moved"') == 2
    steps = step_states(run)
    assert [row[3] for row in steps["line"]] == ["8", "8", *steps["line"][2][3] * 4]
    assert {row[3] for row in steps["line"][2:]} <= set("012345")


def test_words_tell_a_line_that_is_open_from_one_that_is_out(tiny: Scenario) -> None:
    """Line 2-4 is open all day, and has a fault from 12:00 to 14:00."""
    batteries = tiny.batteries
    for forms, words in (
        ([True, False], "no battery forms the grid behind line 2-4, which is {}"),
        ([True, True], "the part behind line 2-4, which is {}, has too little power or energy"),
    ):
        stores = replace(
            batteries, grid_forming=forms, p_max_kw=[50.0, 5.0], s_max_kva=[60.0, 60.0]
        )
        day = with_fault(replace(tiny, batteries=stores), Switches.none(), line=4)
        branches = Branches.of(day)
        closed = branches.closed & (np.array(branches.names) != "2-4")
        run = explain_day(run_day(in_configuration(day, branches, closed).scenario, PAPER))
        told = run.explanations
        homes = told[(told["item"] == "customer") & (told["id"] == "homes")]["words"]
        states = ["open", "open", "out", "out", "open", "open"]
        assert homes.tolist() == [f"Not supplied: {words.format(state)}." for state in states]


def test_words_say_that_no_switch_would_serve_more(tiny: Scenario) -> None:
    """In the outage at the day's end nothing lies behind a tie that has more."""
    run = explain_day(run_day(replace(tiny, switches=ties((3, 4))), MOVING))
    off = ~run.by_step("customers", "served").all(axis=1)
    assert off.any()
    assert set(run.steps["switching_why"][off]) == {"no switch would serve more"}
    told = run.explanations
    of_steps = told[told["item"] == "step"]["words"][off.tolist()]
    assert of_steps.str.contains("No switch would serve more.").all()


def test_options_that_move_no_switches_are_refused(tiny: Scenario) -> None:
    day = with_fault(tiny, ties((3, 4)), line=4)
    with pytest.raises(InputError, match="are not moved by full-horizon"):
        run_day(day, replace(MOVING, controller="full-horizon"))


def packaged_day_with_fault(folder: Path) -> Scenario:
    """The packaged day with its five ties, and a fault of line 6-7 from 12:00 to 18:00."""
    day = load_scenario("uk-heatwave-2022")
    five = ((8, 21), (9, 15), (12, 22), (18, 33), (25, 29))
    fault = LineFault(NOON, NOON + 6 * HOUR, line=7)
    write_scenario(replace(day, switches=ties(*five, ohm=1.0), faults=(fault,)), folder)
    return read_scenario(folder)


@pytest.mark.daily
def test_the_packaged_day_with_a_fault_at_noon(tmp_path: Path) -> None:
    day = packaged_day_with_fault(tmp_path / "day")
    day = replace(day, grid_limit_kw=np.full(day.grid.n_steps, np.inf))
    still, moved = (
        run_day(day, RunOptions(mode="paper", move_switches=moves)) for moves in (False, True)
    )
    assert not still.customers["served"].all()
    assert moved.customers["served"].all()
    assert (moved.steps["switched"] != "").sum() == 1
    assert moved.steps["switched"].iloc[12].endswith("opened 6-7")
    assert (moved.steps["status"] == "optimal").all()


@pytest.mark.nightly
@pytest.mark.parametrize("mode", ["paper", "physical"])
def test_ties_raise_r_in_the_outage_of_the_packaged_day(mode: str, tmp_path: Path) -> None:
    day = packaged_day_with_fault(tmp_path / "day")
    still, moved = (
        resilience(run_day(day, RunOptions(mode=mode, move_switches=moves)))
        for moves in (False, True)
    )
    assert still is not None
    assert moved is not None
    assert moved > still + 0.01
