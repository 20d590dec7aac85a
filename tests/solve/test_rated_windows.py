"""Ratings of lines in windows that no master in the network decides, beside the whole problem."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.rated_windows import PATIENT, rated, verdict
from vppres.model.ratings import limit_kva, with_ratings
from vppres.solve.ladder import WindowSolver


@pytest.mark.monolith
@pytest.mark.parametrize(("kind", "seed"), [("sets", 2), ("belief", 1)])
def test_ratings_and_bounds_hold_beside_the_whole_problem(kind: str, seed: int) -> None:
    """Both windows exceed a rating where none is kept."""
    case = rated(kind, seed)
    assert case is not None
    assert verdict(*case) == []


@pytest.mark.daily
def test_no_flow_is_above_its_rating_for_the_sun_that_it_would_carry() -> None:
    """Beside curtailed PV power a flow at half of its check's tolerance is worth 2e-4 of F."""
    case = rated("sets", 39)
    assert case is not None
    site, data = case
    found = WindowSolver(site, limits=PATIENT).solve(data)
    flow_kva = np.hypot(found.dispatch.p_flow_kw, found.dispatch.q_flow_kvar)
    share = flow_kva / limit_kva(with_ratings(site, data))
    assert found.dispatch.pv_curtailed_kw.sum() > 1.0
    assert 1.0 - 1e-6 < share.max() <= 1.0 + 1e-6
