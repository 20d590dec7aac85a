"""The levels below service: cost of a served set, then the tie-breakers.

One MIP at a usual gap leaves cost and reactive power undecided, so each term is solved to its own
precision with the terms above it held.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.switching import RuleSteps
from vppres.core.arrays import Flags, Floats
from vppres.model.beyond_paper.switching import rule_steps
from vppres.model.data import WindowData
from vppres.model.forms import Form, WindowModel
from vppres.model.numerics import disc_sides
from vppres.model.site import Site
from vppres.model.terms import evaluate
from vppres.model.tie_breakers import TieBreakerModel, charging_modes
from vppres.solve.fleet.demand import DemandModel
from vppres.solve.fleet.relaxation import AggregateModel
from vppres.solve.network.injections import Reactance
from vppres.solve.network.reactive import ReactiveModel
from vppres.solve.result import Outcome, Status
from vppres.solve.solvers import SolverSpec, run, run_conic

POLYGON_SIDES = 16
"""Default sides of an inverter's polygon."""

HELD_REL = 1e-6
HELD_ABS = 1e-5
"""How much the tie-breakers may worsen cost (GBP) and curtailment (kWh)."""

CURTAILMENT_HELD_REL = 1e-7
"""The same of curtailment, which weighs more: nearly as much as all service in a sunny outage."""


@dataclass
class ModelCache:
    """Compiled problems, one for each form and window length, and how many were compiled."""

    site: Site
    models: dict[tuple[Form, int], WindowModel] = field(default_factory=dict)
    lumped: dict[tuple[int, bool, bool, bool, RuleSteps | None], AggregateModel] = field(
        default_factory=dict)
    ties: dict[tuple[int, bool, bool, bool], TieBreakerModel] = field(default_factory=dict)

    demands: dict[tuple[int, bool, bool], DemandModel] = field(default_factory=dict)

    @property
    def compilations(self) -> int:
        """Problems compiled so far."""
        return (len(self.models) + len(self.lumped) + len(self.ties) + len(self.demands)
                + int("reactive" in self.__dict__))

    def window(self, form: Form, data: WindowData) -> WindowModel:
        """The window problem of a form, of the window's length, mode and switching rules."""
        rules = None if form.service == "fixed" else rule_steps(data)
        form = replace(form, physical=data.physical, switching=rules)
        n_steps = data.n_steps
        if (form, n_steps) not in self.models:
            self.models[form, n_steps] = WindowModel(self.site, n_steps, form)
        return self.models[form, n_steps]

    def aggregate(self, data: WindowData, integer: bool = True,
                  lumped: bool = True) -> AggregateModel:
        """The relaxation of the window's length, with a lumped battery or with every battery."""
        key = data.n_steps, integer, lumped, data.physical, rule_steps(data)
        if key not in self.lumped:
            self.lumped[key] = AggregateModel(self.site, *key)
        return self.lumped[key]

    @cached_property
    def reactance(self) -> Reactance:
        """How the site's voltages depend on injections."""
        return Reactance(self.site)

    def demand(self, data: WindowData, lumped: bool) -> DemandModel:
        """What the fleet can carry in a window of that length and mode."""
        key = data.n_steps, lumped, data.physical
        if key not in self.demands:
            self.demands[key] = DemandModel(AggregateModel(
                self.site, data.n_steps, False, lumped, data.physical))
        return self.demands[key]

    @cached_property
    def reactive(self) -> ReactiveModel:
        """Reactive power of one step."""
        return ReactiveModel(self.site)

    def tie_breakers(self, data: WindowData, curtailing: bool) -> TieBreakerModel:
        """The last level's problem of the window's length and mode."""
        key = data.n_steps, curtailing, data.physical, data.moves is not None
        if key not in self.ties:
            self.ties[key] = TieBreakerModel(self.site, *key)
        return self.ties[key]


_CACHES: OrderedDict[str, ModelCache] = OrderedDict()
_CACHES_KEPT = 3


def shared_cache(site: Site) -> ModelCache:
    """The process's compiled problems of a site, shared by all runs; only the last few are kept.

    Compiling costs more than a day of re-solving, so a study of many days on one site should do it
    once. A problem is filled completely before every solve, so nothing leaks from run to run.
    """
    cache = _CACHES.pop(site.key, None) or ModelCache(site)
    _CACHES[site.key] = cache
    while len(_CACHES) > _CACHES_KEPT:
        _CACHES.popitem(last=False)
    return cache


@dataclass(frozen=True, eq=False)
class Stage:
    """A stage's dispatch, if it has one, and its outcome."""

    outcome: Outcome
    dispatch: Dispatch | None


