"""Power that the network itself draws: shunts, charging of lines, fixed demand at buses.

Of fixed generation neither demand, batteries nor the connection may take all. Nothing holds it
back: it flows to the grid beyond the limit of export, whatever is planned. A plan has it as a
demand at the slack bus that weighs more than curtailment, so that PV power is curtailed and
batteries charge first, and no customer is off for it. Other windows have no such demand.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.beyond_paper.addition import Addition, AdditionDispatch
from vppres.model.constraints import Named, at_slack_bus
from vppres.model.data import WindowData
from vppres.model.numerics import LEFT_KW, write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


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


WEIGHT = 2.0
"""Weight of a kWh beyond the limit, in kWh of curtailment."""


class BeyondLimit(Addition):
    """Power that flows to the grid beyond its limit, and the most that nothing holds back, (W,)."""

    by_dispatch = ("P_beyond",)

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        self.P_beyond = cp.Variable(v.P_grid.size, name="P_beyond", nonneg=True)
        self.P_beyond_max = cp.Parameter(v.P_grid.size, name="P_beyond_max", nonneg=True)
        self.dt_h = site.dt_h

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether there is any."""
        return bool(data.beyond_limit_kw.any()) or None

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """A demand at the slack bus."""
        return {"P_added": at_slack_bus(site, self.P_beyond)}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Nothing that can be held back is beyond the limit."""
        return {"beyond_limit": self.P_beyond <= self.P_beyond_max}

    def terms(self) -> dict[str, cp.Expression]:
        """It counts with curtailment."""
        return {"f3": WEIGHT * self.dt_h * cp.sum(self.P_beyond)}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        write(self.P_beyond_max, data.beyond_limit_kw)

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Its weight; it earns nothing."""
        beyond_kw = beyond_limit_kw(site, data, dispatch)
        paid = data.price_gbp_per_kwh if not data.export else data.export.price_gbp_per_kwh
        return {
            "f2": float(paid @ beyond_kw) * site.dt_h,
            "f3": WEIGHT * float(beyond_kw.sum()) * site.dt_h,
        }

    def of_dispatch(self, site: Site, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """Power beyond the limit, known with the active power."""
        return AdditionDispatch({"P_beyond": beyond_limit_kw(site, data, dispatch)})

    def read(self, found: Dispatch) -> Dispatch:
        """The dispatch with all that the grid takes."""
        value = np.asarray(self.P_beyond.value, dtype=float)
        return replace(found, p_grid_kw=found.p_grid_kw - np.where(value < LEFT_KW, 0.0, value))


def beyond_limit_kw(site: Site, data: WindowData, dispatch: Dispatch) -> Floats:
    """Power of a dispatch beyond the limit of export, (W,)."""
    beyond_kw = -dispatch.p_grid_kw - data.export_max_kw(site)
    return np.asarray(np.clip(beyond_kw, 0.0, data.beyond_limit_kw))
