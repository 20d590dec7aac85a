"""What a state of charge that batteries are to hold at the end adds to a window's problem.

The energy that is missing has a variable and a price, and is part of the cost: so it decides
among dispatches of equal service, and no service is given up for it. Without it no problem has any
of this.
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp

from vppres.core.arrays import Floats
from vppres.model.constraints import Named
from vppres.model.numerics import write


@dataclass(frozen=True, eq=False)
class HeldAtEnd:
    """Variable and parameters of what G batteries, or lumped fleets, are to hold at the end.

    Parameters
    ----------
    missing : cvxpy.Variable, shape (G,)
        Energy that is missing in kWh.
    target_kwh : cvxpy.Parameter, shape (G,)
        Energy that is to be held.
    price : cvxpy.Parameter
        Price of a missing kWh in GBP.
    """

    missing: cp.Variable
    target_kwh: cp.Parameter
    price: cp.Parameter

    @classmethod
    def create(cls, G: int) -> HeldAtEnd:
        """What so many batteries are to hold."""
        return cls(
            cp.Variable(G, name="E_missing", nonneg=True),
            cp.Parameter(G, name="E_target", nonneg=True),
            cp.Parameter(name="price_missing", nonneg=True),
        )

    @property
    def f2_missing(self) -> cp.Expression:
        """What the missing energy costs, in GBP."""
        return self.price * cp.sum(self.missing)

    def reached(self, energy_kwh: cp.Expression) -> Named:
        """The energy at the end of the window, (G,), and what is missing to the target."""
        return {"held_at_end": energy_kwh + self.missing >= self.target_kwh}

    def fill(self, target_kwh: Floats, price_gbp_per_kwh: float) -> None:
        """Write what is to be held, (G,), and the price of what is missing."""
        write(self.target_kwh, target_kwh)
        write(self.price, price_gbp_per_kwh)

    @property
    def worst_gbp(self) -> float:
        """Cost of holding nothing at all."""
        return float(self.price.value * self.target_kwh.value.sum())
