"""Outages that nobody knows exactly: what controllers make of warnings, on the same days.

``python -m experiments.studies.uncertain --days 240``, ``--part cigre`` on another feeder, ``--part
wrong`` with beliefs that are wrong about durations, ``--part names`` with estimates of restoration
under another name than the warning, of which some are wrong, and with a crew's notices; ``--part
notice`` on days whose lengths differ more, with estimates and without.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import typer
from matplotlib.figure import Figure
from numpy.random import Generator

from benchmarks.frame.pages import markdown_table
from benchmarks.frame.paired import Estimate, by_seed
from benchmarks.frame.seeds import STUDIES, Days, FirstSeed, Jobs, Results, Span, Study, report
from benchmarks.frame.terminal import Scheduler
from experiments.drawing import draw_grid
from experiments.report import machine
from experiments.studies.outage_days import (
    FALSE_SHARE,
    NOTICE_H,
    NOTICE_SHARE,
    OutageClimate,
    OutageDay,
    before_the_onset,
    biased,
    by_several_names,
    draw_outage_day,
    with_notices,
    with_outage_day,
)
from vppres.contract.observation import Observation
from vppres.contract.stored_value import StoredValue
from vppres.core.arrays import Flags, Floats
from vppres.day.assembly import make_controller
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.outages import OutageView
from vppres.day.simulate import Day
from vppres.day.trajectory import Trajectory
from vppres.io.find import load_scenario
from vppres.outlook.belief import OutageBelief
from vppres.outlook.outlook import Announced, OutageOutlook, SeenOutage, announced_by
from vppres.report.plots.drawing import BLUE
from vppres.scenario.scenario import Scenario
from vppres.studies.side_by_side import Where

Part = Literal["heatwave", "cigre", "wrong", "names", "notice"]

TWO_STAGE = "two-stage"
POLICIES = {
    "none": "none until it happens",
    "likely": "the most likely outage",
    TWO_STAGE: "two-stage, 8 scenarios",
    "belief": "the belief",
    "known": "the exact window, H = 5 h",
    "perfect": "perfect information",
}
BY_NAME = "by name"
NOTICE = "notice"
OF_NAMES = {
    "likely": "the most likely outage",
    BY_NAME: "the belief, each name an outage of its own",
    "belief": "the belief, the last message counts",
    NOTICE: "the same with a notice one hour ahead",
    "known": "the exact window, H = 5 h",
}
"""Policies of the part ``names``."""

SHARP, SILENT = "estimates within a fifth", "no estimates"
VARIED = OutageClimate(duration_median_h=3.0, duration_sigma=1.2, restoration_sign=0.2)
"""Days of the part ``notice``: of lengths that nobody knows before the onset. In those of the part
``names`` they are known better than an estimate says them."""

SCENARIOS = 8
"""Futures that the yardstick of two stages samples in every step."""

WRONG = {
    "2 h too short": (-2.0, 1.0),
    "1 h too short": (-1.0, 1.0),
    "1 h too long": (1.0, 1.0),
    "2 h too long": (2.0, 1.0),
    "median halved": (0.0, 0.5),
    "median doubled": (0.0, 2.0),
}
"""Hours that are added to what is believed of durations, and the factor on it."""

WORST_SHARE = 0.05
TABLE_WIDTH = 120


@dataclass(frozen=True)
class Run:
    """What a policy made of a day."""

    seed: int  #: the day, the same for every policy
    kind: str  #: whether its outage was announced, not announced, or a false alarm
    #: What was known of outages, and what was wrong about it.
    policy: str
    wrong: str
    resilience: float | None  #: none on a day without outage
    #: Of the import, less what it would cost at the day's lowest price to charge what the batteries
    #: hold more than at the beginning.
    cost_gbp: float
    critical_lost_h: float  #: customer hours of critical customers without supply
    gap_max: float  #: largest relative gap of a window
    #: Windows that are not optimal, and steps with a fallback.
    uncertified: int
    fallbacks: int
    process_s: float  #: processor time


@dataclass(frozen=True, eq=False)
class TwoStageView(OutageView):
    """The value of stored energy as the mean over sampled futures, each known once it begins.

    The yardstick: what a stochastic program of two stages would say of the first.
    """

    seed: int = 0

    def _value(self, seen: Observation, belief: OutageBelief, *ahead: Any) -> StoredValue:
        rng = np.random.default_rng([self.seed, seen.t0, 1504])
        drawn = [known_path(sampled(belief, rng)) for _ in range(SCENARIOS)]
        values = [super(TwoStageView, self)._value(seen, path, *ahead) for path in drawn]
        mean = np.mean([value.service for value in values], axis=0)
        return replace(values[0], service=mean, as_service=belief.out)


@dataclass(frozen=True, eq=False)
class OutlookByName(OutageOutlook):
    """The yardstick: every name is an outage of its own, and the first by its onset explains."""

    def expected(self, now: pd.Timestamp, seen: Sequence[SeenOutage]) -> list[Announced]:
        """Every name that has announced an outage, by its likely onset."""
        lasting = seen[-1] if seen and seen[-1].end is None else None
        named = [announced_by(group, lasting) for group in self._messages(now).values()]
        return sorted((one for one in named if one), key=lambda one: one.likely)

    def _explanation(self, announced: Sequence[Announced], seen: SeenOutage) -> Announced | None:
        step = pd.Timedelta(hours=self.step_h)
        return next((one for one in announced if one.explains(seen, step)), None)


def sampled(belief: OutageBelief, rng: Generator) -> Flags:
    """A future of a belief, (T,): whether each step is one of an outage."""
    out = np.zeros(belief.n_steps, dtype=bool)
    kind, elapsed = belief.kind, belief.elapsed
    lasting = belief.out
    come = kind if lasting else 0
    for t in range(belief.n_steps):
        if t and lasting and rng.random() < belief.restored[kind, elapsed]:
            lasting = False
            come = kind
        elif t and lasting:
            elapsed = min(elapsed + 1, belief.duration.shape[1] - 1)
        elif t:
            begins = belief.onsets_from(come, t)
            drawn = int(np.searchsorted(begins.cumsum(), rng.random()))
            if drawn < len(begins):
                lasting, kind, elapsed = True, drawn, 0
        out[t] = lasting
    return out


def known_path(out: Flags) -> OutageBelief:
    """The belief of zeros and ones that a future is, (T,)."""
    T = len(out)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], out, [False]])))
    spans = edges.reshape(-1, 2)
    lengths = np.zeros((len(spans) + 1, T))
    lengths[0, 0] = 1.0
    onset = np.zeros((len(spans), T))
    for row, (begin, end) in enumerate(spans):
        lengths[row + 1, end - begin - 1] = 1.0
        onset[row, begin] = float(begin > 0)
    return OutageBelief(onset, lengths, 0.0, out=bool(out[0]), kind=int(out[0]))


def run_policy(scenario: Scenario, policy: str, seed: int) -> Trajectory:
    """A day under a policy."""
    options = options_of(policy).on(scenario)
    controller = make_controller(scenario, options)
    day = Day(scenario, options)
    if policy == TWO_STAGE:
        known = day.observer.outages
        view = {f.name: getattr(known, f.name) for f in fields(known)}
        day.observer = replace(day.observer, outages=TwoStageView(**view, seed=seed))
    if policy == BY_NAME:
        known = day.observer.outages
        outlook = known.outlook
        by_name = OutlookByName(outlook.warnings, outlook.statistics, outlook.step_h)
        day.observer = replace(day.observer, outages=replace(known, outlook=by_name))
    for t in range(scenario.grid.n_steps):
        day.step(controller, t)
    return day.recorder.finish(options.as_record(), None)


def options_of(policy: str) -> RunOptions:
    """How a policy runs a day."""
    if policy == "perfect":
        return RunOptions(controller="perfect")
    return RunOptions(outages="belief" if policy in (TWO_STAGE, BY_NAME, NOTICE) else policy)


@cache
def heatwave() -> Scenario:
    """The packaged day of the paper."""
    return load_scenario("uk-heatwave-2022")


@cache
def cigre() -> Scenario:
    """Hourly means of the first of two days on the CIGRE feeder."""
    both = load_scenario("two-outages-cigre-mv")
    quarters = round(1.0 / both.grid.dt_h)
    first = both.between(0, 24 * quarters)
    hourly = {
        name: values.reshape(24, quarters, *values.shape[1:]).mean(axis=1)
        for name, values in first.series.items()
        if name != "grid_limit_kw"
    }
    grid = replace(first.grid, step_minutes=60.0, n_steps=24)
    return replace(first, grid=grid, grid_limit_kw=np.full(24, np.inf), **hourly)


def heatwave_day(seed: int) -> list[Run]:
    """All policies on one day of the paper's feeder."""
    return _runs(heatwave(), seed, POLICIES, {"": (0.0, 1.0)})


