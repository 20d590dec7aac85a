"""The report of a run: whole, alone, and right in what it says."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.support.made_up_runs import (
    SECTIONS_OF_A_DAY,
    SERVED,
    day_run,
    day_scenario,
    small_run,
    small_scenario,
    without_devices,
)
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.run_files import read_run
from vppres.day.trajectory import Trajectory
from vppres.report.assumptions import data_words, option_words, simplifications
from vppres.report.clock import Clock
from vppres.report.events import events_of, opening_of
from vppres.report.findings import findings
from vppres.report.key_figures import key_figures
from vppres.report.one_line import (
    CORNER_PX,
    LEAN,
    LETTER_PX,
    SLOT_PX,
    SwitchMark,
    drawing,
    step_states,
    voltage_edges,
    worst_step,
)
from vppres.report.plots.figures import FIGURES, RUN_FIGURES, save_figures
from vppres.report.run_folder import render_report, write_run
from vppres.report.sections import SECTIONS
from vppres.scenario.faults import LineFault
from vppres.scenario.network import Network
from vppres.scenario.switches import Switches


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with its report."""
    folder = tmp_path_factory.mktemp("report") / "run"
    write_run(small_run(planned={"served": SERVED, "energy_kwh": [15.0] * 5}), folder)
    return folder


