"""The levels below service: cost of a served set, then the tie-breakers.

One MIP at a usual gap leaves cost and reactive power undecided, so each term is solved to its own
precision with the terms above it held.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vppres.model.aggregate import AggregateModel
from vppres.model.data import Dispatch, Floats, Site, WindowData, evaluate
from vppres.model.window import Form, WindowModel
from vppres.solve.result import Outcome
from vppres.solve.solvers import SolverSpec, run, run_conic

POLYGON_SIDES = 16
"""Default sides of an inverter's polygon."""

HELD_REL, HELD_ABS = 1e-6, 1e-5
"""How much the tie-breakers may worsen cost (GBP) and curtailment (kWh)."""


@dataclass
class ModelCache:
    """Compiled problems, one for each form and window length, and how many were compiled."""

    site: Site
    models: dict[tuple[Form, int], WindowModel] = field(default_factory=dict)
    lumped: dict[int, AggregateModel] = field(default_factory=dict)

    @property
    def compilations(self) -> int:
        """Problems compiled so far."""
        return len(self.models) + len(self.lumped)

    def window(self, form: Form, n_steps: int) -> WindowModel:
        """The window problem of a form and length."""
        if (form, n_steps) not in self.models:
            self.models[form, n_steps] = WindowModel(self.site, n_steps, form)
        return self.models[form, n_steps]

    def aggregate(self, n_steps: int) -> AggregateModel:
        """The lumped relaxation of a length."""
        if n_steps not in self.lumped:
            self.lumped[n_steps] = AggregateModel(self.site, n_steps)
        return self.lumped[n_steps]


@dataclass(frozen=True, eq=False)
class Stage:
    """A stage's dispatch, if it has one, and its outcome."""

    outcome: Outcome
    dispatch: Dispatch | None


def solve_cost(cache: ModelCache, data: WindowData, served: NDArray[np.bool_], spec: SolverSpec,
               sides: int, time_s: float) -> Stage:
    """Cheapest dispatch of a served set: a linear problem, with binaries only where it needs them."""
    stage = _cost(cache, data, served, spec, Form("cost", "fixed", "relaxed", sides), time_s)
    if stage.dispatch is None:
        return stage
    netted, done = net_modes(cache.site, data, stage.dispatch)
    if done:
        return replace(stage, dispatch=netted)
    return _cost(cache, data, served, spec, Form("cost", "fixed", "integer", sides),
                 time_s - stage.outcome.solve_s)


def _cost(cache: ModelCache, data: WindowData, served: NDArray[np.bool_], spec: SolverSpec,
          form: Form, time_s: float) -> Stage:
    model = cache.window(form, data.n_steps)
    model.fill(data, served)
    conic = form.polygon_sides == 0 and form.exclusivity != "integer"
    # 1e-4 GBP is far below any price difference that a dispatch could exploit.
    outcome = run_conic(model.problem, time_s) if conic else run(model.problem, spec, 1e-4, time_s)
    return Stage(outcome, model.dispatch(served) if outcome.status.has_answer else None)


def net_modes(site: Site, data: WindowData, dispatch: Dispatch) -> tuple[Dispatch, bool]:
    """Cancel charging against simultaneous discharging, and say whether every battery could take it.

    The net power stays, so no balance changes; what used to be lost is stored, so only the upper
    SoC limit can forbid it.
    """
    net = dispatch.charge_kw - dispatch.discharge_kw
    charge, discharge = np.maximum(net, 0.0), np.maximum(-net, 0.0)
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

    The answer is dropped if it is inaccurate or worsens cost or curtailment beyond the tolerance.
    """
    site = cache.site
    model = cache.window(Form("tie_breakers", "fixed", "fixed", 0), data.n_steps)
    model.fill(data, dispatch.served, charging_modes(dispatch))
    terms = evaluate(site, data, dispatch)
    f2_max = terms.f2 + HELD_REL * abs(terms.f2) + HELD_ABS
    f3_max = terms.f3 + HELD_REL * terms.f3 + HELD_ABS
    model.hold(f2_max, f3_max)
    outcome = run_conic(model.problem, time_s)
    if outcome.status != "optimal":
        return Stage(outcome, None)
    better, netted = net_modes(site, data, model.dispatch(dispatch.served))
    after = evaluate(site, data, better)
    kept = after.f2 <= f2_max + HELD_ABS and after.f3 <= f3_max + HELD_ABS and netted
    return Stage(outcome, better if kept else None)


def charging_modes(dispatch: Dispatch) -> NDArray[np.bool_]:
    """Mode of every battery and step; an idle battery takes the fleet's."""
    net = dispatch.charge_kw - dispatch.discharge_kw
    fleet = net.sum(axis=1, keepdims=True) >= 0
    return np.where(np.abs(net) > 1e-6, net > 0, fleet)
