"""Numerics that solvers need: scales, polygons instead of the inverters' discs, one compilation.

Polygons are for solvers without mixed-integer cones. They are combinations of the rows of (3)
``eq:batt_inverter`` and (7) ``eq:pv_inverter``.
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp
import numpy as np
from numpy.typing import ArrayLike

from vppres.core.arrays import Floats
from vppres.core.errors import ModelError
from vppres.model.site import Site

POLYGON_SIDES = 16
"""Sides of an inverter's polygon: an inscribed one keeps 98 % of the radius in any direction."""

LARGEST_WITH_CONES = 400
"""Buses times steps up to which discs are cones where there are no binaries."""

ROUNDING = 1e-9
"""Rounding error of a sum of powers, energies or weights."""

SAME = 1e-12
"""Share by which numbers may differ and still be the same: rounding of products."""

NOISE_KW = 1e-6
"""Power of a kind of asset that a solver leaves where there is none."""

LEFT_KW = 1e-7
"""Power that a solver leaves of the paper's devices and of export, solved to more digits."""

ANY_KW = 1e6
"""Power, in kW or kvar, that nothing has: a limit where there is none."""

BELOW_ZERO = 1e-8
"""Rounding below zero of a value that may not be negative, as cvxpy has it."""


def disc_sides(site: Site, n_steps: int) -> int:
    """Sides of the discs in problems without binaries: 0 for cones, polygons for large windows.

    Inscribed polygons cost 0.01 % of f4. Answers of long windows are theirs. With phases they cost
    whole sets: what the former's phases leave may need all that inverters can give.
    """
    small = site.network.n_buses * n_steps <= LARGEST_WITH_CONES
    return 0 if small or site.phases else POLYGON_SIDES


def cost_scale(site: Site) -> float:
    """Factor that turns the weighted cost terms into GBP, 1 where cost has no weight."""
    weight = site.weights.lambda_grid
    return 1.0 / weight if weight > 0 else 1.0


def objective_scale(site: Site) -> float:
    """Factor of the weighted objective in the masters.

    The cost of a kW weighs about 1e-7 beside a customer's 1, which is where solvers stop to tell a
    reduced cost from zero: a bound would be off by the whole cost. The factor lifts it well above.
    """
    weight = site.weights.lambda_grid
    return float(np.clip(0.1 / weight, 1.0, 1e5)) if weight > 0 else 1.0


def write(parameter: cp.Parameter, values: ArrayLike) -> None:
    """Give a parameter its values; cvxpy's own way takes ten times as long for the same checks.

    Raises
    ------
    ModelError
        If they have another shape, or are below zero where the parameter is not.
    """
    array = np.asarray(values, dtype=float)
    if array.shape != parameter.shape:
        raise ModelError(f"{parameter.name()} has the shape {parameter.shape}, not {array.shape}.")
    if parameter.attributes["nonneg"] and array.min(initial=0.0) < -BELOW_ZERO:
        raise ModelError(f"{parameter.name()} is never negative, but {array.min():g} was given.")
    parameter.save_value(array)


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
