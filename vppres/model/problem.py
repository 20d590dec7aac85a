"""A window's problem, compiled once and re-solved by writing parameters only."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.switching import RuleSteps
from vppres.core.arrays import Flags
from vppres.core.errors import ModelError
from vppres.model import constraints as families
from vppres.model import objective as terms
from vppres.model.beyond_paper.physical import PhysicalParameters
from vppres.model.beyond_paper.switching import SwitchingModel, added_demand
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.variables import Mode, Parameters, Variables

Goal = Literal["service", "cost"]


@dataclass(frozen=True)
class Form:
    """Which variant of the problem is meant.

    Parameters
    ----------
    goal : {"service", "cost"}
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
    """

    goal: Goal = "service"
    service: Mode = "integer"
    exclusivity: Mode = "integer"
    polygon_sides: int = 0
    outer: bool = False
    network: bool = True
    physical: bool = False
    switching: RuleSteps | None = None


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
        self.physical = PhysicalParameters.create(site, n_steps) if form.physical else None
        self.v = Variables.create(site, n_steps, form.service, form.exclusivity)
        self.switching = (SwitchingModel(site, self.v.x_served, form.switching)
                          if form.switching else None)
        self.v = replace(self.v, cold=added_demand(self.switching))
        self.constraints = self._constraints()
        self.problem = cp.Problem(self._objective(), list(self.constraints.values()))
        require_dpp(self.problem, f"window of {n_steps} steps, {form}")

    def _constraints(self) -> families.Named:
        """All constraints by the names of their equations."""
        form = self.form
        args = (self.site, self.v, self.p)
        inverters = (families.inverter_polygons(form.polygon_sides, form.outer)
                     if form.polygon_sides else families.inverter_discs)
        network = ((inverters, *families.NETWORK_FAMILIES) if form.network
                   else families.LUMPED_NETWORK_FAMILIES)
        chosen = (*families.DEVICE_FAMILIES, *network)
        named = {name: c for family in chosen for name, c in family(*args).items()}
        named |= self.switching.constraints if self.switching else {}
        return self.physical.amended(named, self.site, self.v) if self.physical else named

    def _objective(self) -> cp.Maximize | cp.Minimize:
        """The objective of the form's goal, scaled to numbers that solvers like."""
        args = (self.site, self.v, self.p)
        w = self.site.weights
        spending = cost_scale(self.site)
        cost = (spending * w.lambda_grid * terms.f2_cost(*args)
                + spending * w.lambda_curt * terms.f3_curtailment(*args))
        if self.form.goal == "cost":
            return cp.Minimize(cost)
        service = terms.f1_service(*args)
        if self.switching:
            service = service - self.switching.f6_switching
        return cp.Maximize(objective_scale(self.site) * (service - cost / spending))

    def fill(self, data: WindowData, served: Flags | None = None) -> None:
        """Write the window's data and, where the form fixes it, the served set."""
        self.p.fill(self.site, data, served)
        if self.physical:
            self.physical.fill(self.site, data)
        if self.switching:
            self.switching.fill(data)

    def dispatch(self, served: Flags | None = None) -> Dispatch:
        """The solution of the last solve."""
        return self.v.dispatch(self.site, served)


LARGEST_WITH_CONES = 400
SIDES_BEYOND = 16


def disc_sides(site: Site, n_steps: int) -> int:
    """Sides of the discs in problems without binaries: 0 for cones, polygons for large windows.

    cvxpy's time to compile cones grows with the product of variables and parameters: 3 s at 33
    buses and 24 steps, and more than 12 GiB at 500 buses and 6. Inscribed polygons compile ten
    times faster there, solve slower, and cost 0.01 % of f4.
    """
    return 0 if site.network.n_buses * n_steps <= LARGEST_WITH_CONES else SIDES_BEYOND


def cost_scale(site: Site) -> float:
    """Factor that turns the weighted cost terms into GBP, 1 where cost has no weight."""
    weight = site.weights.lambda_grid
    return 1.0 / weight if weight > 0 else 1.0


def objective_scale(site: Site) -> float:
    """Factor of the weighted objective in the masters.

    The cost of a kW weighs about 1e-7 beside a customer's 1, which is where solvers stop to tell a
    reduced cost from zero: a bound would be off by the whole cost. The factor lifts it well above.
    """
    weight = site.weights.lambda_grid
    return float(np.clip(0.1 / weight, 1.0, 1e5)) if weight > 0 else 1.0


def require_dpp(problem: cp.Problem, what: str) -> None:
    """Refuse a problem that would be compiled anew at every solve."""
    if not problem.is_dcp(dpp=True):
        raise ModelError(f"The problem ({what}) is not DPP: a parameter multiplies a parameter or "
                         "enters non-affinely. Move the product into the parameter's value.")
