"""Every form of the problem that is solved, derived from the paper's by named steps.

:func:`vppres.model.problem.paper_constraints` states the paper's constraints. A step takes
constraints by name and says what it drops, replaces and adds:

======================== ==========================================================================
relaxed, fixed service   other variables in the same constraints (``Variables``)
:func:`with_demand`      balances with demand that the paper has not: cold load, losses
:func:`with_polygons`    polygons for the inverters' discs
:func:`without_network`  sums for flows, reactive power and voltages
switching rules          rows on service alone (``SwitchingModel``)
physical mode            reference bus and headroom (``PhysicalParameters``)
export                   a demand of the grid that pays, and a direction (``ExportToGrid``)
======================== ==========================================================================

Elastic limits (:mod:`vppres.model.elastic`) and held levels (:mod:`vppres.model.tie_breakers`) are
derived in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.stored_value import Ending, StoredValue
from vppres.contract.switching import RuleSteps
from vppres.contract.terminal import Terminal
from vppres.core.arrays import Flags, Floats
from vppres.model import lumped
from vppres.model import objective as terms
from vppres.model.beyond_paper.ends import AtEnd, end_of_window, f2_at_end, f7_at_end
from vppres.model.beyond_paper.export import ExportToGrid
from vppres.model.beyond_paper.physical import PhysicalParameters
from vppres.model.beyond_paper.stored_value import ValueAtEnd
from vppres.model.beyond_paper.switching import ColdDemand, SwitchingModel, cold_demand
from vppres.model.constraints import (
    AddedDemand,
    Named,
    active_balance,
    battery_inverter,
    pv_self_consumption,
    reactive_balance,
)
from vppres.model.data import WindowData
from vppres.model.numerics import cost_scale, objective_scale, require_dpp
from vppres.model.polygons import Polygon, battery_polygon, pv_polygon
from vppres.model.problem import paper_constraints
from vppres.model.site import Site
from vppres.model.variables import Mode, Parameters, Variables

Level = Literal["service", "cost"]

DEVICES = (
    "battery_charge_mode",
    "battery_discharge_mode",
    "battery_soc_start",
    "battery_soc_dynamics",
    "battery_soc_min",
    "battery_soc_max",
    "circular_charging",
    "pv_balance",
    "pv_self_consumption",
    "grid_active_limit",
    "grid_reactive_max",
    "grid_reactive_min",
)
INVERTERS = ("battery_inverter_capacity", "pv_inverter_capacity")
NETWORK = (
    "active_power_balance",
    "reactive_power_balance",
    "voltage_slack",
    "delta_lindistflow",
    "voltage_min",
    "voltage_max",
)
SOLVER_ORDER = (*DEVICES, *INVERTERS, *NETWORK)
"""The order in which solvers get the paper's rows. Which of several optima that are equally good
comes out depends on it, so it stays as it is."""


@dataclass(frozen=True)
class Form:
    """Which variant of the problem is meant.

    Parameters
    ----------
    level : {"service", "cost"}
        ``service`` maximises f1, f2 and f3 as weighted; ``cost`` minimises f2 and f3 as weighted.
    service : {"integer", "relaxed", "fixed"}
        What the binaries x_served are.
    exclusivity : {"integer", "relaxed"}
        What the binaries delta are.
    polygon_sides : int
        0 states the inverters as cones, otherwise as polygons.
    outer : bool
        Whether polygons contain the discs, for bounds, or lie inside them, for dispatches.
    network : bool
        Whether flows, reactive power and voltages are part of the problem; without them it is a
        relaxation.
    physical : bool
        Whether losses, the island's reference and headroom are part of the problem.
    switching : RuleSteps or None
        Shape of the switching rules; None has none. A fixed service obeys them or does not.
    exporting : bool
        Whether export is part of the problem. Its direction is a binary where ``exclusivity`` is.
    ending : {"", "target", "value"}
        What the problem says of what batteries hold at the end.
    """

    level: Level = "service"
    service: Mode = "integer"
    exclusivity: Mode = "integer"
    polygon_sides: int = 0
    outer: bool = False
    network: bool = True
    physical: bool = False
    switching: RuleSteps | None = None
    exporting: bool = False
    ending: Ending = ""

    @property
    def polygon(self) -> Polygon | None:
        """What stands for the inverters' discs, None for the discs themselves."""
        if not self.polygon_sides:
            return None
        shape = Polygon.around if self.outer else Polygon.inscribed
        return shape(self.polygon_sides)


