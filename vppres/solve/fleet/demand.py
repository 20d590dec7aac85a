"""What the fleet, PV and import can carry, if served demand is all that is known of service."""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from vppres.contract.stored_value import Ending
from vppres.core.arrays import Flags, Floats
from vppres.model.beyond_paper.ends import f7_at_end
from vppres.model.beyond_paper.stored_value import ValueAtEnd
from vppres.model.beyond_paper.terminal import HeldAtEnd
from vppres.model.data import WindowData
from vppres.model.numerics import require_dpp, write
from vppres.model.site import Site
from vppres.solve.fleet.relaxation import AggregateModel

CONNECTION = ("lumped_grid_limit", "grid_active_limit", "grid_export_limit")
"""Limits of the import, or of import and export where there is one."""


class DemandModel:
    """Demand of each step, loss by curtailment and cost that the lumped relaxation allows.

    Parameters
    ----------
    relaxation : AggregateModel
        Gives the fleet's variables, parameters and limits.

    Attributes
    ----------
    problem : cvxpy.Problem
        Has no objective. Its variables ``load`` (kW, one for each step), ``lost`` (f3 as weighted,
        in units of the weights' grid) and ``spent`` (GBP) are what whoever solves it asks for.
        Later service that counts as service comes off the loss, which may then be negative.
    customer_units : array, shape (C,)
        Weights in units of the grid.
    kept : tuple of float
        Least and most that the energy at the end is worth, in weighted customer hours.
    whole : bool
        Whether service is a whole number of units where nothing is lost.
    """

    def __init__(self, relaxation: AggregateModel) -> None:
        self.relaxation = relaxation
        W = relaxation.n_steps
        site = relaxation.site
        v = relaxation.v
        self.load = cp.Variable(W, name="load", nonneg=True)
        valued = isinstance(relaxation.terminal, ValueAtEnd)
        self.lost = cp.Variable(1, name="lost", nonneg=not valued)
        self.spent = cp.Variable(1, name="spent")
        self.p = {
            name: cp.Parameter(W, name=name, nonneg=True)
            for name in ("load_all", "net_all", "export_all")
        }
        self.kept = (0.0, 0.0)
        self.whole = True
        unit = relaxation.grid or 1.0
        weights = site.customers.weight * site.dt_h
        self.customer_units = np.round(weights / unit).astype(np.int64)
        kept = {*CONNECTION, "lumped_curtailment_min", *relaxation.energy}
        shared = [c for name, c in relaxation.constraints.items() if name in kept]
        lost = site.weights.lambda_curt * site.dt_h / unit * cp.sum(v["P_curt"])
        if valued:
            lost = lost - f7_at_end(relaxation.terminal) / unit
        self.problem = cp.Problem(
            cp.Minimize(0.0),
            [
                *shared,
                *self._power().values(),
                self.lost >= lost,
                self.spent >= relaxation.cost(),
            ],
        )
        require_dpp(self.problem, f"demand of {W} steps")

    def _power(self) -> dict[str, cp.Constraint]:
        """Sums of the power balances and limits, where who is served is not known."""
        v = self.relaxation.v
        p = self.p
        P_ch = cp.sum(v["P_ch"], axis=1)
        P_dch = cp.sum(v["P_dch"], axis=1)
        P_pv = self.relaxation.p["P_pv"]
        loss = self.relaxation.network_kw
        if self.relaxation.export is not None:
            loss = loss + self.relaxation.export.P_out  # gone from the feeder, too
        return {
            "demand_balance": v["P_grid"] + P_pv - v["P_curt"] + P_dch == self.load + loss + P_ch,
            "demand_circular_charging": P_dch <= self.load + loss,
            "demand_net_of_pv": P_dch <= p["net_all"] + loss,
            "demand_curtailment_max": v["P_curt"] <= p["export_all"] + p["load_all"] - self.load,
            "demand_curtailment_of_pv": v["P_curt"] <= P_pv,
            "demand_of_all": self.load <= p["load_all"],
        }

    @property
    def able(self) -> Flags:
        """Who can be served at all, (W, C)."""
        return np.asarray(self.relaxation.p["x_max"].value) > 0.5

    def fill(self, data: WindowData) -> None:
        """Write the window's data."""
        self.relaxation.fill(data)
        self.kept = data.kept_range(self.relaxation.site)
        self.whole = not data.keeps_service
        p = self.relaxation.p
        # Several PV systems may together exceed their owner's demand.
        own = np.minimum(p["self"].value, data.load_kw)
        write(self.p["load_all"], (data.load_kw * self.able).sum(axis=1))
        write(self.p["net_all"], ((data.load_kw - own) * self.able).sum(axis=1))
        export_all = np.maximum(p["P_pv"].value - (own * self.able).sum(axis=1), 0.0)
        write(self.p["export_all"], export_all)

    def worst(self) -> tuple[float, float]:
        """Loss (units) and cost (GBP) that no dispatch exceeds."""
        site = self.relaxation.site
        p = self.relaxation.p
        lost = site.weights.lambda_curt * site.dt_h / (self.relaxation.grid or 1.0)
        prices: Floats = np.maximum(self.relaxation.rho_dt.value, 0.0)
        most_kw = p["P_grid_max"].value
        dearest_gbp = prices @ most_kw
        if self.relaxation.export is not None:
            earned = self.relaxation.export.most_earned_gbp()
            dearest_gbp = np.maximum(prices * most_kw, -earned).sum()
        if isinstance(self.relaxation.terminal, HeldAtEnd):
            dearest_gbp = dearest_gbp + self.relaxation.terminal.worst_gbp
        later, kept_gbp = self._worth(self.kept[0])
        return float(lost * p["P_pv"].value.sum() - later), float(dearest_gbp - kept_gbp)

    def least_lost(self) -> float:
        """Loss in units that no dispatch falls below: zero unless later service comes off it."""
        return -self._worth(self.kept[1])[0]

    def _worth(self, kept: float) -> tuple[float, float]:
        """Units of later service, and GBP, that an energy's worth counts as."""
        end = self.relaxation.terminal
        if not isinstance(end, ValueAtEnd):
            return 0.0, 0.0
        unit = self.relaxation.grid or 1.0
        return float(end.share.value) * kept / unit, float(end.gbp.value) * kept

    def least_cost_gbp(self) -> float:
        """Cost that no dispatch falls below: zero unless import or export earns money."""
        prices: Floats = np.minimum(self.relaxation.rho_dt.value, 0.0)
        most_kw = self.relaxation.p["P_grid_max"].value
        kept_gbp = self._worth(self.kept[1])[1]
        if self.relaxation.export is None:
            return float(prices @ most_kw) - kept_gbp
        earned = self.relaxation.export.most_earned_gbp()
        return float(np.minimum(prices * most_kw, -earned).sum()) - kept_gbp

    def fleet_kw(self) -> float:
        """Power of all batteries and the export, with what is stored and drawn: none exceeds it.

        Nor does the energy that is missing or held at the end, in kWh, or its worth.
        """
        p = self.relaxation.p
        b = self.relaxation.site.batteries
        factor = max(
            1.0,
            float(p["eta_hi"].value.max(initial=1.0)),
            float(p["inv_hi"].value.max(initial=1.0)),
        )
        exported_kw = 0.0
        if self.relaxation.export is not None:
            exported_kw = float(self.relaxation.export.P_out_max.value.max(initial=0.0))
        missing_kwh = 0.0
        if isinstance(self.relaxation.terminal, HeldAtEnd):
            missing_kwh = float(self.relaxation.terminal.target_kwh.value.sum())
        elif self.relaxation.terminal is not None:
            missing_kwh = float(b.energy_kwh.sum()) + max(map(abs, self.kept))
        return float(b.p_max_kw.sum() * factor) + exported_kw + missing_kwh


def demand_model(
    site: Site,
    n_steps: int,
    lumped: bool,
    physical: bool = False,
    exporting: bool = False,
    ending: Ending = "",
) -> DemandModel:
    """What the fleet can carry in windows of a length and mode.

    Parameters
    ----------
    site : Site
        Fixed data.
    n_steps : int
        Steps W of the window.
    lumped : bool
        Whether the fleet is one battery.
    physical : bool
        Whether losses and headroom are part of it.
    exporting : bool
        Whether export is part of it.
    ending : {"", "target", "value"}
        What it says of what batteries hold at the end.
    """
    relaxation = AggregateModel(
        site,
        n_steps,
        integer=False,
        lumped=lumped,
        physical=physical,
        exporting=exporting,
        ending=ending,
    )
    return DemandModel(relaxation)
