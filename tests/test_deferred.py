"""A deferred module is loaded by a call, and is the real one for everybody else."""

from __future__ import annotations

import subprocess
import sys

import cvxpy as cp
import numpy as np
import pytest

from vppres.core.deferred import deferred


def test_a_call_loads_the_module(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    with deferred("colorsys", "rgb_to_hsv"):
        from colorsys import rgb_to_hsv
    assert "colorsys" not in sys.modules
    assert rgb_to_hsv(1.0, 1.0, 1.0) == (0.0, 0.0, 1.0)
    assert "colorsys" in sys.modules


def test_what_is_loaded_stays() -> None:
    import math

    with deferred("math", "sqrt"):
        import math as again
    assert again is math


def test_solving_does_without_statistics_and_cvxpy_still_has_them() -> None:
    code = (
        "import sys, vppres.solve.solvers\n"
        "assert 'cvxpy' in sys.modules and 'scipy.stats' not in sys.modules\n"
        "import scipy.stats\n"
        "print(scipy.stats.norm.cdf(0.0))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "0.5\n"
    # The one use that cvxpy has of them.
    divergence = cp.quantum_rel_entr(np.diag([0.3, 0.7]), np.diag([0.5, 0.5])).value
    assert divergence == pytest.approx(0.3 * np.log(0.6) + 0.7 * np.log(1.4))
