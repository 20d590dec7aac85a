"""Sections and bars of the report, from the measured tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from benchmarks import profiles
from benchmarks.day import day_table, stage_table, step_table
from benchmarks.deadlines import ALLOWED_S, NAMED, by_turn, deadline_table
from benchmarks.frame.store import Row
from benchmarks.licensed import LICENSED
from benchmarks.race import draw_certified
from benchmarks.race import summary as race_summary
from benchmarks.report import Bar, Section
from benchmarks.scaling import FITTED_BUSES, draw_scaling, exponents
from benchmarks.throughput import throughput_table
from benchmarks.worker import worker_table

MIN_RATIO = 25.0
LONG_S = 1.0
"""Time of a monolith from which on the ratio counts; below it the method need only be ahead."""
STRESSED_SHARE = 0.95
HARD_SHARE = 0.97
BINDING = 30
DAY_S = 1.0
STEP_P95_S = 0.15
STEP_MAX_S = 1.5
PLAN_S = 1.0
OUTSIDE_SHARE = 0.3
LARGE_S = {1021: 10.0, 2993: 30.0, 9997: 120.0}
"""What a window of so many buses may take."""
LARGE_P95_S = 3.0
LARGE_GAP = 1e-3
LARGE_MB = 4096.0
FITTED_WINDOWS = 20
EXPONENT = 1.3
THOUSAND_DAYS_MIN = 12.0
ISOLATION_RATIO = 1.1


def window_section(rows: pd.DataFrame) -> Section:
    """Certificates, agreement, ratios and profiles."""
    seconds = profiles.times(rows)
    methods = [str(method) for method in seconds]
    general = [
        m
        for m in methods
        if m.startswith("decomposed") or (m.endswith("16-gon") and not _licensed(m))
    ]
    figures = {"profile": profiles.draw_profile(seconds[general], "All instances")}
    for form in ("16-gon", "4-gon", "cones"):
        of_form = [m for m in methods if m.startswith("decomposed") or m.endswith(form)]
        admitted = [m for m in of_form if seconds[m].notna().any()]
        if any(_licensed(m) for m in admitted):
            figures[f"profile_{form}"] = profiles.draw_profile(
                seconds[admitted], f"Windows that the licences admit, {form}"
            )
    text = (
        "Tables: certificates of the decomposed method; what binds in the stressed instances; "
        "the objective against each monolith; times as multiples of the decomposed method's "
        "on all instances, then on the ordinary windows at H = 5 that meet the outage; the "
        "cost level at H = 5 without an outage."
    )
    tables = (
        profiles.certificates(rows),
        profiles.stress(rows),
        profiles.agreement(rows),
        profiles.ratios(rows),
        profiles.ratios(profiles.outage_windows(rows)),
        profiles.cost_levels(rows),
    )
    return Section("Windows", text, tables, figures)


def window_bars(rows: pd.DataFrame) -> list[Bar]:
    """What must be shown of windows."""
    agree = profiles.agreement(rows)
    certs = profiles.certificates(rows)
    costs = profiles.cost_levels(rows)
    found = [
        Bar(
            "same objective as the monolith, 1e-4 relative",
            f"largest shortfall {agree['below'].max():.1e}",
            bool((agree["below"] <= profiles.AGREEMENT_REL).all()) if len(agree) else None,
        )
    ]
    for group, least in (("ordinary", 1.0), ("stressed", STRESSED_SHARE)):
        part = certs[(certs["group"] == group) & (certs["steps"] == "all")]
        share = float(part["share"].sum()) if len(part) else np.nan
        found.append(
            Bar(
                f"{group} instances certified within 10 s: {least:.0%}",
                f"{share:.1%} of {int(part['instances'].sum())}",
                share >= least if len(part) else None,
            )
        )
    stress = profiles.stress(rows)
    solved = _only(stress, "stressed instances")
    binding = _only(stress, "either")
    found.append(
        Bar(
            f"stressed instances in which voltages bind or PV is curtailed: {BINDING}",
            f"{binding:g} of {solved:g}",
            binding >= BINDING if solved >= BINDING else None,
        )
    )
    worst = costs["largest"].max()
    found.append(
        Bar(
            "cost level at H = 5 without an outage: 0.1 %",
            f"largest {worst:.2%}",
            bool(worst <= 1e-3) if len(costs) else None,
        )
    )
    return found + _ratio_bars(rows)


def _ratio_bars(rows: pd.DataFrame) -> list[Bar]:
    outage = profiles.outage_windows(rows)
    whole = profiles.ratios(rows)
    found = []
    for solver in ("highs", "scip"):
        method = f"monolithic/{solver}/16-gon"
        long, short = profiles.split_by_time(outage, method, LONG_S)
        where = "outage windows at H = 5"
        beyond = f"{where} for which it takes more than {LONG_S:g} s"
        found.append(_ratio_bar(profiles.ratios(long), method, MIN_RATIO, beyond))
        found.append(_ratio_bar(profiles.ratios(short), method, 1.0, f"all other {where}"))
    for method in whole["method"]:
        if _licensed(method):
            found.append(_ratio_bar(whole, method, 1.0, "windows that the licence admits"))
    return found


def _ratio_bar(table: pd.DataFrame, method: str, least: float, where: str) -> Bar:
    row = table[table["method"] == method] if len(table) else table
    claim = f"{least:g} times as fast as {method} in the median, {where}"
    if not len(row) or not row["instances"].iloc[0]:
        return Bar(claim, "no instance", None)
    median, low, high = (float(row[f"ratio {q}"].iloc[0]) for q in ("median", "p5", "p95"))
    undecided = median < least <= float(row["median at most"].iloc[0])
    return Bar(
        claim,
        f"{median:.1f} ({low:.1f} to {high:.1f})"
        + (", cut off by the time limit" if undecided else ""),
        None if undecided else median >= least,
    )


def _licensed(method: str) -> bool:
    return any(f"/{solver}/" in method for solver in LICENSED)


def race_section(rows: pd.DataFrame) -> Section:
    """The windows of both tables against the better monolith."""
    text = (
        "Processor time of one process. A monolith runs beside a window that takes t seconds for "
        "(t - 0.5) / 2 seconds at most: where it is certified by then, the window is slower. Then "
        "the windows that are not certified in 10 s, and those that are slower."
    )
    columns = ["window", "kind", "buses", "steps", "seconds", "monolith_s", "gap", "status"]
    odd = rows[~rows["certified"] | rows["slower"]]
    return Section(
        "Windows that users bring",
        text,
        (race_summary(rows), odd[columns]),
        {"certified": draw_certified(rows)},
    )


def race_bars(rows: pd.DataFrame) -> list[Bar]:
    """What must be shown of the windows of both tables."""
    found = []
    for least, groups in ((1.0, ["ordinary"]), (HARD_SHARE, ["stressed", "hard"])):
        part = rows[rows["group"].isin(groups)]
        share = float(part["certified"].mean())
        found.append(
            Bar(
                f"{' and '.join(groups)} instances certified in 10 s of CPU time: {least:.0%}",
                f"{share:.1%} of {len(part)}",
                share >= least if len(part) else None,
            )
        )
    slower = int(rows["slower"].sum())
    claim = "slower than twice the better of HiGHS and SCIP and 0.5 s: none"
    found.append(Bar(claim, f"{slower} of {len(rows)}", slower == 0))
    return found


def day_section(tables: dict[str, pd.DataFrame]) -> Section:
    """The closed loop."""
    later = tables["ideal"][tables["ideal"]["run"] == "later"]
    text = (
        "Tables: the ideal day, first run (which compiles) and median of the later ones; steps "
        "of all error settings; where the time of the later ideal MPC days goes."
    )
    return Section(
        "A day at H = 5",
        text,
        (
            day_table(tables["ideal"]),
            step_table(tables["steps"]),
            stage_table(later[later["controller"] == "mpc"]),
        ),
    )


def day_bars(tables: dict[str, pd.DataFrame]) -> list[Bar]:
    """What must be shown of a day."""
    table = day_table(tables["ideal"])
    later = table[table["run"] == "later"]
    mpc, plan = (later[later["controller"] == name] for name in ("mpc", "full-horizon"))
    steps = step_table(tables["steps"]).tail(1)
    return [
        _at_most("a day at H = 5", _only(mpc, "total_s"), DAY_S, "s"),
        _at_most("a step over all error settings, p95", _only(steps, "p95_s"), STEP_P95_S, "s"),
        _at_most("a step over all error settings, worst", _only(steps, "max_s"), STEP_MAX_S, "s"),
        _at_most("the ideal 24-step plan", _only(plan, "plan_s"), PLAN_S, "s"),
        _at_most(
            "share of a day outside the solvers", _only(mpc, "outside_share"), OUTSIDE_SHARE, ""
        ),
    ]


def scaling_section(rows: pd.DataFrame) -> Section:
    """Cost against size."""
    columns = [
        "axis",
        "size",
        "n_steps",
        "windows",
        "certified",
        "first_s",
        "median_s",
        "mean_s",
        "p95_s",
        "max_s",
        "gap_max",
        "memory_mb",
        "library_share",
        "main_stage",
    ]
    text = (
        "Each point in a process of its own: windows that meet the outage, in random states, along "
        "the buses with time limits of 8 s to 1,021 buses, then 27 s and 110 s. Seconds are the "
        "processor's. The first solve compiles. Exponents are least-squares fits in logarithms "
        "with 95 % intervals, along the buses to 1,021."
    )
    return Section(
        "Scaling", text, (rows[columns], exponents(rows)), {"scaling": draw_scaling(rows)}
    )


def scaling_bars(rows: pd.DataFrame) -> list[Bar]:
    """What must be shown of size."""
    fits = exponents(rows)
    medians = fits[fits["quantity"] == "median_s"]
    found = [
        _at_most(
            f"exponent in {axis} (median time)",
            _only(medians[medians["axis"] == axis], "exponent"),
            EXPONENT,
            "",
        )
        for axis in ("buses", "steps")
    ]
    fitted = rows[rows["axis"].isin(["buses", "steps"]) & (rows["size"] <= FITTED_BUSES)]
    fewest = int(fitted["windows"].min())
    found.append(
        Bar(
            f"windows of each size that is fitted: at least {FITTED_WINDOWS}",
            f"{fewest}",
            fewest >= FITTED_WINDOWS,
        )
    )
    of_size = {row["size"]: row for _, row in rows[rows["axis"] == "buses"].iterrows()}
    return found + [
        bar
        for size, bars in (
            (1021, _certified_bars),
            (2993, _answered_bars),
            (9997, _joined_bars),
        )
        if size in of_size
        for bar in bars(of_size[size])
    ]


def _certified_bars(row: pd.Series[Any]) -> list[Bar]:
    """What must be shown of 1,021 buses."""
    limit_s = LARGE_S[1021]
    proven = f"{row['certified']} of {row['windows']} certified"
    every = bool(row["certified"] == row["windows"]) and bool(row["max_s"] <= limit_s)
    return [
        Bar(
            f"1,021 buses at H = 5: every window certified in {limit_s:g} s",
            f"{proven}, worst {row['max_s']:.3g} s, largest gap {row['gap_max']:.1e}",
            every,
        ),
        _at_most("1,021 buses at H = 5, p95", float(row["p95_s"]), LARGE_P95_S, "s"),
    ]


def _answered_bars(row: pd.Series[Any]) -> list[Bar]:
    """What must be shown of 3,000 buses."""
    return [
        Bar(
            f"3,000 buses at H = 5: answered in {LARGE_S[2993]:g} s, gap below {LARGE_GAP:g}",
            f"worst {row['max_s']:.3g} s, largest gap {row['gap_max']:.1e}",
            bool(row["max_s"] <= LARGE_S[2993] and row["gap_max"] < LARGE_GAP),
        )
    ]


def _joined_bars(row: pd.Series[Any]) -> list[Bar]:
    """What must be shown of 10,000 buses."""
    return [
        Bar(
            f"10,000 buses at H = 5: an answer with a bound in {LARGE_S[9997]:g} s and 4 GB",
            f"worst {row['max_s']:.3g} s, largest gap {row['gap_max']:.1e}, "
            f"{row['memory_mb'] / 1024:.2g} GB",
            bool(
                row["max_s"] <= LARGE_S[9997]
                and np.isfinite(row["gap_max"])
                and row["memory_mb"] <= LARGE_MB
            ),
        )
    ]


def throughput_section(row: Row) -> Section:
    """Many days at once."""
    return Section(
        "Throughput",
        "MPC days at H = 5 with the reproduction's errors and new seeds, "
        "on all cores, one thread for each process.",
        (throughput_table(row),),
    )


def throughput_bars(row: Row) -> list[Bar]:
    """What must be shown of many days."""
    table = throughput_table(row)
    return [
        _at_most(
            "1,000 MPC days (extrapolated)",
            _only(table, "min for 1,000 days (extrapolated)"),
            THOUSAND_DAYS_MIN,
            "min",
        )
    ]


def worker_section(row: Row) -> Section:
    """What isolation costs."""
    return Section(
        "A process of its own",
        "Every step of the ideal day at H = 5, solved in the "
        "controller's process and in one of its own in turn, problems compiled before. "
        "The processor's time of both processes together.",
        (worker_table(row),),
    )


def worker_bars(row: Row) -> list[Bar]:
    """What must be shown of isolation."""
    return [
        _at_most(
            "a step solved in a process of its own, against in the same: ratio, median",
            row["ratio_median"],
            ISOLATION_RATIO,
            "",
        ),
        Bar(
            "the same answers in both",
            f"{row['equal']} of {row['steps']} steps",
            row["equal"] == row["steps"],
        ),
    ]


def deadline_section(rows: pd.DataFrame) -> Section:
    """How late answers are."""
    return Section(
        "Deadlines",
        "Each window solved twice to each limit: first with nothing compiled, again with what was "
        "compiled then. Seconds beyond the limit, and how many of them the processor worked for "
        f"it: the machine's load was {rows['load'].min():.1f} to {rows['load'].max():.1f}.",
        (deadline_table(rows),),
    )


def deadline_bars(rows: pd.DataFrame) -> list[Bar]:
    """What must be shown of deadlines."""
    solves = by_turn(rows)
    found = []
    for buses, allowed_s in ALLOWED_S.items():
        part = solves[solves["buses"] == buses]
        worst_s = part["late_s"].max()
        within = int((part["late_s"] <= allowed_s).sum())
        measured = (
            f"{within} of {len(part)}, latest {worst_s:.2f} s, "
            f"{part['late_cpu_s'].max():.2f} s of processor"
        )
        found.append(
            Bar(
                f"{buses} buses: answered within the limit and {allowed_s:g} s",
                measured,
                bool(worst_s <= allowed_s) if len(part) else None,
            )
        )
    unnamed = sorted(set(solves["ending"]) - NAMED)
    found.append(
        Bar(
            "every window ends with a status or by name",
            ", ".join(unnamed) or f"{len(solves)} of {len(solves)}",
            not unnamed,
        )
    )
    return found


def _only(table: pd.DataFrame, column: str) -> float:
    """The value of a column in a table of one row."""
    (value,) = table[column]
    return float(value)


def _at_most(what: str, value: float, limit: float, unit: str) -> Bar:
    return Bar(
        f"{what}: at most {limit:g} {unit}".rstrip(), f"{value:.3g} {unit}".rstrip(), value <= limit
    )
