"""Days full of faults: whether they finish, and whether a critical customer is shed without need.

``python -m experiments.studies.campaign --days 500``
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from benchmarks.frame.pages import markdown_table
from benchmarks.frame.seeds import Study, report
from experiments.report import machine
from experiments.studies.alarms import HEADINGS, Alarms, alarm_rows, counted
from experiments.studies.faults import drawn_faults
from experiments.studies.random_days import RandomDay, random_day
from vppres.contract.observation import Observation
from vppres.control.guard.critical import critical_site
from vppres.control.guard.guard import GuardedController
from vppres.control.guard.partial_fleet import reduced_observation, site_with
from vppres.core.errors import SolveError
from vppres.day.assembly import make_controller
from vppres.day.faults import FaultInjector, FaultPlan
from vppres.day.metrics import resilience
from vppres.day.options import RunOptions
from vppres.day.recorder import StepRecord
from vppres.day.simulate import Day
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

FALLBACKS = ("none", "voltage", "service", "previous_plan", "rule", "critical")
"""What may take the place of the controller's own answer, as named in the record."""

HORIZONS_H = (3.0, 4.0, 5.0)
WEIGHT_TOLERANCE = 1e-6
JUDGE = ("monolithic", "scip")
"""Method and solver of the problem that is solved afterwards: neither is the campaign's own."""


@dataclass(frozen=True)
class StepToJudge:
    """A step that left out a critical customer: what was known, and who was served."""

    t: int
    known: Observation
    served: np.ndarray


@dataclass(frozen=True)
class DayOutcome:
    """What became of a day."""

    seed: int  #: makes the day and its faults again
    scenario: str  #: its name
    steps: int  #: steps that were finished
    error: str  #: what ended the day early, empty if nothing did
    resilience: float | None  #: of the finished day
    fallbacks: dict[str, int]  #: steps by kind of fallback
    faults: dict[str, int]  #: steps, measurements and batteries with faults
    #: Steps with estimates; without AC solution; with a fallback that has no reason.
    estimated: int
    ac_failures: int
    unnamed: int
    judged: int  #: steps in which a critical customer was shed
    #: Those of them in which the one-step problem serves more critical customers.
    violations: list[str]
    process_s: float  #: processor time of the day, the judging left out
    alarms: dict[str, Alarms]  #: alarms of frozen readings, by quantity


def run_one(seed: int) -> DayOutcome:
    """Run the day of a seed with its faults, then judge it."""
    drawn = random_day(seed)
    faults = drawn_faults(drawn.scenario, seed)
    options = RunOptions(
        horizon_h=HORIZONS_H[seed % len(HORIZONS_H)],
        errors=drawn.errors,
        seed=seed,
        protect_critical=True,
        limits=SolveLimits(time_s=20.0),
    )
    begin = time.process_time()
    day, to_judge, error = _play(drawn, faults, options)
    process_s = time.process_time() - begin
    records = day.recorder.records
    finished = day.recorder.finish(options.as_record()) if not error else None
    kinds = Counter(record.steps["fallback"] for record in records)
    return DayOutcome(
        seed=seed,
        scenario=drawn.scenario.name,
        steps=len(records),
        error=error,
        resilience=None if finished is None else resilience(finished),
        fallbacks=dict(kinds),
        faults={
            "solver": len(faults.solver),
            "measurements": len(faults.measurements),
            "trips": len(faults.trips),
            "pv_forecast": int(faults.pv_bias != 0),
        },
        estimated=sum(record.steps["estimated"] != "" for record in records),
        ac_failures=sum(record.steps["ac_failed"] != "" for record in records),
        unnamed=sum(_unnamed(record) for record in records),
        judged=len(to_judge),
        violations=judge(drawn, to_judge),
        process_s=process_s,
        alarms=counted(drawn.scenario, faults, records),
    )


def _play(
    drawn: RandomDay, faults: FaultPlan, options: RunOptions
) -> tuple[Day, list[StepToJudge], str]:
    """The day as far as it went, its steps to judge, and what ended it."""
    injector = FaultInjector(faults, drawn.scenario)
    guard = make_controller(drawn.scenario, options, injector)
    assert isinstance(guard, GuardedController)
    day = Day(drawn.scenario, options, injector)
    to_judge = []
    critical = drawn.scenario.customers.tier == drawn.scenario.tiers[0]
    try:
        for t in range(drawn.scenario.grid.n_steps):
            decision = guard.decide(day.observe(guard, t))
            record = day.settle(t, injector.actuate(t, decision))
            day.recorder.add(record)
            served = record.customers["served"]
            if decision.seen is not None and not served[critical].all():
                to_judge.append(StepToJudge(t, decision.seen, served))
    except Exception as error:  # the campaign counts what the guard let through
        return day, to_judge, f"{type(error).__name__}: {error}"
    return day, to_judge, ""


