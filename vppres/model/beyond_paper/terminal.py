"""Target for the batteries' state of charge at the end, in a window's problem.

The energy that is missing has a variable and a price, and is part of the cost: so it decides
among dispatches of equal service, and no service is given up for it. Without it no problem has any
of this.
"""

from __future__ import annotations

from collections.abc import Hashable

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.terminal import Terminal
from vppres.core.arrays import Floats
from vppres.model.beyond_paper.addition import Addition
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


class HeldAtEnd(Addition):
    """Energy in kWh that batteries are to hold at the end, what is missing, and its price."""

    of_batteries = ("E_missing",)

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        B = len(site.batteries)
        self.missing = cp.Variable(B, name="E_missing", nonneg=True)
        self.target_kwh = cp.Parameter(B, name="E_target", nonneg=True)
        self.price = cp.Parameter(name="price_missing", nonneg=True)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether there is a target."""
        return data.ending == "target" or None

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """The energy at the end of the window, and what is missing to the target."""
        energy_kwh = cp.multiply(site.batteries.energy_kwh, v.SoC[-1])
        return {"held_at_end": energy_kwh + self.missing >= self.target_kwh}

    def terms(self) -> dict[str, cp.Expression]:
        """Cost of the missing energy, in GBP."""
        return {"f2": self.price * cp.sum(self.missing)}

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Cost of the missing energy."""
        assert data.terminal is not None
        return {"f2": data.terminal.cost_gbp(site.batteries, dispatch.soc[-1])}

    @classmethod
    def cost_range(
        cls, site: Site, data: WindowData, least_gbp: Floats, dearest_gbp: Floats
    ) -> tuple[Floats, Floats]:
        """Ranges of the parts of the cost, with that of missing energy from none to all."""
        assert data.terminal is not None
        nothing = np.zeros(len(site.batteries))
        most_gbp = data.terminal.cost_gbp(site.batteries, nothing)
        return least_gbp, np.append(dearest_gbp, most_gbp)

    def fill(self, site: Site, data: WindowData) -> None:
        """Write what is to be held and the price of what is missing; nothing without a target."""
        terminal = data.terminal or Terminal(0.0, 0.0)
        target_kwh = terminal.target_kwh(site.batteries)
        write(self.target_kwh, target_kwh if data.terminal else 0.0 * target_kwh)
        write(self.price, terminal.price_gbp_per_kwh)
