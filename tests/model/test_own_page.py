"""A page of one's own: what is added to the problem reaches every method, or is refused by name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import cvxpy as cp
import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from tests.support.random_forms import window_of
from tests.support.sets import gensets
from tests.support.small_windows import DARK, OPEN, battery, two_buses, window
from vppres import solve
from vppres.core.errors import InputError, ModelError
from vppres.kinds.customer.data import RuleSteps
from vppres.kinds.customer.rows import DimmedDemand, LongestTimeOff, SwitchingModel
from vppres.model import problem
from vppres.model.beyond_paper.addition import Addition
from vppres.model.beyond_paper.former_phases import FormerPhases
from vppres.model.beyond_paper.lines_out import LinesOut
from vppres.model.beyond_paper.table import additions, beyond_paper, own_parts
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.model.variables import Parameters, Variables
from vppres.scenario.scenario import Scenario
from vppres.solve.certificate import CostRange
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import SolveLimits, WindowSolution

SHARP = SolveLimits(gap_rel=1e-7, gap_abs=1e-6)


@contextmanager
def page(
    monkeypatch: pytest.MonkeyPatch, objective: object = None, families: object = None
) -> Iterator[None]:
    """The page with something more in its objective, or among its families."""
    F, rows = problem.paper_objective, problem.paper_constraints
    with monkeypatch.context() as m:
        if objective is not None:
            m.setattr(problem, "paper_objective", lambda s, v, p: F(s, v, p) + objective(s, v, p))
        if families is not None:
            m.setattr(
                problem, "paper_constraints", lambda s, v, p: rows(s, v, p) | families(s, v, p)
            )
        yield


def both(site: Site, data: WindowData, limits: SolveLimits | None = None) -> list[WindowSolution]:
    return [WindowSolver(site, method, limits=limits).solve(data) for method in METHODS]


class FleetCycles(Addition):
    """The fleet charges no more than half of its capacity in a window."""

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        charged_kwh = site.dt_h * cp.sum(v.P_ch)
        return {"fleet_cycles": charged_kwh <= 0.5 * site.batteries.energy_kwh.sum()}


def cycles(site: Site, answer: WindowSolution) -> float:
    """Charged energy as a share of the capacity."""
    return float(answer.dispatch.charge_kw.sum() * site.dt_h / site.batteries.energy_kwh.sum())


@pytest.mark.nightly
@pytest.mark.monolith
def test_a_limit_on_cycles_is_solved_by_both_methods_with_true_bounds(nightly: bool) -> None:
    wrong = []
    binding = 0
    for seed in range(50 if nightly else 5):
        scenario, data = random_window(seed, stressed=seed % 2 == 1)
        site = Site.of(scenario)
        if not len(site.batteries):
            continue
        free = WindowSolver(site).solve(data)
        with own_parts(FleetCycles):
            answers = both(site, data)
        best = max(answer.objective for answer in answers)
        sound = all(
            answer.status == "optimal"
            and answer.bound >= best - 1e-6 * max(abs(best), 1.0)
            and cycles(site, answer) <= 0.5 + 1e-6
            for answer in answers
        )
        binding += cycles(site, free) > 0.5 + 1e-3
        if not sound:
            wrong.append((seed, [(a.status, a.objective, a.bound, a.stages) for a in answers]))
    assert not wrong
    assert binding or not nightly


@pytest.fixture
def dark_day() -> Scenario:
    """Three dark hours, in which a battery carries one or two of three customers."""
    day = two_buses([[20.0, 20.0, 21.0]] * 3, [1.0, 1.0, 0.9], [OPEN, DARK, DARK])
    return replace(day, batteries=battery(soc=0.7, p_max_kw=60.0))


def test_a_term_that_punishes_a_customer_changes_all_methods_alike(
    monkeypatch: pytest.MonkeyPatch, dark_day: Scenario
) -> None:
    site, data = Site.of(dark_day), window(dark_day)
    before = both(site, data)
    assert all(answer.dispatch.served[:, 0].any() for answer in before)

    def punished(site: Site, v: Variables, p: Parameters) -> cp.Expression:
        return -100.0 * cp.sum(v.x_served[:, 0])

    with page(monkeypatch, punished):
        after = both(site, data)
    for answer in after:
        assert not answer.dispatch.served[:, 0].any()
        assert answer.dispatch.served[:, 1:].sum() == after[0].dispatch.served[:, 1:].sum()
        assert answer.status == "optimal"
        assert answer.objective == pytest.approx(after[0].objective, abs=1e-6)
    assert both(site, data)[0].dispatch.served[:, 0].any()


class WorstServed(Addition):
    """The least that any customer is supplied, in steps, counts as a customer hour each."""

    def __init__(self, x: cp.Expression) -> None:
        self.x = x
        self.least = cp.Variable(name="least_served")

    @classmethod
    def create(cls, site: Site, v: Variables, shape: object) -> WorstServed:
        return cls(v.x_served)

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        return {"least_served": self.least <= cp.sum(self.x, axis=0)}

    def terms(self) -> dict[str, cp.Expression]:
        return {"own": self.least}


def test_fairness_gives_everyone_a_turn(dark_day: Scenario) -> None:
    site, data = Site.of(dark_day), window(dark_day)
    assert not both(site, data)[0].dispatch.served[1:].any(axis=0).all()
    with own_parts(WorstServed):
        answers = both(site, data, SHARP)
    for answer in answers:
        assert answer.dispatch.served.sum(axis=0).min() == 2
        assert answer.terms.own == pytest.approx(2.0, abs=1e-6)
        assert answer.status == "optimal"


class Gate(Addition):
    """A switch of one's own: in each step either the battery works or PV power is exported."""

    def __init__(self, W: int) -> None:
        self.open = cp.Variable(W, boolean=True, name="gate")

    @classmethod
    def create(cls, site: Site, v: Variables, shape: object) -> Gate:
        return cls(v.P_grid.size)

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        most_kw = float(site.batteries.p_max_kw.sum())
        return {
            "gate": cp.sum(v.P_ch + v.P_dch, axis=1) <= most_kw * self.open,
            "gate_steps": cp.sum(self.open) <= 1,
        }


