"""Polygons instead of the inverters' discs, for solvers without mixed-integer cones.

They are combinations of the rows of (3) ``eq:batt_inverter`` and (7) ``eq:pv_inverter``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats


@dataclass(frozen=True, eq=False)
class Polygon:
    """Half planes ``cos(a) P + sin(a) Q <= reach S``, one for each angle.

    Examples
    --------
    >>> round(Polygon.inscribed(16).reach, 4)
    0.9808
    """

    angles: Floats  #: directions of the half planes in rad
    reach: float  #: their distance from the origin as a share of the rating

    @classmethod
    def inscribed(cls, sides: int) -> Polygon:
        """Inside the disc, with a vertex on the P axis, for dispatches.

        It loses at most ``1 - cos(pi / K)`` of the rating: 1.9% at 16 sides, 0.5% at 32.
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
