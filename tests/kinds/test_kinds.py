"""Laws of every kind: each has a small site in ``tests/support/kinds.py``, and all of them hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from tests.support.agreement import assert_methods_agree
from tests.support.builders import HERE, known, live, solved
from tests.support.kinds import EXAMPLES, Example
from tests.support.refusals import refusal
from tests.support.small_windows import first_step
from vppres import Controller, InputError, Measurement, explain_day, run_day, summarise
from vppres.contract.ahead import KindsAhead
from vppres.contract.decision import Decision
from vppres.control.guard.check import violations
from vppres.io import read_scenario, scenario_digest, write_scenario
from vppres.io.python_door import check_scenario
from vppres.kinds.kind import UnitPlan
from vppres.kinds.table import KINDS, parts
from vppres.model.site import Site
from vppres.plant.plant import Plant
from vppres.report.events import events_of
from vppres.report.run_folder import render_report
from vppres.scenario.scenario import Scenario
from vppres.service.plans.document import tables_of
from vppres.service.plans.gate import refusals
from vppres.solve.ladder import METHODS

of_each_kind = pytest.mark.parametrize("it", EXAMPLES.values(), ids=list(EXAMPLES))


def of_each_kind_drawn(count: int, by_day: int) -> pytest.MarkDecorator:
    """So many random cases of each kind, some of them by day."""
    cases = [
        pytest.param(it, n, marks=() if n < by_day else pytest.mark.nightly, id=f"{kind}-{n}")
        for n in range(count)
        for kind, it in EXAMPLES.items()
    ]
    return pytest.mark.parametrize(("it", "number"), cases)


def without(day: Scenario, *fields: str) -> Scenario:
    """The day without these tables of kinds."""
    return replace(day, **{name: type(getattr(day, name))() for name in fields})


def test_every_kind_has_an_example() -> None:
    assert [*EXAMPLES] == [*KINDS]


@of_each_kind
def test_without_units_no_bit_changes(it: Example, tiny: Scenario, tmp_path: Path) -> None:
    tables = KINDS[it.kind].tables
    empty = without(tiny, *tables)
    assert Site.of(empty).key == Site.of(tiny).key
    assert scenario_digest(empty) == scenario_digest(tiny)
    write_scenario(empty, tmp_path)
    assert not {file.stem for file in tmp_path.iterdir()} & {each.key for each in tables.values()}


@of_each_kind
def test_files_are_written_and_read_again(it: Example, tmp_path: Path) -> None:
    check_scenario(it.day)
    write_scenario(it.day, tmp_path)
    assert scenario_digest(read_scenario(tmp_path)) == scenario_digest(it.day)
    for name in KINDS[it.kind].tables:
        assert scenario_digest(without(it.day, name)) != scenario_digest(it.day)


@of_each_kind_drawn(40, by_day=20)
def test_the_plant_does_nothing_that_a_plan_may_not(it: Example, number: int) -> None:
    """Of any wish: within the limits of the window, and both reckon what units hold alike."""
    day = it.draw(random_window(number).scenario, number)
    rng = np.random.default_rng([number, 7])
    plant, units, steps = Plant(day), getattr(day, it.kind), range(day.grid.n_steps)
    ahead = known(day).ahead.without_duties().by_kind[it.kind]
    served = rng.random((len(steps), len(day.customers))) < 0.7
    taken_kw, running, held = [], [], []
    for t in steps:
        wish_kw = units.largest_kw * rng.uniform(-1.2, 1.2, len(units))
        wanted = rng.random(len(units)) < 0.7
        of_kind = plant.units[it.kind]
        done = of_kind.follow(t, wish_kw, wanted, served[t])
        of_kind.advance(t, *done)
        taken_kw.append(done[0])
        running.append(done[1])
        held.append(it.state(of_kind.state))
    taken, runs = np.array(taken_kw), np.array(running)
    connected = units.connected(day.customers, served)
    assert not taken[~connected].any()
    plan = UnitPlan(taken, runs, connected)
    assert ahead.power_beyond_kw(plan).max() < 1e-6
    assert ahead.stored_beyond_kw(plan).max() < 1e-6
    reckoned = it.stored(ahead, day, taken, runs)
    assert np.abs(reckoned - np.array(held)).max() < 1e-9


@of_each_kind
@pytest.mark.parametrize("method", METHODS)
def test_the_plant_does_what_is_planned(it: Example, method: str) -> None:
    """Row by row: powers that solve the window's rows are carried out as they are."""
    data, plant = known(it.day), Plant(it.day)
    plan = solved(it.day, method, data).dispatch
    taken = plan.taken_kw[it.kind]
    runs = plan.running.get(it.kind, np.ones_like(taken, dtype=bool))
    stored = it.stored(data.ahead.by_kind[it.kind], it.day, taken, runs)
    of_kind = plant.units[it.kind]
    for t, served in enumerate(plan.served):
        done = of_kind.follow(t, taken[t], runs[t], served)
        assert done[0] == pytest.approx(taken[t], abs=1e-5)
        assert (done[1] == runs[t]).all()
        of_kind.advance(t, *done)
        assert it.state(of_kind.state) == pytest.approx(stored[t], abs=1e-4)


