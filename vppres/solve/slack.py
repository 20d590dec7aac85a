"""By how much voltage limits have to give."""

from __future__ import annotations

from dataclasses import replace

from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.numerics import POLYGON_SIDES
from vppres.model.site import Site
from vppres.solve.forms import Form, select_form
from vppres.solve.selection import Selected, Selection, Sheet
from vppres.solve.solvers import run_conic

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