def test_binaries_of_ones_own_are_whole_in_all_answers(dark_day: Scenario) -> None:
    site, data = Site.of(dark_day), window(dark_day)
    with own_parts(Gate):
        answers = both(site, data)
    for answer in answers:
        works = (answer.dispatch.charge_kw + answer.dispatch.discharge_kw).sum(axis=1) > 1e-3
        assert works.sum() <= 1
        assert answer.objective == pytest.approx(answers[0].objective, abs=1e-4)
        assert answer.bound >= answers[0].objective - 1e-6


class VoltageStep(Addition):
    """Voltages may change by so much from step to step: the fleet has no row of it."""

    replaces: ClassVar[tuple[str, ...]] = ()

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        change = v.u[1:] - v.u[:-1]
        return {"voltage_step_up": change <= 1e-4, "voltage_step_down": change >= -1e-4}


def test_what_the_fleet_cannot_bound_is_refused_by_name_and_solved_by_the_monolith() -> None:
    day = two_buses([[100.0, 90.0], [10.0, 10.0]], [1.0, 0.1], [OPEN, OPEN], r_ohm=0.1)
    site, data = Site.of(day), window(day)
    free = WindowSolver(site, "monolithic").solve(data)
    with own_parts(VoltageStep):
        with pytest.raises(InputError, match="voltage_step_up"):
            WindowSolver(site).solve(data)
        held = WindowSolver(site, "monolithic").solve(data)
    u = np.square(held.dispatch.v_pu)
    assert np.abs(np.diff(u, axis=0)).max() <= 1e-4 + 1e-6
    assert held.objective < free.objective - 1e-3
    assert held.bound >= held.objective - 1e-6


@pytest.mark.parametrize(("most", "served"), [(0.6, 2), (1.0, 4)])
def test_a_family_of_the_paper_that_is_stated_anew_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, dark_day: Scenario, most: float, served: int
) -> None:
    """A limit of the state of charge below the paper's, with which 3 are served, and above it."""
    site, data = Site.of(dark_day), window(dark_day, soc=0.5)

    def anew(site: Site, v: Variables, p: Parameters) -> Named:
        return {"battery_soc_max": v.SoC[1:] <= most}

    with page(monkeypatch, families=anew):
        with pytest.raises(InputError, match="battery_soc_max"):
            WindowSolver(site).solve(data)
        answer = WindowSolver(site, "monolithic").solve(data)
    assert answer.status == "optimal"
    assert answer.dispatch.served[1:].sum() == served
    assert answer.dispatch.soc.max() <= most + 1e-6


