"""Every golden run amounts to what it did when the set was made.

After a change that is meant, ``python -m tests.support.golden FOLDER --keep`` writes it anew.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from tests.support.golden import FIGURES, RUNS, figures

KEPT = pd.read_csv(FIGURES, index_col="run")
SHARE = 1e-3
"""By which runs of two machines differ: of plans that are equal to the gap either may be found."""


@pytest.mark.nightly
@pytest.mark.parametrize("name", RUNS)
def test_a_golden_run_is_as_it_was(name: str, tmp_path: Path) -> None:
    RUNS[name](tmp_path / name)
    assert figures(tmp_path / name) == pytest.approx(KEPT.loc[name].dropna().to_dict(), rel=SHARE)
