"""Currents of lines within their ratings, as rows.

Plans make such rows by hand where a solution exceeds a rating (``solve/limits.py``). Shadow prices
need those of all lines, for their duals, so they alone state this family.
"""

from __future__ import annotations

from collections.abc import Hashable

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Wholes
from vppres.model.beyond_paper.addition import Addition
from vppres.model.constraints import Named, disc
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

FAMILY = "line_rating"


class LineRatings(Addition):
    """Largest apparent power of each line that has a rating, shape (W, rated lines)."""

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        self.lines = rated_lines(site)
        size = (v.P_flow.shape[0], len(self.lines))
        self.S_line = cp.Parameter(size, name="S_line", nonneg=True)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether flows are limited."""
        return True if len(data.flow_max_kva) else None

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Cones of active and reactive flow."""
        return {FAMILY: disc(v.P_flow[:, self.lines], v.Q_flow[:, self.lines], self.S_line)}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        write(self.S_line, data.flow_max_kva[:, self.lines])


def rated_lines(site: Site) -> Wholes:
    """Lines that have a rating."""
    return np.flatnonzero(np.isfinite(site.network.i_max_a))
