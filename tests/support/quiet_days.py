"""Random days without faults: whether the guard changes a decision."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from benchmarks.random_feeders import random_scenario
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


@dataclass(frozen=True, eq=False)
class QuietDay:
    """A day without faults and how it is run.

    Parameters
    ----------
    scenario : Scenario
        The actual day.
    options : RunOptions
        Controller, mode, horizon and forecast errors, of any size.
    values : str
        Whether its series move in every step, are repeated, or are constant.
    """

    scenario: Scenario
    options: RunOptions
    values: str


@dataclass(frozen=True)
class QuietOutcome:
    """Actions of the guard on a day without faults.

    Parameters
    ----------
    seed : int
        Makes the day again.
    values, controller, mode : str
        What kind of day it was.
    steps : int
        Steps that were compared.
    changed : list of str
        Steps in which the guard decided otherwise, or estimated, and why.
    ended : str
        What ended the day without guard early, empty if nothing did: then there was no decision
        that a guard could change.
    """

    seed: int
    values: str
    controller: str
    mode: str
    steps: int
    changed: list[str]
    ended: str


class Listening:
    """A controller that keeps what it decided."""

    def __init__(self, inner: Decider) -> None:
        self.inner = inner
        self.decisions = list[Decision]()

    def horizon_steps(self, t0: int) -> range:
        """Steps for which the controller wants a forecast."""
        return self.inner.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The controller's decision."""
        self.decisions.append(self.inner.decide(observation))
        return self.decisions[-1]


def quiet_day(seed: int) -> QuietDay:
    """A random day of 3 to 9 steps of 15, 30 or 60 min, with forecast errors of any size."""
    rng = np.random.default_rng([seed, 1212])
    steps = int(rng.integers(3, 10))
    scenario = random_scenario(seed, stressed=bool(rng.random() < 0.2), n_steps=steps)
    values = str(rng.choice(["moving", "repeated", "constant"]))
    held = replace(
        scenario, load_kw=_held(scenario.load_kw, values), pv_kw=_held(scenario.pv_kw, values)
    )
    return QuietDay(held, _options(rng, seed, scenario.grid.dt_h), values)


def _held(series: Floats, values: str) -> Floats:
    """A series whose rows are repeated in fours, or are all the first."""
    step = np.arange(len(series))
    if values == "repeated":
        return np.asarray(series[step // QUARTERS])
    return np.asarray(series[0 * step] if values == "constant" else series)


def _options(rng: Generator, seed: int, dt_h: float) -> RunOptions:
    """Any controller, mostly the MPC of the paper, with small to wild forecast errors."""
    load_bias, pv_bias = (float(x) for x in rng.uniform(-0.3, 0.3, 2))
    load_alpha, pv_alpha = (float(x) for x in rng.choice([0.0, 0.05, 0.15, 0.3], 2))
    return RunOptions(
        controller=str(rng.choice(["mpc", "full-horizon"], p=[0.8, 0.2])),
        mode=str(rng.choice(["paper", "physical"], p=[0.75, 0.25])),
        horizon_h=dt_h * float(rng.integers(0, 3)),
        seed=seed,
        errors=ForecastErrors(load_bias, load_alpha, pv_bias, pv_alpha),
    )


def run_one(seed: int) -> QuietOutcome:
    """Run the day of a seed with and without guard, and compare every decision."""
    day = quiet_day(seed)
    guarded, _ = decisions(day.scenario, replace(day.options, guard=True))
    plain, ended = decisions(day.scenario, replace(day.options, guard=False))
    changed = [
        f"step {t}: {difference(one, other)}"
        for t, (one, other) in enumerate(zip(guarded, plain, strict=False))
        if difference(one, other)
    ]
    return QuietOutcome(
        seed, day.values, day.options.controller, str(day.options.mode), len(plain), changed, ended
    )


def decisions(scenario: Scenario, options: RunOptions) -> tuple[list[Decision], str]:
    """Decisions of a day as far as it went, and what ended it early."""
    controller = Listening(make_controller(scenario, options))
    day = Day(scenario, options)
    try:
        for t in range(scenario.grid.n_steps):
            day.step(controller, t)
    except SolveError as error:
        return controller.decisions, f"{type(error).__name__}: {error}"
    return controller.decisions, ""


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
