"""Power that the network itself draws: shunts, charging of lines, fixed demand at buses."""

from __future__ import annotations

from collections.abc import Hashable

import cvxpy as cp

from vppres.model.beyond_paper.addition import Addition
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Variables


class DrawnByNetwork(Addition):
    """Demand of the network at its buses, (W, N) each; negative for what gives power.

    ``P_given`` is what it gives on balance, (W,), if it does: batteries may charge from it.
    """

    draws = True

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        self.P_drawn = cp.Parameter(v.u.shape, name="P_drawn")
        self.Q_drawn = cp.Parameter(v.u.shape, name="Q_drawn")
        self.P_given = cp.Parameter(v.u.shape[0], name="P_given", nonneg=True)
        self.gives = bool(shape)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether it draws anything, and whether it gives power in a step."""
        return None if not data.drawn else bool(data.network_gives_kw.any())

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """A demand at the buses, and power from which batteries may charge."""
        demand = {"P_added": self.P_drawn, "Q_added": self.Q_drawn}
        return {**demand, "P_fed_added": self.P_given} if self.gives else demand

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        write(self.P_drawn, data.drawn.kw)
        write(self.Q_drawn, data.drawn.kvar)
        write(self.P_given, data.network_gives_kw)