@pytest.mark.monolith
@of_each_kind_drawn(60, by_day=4)
def test_methods_agree_on_random_windows(it: Example, number: int) -> None:
    scenario, data = random_window(number, stressed=number % 2 > 0)
    day = it.draw(scenario, number)
    data = known(day, data)
    if number % 3 == 0:  # who is yet to come is expected, and not known
        ahead = it.expected(data.ahead.by_kind[it.kind], np.random.default_rng(number))
        data = replace(data, ahead=KindsAhead({**data.ahead.by_kind, it.kind: ahead}))
    assert_methods_agree(Site.of(day), data)


@of_each_kind
def test_the_record_says_how_much_cheaper_the_same_service_can_be(it: Example) -> None:
    assert solved(it.day).cost_gap_gbp < 0.01


@of_each_kind
@pytest.mark.parametrize("method", METHODS)
def test_at_its_limit_a_unit_is_a_battery_or_a_load(it: Example, method: str) -> None:
    one, other = (solved(day, method) for day in it.limit)
    assert one.terms.f1 == other.terms.f1
    assert (one.dispatch.served.sum(axis=0) == other.dispatch.served.sum(axis=0)).all()
    assert one.terms.f2 == pytest.approx(other.terms.f2, abs=2e-3)
    assert one.terms.f3 == pytest.approx(other.terms.f3, abs=1e-4)
    assert one.objective == pytest.approx(other.objective, rel=1e-6)


@of_each_kind
def test_many_units_never_outweigh_a_customer(it: Example) -> None:
    assert solved(it.crowd).dispatch.served.all()


@of_each_kind
def test_the_guard_refuses_what_units_cannot_do(it: Example) -> None:
    for t, wrong_kw, words in it.wrong:
        day = it.day.between(t, it.day.grid.n_steps)
        data = known(day)
        seen = first_step(day, data)
        plan = solved(day, data=data).dispatch
        assert violations(Decision(plan), seen) == []
        wrong = plan.acting(it.kind, np.full((plan.n_steps, 1), wrong_kw))
        assert words in violations(Decision(wrong), seen)


@of_each_kind
def test_readings_are_used_or_named_and_outlive_a_restart(it: Example) -> None:
    """What is told once, is missing or stands still: the same is decided by another process."""
    one = Controller.of(it.day, HERE)
    steps = live(it.day, [told for told, _ in it.told])
    for other, (told, words) in zip(steps, it.told, strict=True):
        step = one.step(Measurement(other.time, other.batteries["soc"], **told))
        assert getattr(step, it.kind).equals(getattr(other, it.kind))
        said = other.solve["estimated"]
        assert (words in said) if words else not said


@of_each_kind
def test_the_last_check_sends_no_set_point_beyond_a_unit(it: Example) -> None:
    t = int(np.argmax(it.day.outage))
    soc = dict.fromkeys(it.day.batteries.id, 0.5)
    tables = tables_of(
        Controller.of(it.day, HERE).step(Measurement(it.day.grid.times[t], soc)), it.day
    )
    assert refusals(tables, it.day, soc) == {}
    (name,) = getattr(it.day, it.kind).id
    for columns, reason in it.beyond:
        wrong = tables | {it.kind: tables[it.kind].assign(**columns)}
        assert refusals(wrong, it.day, soc) == {(it.kind, name): reason}
    live_part = parts("live")[it.kind]
    assert live_part.defaults(it.day) == {name: it.default}
    ruled = live_part.by_rule(it.day.between(t, it.day.grid.n_steps))
    assert {column: float(np.max(value)) for column, value in ruled.items()} == it.by_rule


