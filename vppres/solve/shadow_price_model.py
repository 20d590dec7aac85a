"""The pricing problem: the window as it was, with service continuous where it was withheld.

It is solved after the day, never in the loop, for its duals: they say what one more kWh, kW, kvar
or kVA would have bought. Service lies between the bounds that are given for each customer and step,
the modes of batteries that moved are those of the record in the first step, everything else is the
paper's problem with the true discs. Shorter windows are padded with steps in which nobody has a
load and nothing can be had, so that one problem is compiled for a day.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np

from vppres.contract.stored_value import Ending
from vppres.core.arrays import Floats
from vppres.model import objective as terms
from vppres.model.beyond_paper.ends import end_of_window, f2_at_end, f7_at_end
from vppres.model.beyond_paper.export import ExportToGrid
from vppres.model.beyond_paper.stored_value import ValueAtEnd
from vppres.model.constraints import Named, battery_modes
from vppres.model.data import WindowData
from vppres.model.forms import (
    SOLVER_ORDER,
    fill_end,
    in_order,
    stored_at_end,
    with_demand,
    with_polygons,
)
from vppres.model.linearise import Drawn
from vppres.model.numerics import disc_sides, require_dpp, write
from vppres.model.polygons import Polygon
from vppres.model.problem import paper_constraints
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


@dataclass(frozen=True, eq=False)
class Held:
    """What the pricing problem holds of the record, for a window of W steps.

    Parameters
    ----------
    service_min, service_max : array, shape (W, C)
        Bounds on the share of each customer that is served.
    mode_min, mode_max : array, shape (B,)
        Bounds on the mode of each battery in the first step: 1 charges, 0 discharges.
    """

    service_min: Floats
    service_max: Floats
    mode_min: Floats
    mode_max: Floats


@dataclass(frozen=True)
class PricedTerms:
    """What is maximised: weights of f1 (weighted customer hours), f2 (GBP) and f3 (kWh)."""

    service: float
    cost: float
    curtailment: float
    curtailed_max_kwh: float = np.inf


class ShadowPriceModel:
    """The pricing problem over at most W steps, compiled once.

    Parameters
    ----------
    site : Site
        Fixed data.
    n_steps : int
        Steps W of the longest window.
    exporting : bool
        Whether export is part of it, in a direction without binaries.
    ending : {"", "target", "value"}
        What it says of what batteries hold at the end.
    """

    def __init__(
        self, site: Site, n_steps: int, exporting: bool = False, ending: Ending = ""
    ) -> None:
        self.site = site
        self.n_steps = n_steps
        self.export = ExportToGrid.create(n_steps, "relaxed") if exporting else None
        self.terminal = end_of_window(ending, len(site.batteries))
        self.p = Parameters.create(site, n_steps)
        x = cp.Variable((n_steps, len(site.customers)), name="x_served")
        # Owners' self-consumption follows their service. A bound of its own would take up a part
        # of the dual that belongs to the service.
        P_self = cp.Variable((n_steps, len(site.pv)), name="P_self")
        v = Variables.create(site, n_steps, "fixed", "relaxed")
        self.v = replace(v, x_served=x, P_self=P_self)
        self.x_min, self.x_max = (
            cp.Parameter(x.shape, name=name, nonneg=True) for name in ("x_min", "x_max")
        )
        B = len(site.batteries)
        self.mode_min, self.mode_max = (
            cp.Parameter(B, name=name, nonneg=True) for name in ("mode_min", "mode_max")
        )
        self.weight_f1, self.weight_f3, self.f3_max = (
            cp.Parameter(name=name, nonneg=True) for name in ("weight_f1", "weight_f3", "f3_max")
        )
        self.sides = disc_sides(site, n_steps)
        self.constraints = self._constraints()
        self.problem = cp.Problem(self._objective(), list(self.constraints.values()))
        require_dpp(self.problem, f"pricing problem of {n_steps} steps")

    def _constraints(self) -> Named:
        """The paper's families, and what is held."""
        args = (self.site, self.v, self.p)
        v = self.v
        named = in_order(paper_constraints(*args), SOLVER_ORDER)
        # An inverter has a price of its own: two rows that bind together would share it.
        named |= battery_modes(*args, self.site.batteries.p_max_kw)
        if self.sides:
            named = with_polygons(named, self.site, v, Polygon.inscribed(self.sides))
        if self.export is not None:
            named = with_demand(named, *args, self.export.at_slack_bus(self.site))
            named |= self.export.connection(self.v.P_grid, self.p.P_grid_max)
        if self.terminal is not None:
            named |= self.terminal.reached(stored_at_end(self.site, v))
        return named | {
            "mode_min": v.delta[0] >= self.mode_min,
            "mode_max": v.delta[0] <= self.mode_max,
            "modes": v.delta >= 0,
            "modes_max": v.delta <= 1,
            "service_min": v.x_served >= self.x_min,
            "service_max": v.x_served <= self.x_max,
            "curtailment_held": terms.f3_curtailment(*args) <= self.f3_max,
        }

    def _objective(self) -> cp.Maximize:
        """Service less cost less curtailment as they are priced; f2's weight is in rho_dt."""
        args = (self.site, self.v, self.p)
        worth = (
            self.weight_f1 * terms.f1_service(*args)
            - terms.f2_cost(*args)
            - self.weight_f3 * terms.f3_curtailment(*args)
        )
        if self.export is not None:
            worth = worth + self.export.f2_revenue
        if self.terminal is not None:
            worth = worth - f2_at_end(self.terminal)
        if isinstance(self.terminal, ValueAtEnd):
            worth = worth + f7_at_end(self.terminal)
        return cp.Maximize(worth)

    def fill(self, data: WindowData, held: Held, priced: PricedTerms) -> None:
        """Write a window's data, padded to the compiled length."""
        missing = self.n_steps - data.n_steps
        cost = replace(data, price_gbp_per_kwh=priced.cost * data.price_gbp_per_kwh)
        padded = _padded(cost, missing)
        self.p.fill(self.site, padded)
        if self.terminal is not None:
            fill_end(self.terminal, self.site, data)
            if isinstance(self.terminal, ValueAtEnd):
                write(self.terminal.gbp, priced.cost * self.terminal.gbp.value)
                write(self.terminal.share, priced.service * self.terminal.share.value)
            else:
                write(self.terminal.price, priced.cost * self.terminal.price.value)
        if self.export is not None:
            self.export.fill(self.site, padded)
            write(self.export.sigma_dt, priced.cost * self.export.sigma_dt.value)
        write(self.x_min, _rows(held.service_min, missing))
        write(self.x_max, _rows(held.service_max, missing))
        write(self.mode_min, held.mode_min)
        write(self.mode_max, held.mode_max)
        write(self.weight_f1, priced.service)
        write(self.weight_f3, priced.curtailment)
        # All PV energy of the window is a limit that never binds.
        everything = float(data.pv_kw.sum()) * self.site.dt_h + 1.0
        write(self.f3_max, min(priced.curtailed_max_kwh, everything))


def _padded(data: WindowData, missing: int) -> WindowData:
    """The window followed by empty steps."""
    return replace(
        data,
        load_kw=_rows(data.load_kw, missing),
        pv_kw=_rows(data.pv_kw, missing),
        price_gbp_per_kwh=_rows(data.price_gbp_per_kwh, missing),
        grid_limit_kw=_rows(data.grid_limit_kw, missing),
        delta_pu2=_rows(data.delta_pu2, missing),
        export=data.export and data.export.followed_by_none(missing),
        drawn=data.drawn and Drawn(_rows(data.drawn.kw, missing), _rows(data.drawn.kvar, missing)),
        own_u_pu2=None if data.own_u_pu2 is None else _rows(data.own_u_pu2, missing),
    )


def _rows(values: Floats, missing: int) -> Floats:
    """The array with rows of zeros behind it."""
    return np.concatenate([values, np.zeros((missing, *values.shape[1:]))])
