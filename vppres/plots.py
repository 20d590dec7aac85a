"""Figures of one run, or of several runs of the same day side by side.

Every figure takes either a trajectory or a mapping from label to trajectory. Quantities that hold
over a step are drawn as steps, states at an instant as points joined by lines. Runs differ in
colour, line style and marker, so that the figures survive a grey print and colour-blind eyes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.dates import AutoDateLocator, DateFormatter
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from vppres.metrics import horizon_h
from vppres.metrics import service_by_tier as share_by_tier
from vppres.trajectory import Trajectory

Runs = Trajectory | Mapping[str, Trajectory]
Floats = NDArray[np.float64]

# Okabe and Ito's palette: distinct for the common kinds of colour blindness.
BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY = (
    "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9")
BLACK, GREY = "#000000", "#666666"
UNNAMED = "_"  # a leading underscore keeps a line out of the legend

DPI = 150
MAX_NAMED_CUSTOMERS = 60
HOURS_OF_PLAIN_CLOCK = 48
# A fixed salt keeps two SVG files equal if their data are.
SVG_HASH_SALT = "vppres"


@dataclass(frozen=True)
class Style:
    """How one run, or tier, is told from another where their lines coincide.

    Later ones are thinner and have their markers on other steps, so that all can be seen.
    """

    color: str
    linestyle: str | tuple[int, tuple[int, ...]]
    marker: str
    linewidth: float
    first_marker: int

    def line(self, label: str = "") -> dict[str, Any]:
        """Keywords of a line in this style, with a marker on every third point."""
        return {"color": self.color, "linestyle": self.linestyle, "marker": self.marker,
                "markersize": 4, "markevery": slice(self.first_marker, -1, 3),
                "linewidth": self.linewidth, "label": label or UNNAMED}

    def thin(self, label: str) -> dict[str, Any]:
        """Keywords of a companion of the same run: what was planned or modelled."""
        return self.line(label) | {"linestyle": ":", "linewidth": 1.0, "markerfacecolor": "white"}


RUN_STYLES = (Style(BLUE, "-", "o", 1.8, 0), Style(VERMILLION, (0, (5, 2)), "s", 1.6, 1),
              Style(GREEN, "-.", "^", 1.4, 2), Style(PURPLE, (0, (1, 1)), "D", 1.4, 0),
              Style(BLACK, (0, (6, 1, 1, 1, 1, 1)), "v", 1.2, 1))
# Vermillion is left to the tiles that were not served.
TIER_STYLES = (Style(BLACK, "-", "o", 2.6, 0), Style(SKY, (0, (5, 2)), "s", 2.0, 1),
               Style(GREEN, "-.", "^", 1.4, 2), Style(PURPLE, (0, (1, 1)), "D", 1.2, 0))
SERVED, UNSERVED = "#D6E6F2", VERMILLION


def energy_and_price(runs: Runs) -> Figure:
    """Stored energy, net charging power of all batteries, and the import price."""
    named = _named(runs)
    first = next(iter(named.values()))
    figure, (energy, power, price) = panels(named, heights=(3, 2, 1.3), height_in=7.2)
    for (label, run), style in zip(named.items(), itertools.cycle(RUN_STYLES), strict=False):
        energy.plot(_edges(run), stored_energy_kwh(run), **style.line(label))
        if run.planned is not None:
            energy.plot(_edges(run), run.planned["energy_kwh"], **style.thin(f"{label}: planned"))
        net_kw = _per_step(run, run.batteries["charge_kw"] - run.batteries["discharge_kw"],
                           run.batteries)
        step_line(power, run, net_kw, style.line())
    capacity = first.scenario.batteries
    _limit(energy, float(capacity.energy_kwh @ capacity.soc_max), "upper SoC limit")
    _limit(energy, float(capacity.energy_kwh @ capacity.soc_min), "lower SoC limit")
    energy.set_ylim(bottom=0.0)
    power.axhline(0.0, color=GREY, linewidth=0.8)
    step_line(price, first, first.steps["price_gbp_per_kwh"].to_numpy(), {"color": BLACK})
    price.set_ylim(bottom=0.0)
    energy.set_ylabel("Stored energy (kWh)")
    power.set_ylabel("Net charging\npower (kW)")
    price.set_ylabel("Price\n(GBP/kWh)")
    figure.suptitle("Battery energy and price")
    return _with_legend(figure, energy, columns=len(named))


def import_load_pv(runs: Runs) -> Figure:
    """Grid import, and demand, served demand and available PV power of the feeder."""
    named = _named(runs)
    first = next(iter(named.values()))
    figure, (imports, load) = panels(named, heights=(1, 1), height_in=6.4)
    for (label, run), style in zip(named.items(), itertools.cycle(RUN_STYLES), strict=False):
        step_line(imports, run, run.steps["p_grid_kw"].to_numpy(), style.line())
        step_line(load, run, served_kw(run), style.line(f"{label}: import, and demand served"))
    demand = _per_step(first, first.customers["p_load_kw"], first.customers)
    available = _per_step(first, first.pv["available_kw"], first.pv)
    step_line(load, first, demand, {"color": BLACK, "linewidth": 1.0, "label": "demand"})
    step_line(load, first, available, {"color": ORANGE, "linestyle": (0, (3, 1, 1, 1)),
                                    "label": "PV available"})
    if len(named) == 1:
        _fill_unserved(load, first, served_kw(first), demand)
    imports.set_ylabel("Import at the slack bus,\nAC (kW)")
    load.set_ylabel("Power (kW)")
    load.set_ylim(bottom=0.0)
    figure.suptitle("Grid import, demand and PV")
    return _with_legend(figure, load, columns=2)


def voltages(runs: Runs) -> Figure:
    """Lowest voltage of any bus (AC and optimisation), and the largest difference of the two."""
    named = _named(runs)
    network = next(iter(named.values())).scenario.network
    figure, (lowest, error) = panels(named, heights=(3, 1.4), height_in=6.4)
    for (label, run), style in zip(named.items(), itertools.cycle(RUN_STYLES), strict=False):
        model = run.buses.groupby("time")["v_model_pu"].min().to_numpy()
        step_line(lowest, run, run.steps["v_min_ac_pu"].to_numpy(),
               style.line(f"{label}: AC power flow"))
        step_line(lowest, run, model, style.thin(f"{label}: optimisation"))
        step_line(error, run, 1000.0 * run.steps["v_error_pu"].to_numpy(), style.line())
    _limit(lowest, network.v_min_pu, f"{network.v_min_pu:g} optimisation limit")
    _limit(lowest, network.v_min_ac_pu, f"{network.v_min_ac_pu:g} AC limit", linestyle="-")
    lowest.margins(y=0.1)
    lowest.set_ylabel("Lowest bus voltage (pu)")
    error.set_ylabel("Largest\n|optim. - AC|\n(0.001 pu)")
    error.set_ylim(bottom=0.0)
    figure.suptitle("Voltages: optimisation against AC power flow")
    return _with_legend(figure, lowest, columns=len(named))


def service_by_tier(runs: Runs) -> Figure:
    """Who was served, step by step: a tile per customer, and the share of each tier."""
    named = _named(runs)
    n_customers = max(len(run.scenario.customers) for run in named.values())
    tiles_in = float(np.clip(0.16 * n_customers, 2.0, 9.0))
    figure = Figure(figsize=(3.6 + 4.6 * len(named), tiles_in + 3.2), layout="constrained")
    axes = figure.subplots(2, len(named), squeeze=False, sharex="col",
                           height_ratios=(tiles_in, 1.7))
    for column, (label, run) in enumerate(named.items()):
        tiles, share = axes[0, column], axes[1, column]
        tiles.set_title(label, fontsize=10, loc="left")
        _draw_tiles(tiles, run)
        _draw_shares(share, run)
        _mark_outage(tiles, run, shade=False)
        _mark_outage(share, run, text=False)
        _clock(share, run, max_ticks=9)
    handles = [Patch(facecolor=SERVED, edgecolor=GREY, label="served"),
               Patch(facecolor=UNSERVED, label="not served (x)"),
               *axes[1, 0].get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False)
    figure.suptitle("Service by customer and tier")
    return figure


FIGURES: dict[str, Callable[[Runs], Figure]] = {
    "energy_and_price": energy_and_price,
    "import_load_pv": import_load_pv,
    "voltages": voltages,
    "service_by_tier": service_by_tier,
}

FIGURE_TEXTS = {
    "energy_and_price": "Stored energy, net charging power of all batteries and import price.",
    "import_load_pv": "Import at the slack bus (above); demand, demand served and available PV "
                      "power (below).",
    "voltages": "Lowest bus voltage of each step, and the largest difference between optimisation "
                "and AC power flow at any bus.",
    "service_by_tier": "Who was served in each step, customer by customer, and the share of each "
                       "tier.",
}


def save_figures(runs: Runs, folder: Path) -> list[Path]:
    """Write every figure as PNG and SVG into a folder, which is made if missing.

    Returns
    -------
    list of Path
        The files written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, draw in FIGURES.items():
        files += save_figure(draw(runs), folder / name)
    return files


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write one figure as PNG and SVG; equal figures give equal files.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    stem : Path
        File without its ending, in an existing folder.

    Returns
    -------
    list of Path
        The files written.
    """
    png, svg = stem.with_name(f"{stem.name}.png"), stem.with_name(f"{stem.name}.svg")
    with matplotlib.rc_context({"svg.hashsalt": SVG_HASH_SALT}):
        figure.savefig(svg, metadata={"Date": None})
    figure.savefig(png, dpi=DPI)
    return [png, svg]


def stored_energy_kwh(run: Trajectory) -> Floats:
    """Energy in all batteries at the beginning of each step and at the end, shape (T + 1,)."""
    energy_kwh = np.tile(run.scenario.batteries.energy_kwh, len(run.steps))
    start = _per_step(run, run.batteries["soc_start"] * energy_kwh, run.batteries)
    end = _per_step(run, run.batteries["soc_end"] * energy_kwh, run.batteries)
    return np.append(start, end[-1])


def served_kw(run: Trajectory) -> Floats:
    """Demand of the customers that were served, shape (T,)."""
    return _per_step(run, run.customers["p_load_kw"] * run.customers["served"], run.customers)


def _draw_tiles(ax: Axes, run: Trajectory) -> None:
    """A tile per customer and step, grouped by tier; crosses carry the message without colour."""
    customers = run.scenario.customers
    order = np.concatenate([np.flatnonzero(customers.tier == tier) for tier in run.scenario.tiers])
    served = run.customers["served"].to_numpy(bool).reshape(len(run.steps), -1)[:, order].T
    edges = _edges(run)
    ax.pcolormesh(edges, np.arange(len(order) + 1), served, vmin=0, vmax=1,
                  cmap=ListedColormap([UNSERVED, SERVED]), edgecolors="white", linewidth=0.6)
    rows, columns = np.nonzero(~served)
    middles = edges[:-1] + (edges[1:] - edges[:-1]) / 2
    ax.scatter(middles[columns], rows + 0.5, marker="x", s=14, color="white", linewidths=1.0)
    ax.set_ylim(len(order), 0)
    named = len(order) <= MAX_NAMED_CUSTOMERS
    ax.set_yticks(np.arange(len(order)) + 0.5 if named else [],
                  labels=[str(name) for name in customers.id[order]] if named else [], fontsize=6.5)
    ax.tick_params(axis="y", length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    _name_tiers(ax, run)


def _name_tiers(ax: Axes, run: Trajectory) -> None:
    """Rules between the tiers, and each tier's name, size and share in the outage at the right."""
    top = 0
    in_outage = share_by_tier(run)[run.steps["outage"].to_numpy(bool)].mean()
    for tier, share in in_outage.items():
        count = int(np.sum(run.scenario.customers.tier == tier))
        share_text = f"\n{share:.0%} served\nin outage" if np.isfinite(share) else ""
        ax.text(1.01, top + count / 2, f"{tier} ({count}){share_text}", fontsize=8, va="center",
                transform=ax.get_yaxis_transform())
        top += count
        ax.axhline(top, color=BLACK, linewidth=1.0)


