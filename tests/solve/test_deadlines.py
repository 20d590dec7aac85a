"""Time limits hold in every stage: parts of time, and windows that would never end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import highspy
import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from benchmarks.instances import Instance, packaged, read_instances, window_data
from tests.support.small_windows import window
from vppres.core.errors import LimitError, SolveError
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.cache import ModelCache
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.fleet.masters import Master
from vppres.solve.forms import Form, window_problem
from vppres.solve.ladder import WindowSolver
from vppres.solve.programs import ProgramSolution
from vppres.solve.result import Outcome, SolveLimits, Status
from vppres.solve.selection import Selected
from vppres.solve.solvers import find_solver, run, run_conic
from vppres.solve.task import WindowTask

NEVER_CLOSED = "s039"
"""Its search in the network finds nothing more after half a minute, and does not end in 100 s."""

BUSY_S = 3.0
"""What a machine that does other things at the same time may add to an answer."""


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time, in the hands of the test."""
    time_s = [100.0]
    monkeypatch.setattr(
        "vppres.solve.deadline.time", SimpleNamespace(perf_counter=lambda: time_s[0])
    )
    return time_s


def instance(name: str) -> Instance:
    return next(one for one in read_instances() if one.name == name)


# The clock.


def test_parts_of_a_deadline(now: list[float]) -> None:
    window = Deadline(60.0)
    now[0] += 20.0
    search = window.part(0.5)
    assert (window.left_s, window.spent_s, search.left_s) == (40.0, 20.0, 20.0)
    assert window.later(3.0).left_s == 43.0
    now[0] += 50.0
    assert window.passed and search.passed
    assert window.part(0.5).left_s == 0.0
    assert window.later(3.0).left_s == -7.0


# Stages.


@pytest.mark.parametrize("method", ["decomposed", "monolithic"])
@pytest.mark.parametrize("ohm", [1e6, 1e15])
def test_line_that_carries_next_to_nothing_ends_by_name(method: str, ohm: float) -> None:
    """Limits are met within a tolerance only, so that the same are violated again and again."""
    case = random_window(4, stressed=True)
    net = case.scenario.network
    r_ohm = net.r_ohm.copy()
    r_ohm[-1] = ohm
    site = Site.of(replace(case.scenario, network=replace(net, r_ohm=r_ohm)))
    watch = Stopwatch()
    try:
        answer = WindowSolver(site, method, limits=SolveLimits(time_s=2.0)).solve(case.data)
    except SolveError as error:
        assert str(error).startswith(f"The window of {case.data.n_steps} steps ")
    else:
        assert answer.status in (Status.OPTIMAL, Status.GAP_OPEN, Status.TIME_LIMIT)
    assert watch.spent_s < 2.0 + BUSY_S


@pytest.mark.parametrize("name", ["o040", "s010", "s020", "s036"])
def test_a_hundredth_of_a_second_does_not_take_many(name: str) -> None:
    """It took 6.7 s: every step on the way to the first answer had 5 s of its own."""
    solver = WindowSolver(Site.of(packaged()), limits=SolveLimits(time_s=0.01))
    data = window_data(instance(name))
    ends = []
    for _ in range(2):  # the first compiles
        watch = Stopwatch()
        try:
            ends.append(str(solver.solve(data).status))
        except SolveError as error:
            ends.append(type(error).__name__)
        spent_s = watch.spent_s
    assert ends[-1] in ("optimal", "time_limit", "LimitError")
    assert spent_s < 0.01 + 0.5 + BUSY_S


def test_first_answer_has_the_grace_of_the_network_s_size() -> None:
    """Time is up at once: what is cheap and compiled is still finished."""
    ordinary = next(
        one
        for one in read_instances()
        if one.place == "before" and one.steps == 3 and one.group == "ordinary"
    )
    solver = WindowSolver(Site.of(packaged()), limits=SolveLimits(time_s=60.0))
    first = solver.solve(window_data(ordinary))
    assert first.dispatch.served.all()
    solver.limits = SolveLimits(time_s=1e-6)
    task = solver._task(window_data(ordinary), solver.limits)
    assert task.deadline.passed
    assert 0.3 < task.latest.left_s < 0.4
    assert not task.answer_by(share=0.1).passed
    task_later = WindowTask(task.data, task.cache, SolveLimits(time_s=30.0), task.spec, 16)
    assert 9.0 < task_later.answer_by(share=1 / 3).left_s < 10.1


