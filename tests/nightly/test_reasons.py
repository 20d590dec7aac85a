"""Reasons of customers off supply, drawn on random days: each window is solved again."""

from __future__ import annotations

import pytest

from tests.support.reasons import checked

MOST = 4


@pytest.mark.parametrize("seed", range(40))
def test_drawn_reasons_hold(seed: int) -> None:
    assert "".join(checked(seed, MOST)) == ""
