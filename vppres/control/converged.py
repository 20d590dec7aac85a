"""Windows of physical mode: solve, AC power flow of the candidate, linearise there, solve again.

The first solve decides who is served, at the AC points of the plan before. The passes after it
(:mod:`vppres.control.passes`) solve the continuous part for that set, at the AC points of the last
candidate, until model and AC agree in every step or the passes are used up.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any, ClassVar

import numpy as np

from vppres.contract.observation import Observation
from vppres.control.last_window import NO_ROW, LastWindow, kinds_of
from vppres.control.linearisation import BalancedLinearisation, Linearisation
from vppres.control.passes import Passes
from vppres.control.phased_window import PhasedLinearisation
from vppres.control.unheld import UnheldSteps
from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InfeasibleError, NumericalError
from vppres.kinds.batteries.physics import BatteriesAhead
from vppres.model.data import Physics, WindowData
from vppres.model.phases import phased_model
from vppres.model.site import Site
from vppres.model.terms import evaluate
from vppres.scenario.formers import forming_batteries, largest_forming_battery
from vppres.solve.deadline import Deadline
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, Status, WindowSolution

DEFAULT_HEADROOM = 0.1
LARGEST_RESERVE = 0.5
"""Share of a battery's usable energy that its reserve may take up."""

FIRST_SHARE = 0.75
"""Share of a window's time in which its set is decided first: the passes need the rest."""

SOC_NUDGE = 1e-6
"""Change of a measured SoC that is tried before a window counts as infeasible."""

_NO_POWER_KW = 1e-6


def linearisation_of(site: Site) -> Linearisation[Any]:
    """The linearisation of a site's windows."""
    if not site.phases:
        return BalancedLinearisation(site)
    return PhasedLinearisation(phased_model(site))


