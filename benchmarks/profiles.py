"""From measured rows to ratios, performance profiles and tables of certificates."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.instances import packaged
from benchmarks.windows import BASE, NOT_ADMITTED
from vppres.report.plots.drawing import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    RULE_COLOUR,
    SKY,
    VERMILLION,
)

GAP_REL = 1e-4
GAP_ABS = 5e-3
CERTIFY_S = 10.0
AGREEMENT_REL = 1e-4
H5_STEPS = 6
AT_LIMIT_PU = 1e-5
CURTAILED_KWH = 1e-2
"""What counts as at the limit, and as curtailed, in an answer."""
OUTAGE_PLACES = ("across", "inside")
COLOURS = (BLUE, SKY, VERMILLION, ORANGE, GREEN, PURPLE, BLACK, GREY)


def times(rows: pd.DataFrame) -> pd.DataFrame:
    """Seconds to the gap by instance and method: infinite if unsolved, NaN if not admitted."""
    seconds = rows["solve_s"].where(rows["status"] == "optimal", np.inf)
    seconds = seconds.where(rows["status"] != NOT_ADMITTED)
    return rows.assign(seconds=seconds).pivot(index="instance", columns="method", values="seconds")


def profile(seconds: pd.DataFrame, factors: np.ndarray) -> pd.DataFrame:
    """Share of instances that each method solves within a factor of the best method.

    Parameters
    ----------
    seconds : DataFrame
        As from :func:`times`. Only instances that every method admits are counted; one that no
        method solves counts against all.
    factors : array
        Factors from 1.

    Returns
    -------
    DataFrame
        Factors by methods.
    """
    common = seconds.dropna()
    best = common.min(axis=1)
    ratio = common.div(best, axis=0).fillna(np.inf)  # inf / inf: nobody solved it
    return pd.DataFrame(
        {method: [(ratio[method] <= factor).mean() for factor in factors] for method in common},
        index=pd.Index(factors, name="factor"),
    )


def draw_profile(seconds: pd.DataFrame, title: str) -> Figure:
    """The profile as a figure, up to the largest factor that matters."""
    common = seconds.dropna()
    worst = common.div(common.min(axis=1), axis=0).replace(np.inf, np.nan).max().max()
    factors = np.geomspace(1.0, max(2.0, 1.2 * worst) if np.isfinite(worst) else 2.0, 200)
    shares = profile(seconds, factors)
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    ax = figure.subplots()
    for i, method in enumerate(shares):
        ax.step(
            factors,
            shares[method],
            where="post",
            label=method,
            color=COLOURS[i % len(COLOURS)],
            linestyle=("-", "--", ":")[i % 3],
        )
    ax.set_xscale("log")
    ax.set_ylim(-0.02, 1.02)
    ax.set_xlabel("Time as a multiple of the fastest method's")
    ax.set_ylabel("Share of instances solved")
    ax.grid(True, color=RULE_COLOUR, linewidth=0.5)
    ax.legend(frameon=False, loc="lower right")
    ax.set_title(f"{title}: {len(common)} instances", fontsize=11)
    return figure


def ratios(rows: pd.DataFrame, base: str = BASE) -> pd.DataFrame:
    """How many times the base's time each method takes: median and 5 to 95 % over the instances.

    An instance that the method does not solve in its time limit enters with the limit, so its ratio
    is a lower bound; ``unsolved`` counts them. ``median at most`` is the median if they took for
    ever: where it is infinite, the time limit and not the method sets the median. Instances that a
    licence refuses do not enter.
    """
    reference = rows[(rows["method"] == base) & (rows["status"] == "optimal")]
    base_s = reference.set_index("instance")["solve_s"]
    found = []
    for method, part in rows[rows["method"] != base].groupby("method"):
        admitted = part[(part["status"] != NOT_ADMITTED) & part["instance"].isin(base_s.index)]
        spent = admitted["solve_s"].where(
            admitted["status"] == "optimal", admitted[["solve_s", "limit_s"]].max(axis=1)
        )
        ratio = spent.to_numpy() / base_s[admitted["instance"]].to_numpy()
        spread = np.quantile(ratio, [0.05, 0.5, 0.95]) if len(ratio) else np.full(3, np.nan)
        open_end = np.sort(np.where(admitted["status"] == "optimal", ratio, np.inf))
        found.append(
            {
                "method": method,
                "instances": len(admitted),
                "unsolved": int((admitted["status"] != "optimal").sum()),
                "not admitted": int((part["status"] == NOT_ADMITTED).sum()),
                "ratio p5": spread[0],
                "ratio median": spread[1],
                "ratio p95": spread[2],
                "median at most": open_end[len(ratio) // 2] if len(ratio) else np.nan,
                "share slower": float((ratio > 1).mean()) if len(ratio) else np.nan,
            }
        )
    return pd.DataFrame(found)


def outage_windows(rows: pd.DataFrame) -> pd.DataFrame:
    """Ordinary windows at H = 5 that meet the outage."""
    return rows[
        (rows["group"] == "ordinary")
        & (rows["steps"] == H5_STEPS)
        & rows["place"].isin(OUTAGE_PLACES)
    ]


def split_by_time(
    rows: pd.DataFrame, method: str, seconds: float
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of the instances for which a method takes longer, and of all others."""
    mine = rows[rows["method"] == method]
    longer = rows["instance"].isin(mine.loc[mine["solve_s"] > seconds, "instance"])
    return rows[longer], rows[~longer]


