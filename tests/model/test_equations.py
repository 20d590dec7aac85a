"""Every equation on one dispatch whose numbers are worked out by hand.

The feeder is 1 - 2 - 3 with 1 kV, so that an ohm and a kW are a thousandth of a pu² (times two).
``shop`` is at bus 2 and owns ``deck``, ``home`` is at bus 3 and owns ``roof``. The dispatch obeys
no equation: what each misses by is the sum of all of its terms, so that a term that is dropped or
has another sign changes the number.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pandas as pd
import pytest

from tests.support.selected import missed_by, rows_missed
from tests.support.small_windows import two_buses, window
from vppres.contract.dispatch import Dispatch
from vppres.contract.operating_point import OperatingPoint
from vppres.control.guard.partial_fleet import site_with
from vppres.core.arrays import Floats
from vppres.kinds.batteries.physics import BatteriesAhead, cell_kw
from vppres.kinds.customer.rows import ColdDemand
from vppres.model import formulas, objective
from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.constraints import Named
from vppres.model.data import Physics, WindowData
from vppres.model.implied import battery_room, inverter_active
from vppres.model.linearise import delta_offset
from vppres.model.numerics import Polygon
from vppres.model.problem import PaperProblem, paper_constraints, paper_problem
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.model.terms import evaluate
from vppres.model.variables import Variables
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, ObjectiveWeights, Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.solve.forms import Form, form_problem
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import Status
from vppres.solve.selection import Selected, Selection, Sheet
from vppres.solve.solvers import find_solver, run_by_cvxpy
from vppres.solve.tie_breakers import TieBreakers

STEPS = 2
VALUES: dict[str, list[Any]] = {
    "x_served": [[1, 0], [1, 1]],  # shop, home
    "P_self": [[7, 3], [11, 5]],  # roof, deck
    "P_exp": [[13, 2], [17, 4]],
    "P_curt": [[1, 6], [9, 8]],
    "Q_pv": [[21, -12], [-21, 12]],
    "P_ch": [[10, 0], [0, 6]],  # at bus 2, at bus 3
    "P_dch": [[0, 4], [12, 1]],
    "delta": [[1, 0], [0, 1]],
    "Q_batt": [[24, -3], [5, 12]],
    "SoC": [[0.5, 0.4], [0.6, 0.3], [0.2, 0.7]],
    "P_grid": [5, 8],
    "Q_grid": [-6, 9],
    "u": [[1.05, 0.98, 0.95], [1.02, 0.99, 1.01]],
    "P_flow": [[20, 15], [-25, 30]],
    "Q_flow": [[12, -9], [8, 6]],
}
"""Values of the variables; P_batt is [[10, -4], [-12, 5]]."""

MISSED = {
    # P_ch - P_max delta, P_dch - P_max (1 - delta)
    "battery_charge_mode": [[10 - 40, 0], [0, 6 - 20]],
    "battery_discharge_mode": [[0, 4 - 20], [12 - 40, 1]],
    # 0.5 h; 100 and 50 kWh; efficiencies 0.9 and 0.8, 0.5 and 0.8
    "battery_soc_start": [0.5 - 0.45, 0.4 - 0.35],
    "battery_soc_dynamics": [[0.6 - 0.5 - 0.005 * 0.9 * 10, 0.3 - 0.4 + 0.01 * 4 / 0.8],
        [0.2 - 0.6 + 0.005 * 12 / 0.5, 0.7 - 0.3 - 0.01 * (0.8 * 6 - 1 / 0.8)]],
    "battery_soc_min": [[0.1 - 0.6, 0.2 - 0.3], [0.1 - 0.2, 0.2 - 0.7]],
    "battery_soc_max": [[0.6 - 0.9, 0.3 - 0.8], [0.2 - 0.9, 0.7 - 0.8]],
    # (10, 24), (4, 3), (12, 5), (5, 12) have the lengths 26, 5, 13, 13
    "battery_inverter_capacity": [[26 - 50, 5 - 25], [13 - 50, 13 - 25]],
    # all charging - import - all export
    "circular_charging": [10 - 5 - 15, 6 - 8 - 21],
    "pv_balance": [[7 + 13 + 1 - 100, 3 + 2 + 6 - 20], [11 + 17 + 9 - 30, 5 + 4 + 8 - 50]],
    # roof belongs to home, who is not served at first: 7 - 0; min(90, 30), min(40, 20), min(80, 50)
    "pv_self_consumption": [[7, 3 - 20], [11 - 30, 5 - 50]],
    # (20, 21), (5, 12), (28, 21), (9, 12) have the lengths 29, 13, 35, 15
    "pv_inverter_capacity": [[29 - 105, 13 - 60], [35 - 105, 15 - 60]],
    # export - battery + inflow - outflow - (demand - self-consumption), import at the first bus
    "active_power_balance": [[5 - 20, 2 - 10 + 20 - 15 - (40 - 3), 13 + 4 + 15 - (0 - 7)],
        [8 + 25, 4 + 12 - 25 - 30 - (80 - 5), 17 - 5 + 30 - (90 - 11)]],
    # PV + battery + inflow - outflow - demand: 0.75 and 4/3 kvar for each kW
    "reactive_power_balance": [[-6 - 12, -12 + 24 + 12 + 9 - 30, 21 - 3 - 9 - 0],
        [9 - 8, 12 + 5 + 8 - 6 - 60, -21 + 12 + 6 - 120]],
    # no grid, then 100 kW; reactive power up to demand and ratings: 60 + 120 + 75 + 165 kvar
    "grid_active_limit": [5 - 0, 8 - 100],
    "grid_reactive_max": [-6 - 0, 9 - 420],
    "grid_reactive_min": [-0 + 6, -420 - 9],
    "voltage_min": [[0.81 - 0.98, 0.81 - 0.95], [0.81 - 0.99, 0.81 - 1.01]],
    "voltage_max": [[0.98 - 1.21, 0.95 - 1.21], [0.99 - 1.21, 1.01 - 1.21]],
    "voltage_slack": [1.05 - 1.0816, 1.02 - 1.0816],
    # 1.04 pu
    # u_j - u_i + 2 (r P + x Q) - offset
    "delta_lindistflow": [[0.98 - 1.05 + 0.002 * (0.1 * 20 + 0.2 * 12) - 0.001,
        0.95 - 0.98 + 0.002 * (0.3 * 15 - 0.4 * 9) - 0.002], [
        0.99 - 1.02 + 0.002 * (-0.1 * 25 + 0.2 * 8) - 0.003,
        1.01 - 0.99 + 0.002 * (0.3 * 30 + 0.4 * 6) - 0.004]],
}  # fmt: skip
"""Left-hand side less right-hand side of each equation, of each inequality what is above zero where
it is violated."""
EQUALITIES = {
    "battery_soc_start", "battery_soc_dynamics", "pv_balance", "pv_self_consumption",
    "active_power_balance", "reactive_power_balance", "voltage_slack", "delta_lindistflow",
}  # fmt: skip

TERMS = {
    "f1_service": 0.5 * (1.0 + 1.0 + 0.1),
    "f2_cost": 0.5 * (0.2 * 5 + 0.4 * 8),
    "f3_curtailment": 0.5 * (1 + 6 + 9 + 8),
    "f4_flows": 0.1 * (400 + 144 + 625 + 64) + 0.3 * (225 + 81 + 900 + 36),
    # 21 of 105, 12 of 60, 24 and 5 of 50, 3 and 12 of 25 kvar
    "f5_reactive": 2 * 0.2**2 + 2 * 0.2**2 + 0.48**2 + 0.1**2 + 0.12**2 + 0.48**2,
}


def scenario() -> Scenario:
    """The feeder, its devices and their day."""
    thermal = {
        name: [1.0, 1.0]
        for name in (
            "r_theta_c_per_kw",
            "c_theta_kwh_per_c",
            "alpha_charge_per_c2",
            "alpha_discharge_per_c2",
            "r_int_ohm",
            "beta_per_c",
            "u_batt_v",
            "t_ref_c",
            "t_initial_c",
        )
    }
    return Scenario(
        name="hand",
        title="Two lines",
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(pd.Timestamp("2022-07-19", tz="UTC"), 30.0, STEPS),
        network=Network(
            [1, 2],
            [2, 3],
            [0.1, 0.3],
            [0.2, 0.4],
            slack_bus=1,
            base_kv=1.0,
            v_slack_pu=1.04,
            v_min_pu=0.9,
            v_max_pu=1.1,
            v_min_ac_pu=0.9,
            v_max_ac_pu=1.1,
        ),
        customers=Customers(
            id=["shop", "home"],
            bus=[2, 3],
            tier=["critical", "high"],
            weight=[1.0, 0.1],
            power_factor=[0.8, 0.6],
        ),
        pv=PVSystems(
            id=["roof", "deck"],
            customer=["home", "shop"],
            p_max_kw=[100.0, 60.0],
            s_max_kva=[105.0, 60.0],
        ),
        batteries=Batteries(
            id=["b2", "b3"],
            bus=[2, 3],
            energy_kwh=[100.0, 50.0],
            p_max_kw=[40.0, 20.0],
            s_max_kva=[50.0, 25.0],
            soc_min=[0.1, 0.2],
            soc_max=[0.9, 0.8],
            soc_initial=[0.45, 0.35],
            eta_charge=[0.9, 0.8],
            eta_discharge=[0.5, 0.8],
            **thermal,
        ),
        load_kw=np.array([[40.0, 60.0], [80.0, 90.0]]),
        pv_kw=np.array([[100.0, 20.0], [30.0, 50.0]]),
        price_gbp_per_kwh=np.array([0.2, 0.4]),
        temperature_c=np.array([25.0, 25.0]),
        grid_limit_kw=np.array([0.0, 100.0]),
        objective=ObjectiveWeights(0.1, 0.01, 0.001, 1.0),
    )


@pytest.fixture
def site() -> Site:
    return Site.of(scenario())


@pytest.fixture
def data() -> WindowData:
    return replace(window(scenario()), delta_pu2=np.array([[0.001, 0.002], [0.003, 0.004]]))


@pytest.fixture
def paper(site: Site, data: WindowData) -> PaperProblem:
    """The paper's problem with the dispatch as the variables' values."""
    problem = paper_problem(site, STEPS)
    problem.p.fill(site, data)
    put(problem.v)
    return problem


def put(v: Variables) -> None:
    """Write the dispatch."""
    for name, value in VALUES.items():
        getattr(v, name).value = np.array(value, dtype=float)


def missed(constraint: cp.Constraint) -> Floats:
    """By how much a constraint is missed."""
    if isinstance(constraint, cp.SOC):
        radius, point = (arg.value for arg in constraint.args)
        return np.reshape(np.hypot(*point) - radius, (STEPS, -1), order="F")
    return np.asarray(constraint.expr.value)


def assert_missed(named: Named, expected: dict[str, Any]) -> None:
    """The constraints are those, and miss by what is expected."""
    assert set(named) == set(expected)
    for name, constraint in named.items():
        assert missed(constraint) == pytest.approx(np.array(expected[name]), abs=1e-12), name


# The paper's problem.


def test_every_equation_of_the_paper_is_the_sum_of_its_terms(paper: PaperProblem) -> None:
    assert_missed(paper.subject_to, MISSED)


def test_equations_are_equations_and_limits_are_limits(paper: PaperProblem) -> None:
    equal = {
        name
        for name, constraint in paper.subject_to.items()
        if isinstance(constraint, cp.constraints.Equality)
    }
    assert equal == EQUALITIES


@pytest.mark.parametrize("name", TERMS)
def test_every_term_of_the_objective(site: Site, paper: PaperProblem, name: str) -> None:
    term = getattr(objective, name)(site, paper.v, paper.p)
    assert term.value == pytest.approx(TERMS[name], rel=1e-12)


def test_objective_is_what_the_paper_weighs(paper: PaperProblem) -> None:
    f1, f2, f3, f4, f5 = TERMS.values()
    assert paper.F.value == pytest.approx(f1 - 0.1 * f2 - 0.01 * f3 - 0.001 * f4 - f5, rel=1e-12)


def test_terms_of_arrays_are_those_of_the_problem(
    site: Site, data: WindowData, paper: PaperProblem
) -> None:
    terms = evaluate(site, data, paper.v.dispatch(site))
    assert [terms.f1, terms.f2, terms.f3, terms.f4, terms.f5] == pytest.approx(
        list(TERMS.values()), rel=1e-12
    )
    assert terms.total(site.weights) == pytest.approx(paper.F.value, rel=1e-12)


def test_signs_of_the_variables_are_the_papers(paper: PaperProblem) -> None:
    never_negative = {name for name in VALUES if getattr(paper.v, name).is_nonneg()}
    assert never_negative == {
        "x_served", "P_self", "P_exp", "P_curt", "P_ch", "P_dch", "delta", "P_grid", "u",
    }  # fmt: skip
    assert {v.name() for v in paper.problem.variables() if v.attributes["boolean"]} == {
        "x_served",
        "delta",
    }


@pytest.mark.parametrize(("centre", "expected"), [
    ("lossless",
        [0.81 - 1.0 + 0.002 * (0.1 * 20 + 0.2 * 3), 0.64 - 0.81 + 0.002 * (0.3 * 15 - 0.4 * 9)]),
    ("literal",
        [0.81 - 1.0 + 0.002 * (0.1 * 22 + 0.2 * 5), 0.64 - 0.81 + 0.002 * (0.3 * 16 - 0.4 * 8)]),
    ("none", [0.0, 0.0]),
])  # fmt: skip
def test_offset_of_the_last_ac_point(site: Site, centre: Any, expected: list[float]) -> None:
    # Buses 2 and 3 take 5 and 15 kW, and 12 and -9 kvar: 20 and 15 kW flow without losses.
    point = OperatingPoint(
        v_pu=np.array([1.0, 0.9, 0.8]),
        p_flow_kw=np.array([22.0, 16.0]),
        q_flow_kvar=np.array([5.0, -8.0]),
        p_injection_kw=np.array([0.0, -5.0, -15.0]),
        q_injection_kvar=np.array([0.0, -12.0, 9.0]),
        lines_out=np.zeros(2, dtype=bool),
    )
    assert delta_offset(site.network, point, centre) == pytest.approx(expected, abs=1e-15)


def test_page_of_the_problem_can_be_solved_as_it_stands(tiny: Scenario) -> None:
    """One optimum, found at once by SCIP and level by level by the package."""
    site = Site.of(replace(tiny, objective=ObjectiveWeights(1e-3, 0.1, 1e-9, 1e-9)))
    data = window(tiny, slice(2, 4))
    whole = paper_problem(site, 2)
    whole.p.fill(site, data)
    outcome = run_by_cvxpy(whole.problem, find_solver("scip"), gap_abs=1e-6, time_s=60.0)
    assert outcome.status == Status.OPTIMAL
    assert WindowSolver(site).solve(data).objective == pytest.approx(outcome.value, abs=2e-6)


# Forms derived from it.


def of_form(site: Site, data: WindowData, form: Form) -> Selected:
    """A form of the problem with the window's data."""
    sheet = Sheet(site, STEPS, beyond_paper(site, data))
    problem = form_problem(site, sheet, form, conic=False)
    problem.fill(data)
    return problem


