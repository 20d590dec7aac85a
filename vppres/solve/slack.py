"""By how much voltage limits have to give."""

from __future__ import annotations

from vppres.model.data import WindowData
from vppres.model.elastic import ElasticModel
from vppres.model.site import Site
from vppres.solve.solvers import run_conic

ELASTIC_TIME_S = 20.0
"""Enough for a relaxation without binaries; a step that needs it has lost time already."""


def least_slack(site: Site, data: WindowData, time_s: float = ELASTIC_TIME_S) -> float:
    """Least slack of the squared voltage limits (pu²) that leaves a feasible relaxation.

    Parameters
    ----------
    site : Site
        Fixed data.
    data : WindowData
        The window.
    time_s : float, optional
        Time limit in s.

    Raises
    ------
    SolveError
        If not even free voltages leave one.
    """
    model = ElasticModel(site, data.n_steps, exporting=data.exporting)
    model.fill(data)
    outcome = run_conic(model.problem, min(time_s, ELASTIC_TIME_S))
    outcome.require_answer(f"The window of {data.n_steps} steps without voltage limits")
    return max(outcome.value, 0.0)
