"""Random windows over all forms: the ladder beside the whole problem."""

from __future__ import annotations

import pytest

from tests.support.agreement import assert_methods_agree
from tests.support.random_forms import window_of


@pytest.mark.parametrize("seed", range(120))
def test_methods_agree_on_windows_of_all_forms(seed: int) -> None:
    _, site, data = window_of(seed)
    assert_methods_agree(site, data, always=False)
