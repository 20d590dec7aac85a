"""What switching rules buy and cost: resilience against switching actions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.config import Config
from experiments.drawing import FULL, LINES, MPC, WIDTH_IN, draw_grid
from experiments.jobs import Job
from experiments.results import DayResult
from experiments.rows import Row
from experiments.runner import Results
from vppres.contract.forecast import ForecastErrors
from vppres.day.options import RunOptions
from vppres.kinds.customer.data import SwitchingRules
from vppres.report.plots.drawing import GREEN, GREY

LABEL = "not in the paper"
TITLE = "Switching rules"
PAPER = (
    "The paper may switch every customer every hour. Asked here: with at least two hours "
    "served or unserved, actions beyond one off/on pair per customer fall by at least half "
    "and R falls by at most 0.01."
)

TARGET_H = 2.0
MOST_LOST = 0.01
FREE = SwitchingRules()
STAY = SwitchingRules(stay_restored=True)


@dataclass(frozen=True)
class Outcome:
    """Means over all days under one rule, and the largest loss of resilience on one day."""

    resilience: float
    lost: float
    lost_most: float
    actions: float
    beyond: float
    relaxed: int


def min_time(hours: float) -> SwitchingRules:
    """At least so long served and unserved."""
    return SwitchingRules(min_served_h=float(hours), min_unserved_h=float(hours))


def price(per_action: float) -> SwitchingRules:
    """Every action at a price in weighted customer hours."""
    return SwitchingRules(price_per_action=per_action)


def rules(config: Config) -> dict[str, SwitchingRules]:
    """Every rule, by what is written at its point."""
    return {
        **{f"{h:g} h" if h else "no rule": min_time(h) for h in config["min_times_h"]},
        **{f"{p:g}": price(p) for p in config["prices"]},
        "stay": STAY,
    }


def errors(config: Config) -> list[tuple[ForecastErrors, int]]:
    """Forecast errors and seed of each day: none, random ones, and biases of load or PV."""
    alpha = config["alpha_per_h"]
    random = ForecastErrors(load_alpha_per_h=alpha, pv_alpha_per_h=alpha)
    return [
        (ForecastErrors(), 0),
        *((random, seed) for seed in range(config["error_seeds"])),
        *((ForecastErrors(load_bias=b), 0) for b in config["biases"]),
        *((ForecastErrors(pv_bias=b), 0) for b in config["biases"]),
    ]


def jobs(config: Config) -> list[Job]:
    """Every rule with the MPC; no rule and the target's with the full horizon."""
    found = [job for rule in rules(config).values() for job in _days(config, rule)]
    for rule in (FREE, min_time(TARGET_H)):
        found += _days(config, rule, "full-horizon")
    return found


def outcome(
    config: Config, results: Results, rule: SwitchingRules, controller: str = "mpc"
) -> Outcome:
    """Figures of a rule beside those of no rule on the same days."""
    days = [results[job] for job in _days(config, rule, controller)]
    free = [results[job] for job in _days(config, FREE, controller)]
    lost = np.array([f.resilience - d.resilience for f, d in zip(free, days, strict=True)])
    return Outcome(
        float(np.mean([d.resilience for d in days])),
        float(lost.mean()),
        float(lost.max()),
        _mean(days, "switching_actions"),
        _mean(days, "actions_beyond_one_pair"),
        int(sum(d.summary["switching_relaxed_steps"] for d in days)),
    )


def figure(config: Config, results: Results) -> Figure:
    """Resilience against actions beyond one pair, and against all actions."""
    found = {name: outcome(config, results, rule) for name, rule in rules(config).items()}
    picture = Figure(figsize=(WIDTH_IN, 4.4), layout="constrained")
    left, right = picture.subplots(1, 2, sharey=True)
    _curves(left, config, {name: (o.beyond, o.resilience) for name, o in found.items()})
    _curves(right, config, {name: (o.actions, o.resilience) for name, o in found.items()})
    _bars(left, found["no rule"])
    left.set_xlabel("Actions beyond one off/on pair per customer")
    right.set_xlabel("All switching actions")
    left.set_ylabel("Resilience R")
    picture.suptitle(f"Switching rules, MPC, mean of {len(errors(config))} days", fontsize=11)
    handles = left.get_legend_handles_labels()[0]
    picture.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return picture