def test_sums_of_a_problem_without_network(
    site: Site, data: WindowData, paper: PaperProblem
) -> None:
    problem = of_form(site, data, Form(network=False))
    missed = missed_by(problem, VALUES)
    # import + export - (demand - self-consumption) - battery power
    sums = [5 + 15 - (40 - 10) - 6, 8 + 21 - (170 - 16) + 7]
    assert missed["total_active_power_balance"] == pytest.approx(sums)
    assert not {"active_power_balance", "voltage_min"} & set(missed)
    args = (site, paper.v, paper.p)
    assert_missed(
        inverter_active(*args) | battery_room(*args),
        {
            "battery_charge_rating": [[10 - 50, 0 - 25], [0 - 50, 6 - 25]],
            "battery_discharge_rating": [[0 - 50, 4 - 25], [12 - 50, 1 - 25]],
            "pv_active_rating": [[20 - 105, 5 - 60], [28 - 105, 9 - 60]],
            "battery_room": [
                [0.5 + 0.005 * 9 - 0.9, 0.4 - 0.8],
                [0.6 - 0.9, 0.3 + 0.01 * 4.8 - 0.8],
            ],
            "battery_reserve": [
                [0.1 - 0.5, 0.2 - (0.4 - 0.01 * 5)],
                [0.1 - (0.6 - 0.005 * 24), 0.2 - (0.3 - 0.01 * 1.25)],
            ],
        },
    )


