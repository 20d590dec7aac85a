"""The whole problem, without binaries and with them, and what its voltage limits have to give."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.numerics import POLYGON_SIDES, objective_scale
from vppres.model.site import Site
from vppres.solve.dispatch import FINER, keep_dispatch
from vppres.solve.forms import Form, select_form, window_problem
from vppres.solve.limits import run_within_limits
from vppres.solve.programs import SOLVED
from vppres.solve.result import Status
from vppres.solve.selection import Selected, Selection, Sheet
from vppres.solve.solvers import run, run_conic
from vppres.solve.task import WindowTask

IN_FULL = 1.0 - 1e-3
"""Share from which a customer counts as served in a solution by interior points, which end near a
limit and never at it."""

MOST_SIDES = 16_000
"""Sides of all polygons of a window up to which finer ones are tried."""


def without_binaries(task: WindowTask) -> None:
    """Bound of the whole problem without binaries, and those it serves in full.

    It is there for networks that forbid what the fleet could do: an answer comes before the search
    with binaries, which may need all the time there is. Where there is no answer yet it runs even
    when time is up.
    """
    known = task.certificate
    deadline = task.answer_by()
    if deadline.passed:
        return
    form = Form("service", "relaxed", "relaxed", task.sides or POLYGON_SIDES, outer=True)
    problem = window_problem(task.cache, task.data, form, conic=True)
    problem.fill(task.data)
    ask = partial(run_conic, problem, scale=objective_scale(task.site))
    outcome = run_within_limits(task.site, task.data, problem, deadline.left_s, solve=ask)
    known.note("relaxed", outcome)
    if outcome.status == Status.OPTIMAL:
        known.bound_by(outcome.value + SOLVED * (1.0 + abs(outcome.value)))
        keep_dispatch(task, problem.value_of("x_served") > IN_FULL, network=True)


def with_binaries(task: WindowTask) -> None:
    """The whole problem. Where discs are polygons, outer ones bound and inner ones answer.

    ``docs/decisions/bounds-of-discs.md`` says why there are two. Where the corners that outer ones
    have too much keep a window open, and it is small, outer ones of more sides come first.
    """
    form = Form("service", "integer", "integer", task.sides)
    if task.sides:
        inverters = task.data.n_steps * (len(task.site.batteries) + len(task.site.pv))
        most = MOST_SIDES // inverters if inverters else task.sides
        done = _search(task, "full_outer", replace(form, outer=True))
        while done and task.goes_on and FINER * form.polygon_sides <= most:
            form = replace(form, polygon_sides=FINER * form.polygon_sides)
            done = _search(task, "full_outer", replace(form, outer=True))
    if task.goes_on:
        _search(task, "full", form)


def _search(task: WindowTask, name: str, form: Form) -> bool:
    """Search the whole problem in a form until it is as close as its own objective asks for."""
    return task.search_to_its_gap(1.0, partial(_solve, task, name, form))


def _solve(task: WindowTask, name: str, form: Form, gap: float) -> bool:
    """One solve of the whole problem: keeps the dispatch of its schedule; whether it ended."""
    known = task.certificate
    problem = window_problem(task.cache, task.data, form)
    problem.fill(task.data)
    scale = objective_scale(task.site)
    search = partial(run, problem, task.spec, gap, scale=scale)
    left_s = task.deadline.left_s
    outcome = run_within_limits(task.site, task.data, problem, left_s, solve=search)
    if form.polygon_sides > 0 and not form.outer:
        # Inner polygons take capacity away: what they leave proves nothing.
        known.note(name, outcome)
    else:
        known.learn(name, outcome)
    if outcome.status.has_answer:
        charges = problem.value_of("delta") > 0.5
        keep_dispatch(task, problem.value_of("x_served") > 0.5, network=True, charges=charges)
    return outcome.status == Status.OPTIMAL


GIVING = ("voltage_min", "voltage_max")
"""Families whose limits give."""


def least_slack(site: Site, data: WindowData, time_s: float) -> float:
    """Least slack of the squared voltage limits (pu²) that leaves a feasible relaxation.

    Raises
    ------
    SolveError
        If not even free voltages leave one.
    """
    problem = Selected(Sheet(site, data.n_steps, beyond_paper(site, data)), _elastic, conic=True)
    problem.fill(data)
    outcome = run_conic(problem, time_s)
    outcome.require_answer(f"The window of {data.n_steps} steps without voltage limits")
    return max(outcome.value, 0.0)


def _elastic(sheet: Sheet) -> Selection:
    """The whole problem without binaries, whose voltage limits give by a column of their own."""
    slack = sheet.new_letter("slack", (1,))
    form = Form("service", "relaxed", "relaxed", POLYGON_SIDES, outer=True)
    found = select_form(sheet, form)
    parts = [
        part.with_column(int(slack[0]), -1.0, "slack") if part.name in GIVING else part
        for part in found.parts
    ]
    term = sheet.limit_of("slack", {"slack": 1.0})
    return replace(found, parts=tuple(parts), terms=((term, 1.0),), maximises=False)