def rows(config: Config, results: Results) -> list[Row]:
    """The two bars, for each controller."""
    found = []
    for name, controller in ((MPC, "mpc"), (FULL, "full-horizon")):
        free = outcome(config, results, FREE, controller)
        two = outcome(config, results, min_time(TARGET_H), controller)
        reason = (
            f"{free.beyond:.2f} actions a day without the rule, {two.beyond:.2f} with it; R "
            f"{free.resilience:.4f} and {two.resilience:.4f}, at most {two.lost_most:.4f} "
            f"lost on one day; duties let go in {two.relaxed} steps."
        )
        half = two.beyond <= free.beyond / 2
        lost = two.lost <= MOST_LOST
        found += [
            Row(
                "S1",
                f"Actions beyond one pair, at least {TARGET_H:g} h: {name}",
                "at most half",
                f"{two.beyond:.2f} of {free.beyond:.2f}",
                "",
                "",
                half,
                "" if half else reason,
            ),
            Row(
                "S2",
                f"Resilience lost, at least {TARGET_H:g} h: {name}",
                f"at most {MOST_LOST:g}",
                f"{two.lost:.4f}",
                "",
                "",
                lost,
                "" if lost else reason,
            ),
        ]
    return found


def ours(config: Config, results: Results) -> str:
    """What each rule does, in a sentence each."""
    free = outcome(config, results, FREE)
    lines = [
        f"Without a rule the MPC switches {free.actions:.1f} times a day, {free.beyond:.2f} "
        f"of them beyond one off/on pair, at R = {free.resilience:.4f}."
    ]
    for name, rule in rules(config).items():
        if rule != FREE:
            o = outcome(config, results, rule)
            lines.append(
                f"{_words(name, rule)}: {o.actions:.1f} and {o.beyond:.2f}, R lower by "
                f"{o.lost:.4f} (most on a day: {o.lost_most:.4f})."
            )
    return " ".join(lines)


def _days(config: Config, rule: SwitchingRules, controller: str = "mpc") -> list[Job]:
    """The days under a rule."""
    return [
        Job(options=RunOptions(controller, errors=error, seed=seed, switching=rule))
        for error, seed in errors(config)
    ]


def _mean(days: list[DayResult], name: str) -> float:
    """Mean of a figure of the summary."""
    return float(np.mean([day.summary[name] for day in days]))


def _words(name: str, rule: SwitchingRules) -> str:
    """A rule in words."""
    if rule.price_per_action:
        return f"At a price of {name} for each action"
    return "Once restored, stay" if rule.stay_restored else f"At least {name} served or unserved"


def _bars(ax: Axes, free: Outcome) -> None:
    """What is asked for: half of the actions, at most 0.01 of resilience."""
    lowest = free.resilience - MOST_LOST
    half = free.beyond / 2
    ax.axhline(lowest, color=GREY, linestyle="--", linewidth=1.0)
    ax.axvline(half, color=GREY, linestyle="--", linewidth=1.0)
    ax.text(
        0.98,
        lowest,
        f"no rule \N{MINUS SIGN} {MOST_LOST:g}",
        ha="right",
        va="bottom",
        transform=ax.get_yaxis_transform(),
        fontsize=8,
        color=GREY,
    )
    ax.text(
        half,
        0.5,
        " half of no rule",
        rotation=90,
        ha="right",
        va="center",
        transform=ax.get_xaxis_transform(),
        fontsize=8,
        color=GREY,
    )


def _curves(ax: Axes, config: Config, points: Mapping[str, tuple[float, float]]) -> None:
    """Minimum times and prices as curves from no rule on, the last rule as a point."""
    times = [f"{h:g} h" if h else "no rule" for h in config["min_times_h"]]
    prices = ["no rule", *(f"{p:g}" for p in config["prices"])]
    for names, style, offset, label in (
        (times, LINES[MPC] | {"marker": "o"}, (6, -11), "minimum time served and unserved"),
        (prices, LINES[FULL] | {"marker": "s"}, (-12, 6), "price of an action"),
        (
            ["stay"],
            {"color": GREEN, "marker": "D", "linestyle": "none"},
            (6, 3),
            "once restored, stay",
        ),
    ):
        x, y = zip(*(points[name] for name in names), strict=True)
        ax.plot(x, y, label=label, **style)
        for name, at in zip(names, zip(x, y, strict=True), strict=True):
            if name != "no rule" or names is times:
                ax.annotate(name, at, xytext=offset, textcoords="offset points", fontsize=8)
    draw_grid(ax)
    ax.margins(x=0.14, y=0.1)