class WindowModel:
    """The paper's problem over W steps in one form.

    Parameters
    ----------
    site : Site
        Fixed data.
    n_steps : int
        Steps W of the window.
    form : Form
        Variant of the problem.

    Raises
    ------
    ModelError
        If the problem is not disciplined (DCP) in its variables and parameters (DPP).
    """

    def __init__(self, site: Site, n_steps: int, form: Form) -> None:
        self.site = site
        self.n_steps = n_steps
        self.form = form
        self.p = Parameters.create(site, n_steps)
        self.v = Variables.create(site, n_steps, form.service, form.exclusivity)
        self.physical: PhysicalParameters | None = None
        if form.physical:
            self.physical = PhysicalParameters.create(site, n_steps)
        self.switching: SwitchingModel | None = None
        if form.switching:
            self.switching = SwitchingModel(site, self.v.x_served, form.switching)
        self.export: ExportToGrid | None = None
        if form.exporting:
            self.export = ExportToGrid.create(n_steps, form.exclusivity)
        self.terminal = end_of_window(form.ending, len(site.batteries))
        self.constraints = self._constraints()
        self.problem = cp.Problem(self.objective(), list(self.constraints.values()))
        require_dpp(self.problem, f"window of {n_steps} steps, {form}")

    def _constraints(self) -> Named:
        """All constraints by the names of their equations: the paper's, then step by step."""
        args = (self.site, self.v, self.p)
        named = in_order(paper_constraints(*args), SOLVER_ORDER)
        cold = cold_demand(self.switching)
        added = added_demand(self.site, cold, self.physical, self.export)
        rating = None if self.physical is None else self.physical.rating
        polygon = self.form.polygon
        if added is not None:
            named = with_demand(named, *args, added, cold)
        if self.export is not None:
            named = named | self.export.connection(self.v.P_grid, self.p.P_grid_max)
        if rating is not None:
            named = named | battery_inverter(*args, rating)
        if polygon is not None:
            named = with_polygons(named, self.site, self.v, polygon, rating)
        if not self.form.network:
            named = without_network(named, *args, added)
        if self.switching is not None:
            named = named | self.switching.constraints
        if self.physical is not None:
            named = self.physical.in_island(named, *args)
        if self.terminal is not None:
            named = named | self.terminal.reached(stored_at_end(self.site, self.v))
        return named

    def objective(self) -> cp.Maximize | cp.Minimize:
        """The level's part of F, scaled to numbers that solvers like.

        f4 and f5 are too small to be solved with the rest: the tie-breakers have them.
        """
        if self.form.level == "cost":
            return cp.Minimize(self.scaled_cost())
        cost = self.scaled_cost() / cost_scale(self.site)
        return cp.Maximize(objective_scale(self.site) * (self.service() - cost))

    def service(self) -> cp.Expression:
        """f1 less what switching costs, in weighted customer hours."""
        service = terms.f1_service(self.site, self.v, self.p)
        return service if self.switching is None else service - self.switching.f6_switching

    def scaled_cost(self) -> cp.Expression:
        """f2 and f3 as weighted, with revenue and what is left at the end, in about GBP."""
        args = (self.site, self.v, self.p)
        w = self.site.weights
        gbp = cost_scale(self.site)
        f2 = terms.f2_cost(*args)
        if self.export is not None:
            f2 = f2 - self.export.f2_revenue
        if self.terminal is not None:
            f2 = f2 + f2_at_end(self.terminal)
        cost = gbp * w.lambda_grid * f2 + gbp * w.lambda_curt * terms.f3_curtailment(*args)
        if self.form.ending == "value":
            cost = cost - gbp * f7_at_end(self.terminal)
        return cost

    def fill(self, data: WindowData, served: Flags | None = None) -> None:
        """Write the window's data and, where the form fixes it, the served set."""
        self.p.fill(self.site, data, served)
        if self.physical is not None:
            self.physical.fill(self.site, data)
        if self.switching is not None:
            self.switching.fill(data)
        if self.export is not None:
            self.export.fill(self.site, data)
        if self.terminal is not None:
            fill_end(self.terminal, self.site, data)

    def dispatch(self, served: Flags | None = None) -> Dispatch:
        """The solution of the last solve, import and export of a step netted."""
        found = self.v.dispatch(self.site, served)
        return found if self.export is None else self.export.netted(found)

    def both_kw(self) -> Floats:
        """What the last solution imports and exports at the same time, (W,)."""
        imported = np.maximum(np.asarray(self.v.P_grid.value, dtype=float), 0.0)
        if self.export is None:
            return np.zeros_like(imported)
        return np.asarray(np.minimum(imported, self.export.exported_kw()))


