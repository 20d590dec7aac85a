"""A window's problem, compiled once and re-solved by writing parameters only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from vppres.errors import ModelError
from vppres.model import constraints as families
from vppres.model import objective as terms
from vppres.model.data import Dispatch, Site, WindowData
from vppres.model.variables import Mode, Parameters, Variables

Goal = Literal["service", "cost", "tie_breakers"]


@dataclass(frozen=True)
class Form:
    """Which variant of the problem is meant.

    Parameters
    ----------
    goal : {"service", "cost", "tie_breakers"}
        ``service`` maximises f1, f2 and f3 as weighted; ``cost`` minimises f2 and f3 as weighted;
        ``tie_breakers`` minimises f4 and f5 as weighted while f2 and f3 keep their values.
    service, exclusivity : {"integer", "relaxed", "fixed"}
        What the binaries x_served and delta are.
    polygon_sides : int
        0 states the inverters as cones, otherwise as inscribed polygons.
    network : bool
        Whether flows, reactive power and voltages are part of the problem; without them it is a
        relaxation.
    """

    goal: Goal = "service"
    service: Mode = "integer"
    exclusivity: Mode = "integer"
    polygon_sides: int = 0
    network: bool = True


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
        self.site, self.n_steps, self.form = site, n_steps, form
        self.p = Parameters.create(site, n_steps)
        self.v = Variables.create(site, n_steps, form.service, form.exclusivity)
        self.held = {name: cp.Parameter(name=f"{name}_held") for name in ("f2", "f3")}
        self.constraints = self._constraints()
        self.problem = cp.Problem(self._objective(), list(self.constraints.values()))
        require_dpp(self.problem, f"window of {n_steps} steps, {form}")

    def _constraints(self) -> families.Named:
        """All constraints by the names of their equations."""
        form, args = self.form, (self.site, self.v, self.p)
        inverters = (families.inverter_polygons(form.polygon_sides) if form.polygon_sides
                     else families.inverter_discs)
        network = ((inverters, *families.NETWORK_FAMILIES) if form.network
                   else families.LUMPED_NETWORK_FAMILIES)
        chosen = (*families.DEVICE_FAMILIES, *network)
        named = {name: c for family in chosen for name, c in family(*args).items()}
        if form.goal == "tie_breakers":
            named["cost_held"] = terms.f2_cost(*args) <= self.held["f2"]
            named["curtailment_held"] = terms.f3_curtailment(*args) <= self.held["f3"]
        return named

    def _objective(self) -> cp.Maximize | cp.Minimize:
        """The objective of the form's goal, scaled to numbers that solvers like."""
        args, w = (self.site, self.v, self.p), self.site.weights
        spending = cost_scale(self.site)
        cost = (spending * w.lambda_grid * terms.f2_cost(*args)
                + spending * w.lambda_curt * terms.f3_curtailment(*args))
        if self.form.goal == "cost":
            return cp.Minimize(cost)
        if self.form.goal == "service":
            return cp.Maximize(terms.f1_service(*args) - cost / spending)
        # f4 over the squared base voltage is about the ohmic loss in kW: numbers near 1.
        loss = 1.0 / (1000.0 * self.site.network.base_kv**2)
        total = max(w.lambda_l, w.lambda_q)
        return cp.Minimize(loss * (w.lambda_l / total * terms.f4_flows(*args)
                                   + w.lambda_q / total * terms.f5_reactive(*args)))

    def fill(self, data: WindowData, served: NDArray[np.bool_] | None = None,
             charging: NDArray[np.bool_] | None = None) -> None:
        """Write the window's data and, where the form fixes them, service and battery modes."""
        self.p.fill(self.site, data, served)
        if isinstance(self.v.delta, cp.Parameter):
            self.v.delta.value = np.asarray(charging, dtype=float)

    def hold(self, f2_gbp: float, f3_kwh: float) -> None:
        """Write the values of cost and curtailment that the tie-breakers must not worsen."""
        self.held["f2"].value, self.held["f3"].value = f2_gbp, f3_kwh

    def dispatch(self, served: NDArray[np.bool_] | None = None) -> Dispatch:
        """The solution of the last solve."""
        return self.v.dispatch(self.site, served)


def cost_scale(site: Site) -> float:
    """Factor that turns the weighted cost terms into GBP, 1 where cost has no weight."""
    weight = site.weights.lambda_grid
    return 1.0 / weight if weight > 0 else 1.0


def require_dpp(problem: cp.Problem, what: str) -> None:
    """Refuse a problem that would be compiled anew at every solve."""
    if not problem.is_dcp(dpp=True):
        raise ModelError(f"The problem ({what}) is not DPP: a parameter multiplies a parameter or "
                         "enters non-affinely. Move the product into the parameter's value.")
