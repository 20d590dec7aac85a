"""What the value of energy that is left adds to a window's problem.

The value is the least of a fixed number of lines in the stored energy, so a variable below all of
them and a reward for it state it exactly. In an outage the reward is service; with grid it comes
off the cost. Without a value no problem has any of this.
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp

from vppres.contract.stored_value import PIECES, StoredValue
from vppres.model.constraints import Named
from vppres.model.numerics import write


@dataclass(frozen=True, eq=False)
class ValueAtEnd:
    """Variables and parameters of the value of what is stored at the end of a window.

    Parameters
    ----------
    stored : cvxpy.Variable
        Energy of all batteries in kWh; a variable, since limits with parameters stand beside it.
    kept : cvxpy.Variable
        What it is worth, in weighted customer hours.
    slope, offset : cvxpy.Parameter, shape (K,)
        The lines.
    gbp : cvxpy.Parameter
        What it takes off the cost for each weighted customer hour.
    share : cvxpy.Parameter
        1 where it counts as service, otherwise 0.
    """

    stored: cp.Variable
    kept: cp.Variable
    slope: cp.Parameter
    offset: cp.Parameter
    gbp: cp.Parameter
    share: cp.Parameter

    @classmethod
    def create(cls) -> ValueAtEnd:
        """A value of any window."""
        return cls(
            cp.Variable(name="E_stored"),
            cp.Variable(name="kept"),
            cp.Parameter(PIECES, name="kept_slope"),
            cp.Parameter(PIECES, name="kept_offset"),
            cp.Parameter(name="kept_gbp", nonneg=True),
            cp.Parameter(name="kept_share", nonneg=True),
        )

    @property
    def f2_missing(self) -> cp.Expression:
        """What comes off the cost, in GBP and negative."""
        return -self.gbp * self.kept

    @property
    def f7_later(self) -> cp.Expression:
        """Later service, in weighted customer hours."""
        return self.share * self.kept

    def reached(self, energy_kwh: cp.Expression) -> Named:
        """The energy at the end of the window, (G,), and what it is worth."""
        return {
            "stored_at_end": self.stored == cp.sum(energy_kwh),
            "value_at_end": self.kept <= self.slope * self.stored + self.offset,
        }

    def fill(self, value: StoredValue) -> None:
        """Write the lines and what they count as."""
        write(self.slope, value.slope)
        write(self.offset, value.offset)
        write(self.gbp, value.gbp_as_cost)
        write(self.share, float(value.as_service))
