"""What a connection that also exports adds to a window's problem.

Exported power is a demand at the slack bus that earns its price. Import and export have a variable
each, and one binary for each step says which of the two there is: a meter cannot turn both ways at
once, and the plan would do so wherever export earns more than import costs, or to charge a battery
from another past (4). Without export no problem has any of this.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats
from vppres.model.constraints import AddedDemand, Named, at_slack_bus
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Mode

NOISE_KW = 1e-7
"""What a solver leaves where there is no export."""

CIRCLE_KW = 1e-4
"""By how much charging may exceed import and PV export after import and export were netted."""

EXPLOITED_GBP = 1e-5
"""What exchange in both directions may have earned before it counts as exploited."""


@dataclass(frozen=True, eq=False)
class ExportToGrid:
    """Variables and parameters of the export over W steps.

    Parameters
    ----------
    P_out : cvxpy.Variable, shape (W,)
        Exported power.
    importing : cvxpy.Variable, shape (W,), optional
        1 where the connection may import, 0 where it may export; between them in a relaxation. None
        where the direction is held: then one of the two limits is 0.
    P_out_max : cvxpy.Parameter, shape (W,)
        Largest export.
    sigma_dt : cvxpy.Parameter, shape (W,)
        What a kW of export earns in a step, in GBP.
    """

    P_out: cp.Variable
    importing: cp.Variable | None
    P_out_max: cp.Parameter
    sigma_dt: cp.Parameter

    @classmethod
    def create(cls, W: int, direction: Mode) -> ExportToGrid:
        """Export of a window of W steps."""
        importing = None
        if direction == "integer":
            importing = cp.Variable(W, name="importing", boolean=True)
        if direction == "relaxed":
            importing = cp.Variable(W, name="importing", bounds=[0, 1])
        return cls(
            P_out=cp.Variable(W, name="P_out", nonneg=True),
            importing=importing,
            P_out_max=cp.Parameter(W, name="P_out_max", nonneg=True),
            sigma_dt=cp.Parameter(W, name="sigma_dt"),
        )

    @property
    def f2_revenue(self) -> cp.Expression:
        """What the export earns, in GBP."""
        return self.sigma_dt @ self.P_out

    def at_slack_bus(self, site: Site) -> AddedDemand:
        """The export as a demand; reactive exchange is free in both directions as it is."""
        none = np.zeros((self.P_out.size, site.network.n_buses))
        return AddedDemand(at_slack_bus(site, self.P_out), cp.Constant(none))

    def connection(self, P_grid: cp.Expression, P_grid_max: cp.Parameter) -> Named:
        """Limits of import and export, in place of the limit of import alone."""
        most_in: cp.Expression = P_grid_max
        most_out: cp.Expression = self.P_out_max
        if self.importing is not None:
            most_in = cp.multiply(P_grid_max, self.importing)
            most_out = cp.multiply(self.P_out_max, 1 - self.importing)
        return {"grid_active_limit": P_grid <= most_in, "grid_export_limit": self.P_out <= most_out}

    def fill(self, site: Site, data: WindowData, exporting: Flags | None = None) -> None:
        """Write a window's data, with the steps in which export is held to be the direction."""
        assert data.export is not None
        most = data.export_max_kw(site)
        write(self.P_out_max, most if exporting is None else np.where(exporting, most, 0.0))
        write(self.sigma_dt, data.export.price_gbp_per_kwh * site.dt_h)

    def most_earned_gbp(self) -> Floats:
        """What the largest export of each step earns, negative where it costs, (W,)."""
        return np.asarray(self.sigma_dt.value * self.P_out_max.value)

    def netted(self, found: Dispatch) -> Dispatch:
        """A solution whose import is known, with the grid's power in both directions."""
        return replace(found, p_grid_kw=found.p_grid_kw - self.exported_kw())

    def exported_kw(self) -> Floats:
        """Export of the last solve."""
        value = np.asarray(self.P_out.value, dtype=float)
        return np.where(value < NOISE_KW, 0.0, value)


def net_exchange(data: WindowData, dispatch: Dispatch, both_kw: Floats, dt_h: float) -> bool:
    """Whether a dispatch stands once import and export of the same step are netted.

    Parameters
    ----------
    data : WindowData
        The window.
    dispatch : Dispatch
        Netted.
    both_kw : array, shape (W,)
        What was imported and exported at the same time.
    dt_h : float
        Length of a step in h.
    """
    if data.export is None:
        return True
    margin = np.maximum(data.export.price_gbp_per_kwh - data.price_gbp_per_kwh, 0.0)
    fed = np.maximum(dispatch.p_grid_kw, 0.0) + dispatch.pv_export_kw.sum(axis=1)
    circle = dispatch.charge_kw.sum(axis=1) - fed
    exploited = float(margin @ both_kw) * dt_h
    return exploited <= EXPLOITED_GBP and bool((circle <= CIRCLE_KW).all())


def exporting_steps(dispatch: Dispatch) -> Flags:
    """Steps in which a dispatch exports."""
    return np.asarray(dispatch.p_grid_kw < 0.0)
