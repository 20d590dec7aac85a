"""Ratings of lines in windows that no master in the network decides, beside the whole problem."""

from __future__ import annotations

import pytest

from tests.support.rated_windows import rated, verdict


@pytest.mark.monolith
@pytest.mark.parametrize(("kind", "seed"), [("sets", 2), ("belief", 1)])
def test_ratings_and_bounds_hold_beside_the_whole_problem(kind: str, seed: int) -> None:
    """Both windows exceed a rating where none is kept."""
    case = rated(kind, seed)
    assert case is not None
    assert verdict(*case) == []