@pytest.fixture(scope="module")
def report(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def live(run: Trajectory) -> Trajectory:
    """The run without the voltages of its record that are below the AC limit."""
    return replace(run, buses=run.buses.assign(v_ac_pu=1.0))


def rated(run: Trajectory, i_max_a: list[float]) -> Trajectory:
    net = Network(
        [1, 2, 3], [2, 3, 4], [0.1] * 3, [0.1] * 3, slack_bus=1, base_kv=11.0, i_max_a=i_max_a
    )
    return replace(run, scenario=replace(run.scenario, network=net))


# ---------------------------------------------------------------------------------------- the file


@pytest.mark.daily
def test_the_run_folder_is_whole(folder: Path) -> None:
    assert sorted(file.name for file in folder.iterdir()) == [
        "batteries.parquet",
        "buses.parquet",
        "customers.parquet",
        "figures",
        "lines.parquet",
        "operating_order.csv",
        "options.json",
        "pv.parquet",
        "report.html",
        "scenario",
        "steps.parquet",
        "summary.json",
    ]
    assert sorted(file.stem for file in (folder / "figures").glob("*.svg")) == sorted(
        [*FIGURES, *RUN_FIGURES]
    )


def test_a_run_read_back_gives_the_same_summary(folder: Path) -> None:
    assert summarise(read_run(folder)) == json.loads((folder / "summary.json").read_text())


def test_the_report_needs_nothing_beside_it(report: str) -> None:
    assert {link.partition(",")[0] for link in re.findall(r'(?:src|href)="([^"]*)', report)} == {
        "data:image/png;base64",
        *(f"#{key}" for key in SECTIONS_OF_A_DAY),
    }
    assert {*re.findall(r"https?://[^\"]*", report)} == {"http://www.w3.org/2000/svg"}
    assert "default-src 'none'" in report


def test_all_sections_are_there_in_order(report: str) -> None:
    assert re.findall(r'<section id="(\w+)">', report) == SECTIONS_OF_A_DAY
    # No explanation here, no beliefs, and only one day.
    assert len(SECTIONS) == len(SECTIONS_OF_A_DAY) + 3


def test_every_figure_is_in_the_report(report: str) -> None:
    assert report.count('<figure class="plot') == len(FIGURES) + len(RUN_FIGURES)


def test_a_customer_s_hours_are_in_the_report(report: str) -> None:
    # c was without supply in both outage steps: one hour, 40 kWh.
    assert re.search(
        r"<td>c</td><td>4</td><td>low</td><td[^>]*>1\.00</td><td[^>]*>40\.0</td>", report
    )


def test_the_report_is_small(report: str) -> None:
    assert len(report) < 3e5


def test_ids_are_unique(report: str) -> None:
    ids = re.findall(r'\bid="([^"]*)"', report)
    assert len(ids) == len({*ids})


@pytest.mark.parametrize("scenario", [
    without_devices(small_scenario()),
    small_scenario(outage=False),
    replace(small_scenario(), title="<script>alert(1)</script> & co"),
], ids=["no devices", "no outage", "hostile title"])  # fmt: skip
def test_reports_of_unusual_days(scenario) -> None:
    run = small_run(scenario)
    text = render_report(run, summarise(run))
    assert re.findall(r'<section id="(\w+)">', text) == SECTIONS_OF_A_DAY
    assert "alert(1)</script>" not in text


def test_names_cannot_leave_the_data_of_scripts() -> None:
    day = small_scenario()
    customers = replace(day.customers, id=["</script><b>", "b", "c\"'"])
    run = small_run(replace(day, customers=customers))
    text = render_report(run, summarise(run))
    assert "</script><b>" not in text
    data = re.search(r'id="diagram-data">(.*?)</script>', text, flags=re.DOTALL)
    assert json.loads(data[1])["customers"][0] == "</script><b> (critical)"


def test_key_figures_that_are_undefined_are_left_out() -> None:
    figures = key_figures(summarise(small_run(small_scenario(outage=False))))
    assert not [row for row in figures if row[0].startswith("Resilience")]
    assert ("Imported energy", "203.0", "kWh") in figures


# ---------------------------------------------------------------------------------------- in words


def test_events_by_hand() -> None:
    told = [(event.t, event.time, event.words) for event in events_of(small_run())]
    assert told == [
        (1, "19 Jul 00:30", "Outage begins, 15 kWh stored."),
        (1, "19 Jul 00:30", "2 customers off supply: c (low), b (low)."),
        (2, "19 Jul 01:00", "1 customer off supply: a (critical)."),
        (2, "19 Jul 01:00", "1 customer restored: b (low)."),
        (2, "19 Jul 01:00", "Batteries are at their lower limit."),
        (3, "19 Jul 01:30", "Outage ends, 15 kWh stored."),
        (3, "19 Jul 01:30", "2 customers restored: a (critical), c (low)."),
    ]


def test_a_day_without_outage_has_no_events() -> None:
    day = small_run(small_scenario(outage=False))
    quiet = replace(day, customers=day.customers.assign(served=True))
    assert events_of(quiet) == []
    assert "No grid outage." in opening_of(quiet, summarise(quiet))


def test_sentences_by_hand() -> None:
    run = small_run()
    sentences = opening_of(run, summarise(run))
    assert sentences[0] == "4 steps of 30 min from 19 Jul 00:00 to 19 Jul 02:00 UTC."
    assert sentences[1] == "Grid outage from 19 Jul 00:30 to 01:30, 1 h in total."
    assert sentences[2].startswith(
        "Supplied in the outage, of all customer-steps: critical 50%, low 25%"
    )


def _everyone_on() -> Trajectory:
    """The small day with grid, and with supply for everyone."""
    run = live(small_run(small_scenario(outage=False)))
    return replace(run, customers=run.customers.assign(served=True))


def test_a_run_as_it_should_be_has_no_findings() -> None:
    run = _everyone_on()
    assert findings(run) == []


def test_findings_name_what_is_wrong() -> None:
    run = small_run()
    buses = run.buses.assign(v_ac_pu=run.buses["v_ac_pu"].where(run.buses["bus"] != 3, 0.93))
    lines = run.lines.assign(p_ac_kw=100.0, q_ac_kvar=0.0)
    steps = run.steps.assign(
        corrected=[False, True, False, False],
        correction_reason=["", "SoC", "", ""],
        clipped_kw=[0, 0, 2.5, 0.0],
        status=["optimal", "limit", "limit", "optimal"],
    )
    wrong = rated(replace(run, buses=buses, lines=lines, steps=steps), [4.0, np.inf, np.inf])
    inverted, *found = findings(wrong)
    assert inverted.startswith("Tier order was not kept in 1 customer-step (a)")
    assert found[0] == (
        "Voltage below the AC limit of 0.94 pu in 4 steps at 1 bus: the farthest "
        "is 0.9300 pu at bus 3, 19 Jul 00:00 UTC."
    )
    assert found[1].startswith("Lines above their rating in 4 steps: at most 131%, line 1 to 2")
    assert found[2].startswith("During the outage the AC power flow draws up to 102.0 kW")
    assert found[3] == "The plan was corrected in 1 step (SoC)."
    assert found[4] == "Set-points clipped to device limits in 1 step, by up to 2.50 kW."
    assert found[5] == "Gap above the tolerance in 2 steps, status limit (2)."


def test_findings_name_fallbacks_and_dark_islands() -> None:
    run = live(small_run(small_scenario(outage=False)))
    steps = run.steps.assign(
        fallback=["none", "previous_plan", "rule", "rule"],
        dark=[0.0, 1.0, 1.0, 0.0],
        dark_reason=["", "no battery", "no battery", ""],
        shed_kw=[0.0, 0.0, 65.0, 0.0],
        ac_failed=[False, False, False, True],
    )
    found = findings(replace(run, steps=steps))
    assert "The island was blacked out in 2 steps: no battery." in found
    assert "The plan had promised supply in 1 of them." in found
    assert "AC power flow had no solution in 1 step." in found
    assert "Fallback decisions: rule (2), previous plan (1)." in found


def test_a_bus_without_voltage_is_no_violation() -> None:
    run = _everyone_on()
    dark = run.buses.assign(v_ac_pu=run.buses["v_ac_pu"].where(run.buses["bus"] != 3, np.nan))
    assert findings(replace(run, buses=dark)) == []


def test_every_option_of_a_run_has_a_meaning() -> None:
    rows = option_words(RunOptions().as_record())
    assert len(rows) > len(fields(RunOptions))  # nested groups are taken apart
    assert [row.name for row in rows if not row.meaning] == []
    assert [row.name for row in rows if "`" in row.meaning] == []  # the page shows plain text
    assert {row.name: row.default for row in rows if row.default} == {
        "outages": "known",
        "mode": "physical",
        "voltage limits": "soft",
        "ratings": "limit",
        "priority": "weights",
        "headroom": "0.1",
        "rotation": "0",
        "turn h": "4",
        "minimum on h": "0",
    }


def test_an_option_that_is_not_the_default_says_so() -> None:
    changed = {row.name: row for row in option_words(RunOptions(horizon_h=2.0).as_record())}
    assert (changed["horizon h"].value, changed["horizon h"].default) == ("2", "5")


def test_simplifications_follow_the_run() -> None:
    run = small_run()
    told = " ".join(simplifications(run))
    assert "Forecasts have errors" in told  # the record says load_bias 0.1
    assert "heating is not simulated" in told
    assert "No line has a rating" in told
    assert "takes them, and any mismatch, from the grid's bus" in told
    other = rated(
        replace(run, options=dict(run.options) | {"thermal": "exact", "errors": {}}),
        [10.0, 10.0, 10.0],
    )
    told = " ".join(simplifications(other))
    assert "no forecast errors" in told
    assert "heating" not in told
    assert "Line ratings are reported, not enforced" in told
    for controller, words in (("mpc", "Plans keep the currents"), ("idle", "are reported")):
        kept = dict(other.options) | {"ratings": "limit", "controller": controller}
        assert words in " ".join(simplifications(replace(other, options=kept)))


def test_data_in_words() -> None:
    words = dict(data_words(small_run()))
    assert words["network"] == (
        "4 buses, 3 lines (0 with a rating), 11 kV, grid at bus 1 held at 1 pu"
    )
    assert words["customers"] == (
        "3, 70 kW at the highest; weights: critical 1 (1), high none (0), low several (2)"
    )
    assert words["batteries"] == "1, 100 kWh, 50 kW"


# ------------------------------------------------------------------------------------- the diagram


def test_marks_of_what_is_connected() -> None:
    buses = {bus.name: bus for bus in drawing(small_run()).buses}
    assert buses["1"].slack
    assert not buses["1"].connected["customers"]
    assert buses["2"].critical
    assert buses["3"].connected["pv"]
    assert not buses["2"].connected["pv"]
    assert buses["4"].connected["batteries"] == [0]
    assert buses["4"].connected["customers"] == [2]
    assert [kind for kind, _, _ in buses["4"].symbols] == ["customers", "batteries"]
    assert {(x, y) for _, x, y in buses["4"].symbols} == {(-18, 14), (4, 14)}


def test_states_by_hand() -> None:
    states = step_states(small_run())
    assert states["served"] == ["111", "100", "010", "111"]
    # One digit per bus; a bus without customers counts as served.
    assert states["tile"] == ["0000", "0022", "0202", "0000"]
    assert states["outage"] == [0, 1, 1, 0]
    assert states["v"][0] == [10000, 9800, 10000, 10000]
    assert states["soc"] == [[15]] * 4
    assert states["time"][1] == "19 Jul 00:30 UTC"
    # Step 2 serves b alone, of weight 0.1; step 1 serves a, of weight 1.
    assert states["start"] == worst_step(small_run()) == 2


def test_part_of_a_bus_may_be_served() -> None:
    day = small_scenario()
    together = replace(day, customers=replace(day.customers, bus=[2, 4, 4]))
    assert step_states(small_run(together))["tile"][2] == "0201"


def test_voltage_classes_are_round_and_hold_every_voltage() -> None:
    run = small_run()
    edges = voltage_edges(run)
    assert edges == pytest.approx([0.95, 0.96, 0.97, 0.98, 0.99, 1.0])
    assert step_states(run)["bus"] == ["4344", "4244", "4144", "4044"]


def test_a_voltage_outside_the_limits_has_a_class_of_its_own() -> None:
    run = small_run()
    low = replace(
        run, buses=run.buses.assign(v_ac_pu=run.buses["v_ac_pu"].where(run.buses["bus"] != 4, 0.90))
    )
    assert all(state[3] == "9" for state in step_states(low)["bus"])


def test_loading_classes_by_rating_and_by_the_largest_current() -> None:
    run = small_run()
    amps = 100.0 / (np.sqrt(3.0) * 11.0)  # 5.25 A at 1 pu
    run = replace(run, lines=run.lines.assign(p_ac_kw=[100.0, 50.0, 10.0] * 4, q_ac_kvar=0.0))
    assert step_states(run)["line"][0] == "420"  # without ratings none is overloaded
    assert step_states(rated(run, [amps / 1.1, amps, np.inf]))["line"][0] == "520"


def test_the_worst_step_without_outage_has_the_lowest_voltage() -> None:
    assert worst_step(small_run(small_scenario(outage=False))) == 3


def named_buses(run: Trajectory, name: Callable[[int], str]) -> Trajectory:
    """The run, with other names of buses."""
    day = run.scenario
    names = {bus: name(i) for i, bus in enumerate(day.network.buses)}
    net, again = day.network, lambda buses: [names[bus] for bus in buses]
    network = replace(
        net,
        from_bus=again(net.from_bus),
        to_bus=again(net.to_bus),
        drawing_bus=again(net.drawing_bus),
        slack_bus=names[net.slack_bus],
    )
    moved = replace(
        day,
        network=network,
        customers=replace(day.customers, bus=again(day.customers.bus)),
        batteries=replace(day.batteries, bus=again(day.batteries.bus)),
    )
    return replace(run, scenario=moved)


@pytest.mark.parametrize("letters", [2, 12, 40])
@pytest.mark.parametrize("run", [small_run(), day_run(day_scenario(160))], ids=["4", "161"])
def test_names_of_buses_cover_neither_each_other_nor_a_symbol(run, letters) -> None:
    run = named_buses(run, lambda i: f"{i:03} {'w' * letters}")
    drawn = drawing(run)
    assert all(bus.name.startswith(bus.short.rstrip("…")) for bus in drawn.buses)
    rows = sorted({bus.y for bus in drawn.buses})
    columns = sorted({bus.x for bus in drawn.buses})
    between = min(b - a for a, b in pairwise(columns))
    width = LETTER_PX * max(len(bus.short) for bus in drawn.buses)
    if drawn.leaning:
        high = LEAN * width  # lines that lean at 30 degrees are half as far apart as their buses
        assert LEAN * between >= 12
    else:
        high = 0.0
        assert width < between
    deepest = max(y + 16 for bus in drawn.buses for _, _, y in bus.symbols)
    assert all(b - a >= deepest + high + 10 for a, b in pairwise(rows))
    assert rows[0] >= high + 10
    assert drawn.width >= columns[-1] + (width if drawn.leaning else width / 2)
    assert drawn.height >= rows[-1] + deepest


def test_a_small_feeder_is_spread_and_its_symbols_are_not_enlarged() -> None:
    small, large = drawing(small_run()), drawing(day_run(day_scenario(32)))
    assert small.width < 1000 < large.width
    near, far = ({bus.x for bus in one.buses} for one in (small, large))
    assert max(near) / len(near) > 2 * max(far) / len(far)
    offsets = [{place for bus in one.buses for place in bus.symbols} for one in (small, large)]
    assert offsets[0] & offsets[1]


def test_switches_are_drawn_open_or_closed() -> None:
    run = small_run()
    switches = Switches(
        ["T", "S"], [4, 2], [3, 1], ["tie", "breaker"], [False, True],
        locked=["", "repair"], r_ohm=[1.0, np.nan], x_ohm=[1.0, np.nan],
    )  # fmt: skip
    run = replace(run, scenario=replace(run.scenario, switches=switches))
    drawn = drawing(run)
    at = {bus.name: (bus.x, bus.y) for bus in drawn.buses}
    below = max(y for bus in drawn.buses for _, _, y in bus.symbols) + SLOT_PX
    assert drawn.switches == (
        SwitchMark("T: tie, open", False, 3, (*at["3"], *at["4"]), below),
        SwitchMark("S: breaker, closed, locked: repair", True, 0, (*at["1"], *at["2"]), below),
    )
    page = render_report(run, summarise(run))
    assert page.count('<g class="tie"><title>T: tie, open</title>') == 1
    assert page.count('<g class="switch"><title>S: breaker, closed, locked: repair</title>') == 1
    assert "open switch" in page and "closed switch" in page


def test_a_tie_is_drawn_beside_the_buses_between_its_ends() -> None:
    """Ends are bus 1 and bus 9 of a row, or of a column; other ties may cross what they must."""
    for ends in ((40, 50, 440, 50), (440, 50, 40, 50), (40, 50, 40, 450), (40, 450, 40, 50)):
        tie = SwitchMark("t", False, 9, ends, below=54)
        _, *corners, _ = tie.path
        assert {tie.path[0], tie.path[-1]} == {ends[:2], ends[2:]}
        if ends[1] == ends[3]:
            assert {y for _, y in corners} == {104} == {tie.middle[1]}
            assert all(40 < x < 440 for x, _ in corners)
        else:
            assert {x for x, _ in corners} == {40 + CORNER_PX} == {tie.middle[0]}
            assert all(50 < y < 450 for _, y in corners)


def test_faults_are_drawn_where_they_are_and_named_with_their_times() -> None:
    run = small_run()
    day = run.scenario
    times, step = day.grid.times, day.grid.step
    faults = (
        LineFault(times[2], times[2] + step, line=4),
        LineFault(times[0], times[0] + step, line=4),
        LineFault(times[2], times[2] + step, bus=3),
    )
    run = replace(run, scenario=replace(day, faults=faults))
    drawn = drawing(run)
    at = {bus.name: (bus.x, bus.y) for bus in drawn.buses}
    clock = Clock.of(run)
    first, second = (f"from {clock.at(t)} to {clock.at(t + 1)}" for t in (0, 2))
    line, bus = drawn.faults
    assert line.words == f"line 3-4 out of service {first} and {second}"
    assert (line.x, line.y) == ((at["3"][0] + at["4"][0]) // 2, at["4"][1])
    assert (bus.words, bus.x, bus.y) == (f"bus 3 out of service {second}", *at["3"])
    classes = step_states(run)["line"]
    assert [[digit == "9" for digit in row] for row in classes] == [
        [False, False, True], [False] * 3, [False, True, True], [False] * 3,
    ]  # fmt: skip
    page = render_report(run, summarise(run))
    assert page.count(f'<g class="fault"><title>{line.words}</title>') == 1
    assert f"Faults: {line.words}; {bus.words}." in page


def test_open_ties_and_lines_that_are_out_have_classes_of_their_own() -> None:
    """Bus 4 is behind a fault in step 2, alone with a battery or without."""
    run = small_run()
    day = run.scenario
    tie = Switches(["T"], [4], [2], ["tie"], [False], r_ohm=[1.0], x_ohm=[1.0])
    fault = LineFault(day.grid.times[2], day.grid.times[2] + day.grid.step, line=4)
    run = replace(run, scenario=replace(day, faults=(fault,), switches=tie))
    states = step_states(run)
    assert [row[2:] for row in states["line"]] == ["08", "08", "98", "08"]
    assert [row[3] for row in states["part"]] == ["0", "1", "4", "0"]
    feeder = run.plot("feeder", time=day.grid.times[2])
    assert {"open", "out of service"} <= {text.get_text() for text in feeder.get_legend().texts}
    page = render_report(run, summarise(run))
    moment = page[page.index('<div class="moment">') :]
    assert "Out of service: 3-4.</p>" in moment
    assert 0 < moment.index("<b>Before.</b>") < moment.index("<b>After.</b>")


def test_figures_of_one_run_alone_are_left_out_for_several(tmp_path: Path) -> None:
    files = save_figures({"one": small_run()}, tmp_path, ("svg",))
    assert {file.stem for file in files} == set(FIGURES)