@of_each_kind
def test_without_voltage_units_do_nothing(it: Example) -> None:
    """As much as before in steps that are lit, and nothing in others."""
    ahead = known(it.day).ahead
    lit = np.arange(it.day.grid.n_steps) % 2 > 0
    part = ahead.in_the_dark(lit[:, None]).by_kind[it.kind]
    for most in ("most_taken_kw", "most_given_kw"):
        whole_kw, part_kw = (getattr(each, most)() for each in (ahead.by_kind[it.kind], part))
        assert (part_kw == np.where(lit, whole_kw, 0.0)).all()


@of_each_kind
def test_a_record_adds_up_and_says_why(it: Example) -> None:
    kind, words = KINDS[it.kind], parts("words")[it.kind]
    run = explain_day(run_day(it.day, HERE))
    assert (run.steps["fallback"] == "none").all() and (run.steps["clipped_kw"] == 0.0).all()
    kw = run.by_step(kind.table, "p_kw").sum(axis=1) * (-1.0 if kind.gives else 1.0)
    loads_kw = run.by_step("customers", "p_load_kw") * run.by_step("customers", "served")
    batteries = run.batteries["charge_kw"] - run.batteries["discharge_kw"]
    stored_kw = batteries.to_numpy().reshape(len(kw), -1).sum(axis=1)
    used_kw = kw + loads_kw.sum(axis=1) + stored_kw + run.steps["losses_kw"]
    assert run.steps["p_grid_kw"].to_numpy() == pytest.approx(used_kw.to_numpy(), abs=1e-4)
    summary = summarise(run)
    first, *back = (kwh for _, kwh in words.energies(summary[kind.table]))
    assert first - sum(back) == pytest.approx(abs(kw.sum()) * it.day.grid.dt_h, abs=1e-9)
    for name, value in it.figures.items():
        assert summary[kind.table][name] == pytest.approx(value, abs=1e-3), name
    assert [words for words in summary["cautions"] if words.startswith(it.caution)]
    told = run.explanations
    why = told[told["item"] == kind.subject].groupby("action")["words"].first()
    assert {*why.index} == {*it.why}
    assert all(why[action].startswith(words) for action, words in it.why.items())
    assert it.event in {event.words for event in events_of(run)}
    page = render_report(run, summary)
    labels = [label for label, kwh in words.energies(summary[kind.table]) if kwh]
    assert all(words in page for words in (it.event, *labels))


@of_each_kind
def test_a_record_is_played_again_from_step_to_step(it: Example) -> None:
    """What a step left is what the next one began with."""
    kind, words = KINDS[it.kind], parts("words")[it.kind]
    run = run_day(it.day, HERE)
    taken_kw = run.by_step(kind.table, "p_kw") * (-1.0 if kind.gives else 1.0)
    runs = run.by_step(kind.table, "running" if kind.gives else "p_kw").astype(bool)
    of_kind = Plant(it.day).units[it.kind]
    for t, now_kw in enumerate(taken_kw):
        recorded = it.state(words.state_of(run.rows(kind.table, t)))
        assert recorded == pytest.approx(it.state(of_kind.at(t)), abs=1e-9)
        of_kind.advance(t, now_kw, runs[t])


@of_each_kind
def test_mistakes_are_named(it: Example, tmp_path: Path) -> None:
    write_scenario(it.day, tmp_path)
    for name, before, after, message in it.mistakes:
        file = tmp_path / name
        good = file.read_text("utf-8")
        assert before in good
        file.write_text(good.replace(before, after, 1) if before else good + after, "utf-8")
        assert message in refusal(read_scenario, tmp_path), message
        file.write_text(good, "utf-8")


@of_each_kind
def test_what_does_not_go_with_a_kind_is_refused(it: Example) -> None:
    for day, options, message in it.refused:
        with pytest.raises(InputError, match=message):
            run_day(day, options)