def solve_cost(cache: ModelCache, data: WindowData, served: Flags, spec: SolverSpec,
               form: Form, time_s: float) -> Stage:
    """Cheapest dispatch of a served set: a convex problem, with binaries only where it needs them.

    ``form`` says whether the network is part of it, and how its discs are stated for binaries;
    without binaries they are cones, or polygons in large windows.
    """
    sides = disc_sides(cache.site, data.n_steps) if form.network else 0
    relaxed = replace(form, exclusivity="relaxed", polygon_sides=sides)
    stage = _cost(cache, data, served, spec, relaxed, time_s)
    if stage.dispatch is None:
        return stage
    netted, done = net_modes(cache.site, data, stage.dispatch)
    if done:
        return replace(stage, dispatch=netted)
    first_s = stage.outcome.solve_s
    exclusive = _cost(cache, data, served, spec, replace(form, exclusivity="integer"),
                      time_s - first_s)
    both_s = first_s + exclusive.outcome.solve_s
    return replace(exclusive, outcome=replace(exclusive.outcome, solve_s=both_s))


def cost_form(polygon_sides: int, network: bool) -> Form:
    """Form of the cost level."""
    return Form("cost", "fixed", "relaxed", polygon_sides if network else 0, network=network)


def _cost(cache: ModelCache, data: WindowData, served: Flags, spec: SolverSpec,
          form: Form, time_s: float) -> Stage:
    model = cache.window(form, data)
    model.fill(data, served)
    conic = form.network and form.exclusivity == "relaxed"
    # 1e-4 GBP is far below any price difference that a dispatch could exploit.
    outcome = run_conic(model.problem, time_s) if conic else run(model.problem, spec, 1e-4, time_s)
    return Stage(outcome, model.dispatch(served) if outcome.status.has_answer else None)


def net_modes(site: Site, data: WindowData, dispatch: Dispatch) -> tuple[Dispatch, bool]:
    """Cancel charging against simultaneous discharging, and say whether every battery can take it.

    The net power stays, so no balance changes; what used to be lost is stored, so only the upper
    SoC limit can forbid it.
    """
    net = dispatch.charge_kw - dispatch.discharge_kw
    charge = np.maximum(net, 0.0)
    discharge = np.maximum(-net, 0.0)
    soc = soc_path(site, data, charge, discharge)
    return (replace(dispatch, charge_kw=charge, discharge_kw=discharge, soc=soc),
            bool((soc <= site.batteries.soc_max + 1e-7).all()))


def soc_path(site: Site, data: WindowData, charge_kw: Floats, discharge_kw: Floats) -> Floats:
    """State of charge before every step and after the last, shape (W + 1, B)."""
    gain = data.eta_charge * charge_kw - discharge_kw / data.eta_discharge
    change = np.cumsum(gain, axis=0) * site.dt_h / site.batteries.energy_kwh
    return np.vstack([data.soc, data.soc + change])


def polish(cache: ModelCache, data: WindowData, dispatch: Dispatch, time_s: float) -> Stage:
    """Minimise the tie-breakers with service, cost and curtailment held.

    It also decides whether a dispatch that was found without the network can be had in it: reactive
    power, voltages and true discs are all here. The answer is dropped if it is inaccurate or
    worsens cost or curtailment beyond the tolerance.
    """
    site = cache.site
    terms = evaluate(site, data, dispatch)
    f2_max = terms.f2 + HELD_REL * abs(terms.f2) + HELD_ABS
    f3_max = terms.f3 + CURTAILMENT_HELD_REL * terms.f3 + HELD_ABS
    curtailing = terms.f3 > HELD_ABS or bool((data.pv_kw > site.pv.s_max_kva).any())
    model = cache.tie_breakers(data, curtailing)
    model.fill(data, dispatch, charging_modes(dispatch), f2_max, f3_max)
    outcome = run_conic(model.problem, time_s)
    if outcome.status != Status.OPTIMAL:
        return Stage(outcome, None)
    better = model.dispatch(dispatch.served)
    better = replace(better, soc=soc_path(site, data, better.charge_kw, better.discharge_kw))
    after = evaluate(site, data, better)
    kept = after.f2 <= f2_max + HELD_ABS and after.f3 <= f3_max + HELD_ABS
    return Stage(outcome, better if kept else None)


def least_reactive(cache: ModelCache, data: WindowData, dispatch: Dispatch,
                   time_s: float) -> tuple[Outcome, Dispatch]:
    """Least reactive flows and use of inverters for the active power of a dispatch, step by step.

    A step without an answer keeps the reactive power that it has.
    """
    begin = time.perf_counter()
    model = cache.reactive
    changed = dispatch
    status = Status.OPTIMAL
    for t in range(data.n_steps):
        model.fill(data, dispatch, t)
        outcome = run_conic(model.problem, time_s - (time.perf_counter() - begin))
        if outcome.status == Status.OPTIMAL:
            changed = model.put_into(changed, t)
        else:
            status = outcome.status
    return Outcome(status, np.nan, np.nan, time.perf_counter() - begin), changed
