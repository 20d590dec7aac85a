"""Chains of lines that act as one in the tie-breakers of phased windows."""

from __future__ import annotations

import numpy as np

from experiments.studies.phased_feeders import decided, random_phased
from vppres.model.terms import evaluate
from vppres.model.violations import with_flows
from vppres.solve.cache import ModelCache
from vppres.solve.forms import sheet_of
from vppres.solve.solvers import run_conic
from vppres.solve.tie_breakers import TieBreakers


def test_chains_say_of_losses_what_all_lines_say() -> None:
    site, data, found = decided(random_phased(15))
    data, dispatch = data.for_service(found.dispatch.served), found.dispatch
    least, columns = [], []
    for in_chains in (True, False):
        problem = TieBreakers(site, sheet_of(ModelCache(site), data), curtailing=True, moves=False)
        problem.in_chains = in_chains
        terms = evaluate(site, data, dispatch)
        problem.hold(data, dispatch, terms.f2 + 1e-3, terms.f3 + 1e-3)
        assert run_conic(problem, 60.0).status.has_answer
        better = with_flows(site, data, problem.dispatch(dispatch.served))
        least.append(evaluate(site, data, better).f4)
        columns.append(len(problem.x))
    assert least[0] > 0.0
    np.testing.assert_allclose(least[0], least[1], rtol=1e-6)
    assert columns[0] < columns[1]