def polygon_missed(site: Site, data: WindowData, name: str, polygon: Polygon, half: bool) -> Floats:
    """By how much the dispatch misses a family's polygons."""

    def select(sheet: Sheet) -> Selection:
        return Selection(sheet).polygon(name, polygon, of_size=half)

    problem = Selected(Sheet(site, STEPS), select)
    problem.fill(data)
    return missed_by(problem, VALUES)[name]


def test_sides_of_polygons(site: Site, data: WindowData) -> None:
    root = np.sqrt(0.5)
    batteries, pv = "battery_inverter_capacity", "pv_inverter_capacity"
    # Inscribed: P + Q, Q - P, -P - Q, P - Q, all over the root of two, less the rating over it.
    P = np.array([[10, -4], [-12, 5]])
    Q = np.array([[24, -3], [5, 12]])
    S = np.array([50, 25])
    four = Polygon.inscribed(4)
    assert polygon_missed(site, data, batteries, four, half=False) == pytest.approx(
        root * np.vstack([P + Q - S, Q - P - S, -P - Q - S, P - Q - S]), abs=1e-12
    )
    # Around: P, Q, -P and -Q less the rating, of PV with its own power and export.
    P, Q, S = np.array([[20, 5], [28, 9]]), np.array(VALUES["Q_pv"]), np.array([105, 60])
    assert polygon_missed(site, data, pv, Polygon.around(4), half=False) == pytest.approx(
        np.vstack([P - S, Q - S, -P - S, -Q - S]), abs=1e-12
    )
    # Half: charging plus discharging for P, the first and the last side.
    P, Q, S = np.array([[10, 4], [12, 7]]), np.array(VALUES["Q_batt"]), np.array([50, 25])
    assert polygon_missed(site, data, batteries, four.right_half, half=True) == pytest.approx(
        root * np.vstack([P + Q - S, P - Q - S]), abs=1e-12
    )


