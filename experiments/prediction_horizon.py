"""Figure 1a: resilience and cost of the MPC against its prediction horizon."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments import ideal
from experiments.config import Config
from experiments.drawing import panels
from experiments.jobs import Job
from experiments.rows import Row, asserted, measured, numbers
from experiments.runner import Results
from vppres.core.arrays import Floats
from vppres.report import plot

LABEL = "fig:1a"
TITLE = "MPC prediction horizon"
PAPER = (
    "Short horizons (H below 4 h) see the outage too late and lose resilience. From 4 h on "
    "the MPC reaches the full horizon's resilience of about 0.92; the cost rises with H as "
    "batteries are charged earlier. The paper chooses H = 5."
)

CHOSEN_H = 5
PLATEAU_H = 4


def jobs(config: Config) -> list[Job]:
    """One day for each horizon, and the full horizon."""
    return [*(ideal.mpc(h) for h in config["horizons_h"]), ideal.FULL_HORIZON]


def curves(config: Config, results: Results) -> tuple[Floats, Floats, Floats]:
    """Horizons, resilience and cost."""
    days = [results[ideal.mpc(h)] for h in config["horizons_h"]]
    return (
        np.array(config["horizons_h"], dtype=float),
        np.array([d.resilience for d in days]),
        np.array([d.summary["cost_gbp"] for d in days]),
    )


def figure(config: Config, results: Results) -> Figure:
    """Resilience above, cost below, each with the full horizon as a reference."""
    days = [results[job] for job in jobs(config)]
    picture, (above, below) = panels((3, 2), 5.6, "Prediction horizon, ideal conditions")
    for ax, value in ((above, "resilience"), (below, "cost_gbp")):
        plot.horizon(days, value, ax).label_outer()
        ax.axvline(CHOSEN_H, color="#999999", linewidth=0.8, linestyle=":")
    above.text(
        CHOSEN_H,
        1.01,
        f"H = {CHOSEN_H} h",
        transform=above.get_xaxis_transform(),
        ha="center",
        va="bottom",
        fontsize=8,
    )
    return picture


def rows(config: Config, results: Results) -> list[Row]:
    """R1, R2 and R3."""
    horizons, resilience, cost = curves(config, results)
    full = results[ideal.FULL_HORIZON]
    chosen = results[ideal.mpc(CHOSEN_H)]
    plateau = horizons >= PLATEAU_H
    rising = horizons <= PLATEAU_H
    short = resilience[~plateau]
    before = np.diff(cost[rising])
    return [
        measured("R1", chosen.resilience, ".4f", reason=chosen.evidence),
        measured("R2", chosen.resilience - full.resilience, "+.4f", reason=full.evidence),
        measured("R2b", full.summary["corrections"], ".0f", reason=full.evidence),
        measured(
            "R3a",
            float(np.abs(resilience[plateau] - full.resilience).max()),
            ".4f",
            reason=full.evidence,
        ),
        asserted(
            "R3b",
            {
                "R grows with H up to the plateau": bool((np.diff(resilience[rising]) > 0).all()),
                "every shorter horizon is below the plateau": bool(
                    (short < resilience[plateau].min()).all()
                ),
            },
            f"R = {numbers(short, '.4f')} at H = {numbers(horizons[~plateau], 'g')}",
            reason="Differences from one H to the next: "
            f"{numbers(np.diff(resilience[rising]), '+.4f')}.",
        ),
        asserted(
            "R3c",
            {"each step of H costs more": bool((before > 0).all())},
            f"GBP {numbers(cost[rising], ',.0f')} at H = {numbers(horizons[rising], 'g')}",
            reason=f"Differences from one H to the next: {numbers(before, '+,.0f')} GBP; the "
            f"largest fall is {-before.min() / cost.max():.2%} of the cost, and the "
            "cost of a window with an outage is solved within 0.1 %.",
        ),
    ]


def ours(config: Config, results: Results) -> str:
    """What our figure shows."""
    horizons, resilience, cost = curves(config, results)
    full = results[ideal.FULL_HORIZON]
    return (
        f"R grows from {resilience[0]:.3f} at H = {horizons[0]:g} to "
        f"{results[ideal.mpc(CHOSEN_H)].resilience:.3f} at H = {CHOSEN_H}; the full horizon "
        f"has {full.resilience:.3f}. The cost rises from GBP {cost[0]:,.0f} to "
        f"{cost[horizons >= PLATEAU_H].max():,.0f}; the full horizon pays "
        f"{full.summary['cost_gbp']:,.0f}."
    )