def cigre_day(seed: int) -> list[Run]:
    """All policies on one day of the CIGRE feeder."""
    return _runs(cigre(), seed, POLICIES, {"": (0.0, 1.0)})


def wrong_day(seed: int) -> list[Run]:
    """The likely outage and the belief on one day, both wrong about durations in the same way."""
    return _runs(heatwave(), seed, ("likely", "belief"), WRONG)


def names_day(seed: int) -> list[Run]:
    """Estimates under another name, on one day of the paper's feeder."""
    return _of_names(by_several_names(draw_outage_day(seed, heatwave().grid.start), seed), "", seed)


def notice_day(seed: int) -> list[Run]:
    """What names and notices are worth where lengths differ much, on a day with an outage."""
    drawn = draw_outage_day(seed, heatwave().grid.start, VARIED)
    if not drawn.outages:
        return []
    named = by_several_names(drawn, seed, VARIED)
    runs = _of_names(named, SHARP, seed, VARIED)
    return runs + _of_names(before_the_onset(named), SILENT, seed, VARIED)


def _of_names(
    day: OutageDay, kind: str, seed: int, climate: OutageClimate | None = None
) -> list[Run]:
    """The policies of the part ``names`` on a day."""
    base = heatwave()
    scenario = with_outage_day(base, day, climate)
    told = with_outage_day(base, with_notices(day, base.grid.start, seed), climate)
    told = replace(
        told,
        outage_statistics=replace(
            told.outage_statistics,
            notice_h=NOTICE_H,
            notice_share=NOTICE_SHARE,
            notice_false_share=FALSE_SHARE,
        ),
    )
    return [
        _run(told if policy == NOTICE else scenario, day, policy, kind, seed) for policy in OF_NAMES
    ]