# Steps.


def stored_at_end(site: Site, v: Variables) -> cp.Expression:
    """Energy of each battery at the end of the window in kWh, (B,)."""
    return cp.multiply(site.batteries.energy_kwh, v.SoC[-1])


def fill_end(held: AtEnd, site: Site, data: WindowData) -> None:
    """Write a value, or what each battery is to hold; nothing for a window that says neither."""
    if isinstance(held, ValueAtEnd):
        held.fill(data.stored_value or StoredValue.nothing())
        return
    terminal = data.terminal or Terminal(0.0, 0.0)
    target_kwh = terminal.target_kwh(site.batteries)
    ends = data.terminal is not None
    held.fill(target_kwh if ends else 0.0 * target_kwh, terminal.price_gbp_per_kwh)


def in_order(named: Named, order: Sequence[str]) -> Named:
    """The constraints of some names in their order; the others are dropped."""
    return {name: named[name] for name in order if name in named}


def without(named: Named, names: Sequence[str]) -> Named:
    """The constraints without some of them."""
    return {name: constraint for name, constraint in named.items() if name not in names}


def added_demand(
    site: Site,
    cold: ColdDemand | None,
    physical: PhysicalParameters | None,
    export: ExportToGrid | None = None,
) -> AddedDemand | None:
    """Cold load, losses and export at the buses, None where there is none of them."""
    parts = []
    if cold is not None:
        parts.append(cold.at_buses(site))
    if physical is not None:
        parts.append(AddedDemand(physical.P_loss, physical.Q_loss))
    if export is not None:
        parts.append(export.at_slack_bus(site))
    if not parts:
        return None
    P = parts[0].P
    Q = parts[0].Q
    for part in parts[1:]:
        P = P + part.P
        Q = Q + part.Q
    return AddedDemand(P, Q)


def with_demand(
    named: Named,
    site: Site,
    v: Variables,
    p: Parameters,
    added: AddedDemand,
    cold: ColdDemand | None = None,
) -> Named:
    """Balances (8), (11) with more demand; PV owners (6) consume more of their own when cold."""
    named = named | active_balance(site, v, p, added) | reactive_balance(site, v, p, added)
    if cold is not None:
        named = named | pv_self_consumption(site, v, p, cold.own(site))
    return named


def with_polygons(
    named: Named, site: Site, v: Variables, polygon: Polygon, S_max: cp.Expression | None = None
) -> Named:
    """Polygons for the discs of (3) and (7); ``S_max`` is what plans may use of a battery's."""
    return named | battery_polygon(site, v, polygon, S_max) | pv_polygon(site, v, polygon)


def without_network(
    named: Named, site: Site, v: Variables, p: Parameters, added: AddedDemand | None = None
) -> Named:
    """Only what the network and the discs imply for sums and for active power; a relaxation."""
    kept = without(named, (*INVERTERS, *NETWORK))
    return (
        kept
        | lumped.total_balance(site, v, p, added)
        | lumped.inverter_active(site, v)
        | lumped.battery_room(site, v, p)
    )