def physics() -> Physics:
    """Losses in both steps; in the second, an island that the battery at bus 3 holds."""
    return Physics(
        loss_kw=np.array([[1.0, 2.0], [3.0, 4.0]]),
        loss_kvar=np.array([[0.5, 1.5], [2.5, 3.5]]),
        reference=np.array([0, 2]),
        headroom_kw=np.array([[0.0, 0.0], [0.0, 6.0]]),
        soc_reserve=np.array([[0.0, 0.0], [0.0, 0.05]]),
    )


CHANGED = {
    # the loss of a line where it ends
    "active_power_balance": np.array(MISSED["active_power_balance"]) - [[0, 1, 2], [0, 3, 4]],
    "reactive_power_balance": np.array(MISSED["reactive_power_balance"])
    - [[0, 0.5, 1.5], [0, 2.5, 3.5]],
    "voltage_reference": [1.05 - 1.0816, 1.01 - 1.0816],
    "root_voltage_min": [0 - 1.05, 0.81 - 1.02],
    "root_voltage_max": [1.05 - 4, 1.02 - 1.21],  # no limit at 4 pu² while the grid is there
    "headroom_charge": [[10 - 40, -4 - 20], [-12 - 40, 5 - 14]],
    "headroom_discharge": [[-10 - 40, 4 - 20], [12 - 40, -5 - 14]],
    "battery_inverter_capacity": [[26 - 50, 5 - 25], [13 - 50, 13 - 19]],
    "battery_soc_min": [[0.1 - 0.6, 0.2 - 0.3], [0.1 - 0.2, 0.25 - 0.7]],
}


