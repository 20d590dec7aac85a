"""Random days without faults: whether the guard changes a decision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.frame.random_feeders import random_scenario
from vppres.contract.decision import Decider, Decision
from vppres.contract.forecast import ForecastErrors
from vppres.contract.observation import Observation
from vppres.core.arrays import Floats
from vppres.core.errors import SolveError
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.simulate import Day
from vppres.scenario.scenario import Scenario

SET_POINTS = ("served", "charge_kw", "discharge_kw", "batt_q_kvar", "pv_curtailed_kw", "pv_q_kvar")
QUARTERS = 4


class Listening:
    """A controller that keeps what it decided."""

    def __init__(self, inner: Decider) -> None:
        self.inner = inner
        self.decisions = list[Decision]()
        self.horizon_steps = inner.horizon_steps

    def decide(self, observation: Observation) -> Decision:
        """The controller's decision."""
        self.decisions.append(self.inner.decide(observation))
        return self.decisions[-1]


def quiet_day(seed: int) -> tuple[Scenario, RunOptions, str]:
    """A random day of 3 to 9 steps of 15, 30 or 60 min, and how its series move.

    Any controller runs it, mostly the MPC of the paper, with small to wild forecast errors.
    """
    rng = np.random.default_rng([seed, 1212])
    steps = int(rng.integers(3, 10))
    day = random_scenario(seed, stressed=bool(rng.random() < 0.2), n_steps=steps)
    values = str(rng.choice(["moving", "repeated", "constant"]))
    held = replace(day, load_kw=_held(day.load_kw, values), pv_kw=_held(day.pv_kw, values))
    load_bias, pv_bias = (float(x) for x in rng.uniform(-0.3, 0.3, 2))
    load_alpha, pv_alpha = (float(x) for x in rng.choice([0.0, 0.05, 0.15, 0.3], 2))
    options = RunOptions(
        controller=str(rng.choice(["mpc", "full-horizon"], p=[0.8, 0.2])),
        mode=str(rng.choice(["paper", "physical"], p=[0.75, 0.25])),
        horizon_h=day.grid.dt_h * float(rng.integers(0, 3)),
        seed=seed,
        errors=ForecastErrors(load_bias, load_alpha, pv_bias, pv_alpha),
    )
    return held, options, values


def _held(series: Floats, values: str) -> Floats:
    """A series whose rows are repeated in fours, or are all the first."""
    step = np.arange(len(series))
    if values == "repeated":
        return np.asarray(series[step // QUARTERS])
    return np.asarray(series[0 * step] if values == "constant" else series)


def changed_by_the_guard(seed: int) -> tuple[list[str], int, str]:
    """Decisions of a seed's day that the guard changes, how many there are, how its series move."""
    day, options, values = quiet_day(seed)
    guarded, plain = (decisions(day, replace(options, guard=guard)) for guard in (True, False))
    pairs = enumerate(zip(guarded, plain, strict=False))
    told = ((t, difference(one, other)) for t, (one, other) in pairs)
    return [f"day {seed}, step {t}: {text}" for t, text in told if text], len(plain), values


def decisions(day: Scenario, options: RunOptions) -> list[Decision]:
    """Decisions of a day as far as it went: without guard an error ends it."""
    controller = Listening(make_controller(day, options))
    run = Day(day, options)
    try:
        for t in range(day.grid.n_steps):
            run.step(controller, t)
    except SolveError:
        assert not options.guard
    return controller.decisions


def difference(guarded: Decision, plain: Decision) -> str:
    """How a guarded decision differs from the plain one, empty if not in a single bit."""
    words = [text for text in (guarded.fallback_reason, guarded.estimated) if text]
    words += [
        name
        for name in SET_POINTS
        if not np.array_equal(
            getattr(guarded.dispatch, name)[guarded.row], getattr(plain.dispatch, name)[plain.row]
        )
    ]
    return "; ".join(words)
