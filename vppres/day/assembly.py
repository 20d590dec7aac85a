"""The controller that the options of a run name, put together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial

import numpy as np

from vppres.contract.decision import Decider
from vppres.control.baselines import IdleController, ReserveController
from vppres.control.by_weight import ByWeight
from vppres.control.configurations import InConfiguration
from vppres.control.converged import ConvergedPlanner
from vppres.control.full_horizon import FullHorizonController
from vppres.control.guard.check import Tolerances
from vppres.control.guard.guard import GuardedController
from vppres.control.guard.options import GuardOptions
from vppres.control.headroom import HeadroomPlanner
from vppres.control.mpc import MPCController
from vppres.control.planner import Planner
from vppres.control.proposing import Proposing
from vppres.control.rotation import Rotating
from vppres.control.switching import Switching
from vppres.core.errors import SolveError, VerificationError
from vppres.core.plain import Given
from vppres.day.checks import check_run
from vppres.day.faults import FaultInjector, FaultySolver, SolverKilledError
from vppres.day.options import RULES, RunOptions
from vppres.day.own import ByStepWeights, Own
from vppres.day.priority import site_of, weighed
from vppres.kinds.customer.data import SwitchingRules
from vppres.model.site import Site
from vppres.scenario.fairness import Fairness, hours_off
from vppres.scenario.priority import STRICT
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.solve.isolated import IsolatedSolver
from vppres.solve.ladder import WindowSolver

FAILURES = (SolveError, VerificationError, SolverKilledError, MemoryError, OSError)
"""Errors that the guard answers in a simulated day. Any other one is a mistake in code, and figures
of a day that rules decided for it would look like figures."""


def make_controller(
    scenario: Scenario,
    options: RunOptions,
    faults: FaultInjector | None = None,
    grid: TimeGrid | None = None,
    make_solver: Callable[[Site], WindowSolver] | None = None,
    own: Own | None = None,
    measured: bool = False,
) -> Decider:
    """The controller that the options name, with problems that are yet to be compiled.

    No series of the scenario reaches the controller. ``grid`` has the steps that there may be,
    where they are not the scenario's; ``make_solver`` makes the solver of a site, and ``own``
    replaces the controller that the options name, or the weights of its customers, of a simulated
    day. Where states are ``measured``, switches may be found in others than the scenario's.

    Raises
    ------
    InputError
        If its plans cannot hold what options or scenario say.
    """
    grid = grid or scenario.grid
    options = options.on(scenario)
    check_run(scenario, options, grid)
    moves = options.move_switches and scenario.switches.movable.any()
    if moves or (measured and scenario.follows_switches):
        fixed = replace(options, move_switches=False)
        of_day = partial(
            make_controller,
            options=fixed,
            faults=faults,
            grid=grid,
            make_solver=make_solver,
            own=own,
        )
        return _of_configurations(scenario, options, of_day, own, measured)
    site = site_of(scenario, options.as_record())
    guard_options = _guard_options(scenario, options, simulated=own is not None)
    make = make_solver or _solver_maker(options)

    def solver_of(part: Site) -> WindowSolver:
        solver = make(part)
        return solver if faults is None else FaultySolver(solver, faults)

    def controller_of(part: Site) -> Decider:
        made = None if own is None else own.made_controller(part)
        return made or _plain_controller(part, grid, scenario.tiers, options, solver_of)

    def decider_of(whole: Site) -> Decider:
        if not options.guard:
            return controller_of(whole)
        return GuardedController(controller_of, solver_of, whole, guard_options)

    def controllers() -> ByWeight:
        return ByWeight(
            decider_of,
            partial(weighed, site, scenario, options.as_record()),
            scenario.customers.weight,
            {Site: site, SwitchingRules: options.rules},
        )

    if own is not None and own.weights is not None:
        return ByStepWeights(controllers(), own, scenario.customers.weight)
    if options.shares_supply:
        rules = Fairness(**{f.name: getattr(options, f.name) for f in fields(Fairness)})
        # A day knows nothing of what comes after its beginning, and counts it itself.
        begins = None if measured else scenario.grid.start
        off_h = hours_off(scenario.interruptions, scenario.customers.id, begins)
        return Rotating(controllers(), scenario, rules, off_h)
    return decider_of(site)


def _of_configurations(
    scenario: Scenario,
    options: RunOptions,
    controller_of: Callable[[Scenario], Decider],
    own: Own | None,
    measured: bool,
) -> InConfiguration:
    """A controller with one of the options' for each configuration.

    It moves switches if the options say so, or proposes that where they are measured.
    """

    def site_in(day: Scenario) -> Site:
        return site_of(day, options.as_record())

    def given(site: Site) -> Given:
        return {Site: site, SwitchingRules: options.rules}

    if not (options.move_switches and scenario.switches.movable.any()):
        return InConfiguration(scenario, controller_of, site_in, given, options.centre)
    weighed_anew = options.shares_supply or (own is not None and own.weights is not None)
    kind = Proposing if measured else Switching
    return kind(
        scenario,
        controller_of,
        site_in,
        given,
        options.centre,
        None if weighed_anew else _solver_maker(replace(options, isolate=False)),
        options.limits,
        _guard_options(scenario, options, simulated=own is not None).within,
    )


def _guard_options(scenario: Scenario, options: RunOptions, simulated: bool) -> GuardOptions:
    """Options of the guard: limits of decisions, and the errors that it handles."""
    # A rule does not plan for voltages, and must not be replaced by another rule for them.
    v_pu = np.inf if options.controller in RULES else Tolerances().v_pu
    physical = options.mode == "physical"
    answers = FAILURES if simulated else (Exception,)
    return GuardOptions(
        scenario.tiers,
        options.protect_critical,
        options.centre,
        Tolerances(v_pu=v_pu, losses=physical),
        physical=physical,
        answers=answers,
    )


def _solver_maker(options: RunOptions) -> Callable[[Site], WindowSolver]:
    """Makes the solver that the options name, of any site."""
    kind = IsolatedSolver if options.isolate else WindowSolver
    return partial(
        kind,
        method=options.method,
        solver=options.solver,
        limits=options.limits,
        polygon_sides=options.polygon_sides,
    )


def _plain_controller(
    site: Site,
    grid: TimeGrid,
    tiers: tuple[str, ...],
    options: RunOptions,
    solver_of: Callable[[Site], WindowSolver],
) -> Decider:
    """A controller without guard for the whole fleet or a part of it."""
    centre = options.centre
    if options.controller == "idle":
        return IdleController(site, tiers, centre)
    if options.controller == "reserve":
        return ReserveController(site, grid, tiers, options.reserve, centre)
    solver = solver_of(site)
    planner = _planner(solver, options)
    if options.controller == "mpc":
        return MPCController(
            solver, grid, options.horizon_h, centre, planner, options.rules.move_weight
        )
    physical = options.mode == "physical"
    return FullHorizonController(solver, grid, options.pv_check, centre, planner, physical)


def _planner(solver: WindowSolver, options: RunOptions) -> Planner | None:
    """Planner of windows in physical mode; None for the paper's one solve."""
    if options.mode != "physical":
        return None
    assert options.headroom is not None
    if options.priority == STRICT and options.headroom > 0.0:
        return HeadroomPlanner(partial(ConvergedPlanner, solver), options.headroom)
    return ConvergedPlanner(solver, options.headroom)