def test_physical_mode_has_losses_a_reference_and_headroom(site: Site, data: WindowData) -> None:
    island = replace(data, physics=physics())
    statement = Statement(site, STEPS, beyond_paper(site, island))
    statement.write(island)
    put(statement.v)
    expected = {**MISSED, **CHANGED}
    del expected["voltage_slack"]
    # The grid supplies the reactive losses of the second step too.
    expected["grid_reactive_max"] = [-6, 9 - 420 - 6]
    expected["grid_reactive_min"] = [6, -420 - 6 - 9]
    assert_missed(statement.families, expected)
    # Of a battery whose modes exclude each other the headroom limits both powers together.
    both = missed(statement.implied["headroom_power"])
    assert both == pytest.approx(np.array([[10 - 40, 4 - 20], [12 - 40, 7 - 14]]))


def test_losses_add_up_where_there_is_no_network(site: Site, data: WindowData) -> None:
    problem = of_form(site, replace(data, physics=physics()), Form(network=False))
    sums = missed_by(problem, VALUES)["total_active_power_balance"]
    assert sums == pytest.approx([-16 - 3, -118 - 7])


def test_headroom_shrinks_polygons(site: Site, data: WindowData) -> None:
    form = Form(polygon_sides=4, outer=True)
    problem = of_form(site, replace(data, physics=physics()), form)
    sides = missed_by(problem, VALUES)["battery_inverter_capacity"]
    assert sides[:2] == pytest.approx(np.array([[10 - 50, -4 - 25], [-12 - 50, 5 - 19]]))


