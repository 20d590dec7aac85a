"""Export of a connection in a window's problem.

Exported power is a demand at the slack bus that earns its price. Import and export have a variable
each, and one binary for each step says which of the two there is: a meter cannot turn both ways at
once, and the plan would do so wherever export earns more than import costs, or to charge a battery
from another past (4). Without export no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import ClassVar, Self

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


@dataclass(frozen=True, eq=False)
class ExportToGrid(Addition):
    """Variables and parameters of the export over W steps."""

    P_out: cp.Variable  #: exported power, (W,)
    #: 1 for a step in which the connection may import, 0 for one in which it may export, (W,).
    importing: cp.Variable
    P_out_max: cp.Parameter  #: largest export, (W,)
    sigma_dt: cp.Parameter  #: what a kW of export earns in a step, in GBP, (W,)

    replaces: ClassVar[tuple[str, ...]] = ("grid_active_limit",)
    directions: ClassVar[tuple[str, ...]] = ("importing",)
    by_dispatch: ClassVar[tuple[str, ...]] = ("importing",)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether the connection exports."""
        return bool(data.export) or None

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """Export of a window."""
        W = v.P_grid.size
        return cls(
            P_out=cp.Variable(W, name="P_out", nonneg=True),
            importing=cp.Variable(W, name="importing", boolean=True),
            P_out_max=cp.Parameter(W, name="P_out_max", nonneg=True),
            sigma_dt=cp.Parameter(W, name="sigma_dt"),
        )

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """The export as a demand; reactive exchange is free in both directions as it is."""
        return {"P_added": at_slack_bus(site, self.P_out)}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Limits of import and export, instead of the limit of import alone."""
        most_in = cp.multiply(p.P_grid_max, self.importing)
        most_out = cp.multiply(self.P_out_max, 1 - self.importing)
        return {
            "grid_active_limit": v.P_grid <= most_in,
            "grid_export_limit": self.P_out <= most_out,
        }

    def terms(self) -> dict[str, cp.Expression]:
        """Revenue of the export, which comes off the cost, in GBP."""
        return {"f2": -(self.sigma_dt @ self.P_out)}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        write(self.P_out_max, data.export_max_kw(site))
        write(self.sigma_dt, data.export.price_gbp_per_kwh * site.dt_h)

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Correction of the cost: exported energy earns its own price and not that of import."""
        exported_kw = np.maximum(-dispatch.p_grid_kw, 0.0)
        each_gbp = data.price_gbp_per_kwh - data.export.price_gbp_per_kwh
        return {"f2": float(each_gbp @ exported_kw) * site.dt_h}

    @classmethod
    def cost_range(
        cls, site: Site, data: WindowData, least_gbp: Floats, dearest_gbp: Floats
    ) -> tuple[Floats, Floats]:
        """A step imports or exports: the most of one or the other."""
        most_gbp = -data.export.price_gbp_per_kwh * data.export_max_kw(site) * site.dt_h
        return np.minimum(least_gbp, most_gbp), np.maximum(dearest_gbp, most_gbp)

    def of_dispatch(self, site: Site, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """The direction of each step."""
        return AdditionDispatch({"importing": np.where(dispatch.p_grid_kw < 0.0, 0.0, 1.0)})

    def both_ways_kw(self, P_grid_kw: Floats) -> Floats:
        """The lesser of import and export."""
        return np.minimum(P_grid_kw, self.exported_kw())

    def read(self, found: Dispatch) -> Dispatch:
        """The dispatch with the grid's power in both directions."""
        return replace(found, p_grid_kw=found.p_grid_kw - self.exported_kw())

    def exported_kw(self) -> Floats:
        """Export of the last solve."""
        value = np.asarray(self.P_out.value, dtype=float)
        return np.where(value < LEFT_KW, 0.0, value)