# Compiling.


def test_what_cannot_be_compiled_in_time_is_not_begun(
    monkeypatch: pytest.MonkeyPatch, tiny: Scenario
) -> None:
    monkeypatch.setattr("vppres.solve.solvers.COMPILE_S_PER_ENTRY", 100.0)
    site, data = Site.of(tiny), window(tiny, slice(1))
    cache = ModelCache(site)
    relaxed = Form(service="relaxed", exclusivity="relaxed")
    for conic in (False, True):
        form = relaxed if conic else Form(network=False)
        problem = window_problem(cache, data, form, conic)
        problem.fill(data)
        outcome = (
            run_conic(problem, time_s=60.0)
            if conic
            else run(problem, find_solver("highs"), 0.0, time_s=60.0)
        )
        assert outcome.status == Status.NO_ANSWER
        assert not problem.is_compiled
    monkeypatch.undo()
    assert run_conic(problem, time_s=600.0).status == Status.OPTIMAL


def test_a_solver_gets_what_compiling_leaves(
    monkeypatch: pytest.MonkeyPatch, tiny: Scenario, now: list[float]
) -> None:
    """Compiling took its 5 s on top of the limit."""
    given = []
    of = ProgramSolution.of

    def noted(solver: highspy.Highs, deadline: Deadline) -> ProgramSolution:
        given.append(deadline.left_s)
        return of(solver, deadline)

    monkeypatch.setattr(ProgramSolution, "of", noted)
    spec = find_solver("highs")
    data = window(tiny, slice(1))
    for time_s, ended in ((8.0, Status.OPTIMAL), (4.0, Status.NO_ANSWER)):
        problem = window_problem(ModelCache(Site.of(tiny)), data, Form(network=False))
        problem.fill(data)
        compiled = problem.compile

        def slow(problem: Selected = problem, compiled: Callable[[], None] = compiled) -> None:
            now[0] += 0.0 if problem.is_compiled else 5.0
            compiled()

        monkeypatch.setattr(problem, "compile", slow)
        assert run(problem, spec, 0.0, time_s=time_s).status == ended
        assert given == [3.0]


def test_no_time_to_compile_is_no_numerical_trouble(monkeypatch: pytest.MonkeyPatch) -> None:
    """The window is not late yet when it is known that nothing more can be compiled in time."""
    monkeypatch.setattr("vppres.solve.solvers.COMPILE_S_PER_ENTRY", 100.0)
    solver = WindowSolver(Site.of(packaged()), limits=SolveLimits(time_s=30.0))
    solver.cache = ModelCache(solver.site)
    data = window_data(instance("o040"))
    with pytest.raises(LimitError, match="was not solved before the time limit"):
        solver.solve(data)


def test_a_bound_whose_search_ran_out_of_time_is_not_called_optimal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The bound by shares of customers stands, and the gap of cost that it leaves."""
    site = Site.of(packaged())
    data = window_data(instance("o041"))
    solver = WindowSolver(site, limits=SolveLimits(time_s=60.0))
    found = solver.solve(data)

    def no_search(*_: object) -> tuple[Outcome, None]:
        return Outcome(Status.NO_ANSWER, np.nan, np.nan, 0.0, "highs"), None

    monkeypatch.setattr(Master, "cheaper", no_search)
    open_ = solver.solve(data)
    assert "cost_level[highs]:no_answer" in open_.stages
    assert open_.terms.f1 == pytest.approx(found.terms.f1)
    assert found.cost_gap_gbp < open_.cost_gap_gbp < open_.terms.f2