def test_dispatch_has_every_variable_in_its_place(site: Site, paper: PaperProblem) -> None:
    dispatch: Dispatch = paper.v.dispatch(site)
    columns = {
        "served": "x_served", "pv_self_kw": "P_self", "pv_export_kw": "P_exp",
        "pv_curtailed_kw": "P_curt", "pv_q_kvar": "Q_pv", "charge_kw": "P_ch",
        "discharge_kw": "P_dch", "batt_q_kvar": "Q_batt", "soc": "SoC", "p_grid_kw": "P_grid",
        "q_grid_kvar": "Q_grid", "p_flow_kw": "P_flow", "q_flow_kvar": "Q_flow",
    }  # fmt: skip
    for name, variable in columns.items():
        assert np.asarray(getattr(dispatch, name), float) == pytest.approx(
            np.array(VALUES[variable], float)
        ), name
    assert dispatch.v_pu**2 == pytest.approx(np.array(VALUES["u"]))


def test_cold_load_adds_demand_and_self_consumption(
    site: Site, data: WindowData, paper: PaperProblem
) -> None:
    cold = ColdDemand.create(site, STEPS)
    cold.z.value = np.array([[1.0, 0.0], [0.0, 1.0]])
    cold.P_cold.value = np.array([[3.0, 5.0], [7.0, 11.0]])
    cold.Q_cold.value = np.array([[2.0, 4.0], [6.0, 8.0]])
    cold.P_self_cold.value = np.array([[0.5, 1.5], [2.5, 3.5]])
    P, Q = (power @ site.taking_bus["customers"].T for power in cold.taken)
    vars(paper.p).update(P_added=P, Q_added=Q, **cold.parameters(site))
    named = paper_constraints(site, paper.v, paper.p)
    # The shop's at bus 2 and its deck's, then the home's at bus 3 and its roof's.
    more = {
        "active_power_balance": [[0, 3, 0], [0, 0, 11]],
        "reactive_power_balance": [[0, 2, 0], [0, 0, 8]],
        "pv_self_consumption": [[0, 1.5], [2.5, 0]],
    }
    for name, value in more.items():
        assert missed(named[name]) == pytest.approx(np.array(MISSED[name]) - value), name