def _runs(
    base: Scenario,
    seed: int,
    policies: Sequence[str] | Mapping[str, str],
    errors: Mapping[str, tuple[float, float]],
) -> list[Run]:
    """Policies on the same day, with each error of their beliefs."""
    day = draw_outage_day(seed, base.grid.start)
    runs = []
    for wrong, (shift_h, factor) in errors.items():
        said = replace(day, warnings=biased(day.warnings, shift_h, factor))
        scenario = with_outage_day(base, said)
        runs += [_run(scenario, day, policy, wrong, seed) for policy in policies]
    return runs


def _run(scenario: Scenario, day: OutageDay, policy: str, wrong: str, seed: int) -> Run:
    begin = time.process_time()
    run = run_policy(scenario, policy, seed)
    figures = summarise(run)
    solved = run.steps.dropna(subset="gap")  # a plan of the whole day is solved once
    critical = run.customers["tier"] == scenario.tiers[0]
    held = scenario.batteries.energy_kwh
    last = run.batteries["soc_end"].to_numpy(float)[-len(held) :]
    more_kwh = float((last - scenario.batteries.soc_initial) @ held)
    price = float(scenario.price_gbp_per_kwh.min() / scenario.batteries.eta_charge.mean())
    return Run(
        seed=seed,
        kind=day.kind,
        policy=policy,
        wrong=wrong,
        resilience=figures["resilience"],
        cost_gbp=figures["cost_gbp"] - price * more_kwh,
        critical_lost_h=float((critical & ~run.customers["served"].astype(bool)).sum())
        * scenario.grid.dt_h,
        gap_max=float(solved["gap"].max()),
        uncertified=int((solved["status"] != "optimal").sum()),
        fallbacks=figures["fallbacks"],
        process_s=time.process_time() - begin,
    )


# Reports.


def paired(runs: Sequence[Run], policy: str, wrong: str, value: Callable[[Run], Any]) -> Floats:
    """A value of each day of a policy, in the order of the seeds."""
    return by_seed(runs, value, policy=policy, wrong=wrong)


def with_outage(runs: Sequence[Run]) -> list[Run]:
    """Runs of days that had an outage."""
    return [run for run in runs if run.resilience is not None]


def _resilience(run: Run) -> float:
    """That of a day, NaN where it had no outage."""
    return np.nan if run.resilience is None else run.resilience


def worst(resilience: Floats) -> float:
    """Mean of the worst twentieth of the days, one at least."""
    count = max(round(WORST_SHARE * len(resilience)), 1)
    return float(np.sort(resilience)[:count].mean())


def closed(runs: Sequence[Run], policy: str, wrong: str = "") -> Estimate:
    """Share of the gap from the likely outage to the known one that a policy closes.

    The interval is the bootstrap's, over paired days.
    """
    columns = [
        paired(runs, name, wrong, lambda run: run.resilience)
        for name in ("likely", policy, "known")
    ]
    likely, mine, known = columns
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(likely), (9999, len(likely)))
    gap = (known - likely)[drawn].mean(axis=1)
    share = (mine - likely)[drawn].mean(axis=1) / np.where(gap > 0.0, gap, np.nan)
    low, high = np.nanquantile(share, [0.025, 0.975])
    mean = (mine - likely).mean() / (known - likely).mean()
    return Estimate(float(mean), float(low), float(high))