def test_a_page_without_a_family_of_the_paper_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, dark_day: Scenario
) -> None:
    site, data = Site.of(dark_day), window(dark_day)
    rows = problem.paper_constraints
    monkeypatch.setattr(
        problem,
        "paper_constraints",
        lambda s, v, p: {n: c for n, c in rows(s, v, p).items() if n != "circular_charging"},
    )
    with pytest.raises(InputError, match="circular_charging"):
        WindowSolver(site).solve(data)
    assert WindowSolver(site, "monolithic").solve(data).status == "optimal"


def test_what_is_not_linear_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, dark_day: Scenario
) -> None:
    site, data = Site.of(dark_day), window(dark_day)
    with (
        page(monkeypatch, lambda s, v, p: -cp.sum_squares(v.P_ch)),
        pytest.raises(ModelError, match="paper_objective"),
    ):
        WindowSolver(site).solve(data)
    with (
        page(
            monkeypatch,
            families=lambda s, v, p: {"twice": cp.multiply(p.rho_dt, p.P_grid_max) <= v.P_grid},
        ),
        pytest.raises(ModelError, match="family twice is not DPP"),
    ):
        WindowSolver(site).solve(data)
    with (
        page(monkeypatch, families=lambda s, v, p: {"round": cp.norm(v.P_ch) <= 1.0}),
        pytest.raises(ModelError, match="family round"),
    ):
        WindowSolver(site).solve(data)


# One file for one thing.


SHAPES = {
    SwitchingModel: RuleSteps(2, 2, 2),
    LongestTimeOff: ((0, 1),),
    DimmedDemand: (2, 0),
    LinesOut: ((0,), (1,)),
}
"""What problems are compiled for, of additions that have more than one shape."""

AS_ARRAYS = {"injections.py", "rules.py", "terms.py", "master.py", "cheapest.py"}
"""Modules of ``solve/network`` on arrays, for windows that are too large to be compiled."""


def test_no_method_names_what_is_beyond_the_paper(tiny: Scenario) -> None:
    dimmed = replace(tiny.customers, share_min=[0.5, 0.5, 1.0])
    site = Site.of(replace(tiny, customers=dimmed, gensets=gensets()))
    paper = Statement(site, 2)
    others = [each for each in additions() if each is not FormerPhases]  # this one needs phases
    beyond = Statement(site, 2, tuple((each, SHAPES.get(each, True)) for each in others))
    names = (beyond.letters.keys() | beyond.families.keys()) - paper.letters.keys()
    names -= paper.families.keys()
    assert len(names) > 20
    wrong = {}
    for file in Path(str(solve.__file__)).parent.rglob("*.py"):
        source = re.sub(r"^ORDER = \(.*?^\)", "", file.read_text(), flags=re.DOTALL | re.MULTILINE)
        found = names & set(re.findall(r'"(\w+)"', source))
        if found and file.name not in AS_ARRAYS:
            wrong[file.name] = found
    assert not wrong


@pytest.mark.nightly
def test_additions_compute_what_their_terms_say(nightly: bool) -> None:
    """Cost of a dispatch by arrays and by the statement, within its range: ends and export."""
    for number in range(3, 12 * (10 if nightly else 2), 3):
        _, site, data = window_of(number)
        answer = WindowSolver(site).solve(data)
        statement = Statement(site, data.n_steps, beyond_paper(site, data))
        d = answer.dispatch
        values = {"P_grid": np.maximum(d.p_grid_kw, 0.0), "SoC": d.soc}
        values |= {"P_out": np.maximum(-d.p_grid_kw, 0.0)}
        b = site.batteries
        if data.terminal is not None:
            missing = data.terminal.target_kwh(b) - d.soc[-1] * b.energy_kwh
            values |= {"E_missing": np.maximum(missing, 0.0)}
        if data.stored_value is not None:
            values |= {"kept": data.stored_value.at(float(d.soc[-1] @ b.energy_kwh))}
        statement.write(data)
        statement.put({n: np.asarray(v) for n, v in values.items() if n in statement.letters})
        f2 = float(statement.terms["f2"].value)
        assert answer.terms.f2 == pytest.approx(f2, abs=1e-6)
        cost = CostRange.of(site, data)
        assert cost.least_gbp - 1e-6 <= f2 <= cost.dearest_gbp + 1e-6