def tie_breakers(
    site: Site, data: WindowData, paper: PaperProblem, curtailing: bool
) -> dict[str, Floats]:
    """What the last level's rows miss, with the dispatch's service and modes held."""
    problem = TieBreakers(site, Sheet(site, STEPS), curtailing, moves=False)
    # Net powers of the dispatch, so that the modes are charging and discharging in turn.
    net = replace(
        paper.v.dispatch(site),
        charge_kw=np.array([[10.0, 0.0], [0.0, 5.0]]),
        discharge_kw=np.array([[0.0, 4.0], [12.0, 0.0]]),
    )
    problem.hold(data, net, f2_gbp=1.0, f3_kwh=10.0)
    numbers = problem.numbers()
    full = np.zeros(len(problem.x_lower))
    values = {**VALUES, "P_ch": [[10.0, -4.0], [-12.0, 5.0]]}
    for name in problem.first:
        if name in values:
            full[problem.at(name)] = np.array(values[name], dtype=float)
    x = full[problem._y]
    f4, f5 = TERMS["f4_flows"], TERMS["f5_reactive"]
    # About kW of loss: over 1000 times the squared base voltage and the heavier weight, 1.0.
    squares = float(x @ (numbers.squares @ x)) / 2.0
    assert squares == pytest.approx((0.001 * f4 + f5) / 1000.0)
    return rows_missed(problem, numbers.rows @ x - numbers.limit)


def test_tie_breakers_hold_modes_cost_and_curtailment(
    site: Site, data: WindowData, paper: PaperProblem
) -> None:
    found = tie_breakers(site, data, paper, curtailing=True)
    drop = np.array(MISSED["delta_lindistflow"])
    soc = {
        name: 1e4 * np.array(MISSED[name])
        for name in ("battery_soc_start", "battery_soc_min", "battery_soc_max")
    }
    expected = {
        **soc,
        "battery_soc_dynamics": 1e4
        * np.array(
            [
                [0.6 - 0.5 - 0.005 * 0.9 * 10, 0.3 - 0.4 + 0.01 * 4 / 0.8],
                [0.2 - 0.6 + 0.005 * 12 / 0.5, 0.7 - 0.3 - 0.01 * 0.8 * 5],
            ]
        ),
        "delta_lindistflow": 1e2 * drop,
        "battery_power_min": [[0 - 10, -20 + 4], [-40 + 12, 0 - 5]],
        "battery_power_max": [[10 - 40, -4 - 0], [-12 - 0, 5 - 20]],
        "f2": [TERMS["f2_cost"] - 1.0],
        "f3": [TERMS["f3_curtailment"] - 10.0],
        # Export is PV power less self-consumption of the served and curtailment.
        "pv_export": [[-(100 - 0 - 1), -(20 - 20 - 6)], [-(30 - 30 - 9), -(50 - 50 - 8)]],
        "circular_charging": [10 - 5 - (99 - 6), 5 - 8 + 17],
        **{
            name: MISSED[name]
            for name in (
                "battery_inverter_capacity",
                "reactive_power_balance",
                "grid_active_limit",
                "voltage_slack",
                "voltage_min",
                "voltage_max",
            )
        },
    }
    for name, value in expected.items():
        assert found[name] == pytest.approx(np.array(value), abs=1e-9), name


def test_tie_breakers_without_curtailment_leave_an_interval_for_reactive_power(
    site: Site, data: WindowData, paper: PaperProblem
) -> None:
    found = tie_breakers(site, data, paper, curtailing=False)
    left = np.sqrt([[105**2 - 100**2, 60**2 - 20**2], [105**2 - 30**2, 60**2 - 50**2]])
    for name, sign in (("pv_reactive_min", -1.0), ("pv_reactive_max", 1.0)):
        limit = sign * np.array(VALUES["Q_pv"]) - left
        assert found[name] == pytest.approx(limit), name
    assert {"pv_export", "pv_inverter_capacity"}.isdisjoint(found)