def certified(rows: pd.DataFrame) -> pd.Series:
    """Whether each row is certified to both gaps in time."""
    return (rows["gap"] <= GAP_REL) & (rows["gap_abs"] <= GAP_ABS) & (rows["solve_s"] <= CERTIFY_S)


def certificates(rows: pd.DataFrame, method: str = BASE) -> pd.DataFrame:
    """Certified share and times of a method by group and number of steps."""
    mine = rows[rows["method"] == method].copy()
    mine["certified"] = certified(mine)
    whole = mine.assign(steps="all")
    groups = pd.concat([mine, whole]).groupby(["group", "steps"], sort=False)
    table = groups.agg(
        instances=("instance", "count"),
        certified=("certified", "sum"),
        share=("certified", "mean"),
        worst_gap=("gap", "max"),
        worst_gap_abs=("gap_abs", "max"),
        median_s=("solve_s", "median"),
        p95_s=("solve_s", lambda s: s.quantile(0.95)),
        max_s=("solve_s", "max"),
    )
    return table.reset_index()


def stress(rows: pd.DataFrame, method: str = BASE) -> pd.DataFrame:
    """In how many stressed instances the answer meets the voltage limit or has to curtail."""
    mine = rows[(rows["method"] == method) & (rows["group"] == "stressed")]
    low = mine["v_min_pu"] <= packaged().network.v_min_pu + AT_LIMIT_PU
    lost = mine["curtailed_kwh"] > CURTAILED_KWH
    return pd.DataFrame(
        [
            {
                "stressed instances": len(mine),
                "at the voltage limit": int(low.sum()),
                "curtailed": int(lost.sum()),
                "either": int((low | lost).sum()),
            }
        ]
    )


def agreement(rows: pd.DataFrame, base: str = BASE) -> pd.DataFrame:
    """Objectives of the base against each monolith, on the instances that both solve.

    ``below`` is how far the base falls short of the monolith, relative: it must not exceed 1e-4.
    ``above`` may: an inscribed polygon takes capacity from the monolith. ``above bound`` is how far
    the base's value exceeds the monolith's bound, which only cones may not allow.
    """
    solved = rows[rows["status"] == "optimal"].set_index("instance")
    mine = solved[solved["method"] == base]
    found = []
    for method, part in solved[~solved["method"].str.startswith("decomposed")].groupby("method"):
        both = part.join(mine["value"].rename("mine"), how="inner")
        scale = both["value"].abs().clip(lower=1e-9)
        less = (both["value"] - both["mine"]) / scale
        found.append(
            {
                "method": method,
                "instances": len(both),
                "below": float(less.max()),
                "above": float((-less).max()),
                "above bound": float(((both["mine"] - both["bound"]) / scale).max()),
                "agree": int((less <= AGREEMENT_REL).sum()),
            }
        )
    columns = ["method", "instances", "below", "above", "above bound", "agree"]
    return pd.DataFrame(found, columns=columns)


def cost_levels(rows: pd.DataFrame, method: str = BASE) -> pd.DataFrame:
    """Largest share by which the cost could be lower, at H = 5 in windows without an outage."""
    mine = rows[
        (rows["method"] == method)
        & (rows["steps"] == H5_STEPS)
        & ~rows["place"].isin(OUTAGE_PLACES)
    ]
    share = mine["cost_gap_gbp"] / mine["cost_gbp"].clip(lower=1e-9)
    table = (
        mine.assign(share=share)
        .groupby("group")
        .agg(
            instances=("share", "count"),
            largest=("share", "max"),
            within=("share", lambda s: int((s <= 1e-3).sum())),
        )
    )
    return table.rename(columns={"within": "within 0.1 %"}).reset_index()
