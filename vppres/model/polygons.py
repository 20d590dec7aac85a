"""Polygons in place of the inverters' discs, for solvers without mixed-integer cones.

They stand under the names of (3) ``eq:batt_inverter`` and (7) ``eq:pv_inverter``.
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Floats
from vppres.model.constraints import Named
from vppres.model.site import Site
from vppres.model.variables import Variables


@dataclass(frozen=True, eq=False)
class Polygon:
    """Half planes ``cos(a) P + sin(a) Q <= reach S``, one for each angle.

    Parameters
    ----------
    angles : array
        Directions of the half planes in rad.
    reach : float
        Their distance from the origin as a share of the rating.

    Examples
    --------
    >>> round(Polygon.inscribed(16).reach, 4)
    0.9808
    """

    angles: Floats
    reach: float

    @classmethod
    def inscribed(cls, sides: int) -> Polygon:
        """Inside the disc, with a vertex on the P axis, for dispatches.

        It loses at most ``1 - cos(pi / K)`` of the rating: 1.9 % at 16 sides, 0.5 % at 32.
        """
        angles = np.pi / sides + 2 * np.pi * np.arange(sides) / sides
        return cls(angles, float(np.cos(np.pi / sides)))

    @classmethod
    def around(cls, sides: int) -> Polygon:
        """Tangents of the disc, two of them across the P axis, so exact in P alone; for bounds."""
        return cls(2 * np.pi * np.arange(sides) / sides, 1.0)

    @property
    def right_half(self) -> Polygon:
        """The half planes that limit positive P."""
        return Polygon(self.angles[np.cos(self.angles) > 1e-9], self.reach)

    def contains(
        self,
        P: cp.Expression,
        Q: cp.Expression,
        s_max_kva: Floats,
        S_max: cp.Expression | None = None,
    ) -> cp.Constraint:
        """One block of rows for each angle; ``S_max`` is a rating that changes with the steps."""
        distance = np.broadcast_to(s_max_kva * self.reach, P.shape)
        rows: Floats | cp.Expression = np.vstack([distance] * len(self.angles))
        if S_max is not None:
            share = rows / np.tile(s_max_kva, (len(rows), 1))
            rows = cp.multiply(share, cp.vstack([S_max] * len(self.angles)))
        # One product for all angles: cvxpy compiles it in a fifth of the time of one for each.
        steps = sp.eye_array(P.shape[0])
        by_P, by_Q = (sp.kron(share(self.angles)[:, None], steps) for share in (np.cos, np.sin))
        return by_P @ P + by_Q @ Q <= rows


def battery_polygon(
    site: Site, v: Variables, polygon: Polygon, S_max: cp.Expression | None = None
) -> Named:
    """Battery inverters as polygons."""
    rating = site.batteries.s_max_kva
    return {"battery_inverter_capacity": polygon.contains(v.P_batt, v.Q_batt, rating, S_max)}


def battery_half_polygon(
    site: Site, v: Variables, polygon: Polygon, S_max: cp.Expression | None = None
) -> Named:
    """Polygons of batteries whose modes exclude each other, in ``|P|`` and Q.

    ``|P|`` is then charging plus discharging, so half of the sides say what all of them do.
    """
    rating = site.batteries.s_max_kva
    return {
        "battery_inverter_capacity": polygon.right_half.contains(
            v.P_ch + v.P_dch, v.Q_batt, rating, S_max
        )
    }


def pv_polygon(site: Site, v: Variables, polygon: Polygon) -> Named:
    """PV inverters as polygons."""
    through = v.P_self + v.P_exp
    return {"pv_inverter_capacity": polygon.contains(through, v.Q_pv, site.pv.s_max_kva)}