def test_tie_breakers_of_a_site_without_batteries_have_no_moves(site: Site) -> None:
    none = site_with(site, np.zeros(2, dtype=bool))
    assert not TieBreakers(none, Sheet(none, STEPS), curtailing=True, moves=True).moves


def test_balances_of_thousands_of_customers_compile_in_little_memory() -> None:
    """A product of 7,500 parameters at once takes 500 MB."""
    many = two_buses(np.ones((5, 1500)), np.ones(1500), np.full(5, np.inf))
    sheet = Sheet(Site.of(many), 5)
    tracemalloc.start()
    rows = sheet.family("active_power_balance").rows
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rows.shape[0] == 10 and len(rows.row) > 7500
    assert peak < 200e6


# The same formulas on arrays.


def test_state_of_charge_of_arrays_is_that_of_the_problem(site: Site) -> None:
    b = site.batteries
    charge, discharge = np.array(VALUES["P_ch"], float), np.array(VALUES["P_dch"], float)
    stored_kw = cell_kw(charge, discharge, b.eta_charge, b.eta_discharge)
    assert stored_kw == pytest.approx(np.array([[9.0, -5.0], [-24.0, 4.8 - 1.25]]))
    soc = np.array(VALUES["SoC"])
    ahead = BatteriesAhead(b, soc[0], b.eta_charge, b.eta_discharge, 0.5)
    missing = np.diff(soc, axis=0) - np.diff(ahead.path(charge, discharge), axis=0)
    assert missing == pytest.approx(np.array(MISSED["battery_soc_dynamics"]))


def test_power_that_fills_and_empties_a_battery(site: Site) -> None:
    b = site.batteries
    soc = np.array([0.5, 0.1])
    # 40 kWh of room and 35 kWh in half an hour at 0.9 and 0.8
    ahead = BatteriesAhead(b, soc, b.eta_charge, b.eta_discharge, 0.5)
    full = ahead.charge_to_kw(b.soc_max)
    assert full == pytest.approx([40.0 / 0.9 / 0.5, 35.0 / 0.8 / 0.5])
    # 40 kWh above the lower limit at 0.5, and nothing
    empty = ahead.discharge_to_kw(b.soc_min)
    assert empty == pytest.approx([40.0 * 0.5 / 0.5, 0.0])
    assert ahead.charge_to_kw(np.array(0.4))[0] == 0.0
    most = np.minimum(b.active_max_kw, full), np.minimum(b.active_max_kw, empty)
    np.testing.assert_array_equal(ahead.most_kw(), most)


def test_injections_flows_and_voltages_of_arrays(site: Site) -> None:
    net = site.network
    given: dict[formulas.Devices, Floats] = {
        "pv": np.array([20.0, 5.0]),
        "batteries": np.array([-10.0, 4.0]),
        "customers": np.array([-40.0, -60.0]),
    }
    p_kw = formulas.bus_injections(site, given)
    assert p_kw.tolist() == [0.0, 5.0 - 10.0 - 40.0, 20.0 + 4.0 - 60.0]
    flows = formulas.lossless_flows(net, np.array([p_kw, -p_kw]))
    assert flows.tolist() == [[81.0, 36.0], [-81.0, -36.0]]
    p = np.array([20.0, 15.0])
    q = np.array([12.0, -9.0])
    assert formulas.voltage_drop_pu2(net, p, q) == pytest.approx([0.0088, 0.0018])
    offset = formulas.voltage_offset_pu2(net, np.array([[1.05, 0.98, 0.95]]), p, q)
    u = np.array(MISSED["delta_lindistflow"])[0] + [0.001, 0.002]  # without the offset
    assert offset == pytest.approx(u[None, :])
    along = formulas.squared_voltages(net, p, q, np.array([0.001, 0.002]))
    assert along == pytest.approx([1.0816, 1.0816 - 0.0078, 1.0816 - 0.0078 + 0.0002])
