"""Random days without faults: whether the guard changes a decision.

``python -m experiments.quiet_days --days 500``
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import typer
from numpy.random import Generator

from benchmarks.pages import markdown_table, write_pages
from benchmarks.random_feeders import random_scenario
from experiments.report import machine
from experiments.seeds import (
    Study,
)
from vppres.contract.decision import Decider, Decision
from vppres.contract.forecast import ForecastErrors
from vppres.contract.observation import Observation
from vppres.core.arrays import Floats
from vppres.core.errors import SolveError
from vppres.day.assembly import make_controller
from vppres.day.metrics import versions
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
    """What the guard did on a day without faults.

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


def write_report(outcomes: Sequence[QuietOutcome], wall_s: float, folder: Path) -> Path:
    """Write ``quiet_days.json``, ``.md`` and ``.html``; returns the Markdown file."""
    record = {
        "days": [asdict(outcome) for outcome in outcomes],
        "wall_s": wall_s,
        "versions": versions(),
    }
    return write_pages(folder, "quiet_days", "Days without faults", _text(outcomes, wall_s), record)


def _text(outcomes: Sequence[QuietOutcome], wall_s: float) -> str:
    """The report in words and tables."""
    changed = [f"day {o.seed}, {text}" for o in outcomes for text in o.changed]
    summary = [
        ("days", len(outcomes)),
        ("steps compared", sum(o.steps for o in outcomes)),
        ("steps in which the guard changed a decision or a reading", len(changed)),
        (
            "days that end early without guard, for want of a dispatch",
            sum(o.ended != "" for o in outcomes),
        ),
        ("wall time (min)", f"{wall_s / 60:.1f}"),
    ]
    kinds = sorted({(o.values, o.controller, o.mode) for o in outcomes})
    rows = []
    for kind in kinds:
        of_kind = [o for o in outcomes if (o.values, o.controller, o.mode) == kind]
        rows.append(
            (
                *kind,
                len(of_kind),
                sum(o.steps for o in of_kind),
                sum(len(o.changed) for o in of_kind),
            )
        )
    return "\n\n".join(
        [
            markdown_table(("", ""), summary),
            "## By kind",
            markdown_table(("values", "controller", "mode", "days", "steps", "changed"), rows),
            "## Changed decisions",
            "\n".join(f"- {text}" for text in changed) or "None.",
            f"Forecasts are off by a bias of up to 30 % and by noise of up to 30 % an hour. "
            f"{machine()}.",
        ]
    )


STUDY = Study(run_one, write_report, lambda day: day.changed)


main = STUDY.command(
    days=500, words="Compare the decisions of random days without faults with and without guard."
)


if __name__ == "__main__":
    typer.run(main)
