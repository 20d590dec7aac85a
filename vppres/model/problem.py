"""The paper's problem: Section 3, in its order and with its letters, and nothing else.

Numbers in brackets count the paper's equations, names with ``eq:`` are its labels. What a call
states is in :mod:`vppres.model.constraints` and :mod:`vppres.model.objective`, one function for
each family. Every problem that is solved is a selection of this page and of what a window has
beyond it: see :mod:`vppres.model.statement`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp

from vppres.model.constraints import (
    Named,
    active_balance,
    battery_inverter,
    battery_modes,
    battery_soc,
    battery_soc_limits,
    circular_charging,
    delta_lindistflow,
    grid_connection,
    pv_balance,
    pv_inverter,
    pv_self_consumption,
    reactive_balance,
    voltage_limits,
    voltage_slack,
)
from vppres.model.objective import f1_service, f2_cost, f3_curtailment, f4_flows, f5_reactive
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


def page() -> tuple[object, ...]:
    """The two functions of the page as they are now: problems compiled of others are others."""
    return paper_objective, paper_constraints


@dataclass(frozen=True, eq=False)
class PaperProblem:
    """Variables, parameters, objective and constraints of a window of W steps."""

    v: Variables
    p: Parameters
    F: cp.Expression
    subject_to: Named

    @property
    def problem(self) -> cp.Problem:
        """Problem of cvxpy: mixed-integer with cones and a quadratic objective."""
        return cp.Problem(cp.Maximize(self.F), list(self.subject_to.values()))


def paper_problem(site: Site, n_steps: int) -> PaperProblem:
    """The problem of Section 3 (``sec:math``) over the steps ``t_0 .. t_0 + H``.

    Examples
    --------
    >>> from vppres.io import find_scenario, read_scenario
    >>> day = read_scenario(find_scenario("uk-heatwave-2022"))
    >>> paper = paper_problem(Site.of(day), 2)
    >>> paper.problem.is_mixed_integer(), paper.problem.is_dcp()
    (True, True)
    """
    v = Variables(site, n_steps)  # Table 1, tab:opt_variables
    p = Parameters(site, n_steps)  # Table 2, tab:parameters
    return PaperProblem(v, p, paper_objective(site, v, p), paper_constraints(site, v, p))


def paper_objective(site: Site, v: Variables, p: Parameters) -> cp.Expression:
    """F of (30), ``objective_function``, which is maximised (``sec:objective``)."""
    w = site.weights
    return (
        f1_service(site, v, p)  # (25)
        - w.lambda_grid * f2_cost(site, v, p)  # (26)
        - w.lambda_curt * f3_curtailment(site, v, p)  # (27)
        - w.lambda_l * f4_flows(site, v, p)  # (28)
        - w.lambda_q * f5_reactive(site, v, p)
    )  # (29)


def paper_constraints(site: Site, v: Variables, p: Parameters) -> Named:
    """Constraints of the paper's F (``sec:constraints``, ``sec:delta``)."""
    return {
        # Battery storage; (1), the net power, is an expression of the variables.
        **battery_modes(site, v, p),  # text above (1)
        **battery_soc(site, v, p),  # (2)
        **battery_soc_limits(site, v, p),  # text below (2)
        **battery_inverter(site, v, p),  # (3) eq:batt_inverter
        **circular_charging(site, v, p),  # (4)
        # PV systems.
        **pv_balance(site, v, p),  # (5)
        **pv_self_consumption(site, v, p),  # (6) eq:min_pv
        **pv_inverter(site, v, p),  # (7) eq:pv_inverter
        # Power balance at every bus.
        **active_balance(site, v, p),  # (8) to (10)
        **reactive_balance(site, v, p),  # (11) to (14)
        # Grid connection.
        **grid_connection(site, v, p),  # (15)
        # Voltages.
        **voltage_limits(site, v, p),  # text below (15)
        # Power flow approximation around the last AC point.
        **voltage_slack(site, v, p),  # text below (24)
        **delta_lindistflow(site, v, p),  # (16) to (24), eq:dist_flow_diff
    }
