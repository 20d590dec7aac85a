"""The picture that opens README and documentation: ``python docs/first_look.py``.

The packaged day at a glance: what supplied the demand, who was served, what was stored.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("svg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from vppres import RunOptions, Trajectory, load_scenario, run_day
from vppres.core.arrays import Floats

FILE = Path(__file__).with_name("_static") / "first_look.svg"
GRID, PV, BATTERY, MISSING = "#9FB8CC", "#F2C14E", "#2A9D7F", "#D95F02"
TIERS = {"critical": ("#111111", "-"), "high": ("#1F78B4", "--"), "low": ("#7A7A7A", ":")}
SMALL = 8.5


def hourly(table: str, column: str, run: Trajectory) -> Floats:
    """Sum of a column over all items, for every step, in MW."""
    return np.asarray(run.tables[table].groupby("time")[column].sum(), dtype=float) / 1000.0


def draw_supply(axes: Axes, run: Trajectory, edges: Floats) -> None:
    """Demand, and what supplied it."""
    customers = run.tables["customers"]
    demand = hourly("customers", "p_load_kw", run)
    served = (
        np.asarray(
            (customers["p_load_kw"] * customers["served"]).groupby(customers["time"]).sum(),
            dtype=float,
        )
        / 1000.0
    )
    pv = hourly("pv", "self_kw", run) + hourly("pv", "export_kw", run)
    given = hourly("batteries", "discharge_kw", run)
    # Power that charges batteries supplies nobody yet: the grid gives what PV and batteries do not.
    from_pv = np.minimum(pv, served)
    from_battery = np.minimum(given, served - from_pv)
    from_grid = np.maximum(served - from_pv - from_battery, 0.0)
    axes.stackplot(
        edges,
        *(
            np.append(part, part[-1])
            for part in (from_pv, from_battery, from_grid, demand - served)
        ),
        step="post",
        colors=[PV, BATTERY, GRID, "none"],
    )
    axes.fill_between(
        edges,
        np.append(served, served[-1]),
        np.append(demand, demand[-1]),
        step="post",
        facecolor="none",
        edgecolor=MISSING,
        hatch="////",
        linewidth=0,
    )
    axes.step(edges, np.append(demand, demand[-1]), where="post", color="black", linewidth=1.2)
    axes.set_ylabel("Demand (MW)")
    axes.set_ylim(0, 1.12 * demand.max())
    for x, y, text in (
        (3.0, 1.1, "grid"),
        (9.5, 0.35, "PV"),
        (6.5, 2.05, "batteries"),
        (15.0, 2.6, "not supplied"),
    ):
        axes.text(
            x,
            y,
            text,
            ha="center",
            va="center",
            fontsize=SMALL,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5, "alpha": 0.85},
        )


def draw_service(axes: Axes, run: Trajectory, edges: Floats) -> None:
    """Share of each tier's customers that is served."""
    customers = run.tables["customers"]
    for tier, (colour, style) in TIERS.items():
        of_tier = customers[customers["tier"] == tier]
        share = 100.0 * np.asarray(of_tier.groupby("time")["served"].mean(), dtype=float)
        axes.step(
            edges,
            np.append(share, share[-1]),
            where="post",
            color=colour,
            linestyle=style,
            linewidth=1.8,
            label=tier,
        )
    axes.set_ylabel("Customers\nserved (%)")
    axes.set_ylim(-5, 108)
    axes.legend(loc="center left", bbox_to_anchor=(0.02, 0.45), frameon=False, fontsize=SMALL)


def draw_energy(axes: Axes, run: Trajectory, edges: Floats) -> None:
    """Energy in all batteries."""
    batteries = run.scenario.batteries
    soc = run.tables["batteries"].pivot(index="time", columns="id", values="soc_start")
    end = run.tables["batteries"].pivot(index="time", columns="id", values="soc_end")
    order = list(batteries.id)
    energy = (
        np.append(
            soc[order].to_numpy() @ batteries.energy_kwh,
            end[order].to_numpy()[-1] @ batteries.energy_kwh,
        )
        / 1000.0
    )
    axes.plot(edges, energy, color=BATTERY, linewidth=2.0)
    axes.set_ylabel("Stored\n(MWh)")
    axes.set_ylim(0, 1.15 * energy.max())


def main() -> None:
    """Run the packaged day and draw it."""
    run = run_day(load_scenario("uk-heatwave-2022"), RunOptions())
    edges = np.arange(run.scenario.grid.n_steps + 1, dtype=float)
    dark = np.flatnonzero(run.scenario.outage)
    with matplotlib.rc_context(
        {
            "font.size": 9.5,
            "svg.hashsalt": "vppres",
            "hatch.linewidth": 0.6,
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    ):
        figure, rows = plt.subplots(
            3, sharex=True, figsize=(7.6, 5.4), layout="constrained", height_ratios=[2.2, 1.3, 1.0]
        )
        for axes in rows:
            axes.axvspan(dark[0], dark[-1] + 1, color="#ECECEC", zorder=0)
        for draw, axes in zip((draw_supply, draw_service, draw_energy), rows, strict=True):
            draw(axes, run, edges)
        rows[0].set_title(
            "A heat-wave day with no grid from 12:00 to 18:00", loc="left", fontsize=10.5
        )
        rows[0].text(
            (dark[0] + dark[-1] + 1) / 2,
            rows[0].get_ylim()[1],
            "outage",
            ha="center",
            va="top",
            fontsize=SMALL,
            color="#444444",
        )
        rows[-1].set_xlim(0, edges[-1])
        rows[-1].set_xticks(edges[::3], [f"{int(hour):02d}:00" for hour in edges[::3]])
        rows[-1].set_xlabel("19 July 2022 (UTC)")
        figure.savefig(FILE, metadata={"Date": None})


if __name__ == "__main__":
    main()
