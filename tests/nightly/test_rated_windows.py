"""The same of 200 random windows with what is caught up, sets, a belief and ramps."""

from __future__ import annotations

import pytest

from tests.support.rated_windows import KINDS, rated, verdict


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(50))
def test_ratings_and_bounds_hold_beside_the_whole_problem(kind: str, seed: int) -> None:
    case = rated(kind, seed)
    assert case is None or verdict(*case) == []