def _draw_shares(ax: Axes, run: Trajectory) -> None:
    """Share of each tier's customers that are served, in per cent."""
    shares = share_by_tier(run)
    for (tier, share), style in zip(shares.items(), itertools.cycle(TIER_STYLES), strict=False):
        step_line(ax, run, 100.0 * share.to_numpy(), style.line(str(tier)))
    ax.set_ylim(-4.0, 104.0)
    ax.set_yticks([0, 50, 100])
    ax.set_ylabel("Customers\nserved (%)")
    _grid(ax)


def _fill_unserved(ax: Axes, run: Trajectory, served: Floats, demand: Floats) -> None:
    """Hatch the demand that was not met."""
    ax.fill_between(_edges(run), _closed(served), _closed(demand), step="post", facecolor="none",
                    edgecolor=VERMILLION, hatch="////", linewidth=0.0, label="not served")


def _named(runs: Runs) -> dict[str, Trajectory]:
    """Runs by label; a single run is labelled by its controller."""
    if not isinstance(runs, Trajectory):
        return dict(runs)
    horizon = horizon_h(runs)
    return {"full horizon" if horizon is None else f"MPC, H = {horizon:g} h": runs}


def panels(runs: Mapping[str, Trajectory], heights: tuple[float, ...],
            height_in: float) -> tuple[Figure, list[Axes]]:
    """Panels above each other over one time axis, with the outage shaded."""
    run = next(iter(runs.values()))
    figure = Figure(figsize=(8.6, height_in), layout="constrained")
    axes = list(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
    for position, ax in enumerate(axes):
        _mark_outage(ax, run, text=position == 0)
        _grid(ax)
    _clock(axes[-1], run)
    figure.align_ylabels(axes)
    return figure, axes


def _with_legend(figure: Figure, panel: Axes, columns: int) -> Figure:
    """Put the legend of one panel below the figure."""
    figure.legend(handles=panel.get_legend_handles_labels()[0], loc="outside lower center",
                  ncols=columns, frameon=False)
    return figure


def _edges(run: Trajectory) -> NDArray[np.object_]:
    """Beginning of every step and the end of the last, as datetimes in UTC, shape (T + 1,)."""
    grid = run.scenario.grid
    times = pd.date_range(grid.start, periods=len(run.steps) + 1,
                          freq=pd.Timedelta(minutes=grid.step_minutes))
    return np.asarray(times.tz_convert(UTC).to_pydatetime())


def _closed(values: Floats) -> Floats:
    """Values with the last one repeated: the height of a step at its end."""
    return np.append(values, values[-1])


def step_line(ax: Axes, run: Trajectory, values: Floats, line: Mapping[str, Any]) -> None:
    """A quantity that holds over each step."""
    ax.plot(_edges(run), _closed(values), drawstyle="steps-post", **line)


def _per_step(run: Trajectory, values: pd.Series[Any], table: pd.DataFrame) -> Floats:
    """Sum over the items of each step, shape (T,); zero where there are no items."""
    total = values.groupby(table["time"]).sum()
    return total.reindex(run.steps["time"], fill_value=0.0).to_numpy(float)


def _limit(ax: Axes, value: float, text: str, linestyle: str = "--") -> None:
    """A horizontal limit, named outside the axes."""
    ax.axhline(value, color=GREY, linestyle=linestyle, linewidth=1.0)
    ax.text(1.01, value, text, transform=ax.get_yaxis_transform(), va="center", fontsize=8,
            color=GREY)


def _mark_outage(ax: Axes, run: Trajectory, text: bool = True, shade: bool = True) -> None:
    """Shade or bracket every outage; name it above the axes."""
    edges = _edges(run)
    for first, last in outage_spans(run):
        if shade:
            ax.axvspan(edges[first], edges[last], color="#E4E4E4", zorder=0)
        else:
            for edge in (edges[first], edges[last]):
                ax.axvline(edge, color=BLACK, linewidth=1.2, linestyle="--")
        if text:
            middle = edges[first] + (edges[last] - edges[first]) / 2
            ax.text(middle, 1.01, "outage", transform=ax.get_xaxis_transform(), ha="center",
                    va="bottom", fontsize=8)


def outage_spans(run: Trajectory) -> list[tuple[int, int]]:
    """Half-open ranges of steps without grid."""
    change = np.diff(run.steps["outage"].to_numpy(int), prepend=0, append=0)
    return list(zip(np.flatnonzero(change == 1).tolist(), np.flatnonzero(change == -1).tolist(),
                    strict=True))


def _grid(ax: Axes) -> None:
    ax.grid(True, color="#D0D0D0", linewidth=0.5)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _clock(ax: Axes, run: Trajectory, max_ticks: int = 13) -> None:
    """Time axis in UTC, named with its day."""
    edges = _edges(run)
    hours = (edges[-1] - edges[0]).total_seconds() / 3600.0
    plain = hours <= HOURS_OF_PLAIN_CLOCK
    ax.set_xlim(edges[0], edges[-1])
    text = "%H:%M" if plain else "%d %b\n%H:%M"
    # Two classes of matplotlib's that carry no annotations yet.
    locator = AutoDateLocator(tz=UTC, minticks=4, maxticks=max_ticks)  # type: ignore[no-untyped-call]
    formatter = DateFormatter(text, tz=UTC)  # type: ignore[no-untyped-call]
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(formatter)
    ax.set_xlabel(f"Time (UTC), from {edges[0]:%d %B %Y}")