def figure(runs: Sequence[Run]) -> Figure:
    """Resilience of every policy: each outage day as a dot, mean and interval beside."""
    drawn = Figure(figsize=(8.0, 4.4), layout="constrained")
    left, right = drawn.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    outages = with_outage(runs)
    names = list(POLICIES)[::-1]
    likely = paired(outages, "likely", "", lambda run: run.resilience)
    for row, name in enumerate(names):
        found = paired(outages, name, "", lambda run: run.resilience)
        jitter = np.random.default_rng(row).uniform(-0.28, 0.28, len(found))
        left.plot(found, row + jitter, ".", color="#B8B8B8", markersize=3)
        left.plot(found.mean(), row, "o", color=BLUE)
        left.plot(worst(found), row, "v", color="#B03A2E", markersize=6)
        gain = Estimate.of(found - likely)
        error = [[gain.mean - gain.low], [gain.high - gain.mean]]
        right.errorbar(gain.mean, row, xerr=error, fmt="o", color=BLUE, capsize=4)
    left.set_yticks(range(len(names)), [POLICIES[name] for name in names])
    left.set_xlabel("resilience R")
    right.set_xlabel("R gained over the likely outage")
    right.axvline(0.0, color="#666666", linewidth=0.8)
    for ax in (left, right):
        draw_grid(ax, axis="x")
    drawn.suptitle(
        f"{len(likely)} outage days: every day (grey), mean (blue), worst 5 % (red); "
        "right: mean gain, 95 %",
        fontsize=10,
    )
    return drawn


def _policies_text(runs: Sequence[Run], policies: Mapping[str, str] = POLICIES) -> str:
    """The table of the policies."""
    outages = with_outage(runs)
    likely = paired(outages, "likely", "", lambda run: run.resilience)
    all_cost = paired(runs, "likely", "", lambda run: run.cost_gbp)
    rows = []
    for name, words in policies.items():
        found = paired(outages, name, "", lambda run: run.resilience)
        cost = paired(runs, name, "", lambda run: run.cost_gbp)
        critical = paired(outages, name, "", lambda run: run.critical_lost_h)
        rows.append(
            (
                words,
                f"{found.mean():.4f}",
                f"{worst(found):.3f}",
                Estimate.of(found - likely).text("+.4f"),
                closed(outages, name).text(".2f"),
                f"{(found < likely - 1e-9).mean():.0%}",
                f"{critical.mean():.2f}",
                f"{cost.sum() / all_cost.sum() - 1.0:+.2%}",
                f"{paired(runs, name, '', lambda run: run.process_s).mean():.2f}",
            )
        )
    head = (
        "what is known",
        "R",
        "worst 5 %",
        "R - likely",
        "gap closed",
        "days worse than likely",
        "critical customer hours lost",
        "cost",
        "processor s a day",
    )
    return markdown_table(head, rows)


def _kinds_text(runs: Sequence[Run]) -> str:
    """Days by kind, and what each costs."""
    rows = []
    for kind in sorted({run.kind for run in runs}):
        of_kind = [run for run in runs if run.kind == kind]
        days = len({run.seed for run in of_kind})
        cells: list[Any] = [kind, days]
        for name in POLICIES:
            found = paired(of_kind, name, "", _resilience)
            cost = paired(of_kind, name, "", lambda run: run.cost_gbp).mean()
            served = "" if np.isnan(found).all() else f"R {found.mean():.3f}, "
            cells.append(f"{served}GBP {cost:,.0f}")
        rows.append(tuple(cells))
    return markdown_table(("days", "count", *POLICIES.values()), rows)


def _names_text(runs: Sequence[Run]) -> str:
    """The table of messages by several names, and what the last one gains, day by day."""
    outages = with_outage(runs)
    gains = []
    for one, other in (("belief", BY_NAME), (NOTICE, "belief")):
        off = [paired(outages, name, "", lambda run: run.critical_lost_h) for name in (one, other)]
        found = [paired(outages, name, "", lambda run: run.resilience) for name in (one, other)]
        gains.append(
            f"{OF_NAMES[one]} less {OF_NAMES[other]}: R "
            f"{Estimate.of(found[0] - found[1]).text('+.4f')}, critical customer hours "
            f"{Estimate.of(off[0] - off[1]).text('+.2f')}."
        )
    return "\n\n".join([_policies_text(runs, OF_NAMES), *gains])