class ConvergedPlanner:
    """Plans windows that AC agrees with.

    A plan leaves ``headroom`` of a grid-forming battery's inverter rating free in an island. A
    window takes at most so many ``passes``, each a solve and an AC power flow; with 0 it is planned
    in the linearisation at rest.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {"_last": LastWindow | None}

    def __init__(
        self, solver: WindowSolver, headroom: float = DEFAULT_HEADROOM, passes: int | None = None
    ) -> None:
        self.solver = solver
        self.headroom = headroom
        self.linearisation = linearisation_of(solver.site)
        self.passes = self.linearisation.passes if passes is None else passes
        self._last: LastWindow | None = None

    def plan(
        self, observation: Observation, n_steps: int | None = None, within_s: float = inf
    ) -> WindowSolution:
        """Solution of the observed window, or of its first steps.

        It may take no more than ``within_s`` seconds, or its limit where that is less.

        Raises
        ------
        SolveError
            If no dispatch was found, not even at rest.
        """
        whole, dark, start = self.begun(observation, n_steps)
        if self.passes == 0:
            return self._finished(whole, dark, start, self.solver.solve(start))
        deadline = Deadline(min(self.solver.limits.time_s, within_s, observation.within_s))
        first = deadline.part(FIRST_SHARE)
        t0 = observation.t0
        try:
            data, solution = self.decide(self._started_where_last(t0, start), start, first)
        except InfeasibleError:
            beyond = UnheldSteps(self.solver, self._at_rest, whole, dark, first).found(start)
            if not beyond.any():
                raise
            dark = dark | beyond
            start = self._at_rest(whole, dark)
            data, solution = self.decide(start, start, first)
        passes = Passes(self.solver, self.linearisation, self.passes, deadline)
        data, reached, solution = passes.converged(data, solution)
        known = self.linearisation.known(reached, solution.dispatch)
        self._last = LastWindow(t0, kinds_of(reached), known)
        return self._finished(whole, dark, data, solution)

    def begun(
        self, observation: Observation, n_steps: int | None = None
    ) -> tuple[WindowData, Flags, WindowData]:
        """The observed window, its steps without power, and the window that is solved first."""
        whole = self.linearisation.observed(observation)
        whole = whole if n_steps is None else whole.first(n_steps)
        site = self.solver.site
        whole, dark = whole.formed(site, dark_steps(site, whole), self.headroom)
        return whole, dark, self._at_rest(whole, dark)

    def decide(
        self, data: WindowData, start: WindowData, deadline: Deadline
    ) -> tuple[WindowData, WindowSolution]:
        """Served set and first candidate; the stages say where it took a second attempt.

        A plan that lived on exactly the energy it had charged may miss it by the solvers' tolerance
        one step later: the search with binaries finds its supply schedule again, the linear problem
        calls it infeasible. SoC is not known that sharply anyway. Where an old AC point leaves no
        dispatch at all, the window is solved as it was before one was put in.
        """
        try:
            return data, self.solver.solve(data, deadline.left_s)
        except (InfeasibleError, NumericalError):
            pass
        soc = np.minimum(data.soc + SOC_NUDGE, self.solver.site.batteries.soc_max)
        nudged = replace(data, soc=soc)
        try:
            return nudged, _with_stage("nudged", self.solver.solve(nudged, deadline.left_s))
        except (InfeasibleError, NumericalError):
            return start, _with_stage("lossless", self.solver.solve(start, deadline.left_s))

    def _at_rest(self, whole: WindowData, dark: Flags) -> WindowData:
        """The window with its dark steps, in the linearisation that is known without a plan."""
        lit = without_power(whole, dark)
        physics = physics_of(self.solver.site, lit, self.headroom, self.linearisation.open_kw)
        return self.linearisation.at_rest(replace(lit, physics=physics))

    def _started_where_last(self, t0: int, start: WindowData) -> WindowData:
        """The window at what its steps, or others like them, were linearised at before."""
        if self._last is None:
            return start
        rows = self._last.rows_for(t0, start)
        before = tuple(values[rows] for values in self._last.rows)
        return self.linearisation.at_known(start, before, rows != NO_ROW)

    def _finished(
        self, whole: WindowData, dark: Flags, data: WindowData, solution: WindowSolution
    ) -> WindowSolution:
        """A window's solution with its voltages, and what its dark steps lose.

        It is called optimal if it is then still.
        """
        plan = self.linearisation.finished(data, solution.dispatch)
        site, limits = self.solver.site, self.solver.limits
        return in_the_dark(site, whole, dark, replace(solution, dispatch=plan), limits)


def _with_stage(attempt: str, solution: WindowSolution) -> WindowSolution:
    return replace(solution, stages=(attempt, *solution.stages))


def physics_of(site: Site, data: WindowData, headroom: float, open_kw: float = 0.0) -> Physics:
    """Reference, headroom and reserve of a window, without losses.

    ``open_kw`` is what passes may leave open between a plan and AC: a former has it left to the end
    of an outage.
    """
    b = site.batteries
    W = data.n_steps
    island = data.grid_limit_kw <= 0.0
    reference = np.zeros(W, dtype=int)
    former = largest_forming_battery(site)
    if former is not None:
        reference[island] = site.network.bus_index[b.bus[former]]
    for kind, forms in data.ahead.formers().items():
        step, one = np.nonzero(forms)
        buses = site.kinds[kind].buses(site.customers)[one]
        reference[step] = [site.network.bus_index[bus] for bus in buses]
    forms = island[:, None] & forming_batteries(site)
    parts = data.parts
    reference = np.where(parts.cut, np.maximum(parts.reference[:, 0], 0), reference)
    forms = np.where(parts.cut[:, None], parts.forms, forms)
    headroom_kw = np.where(forms, np.minimum(headroom * b.s_max_kva, b.active_max_kw), 0.0)
    zero = np.zeros((W, site.network.n_lines))
    left_kw = np.minimum(headroom_kw, open_kw)
    return Physics(zero, zero, reference, headroom_kw, _reserve(site, data, headroom_kw, left_kw))


def _reserve(site: Site, data: WindowData, headroom_kw: Floats, left_kw: Floats) -> Floats:
    """Reserve for the headroom of the island steps that follow, as far as it can be had."""
    b = site.batteries
    dt_h = site.dt_h
    usable = b.soc_max - b.soc_min
    wanted = np.zeros_like(headroom_kw)
    after_kwh = np.zeros(len(b))
    for t in range(data.n_steps - 1, -1, -1):
        own_kwh = headroom_kw[t] * dt_h
        # Nothing is kept behind the last step of an outage that ends in the window or with the run.
        # Of one whose end is not known, what is kept for later steps would move on with the window
        # and never be given: there it is that of the step itself.
        known = data.ends if t + 1 == data.n_steps else not data.open_ended
        kept_kwh = after_kwh + left_kw[t] * dt_h if known else own_kwh
        after_kwh = np.where(own_kwh > 0, after_kwh + own_kwh, 0.0)
        wanted[t] = np.minimum(
            kept_kwh / (data.eta_discharge * b.energy_kwh), LARGEST_RESERVE * usable
        )
    # What cannot be in the battery must not be asked for: the window would have no dispatch.
    reach = np.maximum(data.soc - b.soc_min, 0.0)
    charge = data.eta_charge * b.active_max_kw * dt_h / b.energy_kwh
    for t in range(data.n_steps):
        if np.isinf(data.grid_limit_kw[t]):
            reach = np.where(data.parts.forms[t], reach, np.minimum(reach + charge, usable))
        wanted[t] = np.minimum(wanted[t], reach)
        reach = np.where(headroom_kw[t] > 0, wanted[t], reach)
    return wanted


def dark_steps(site: Site, data: WindowData) -> Flags:
    """Island steps in which no battery can form the grid, (W,).

    Without a grid-forming battery that is every one; with empty ones those before the grid is back.
    Steps in which lines are out have dead parts instead.
    """
    b = site.batteries
    island = data.grid_limit_kw <= 0.0
    parted = data.parts.cut
    formers = forming_batteries(site)
    if not formers.any():
        return island & ~parted
    held_kw = BatteriesAhead.of(b, data, site.dt_h).discharge_to_kw(b.soc_min)
    able = bool((b.holds_energy(data.soc) & (held_kw > _NO_POWER_KW))[formers].any())
    empty = np.zeros_like(island) if able else np.logical_and.accumulate(island)
    return empty & ~parted


def without_power(data: WindowData, dark: Flags) -> WindowData:
    """The window with nothing to serve and no sun in its dark steps."""
    lit = ~dark[:, None]
    return replace(
        data,
        load_kw=data.load_kw * lit,
        pv_kw=data.pv_kw * lit,
        drawn=data.drawn and data.drawn.at(lit),
        switching=data.switching and data.switching.in_the_dark(dark),
        ahead=data.ahead.in_the_dark(lit),
    )


def in_the_dark(
    site: Site, whole: WindowData, dark: Flags, solution: WindowSolution, limits: SolveLimits
) -> WindowSolution:
    """The solution with no customer supplied and all PV power curtailed in the blacked-out steps.

    The objective is nearer to zero then, and the same gap a larger share of it. A first step in the
    dark is never called optimal.
    """
    if not dark.any():
        return solution
    plan = solution.dispatch
    dispatch = replace(
        plan,
        served=plan.served & ~dark[:, None],
        share=None if plan.share is None else plan.share * ~dark[:, None],
        taken_kw={kind: kw * ~dark[:, None] for kind, kw in plan.taken_kw.items()},
        given_kvar={kind: kvar * ~dark[:, None] for kind, kvar in plan.given_kvar.items()},
        pv_curtailed_kw=np.where(dark[:, None], whole.pv_kw, plan.pv_curtailed_kw),
    )
    curtailed_kwh = whole.pv_kw[dark].sum() * site.dt_h
    lost = (
        plan.supplied[dark] @ site.customers.weight
    ).sum() * site.dt_h + site.weights.lambda_curt * curtailed_kwh
    objective = solution.objective - lost
    bound = solution.bound - lost
    status = solution.status
    if dark[0]:
        status = Status.BLACKED_OUT
    elif status == Status.OPTIMAL and not limits.met(bound, objective):
        status = Status.GAP_OPEN
    return replace(
        solution,
        dispatch=dispatch,
        terms=evaluate(site, whole, dispatch),
        objective=objective,
        bound=bound,
        status=status,
    )