def _unnamed(record: StepRecord) -> bool:
    return record.steps["fallback"] not in FALLBACKS or (
        (record.steps["fallback"] != "none") != (record.steps["fallback_reason"] != "")
    )


def judge(drawn: RandomDay, steps: Sequence[StepToJudge]) -> list[str]:
    """Steps whose one-step problem serves more critical weight than was served, in words."""
    scenario = drawn.scenario
    first = scenario.customers.tier == scenario.tiers[0]
    weight = scenario.customers.weight * first
    found = []
    for step in steps:
        possible = weight @ _best_alone(scenario.tiers[0], Site.of(scenario), step.known)
        served = weight @ step.served
        if possible > served + WEIGHT_TOLERANCE:
            found.append(
                f"step {step.t}: {served:g} of the critical weight served, "
                f"{possible:g} possible; {step.known.estimated or 'all measured'}"
            )
    return found


def _best_alone(tier: str, site: Site, known: Observation) -> np.ndarray:
    """Who is served in the step alone with the tier above everything else, (C,)."""
    part = critical_site(site_with(site, known.online), tier)
    seen = reduced_observation(known, site.batteries)
    method, solver = JUDGE
    try:
        window = WindowData.of(seen, part, "lossless").first(1)
        return np.asarray(WindowSolver(part, method, solver).solve(window).dispatch.served[0])
    except SolveError:
        return np.zeros(len(site.customers))


def write_report(outcomes: Sequence[DayOutcome], wall_s: float, folder: Path) -> Path:
    """Write ``campaign.json``, ``.md`` and ``.html``; returns the Markdown file."""
    text = _text(outcomes, wall_s)
    return report(folder / "campaign", "Days full of faults", text, outcomes, wall_s)


def _text(outcomes: Sequence[DayOutcome], wall_s: float) -> str:
    """The report in words and tables."""
    count = len(outcomes)
    kinds: Counter[str] = Counter()
    days_with: Counter[str] = Counter()
    for outcome in outcomes:
        kinds.update(outcome.fallbacks)
        days_with.update({kind: 1 for kind in outcome.fallbacks})
    steps = sum(outcome.steps for outcome in outcomes)
    seconds = np.array([outcome.process_s for outcome in outcomes])
    violations = [f"day {o.seed}, {text}" for o in outcomes for text in o.violations]
    summary = [
        ("days", count),
        ("days that finished", sum(not o.error for o in outcomes)),
        ("steps", steps),
        ("steps with a fallback", steps - kinds["none"]),
        ("fallbacks without a name or a reason", sum(o.unnamed for o in outcomes)),
        ("steps with estimated measurements or a battery out", sum(o.estimated for o in outcomes)),
        ("steps without AC solution", sum(o.ac_failures for o in outcomes)),
        ("steps that shed a critical customer", sum(o.judged for o in outcomes)),
        ("of them, steps that could have served more critical weight", len(violations)),
        (
            "processor time of a day, median and longest (s)",
            f"{np.median(seconds):.1f}, {seconds.max():.1f}",
        ),
        ("wall time of the campaign (min)", f"{wall_s / 60:.1f}"),
    ]
    by_kind = [
        (kind, kinds[kind], days_with[kind], f"{kinds[kind] / max(steps, 1):.2%}")
        for kind in FALLBACKS
    ]
    fault_days = [
        (name, sum(o.faults[name] > 0 for o in outcomes))
        for name in ("solver", "measurements", "trips", "pv_forecast")
    ]
    failures = [f"day {o.seed}: {o.error}" for o in outcomes if o.error]
    bad = "\n".join(f"- {text}" for text in [*failures, *violations]) or "None."
    return "\n\n".join(
        [
            markdown_table(("", ""), summary),
            "## Fallbacks by kind",
            markdown_table(("kind", "steps", "days", "share of steps"), by_kind),
            "## Days with faults",
            markdown_table(("fault", "days"), fault_days),
            "## Alarms of frozen readings",
            markdown_table(HEADINGS, alarm_rows(outcome.alarms for outcome in outcomes)),
            "## Days that ended early, and critical customers shed without need",
            bad,
            "Each step that shed a critical customer is solved again afterwards, alone, from what "
            "was "
            f"known in it, with the first tier above everything else ({', '.join(JUDGE)}). "
            f"{machine()}.",
        ]
    )


STUDY = Study(run_one, write_report, lambda day: day.error or day.violations or day.unnamed)


main = STUDY.command(
    days=500, words="Run random days full of faults, and judge what was done to critical customers."
)


if __name__ == "__main__":
    typer.run(main)