def _notice_text(runs: Sequence[Run]) -> str:
    """What the last message and a notice gain on days of each kind, day by day."""
    rows = []
    for kind in (SHARP, SILENT):
        found = {name: paired(runs, name, kind, lambda run: run.resilience) for name in OF_NAMES}
        shares = [closed(runs, name, kind).text(".2f") for name in (BY_NAME, "belief", NOTICE)]
        by_last, by_notice = (
            Estimate.of(found[one] - found[other]).text("+.4f")
            for one, other in (("belief", BY_NAME), (NOTICE, "belief"))
        )
        rows.append((kind, len(found["belief"]), *shares, by_last, by_notice))
    head = (
        "days",
        "number",
        "closed by name",
        "by the last message",
        "with notices",
        "R by the last message",
        "R by notices",
    )
    return markdown_table(head, rows)


def _wrong_text(runs: Sequence[Run]) -> str:
    """The table of wrong beliefs."""
    outages = with_outage(runs)
    rows = []
    for wrong in WRONG:
        likely = paired(outages, "likely", wrong, lambda run: run.resilience)
        belief = paired(outages, "belief", wrong, lambda run: run.resilience)
        costs = [
            paired(runs, name, wrong, lambda run: run.cost_gbp).sum()
            for name in ("likely", "belief")
        ]
        rows.append(
            (
                wrong,
                f"{likely.mean():.4f}",
                f"{belief.mean():.4f}",
                Estimate.of(belief - likely).text("+.4f"),
                f"{worst(likely):.3f}",
                f"{worst(belief):.3f}",
                f"{costs[1] / costs[0] - 1.0:+.2%}",
            )
        )
    head = (
        "durations believed",
        "R likely",
        "R belief",
        "difference",
        "worst 5 % likely",
        "worst 5 % belief",
        "cost",
    )
    return markdown_table(head, rows)


def _soundness(runs: Sequence[Run]) -> str:
    """What the certificates and the guard say of all runs."""
    return (
        f"Windows that are not certified: {sum(run.uncertified for run in runs)}; largest gap "
        f"{max(run.gap_max for run in runs):.1e}; steps with a fallback: "
        f"{sum(run.fallbacks for run in runs)}."
    )


def _write(part: Part, runs: Sequence[Run], wall_s: float, folder: Path) -> Path:
    """Figure, JSON, Markdown and HTML of a part; returns the Markdown file."""
    name = f"uncertain-{part}"
    days = len({run.seed for run in runs})
    outages = len({run.seed for run in with_outage(runs)})
    texts = {"wrong": _wrong_text, "names": _names_text, "notice": _notice_text}
    parts = [texts[part](runs)] if part in texts else [_policies_text(runs), _kinds_text(runs)]
    if part not in texts:
        parts.insert(1, f"![Resilience by what is known]({name}.svg)")
    parts.append(
        f"{days} days, {outages} of them with an outage; {_soundness(runs)} Intervals are 95 % "
        f"bootstrap intervals over paired days. Costs are those of all days, less what it costs to "
        f"charge what batteries hold more in the end. Wall time {wall_s / 60:.1f} min, {machine()}."
    )
    drawn = None if part in texts else figure(runs)
    title = "Outages that nobody knows exactly"
    return report(folder / name, title, "\n\n".join(parts), runs, wall_s, drawn)


def _writer(part: Part) -> Callable[[Sequence[list[Run]], float, Path], Path]:
    def write(days: Sequence[list[Run]], wall_s: float, folder: Path) -> Path:
        return _write(part, [run for day in days for run in day], wall_s, folder)

    return write


PARTS: dict[Part, Study[list[Run]]] = {
    "heatwave": Study(heatwave_day, _writer("heatwave"), width=TABLE_WIDTH),
    "cigre": Study(cigre_day, _writer("cigre"), width=TABLE_WIDTH),
    "wrong": Study(wrong_day, _writer("wrong"), width=TABLE_WIDTH),
    "names": Study(names_day, _writer("names"), width=TABLE_WIDTH),
    "notice": Study(notice_day, _writer("notice"), width=TABLE_WIDTH),
}


def main(
    days: Days = 240,
    seed: FirstSeed = 0,
    jobs: Jobs = -1,
    results: Results = STUDIES,
    scheduler: Scheduler = None,
    part: Annotated[
        Part, typer.Option(help="The paper's feeder, another one, wrong beliefs, several names.")
    ] = "heatwave",
) -> None:
    """Run what may be known of outages on the same uncertain days."""
    PARTS[part].play(Span(seed, days), Where(jobs, scheduler), results)


if __name__ == "__main__":
    typer.run(main)
