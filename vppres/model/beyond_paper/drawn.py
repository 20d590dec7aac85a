"""Power that the network itself draws: shunts, charging of lines, fixed demand at buses."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import ClassVar, Self

import cvxpy as cp

from vppres.model.beyond_paper.addition import Addition
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Variables


@dataclass(frozen=True, eq=False)
class DrawnByNetwork(Addition):
    """Demand of the network at its buses, (W, N) each; negative for what gives power."""

    draws: ClassVar[bool] = True

    P_drawn: cp.Parameter
    Q_drawn: cp.Parameter
    P_given: cp.Parameter | None = None  #: what it gives on balance, (W,); None if nothing

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether it draws anything, and whether it gives power in a step."""
        return None if data.drawn is None else bool(data.network_gives_kw.any())

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """Parameters of a window."""
        P_drawn, Q_drawn = (cp.Parameter(v.u.shape, name=name) for name in ("P_drawn", "Q_drawn"))
        W = v.u.shape[0]
        P_given = cp.Parameter(W, name="P_given", nonneg=True) if shape else None
        return cls(P_drawn, Q_drawn, P_given)

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """A demand at the buses, and power from which batteries may charge."""
        demand = {"P_added": self.P_drawn, "Q_added": self.Q_drawn}
        return demand if self.P_given is None else {**demand, "P_fed_added": self.P_given}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        assert data.drawn is not None
        write(self.P_drawn, data.drawn.kw)
        write(self.Q_drawn, data.drawn.kvar)
        if self.P_given is not None:
            write(self.P_given, data.network_gives_kw)
