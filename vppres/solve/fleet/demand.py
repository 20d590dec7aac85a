"""What the fleet, PV and import can carry, if served demand is all that is known of service."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.certificate import CostRange
from vppres.solve.fleet.relaxation import Fleet, rank
from vppres.solve.linear import Linear
from vppres.solve.selection import MOST, Family, Selected, Selection, Sheet

WITH_SERVICE = ("total_active_power_balance", "circular_charging")
"""Families of the fleet that service enters by the demand that it brings about; others with it tell
customers apart, and are left out."""


class DemandModel(Selected):
    """Demand of each step, loss by curtailment and cost that the fleet allows.

    Customers are one demand ``load`` (kW, one for each step), and their self-consumption is what
    it is for some of them: no more than that of all, and no less than that of all less the demand
    that is not served. Its letters ``lost`` (f3 as weighted, in units of the weights' grid) and
    ``spent`` (GBP) are what is asked for. Later service that counts as service comes off the loss.

    Parameters
    ----------
    site : Site
        Fixed data.
    fleet : Fleet
        Its rows.

    Attributes
    ----------
    customer_units : array, shape (C,)
        Weights in units of the grid.
    whole_units : bool
        Whether service is a whole number of units where nothing is lost.
    """

    def __init__(self, site: Site, fleet: Fleet) -> None:
        super().__init__(fleet.sheet, partial(_select, fleet=fleet), without=fleet.left_out)
        self.site = site
        self.fleet = fleet
        self.grid = fleet.grid
        self.n_steps = fleet.sheet.n_steps
        self.extras = fleet.extras
        self.unit = fleet.grid or 1.0
        self.customer_units = np.round(site.customers.weight * site.dt_h / self.unit).astype(
            np.int64
        )

    def write(self, data: WindowData) -> None:
        """Write the window's data."""
        site = self.site
        limits, self.values = self.fleet.written(data, self.sheet.statement.write(data))
        self.able: Flags = self.fleet.able(data) > 0.5
        owned_kw = data.self_limit_kw(site) @ site.pv_customer.T
        self.load_kw = (data.load_kw * self.able).sum(axis=1)
        # Several PV systems may together exceed their owner's demand.
        own_kw = (np.minimum(owned_kw, data.load_kw) * self.able).sum(axis=1)
        self.limits = {
            **limits,
            "demand_of_all": self.load_kw,
            "own_of_all": (owned_kw * self.able).sum(axis=1),
            "own_of_some": self.load_kw - own_kw,
        }
        self.whole_units = not data.keeps_service
        cost = CostRange.of(site, data)
        self.cost_gbp = cost.least_gbp, cost.dearest_gbp
        least, most = data.kept_range(site) if data.keeps_service else (0.0, 0.0)
        lost = site.weights.lambda_curt * site.dt_h * float(data.pv_kw.sum())
        self.lost = -most / self.unit, (lost - least) / self.unit
        self.fleet_kw = _largest(site, data)

    def worst(self) -> tuple[float, float]:
        """Loss (units) and cost (GBP) that no dispatch exceeds."""
        return self.lost[1], self.cost_gbp[1]

    def least(self) -> tuple[float, float]:
        """The same that no dispatch falls below."""
        return self.lost[0], self.cost_gbp[0]


def _largest(site: Site, data: WindowData) -> float:
    """What no column but the demand exceeds: powers of fleet and cells, and energies."""
    b = site.batteries
    factor = max(1.0, float((1.0 / data.eta_discharge).max(initial=1.0)))
    exported_kw = float(data.export_max_kw(site).max(initial=0.0))
    at_end = float(b.energy_kwh.sum()) + max(map(abs, data.kept_range(site)))
    sun_kw = float(data.pv_kw.sum(axis=1).max(initial=0.0))
    return (
        float(b.p_max_kw.sum() * factor) + exported_kw + sun_kw + (at_end if data.ending else 0.0)
    )


def _select(sheet: Sheet, fleet: Fleet) -> Selection:
    """The fleet's rows with one demand for all customers."""
    site = fleet.site
    sheet.new_letter("load", (sheet.n_steps,))
    lost = sheet.new_letter("lost", (1,), -np.inf if "f7" in sheet.statement.terms else 0.0)
    spent = sheet.new_letter("spent", (1,), -np.inf)
    named = {
        name: family
        for name, family in fleet.joined.items()
        if name in WITH_SERVICE or "x_served" not in family.letters
    }
    for name in WITH_SERVICE:
        if name in named:
            named[name] = _with_load(sheet, named[name])
    parts = fleet.put_in(named, ("pv_balance",), ("P_exp",))
    parts.append(sheet.limit_of("demand_of_all", {"load": 1.0}))
    if len(site.pv):
        parts.append(sheet.limit_of("own_of_all", {"all P_self": 1.0}))
        parts.append(sheet.limit_of("own_of_some", {"load": 1.0, "all P_self": -1.0}))
    parts += fleet.limits()
    parts.sort(key=rank)
    unit = fleet.grid or 1.0
    loss = fleet.sum_of_terms(
        "lost", MOST, ("f3", site.weights.lambda_curt / unit), ("f7", -1.0 / unit)
    )
    parts.append(loss.with_column(int(lost[0]), -1.0, "lost"))
    cost = fleet.sum_of_terms("spent", MOST, ("f2", 1.0))
    parts.append(cost.with_column(int(spent[0]), -1.0, "spent"))
    found = Selection(sheet, tuple(parts), order=("load", "lost", "spent"))
    return found.relaxed_to_shares(sheet.statement.named("directions"))


def _with_load(sheet: Sheet, family: Family) -> Family:
    """A family with the demand of all customers in the place of theirs, one row for each step."""
    rows = family.rows.wider(sheet.size)
    others = ~np.isin(rows.column, sheet.columns["x_served"])
    kept = Linear(rows.row[others], rows.column[others], sp.csr_array(rows.by[others]), rows.shape)
    joined = kept.plus(sheet.limit_of("load", {"load": -1.0}).rows)
    letters = tuple(name for name in family.letters if name != "x_served")
    return replace(family, rows=joined, letters=(*letters, "load"))
