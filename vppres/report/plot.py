"""Pictures of runs and scenarios with matplotlib, for notebooks and papers: ``vppres.plot``.

``runs`` is one run, or several by label or in a row; ``ax`` the Axes to draw into, in a picture of
several panels one for each. A figure of its own is made without. The Axes are returned, to be
changed further. Curves differ by colour, dashes and width, and areas by hatches, so that a grey
print shows the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any, Protocol, cast

import numpy as np
import pandas as pd
from matplotlib import dates, pyplot
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from vppres.core.arrays import Flags, Floats, Wholes, spans_of
from vppres.core.errors import InputError
from vppres.core.plain import flattened
from vppres.day.metrics import service_by_tier, summarise
from vppres.day.series import edges_of, per_step, quantity
from vppres.day.trajectory import Trajectory
from vppres.kinds.table import KINDS
from vppres.report.key_figures import KEY_FIGURES
from vppres.report.one_line import (
    OPEN,
    OUT_OF_LIMITS,
    OUT_OF_SERVICE,
    loading_classes,
    voltage_classes,
    voltage_colours,
    voltage_edges,
    worst_step,
)
from vppres.report.plots.chart import label_of
from vppres.report.plots.drawing import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    OUTAGE_COLOUR,
    PURPLE,
    RULE_COLOUR,
    RUN_STYLES,
    SKY,
    TIER_STYLES,
    VERMILLION,
    WHITE,
    Style,
    shortened,
)
from vppres.report.tree_layout import tree_layout
from vppres.scenario.configuration import Branches
from vppres.scenario.scenario import Scenario

_SMALL = 8.0
_MOST_NAMED_BUSES = 60
_MOST_LETTERS, _MOST_UPRIGHT = 10, 3
"""Letters of a bus's name that are shown, and that stand without being turned."""
_LOAD, _PV = Style(BLACK, "", 1.3), Style(ORANGE, "6 2 2 2", 1.6)
_SOURCES = {
    "PV": (ORANGE, "||"),
    "batteries": (GREEN, "///"),
    "generating sets": (PURPLE, "xx"),
    "vehicles": (BLUE, "++"),
    "grid": (SKY, ""),
}
_TIER_MARKS = ("s", "o", "^", "v", "<", ">")
_UNIT_MARKS = (("p", BLUE), ("h", SKY), ("d", PURPLE))
"""Mark and colour of each kind of unit, again from the first where there are more."""
_FIRST_MARK, _NEXT_MARK, _POINTS_PER_INCH = 12.0, 8.0, 72.0
"""Distances of marks below a bus, in points."""
_HATCHES = ("", "///", "...", "xx", "---")
_LINE_WIDTHS = (0.8, 1.4, 2.0, 2.8, 3.6, 5.0)
"""Width of a line in each class of its loading."""


class Record(Protocol):
    """Series of a run that are drawn; also of one of which only the series are kept."""

    @property
    def edges(self) -> Any:
        """Beginning of every step and the end of the last: times, or hours."""

    @property
    def summary(self) -> Mapping[str, Any]:
        """Its key figures."""

    @property
    def planned(self) -> Mapping[str, Any] | None:
        """Planned series of a full horizon."""

    def series(self, name: str) -> Floats:
        """A quantity of :data:`vppres.day.series.QUANTITIES`, or a column of the steps."""


Run = Trajectory | Record
Runs = Run | Mapping[str, Run] | Sequence[Run]


class _OfTrajectory:
    """The record of a run in full."""

    def __init__(self, run: Trajectory) -> None:
        self.run = run

    @property
    def edges(self) -> Any:
        return edges_of(self.run)

    @property
    def summary(self) -> Mapping[str, Any]:
        return summarise(self.run)

    @property
    def planned(self) -> Mapping[str, Any] | None:
        return self.run.planned

    def series(self, name: str) -> Floats:
        return quantity(self.run, name)


def line_of(style: Style) -> dict[str, Any]:
    """A style in matplotlib's words.

    >>> line_of(Style("#000000", "8 4", 2.0))
    {'color': '#000000', 'linewidth': 2.0, 'linestyle': (0, (4.0, 2.0))}
    """
    dashes = tuple(float(length) / style.width for length in style.dash.split())
    line = (0, dashes) if dashes else "-"
    return {"color": style.color, "linewidth": style.width, "linestyle": line}


def drawn(kind: str, run: Trajectory, **options: Any) -> Any:
    """A picture of a run by the name of its kind."""
    of_runs: dict[str, Callable[..., Any]] = {
        picture.__name__: picture for picture in (day, supply, energy, voltages, feeder, compare)
    }
    if kind not in of_runs:
        raise InputError.of(
            "plot",
            "is no picture of a run",
            f"Give one of {', '.join(of_runs)}.",
            field="kind",
            value=kind,
        )
    return of_runs[kind](run, **options)


def day(run: Trajectory, ax: Sequence[Axes] | None = None) -> Sequence[Axes]:
    """The day in three panels: supply, share of each tier that is supplied, stored energy."""
    panels = _panels((2.2, 1.2, 1.2), (8.0, 6.6), ax)
    supply(run, panels[0])
    _service(run, panels[1])
    energy(run, panels[2])
    for panel in panels[:-1]:
        panel.set_xlabel("")
        panel.tick_params(labelbottom=False)
    return panels


def supply(runs: Runs, ax: Axes | None = None) -> Axes:
    """Demand and what supplied it; of several runs import and supplied demand of each."""
    ax = _axes(ax)
    named = _named(runs)
    first = next(iter(named.values()))
    if isinstance(runs, Trajectory):
        _stack(runs, ax)
    else:
        steps(ax, first, first.series("pv_kw"), _PV, "PV available")
        for (label, run), style in zip(named.items(), RUN_STYLES, strict=False):
            steps(ax, run, run.series("p_grid_kw"), style, f"{label}: import")
            thin = style.thin()
            steps(ax, run, run.series("served_kw"), thin, f"{label}: demand supplied")
    steps(ax, first, first.series("load_kw"), _LOAD, "demand")
    ax.set_ylabel("Power (kW)")
    if ax.get_ylim()[0] > 0.0 or isinstance(runs, Trajectory):
        ax.set_ylim(bottom=0.0)
    return finish(ax, runs)


def energy(runs: Runs, ax: Axes | None = None) -> Axes:
    """Energy in all batteries, what a full horizon planned, and the limits of the SoC."""
    ax = _axes(ax)
    for (label, run), style in zip(_named(runs).items(), RUN_STYLES, strict=False):
        ax.plot(run.edges, run.series("energy_kwh"), label=label, **line_of(style))
        if run.planned:
            planned = np.asarray(run.planned["energy_kwh"], dtype=float)
            ax.plot(run.edges, planned, label=f"{label}: planned", **line_of(style.thin()))
    first = next(_each(runs))
    if isinstance(first, Trajectory):
        b = first.scenario.batteries
        for share, words, dash in ((b.soc_max, "upper", "--"), (b.soc_min, "lower", ":")):
            ax.axhline(float(b.energy_kwh @ share), label=f"{words} SoC limit", **_limit_line(dash))
    ax.set_ylabel("Stored energy (kWh)")
    ax.set_ylim(bottom=0.0)
    return finish(ax, runs)


def voltages(runs: Runs, ax: Axes | None = None) -> Axes:
    """Lowest bus voltage of each step by AC power flow, thin by the optimisation; limits."""
    ax = _axes(ax)
    for (label, run), style in zip(_named(runs).items(), RUN_STYLES, strict=False):
        steps(ax, run, run.series("v_min_ac_pu"), style, f"{label}: AC power flow")
        steps(ax, run, run.series("v_min_model_pu"), style.thin(), f"{label}: optimisation")
    first = next(_each(runs))
    if isinstance(first, Trajectory):
        network = first.scenario.network
        for v_pu, words, dash in (
            (network.v_min_pu, "optimisation", "--"),
            (network.v_min_ac_pu, "AC", ":"),
        ):
            ax.axhline(v_pu, label=f"{v_pu:g} pu, {words} limit", **_limit_line(dash))
    ax.set_ylabel("Lowest bus voltage (pu)")
    return finish(ax, runs)


def feeder(
    shown: Trajectory | Scenario,
    time: pd.Timestamp | str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """The feeder with its customers by tier, PV systems and batteries.

    Of a run the buses have the colour of their voltage in a step, lines are as wide as they are
    loaded, and customers that are off supply are crossed out. ``time`` is the beginning
    of that step, which is the one with the least service in the outage if not given.
    """
    site = shown.scenario if isinstance(shown, Trajectory) else shown
    net = site.network
    layout = tree_layout(net)
    x, y = layout.column.astype(float), -layout.row.astype(float)
    ax = _axes(ax, (min(16.0, 3.0 + 0.45 * x.max()), min(10.0, 2.0 + 0.8 * (1.0 - y.min()))))
    ax.grid(False)
    branches = Branches.of(site)
    classes = np.where(branches.closed, 1, OPEN)
    colours: list[str] | str = WHITE
    off = np.zeros(len(site.customers), dtype=bool)
    if isinstance(shown, Trajectory):
        t = worst_step(shown) if time is None else shown.step_at(time)
        classes = loading_classes(shown)[t]
        colours = _voltage_colours(shown, t, ax)
        off = ~shown.by_step("customers", "served")[t].astype(bool)
        local = site.grid.local(pd.Timestamp(shown.steps["time"].iloc[t]))
        ax.set_title(f"{local:%d %b %Y %H:%M} ({site.grid.zone})", fontsize=10)
    for branch, (start, end) in enumerate(branches.ends):
        is_line = branch < net.n_lines
        corner = ([x[start], x[start], x[end]], [y[start], y[end], y[end]])
        path = corner if is_line else ([x[start], x[end]], [y[start], y[end]])
        _branch(ax, path, int(classes[branch]))
    for look, words in ((OPEN, "open"), (OUT_OF_SERVICE, "out of service")):
        if look in classes:
            _branch(ax, ([], []), look, words)
    ax.scatter(x, y, s=46, c=colours, edgecolors=BLACK, linewidths=0.8, zorder=3)
    ax.scatter(x[:1], y[:1], s=90, marker="D", color=BLACK, zorder=4, label="grid connection")
    _devices(site, off, _Marks(x, y, ax))
    if net.n_buses <= _MOST_NAMED_BUSES:
        for bus, name in enumerate(net.buses):
            _name_bus(ax, str(name), (x[bus], y[bus]))
    ax.set_xlabel("Lines from the grid connection")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ax.set_ylim(y.min() - 1.0, 0.6)
    return _legend(ax)


def horizon(runs: Runs, value: str = "resilience", ax: Axes | None = None) -> Axes:
    """A key figure of runs of the MPC against their prediction horizon; others as a level.

    ``value`` is a key of the summary; of nested ones with a dot, as ``served_share.critical``.
    """
    ax = _axes(ax)
    points = []
    levels: dict[str, float] = {}
    for run in _each(runs):
        summary = _record(run).summary
        found = _figure(summary, value)
        if summary["horizon_h"] is None:
            levels[str(summary["controller"]).replace("-", " ")] = found
        else:
            points.append((float(summary["horizon_h"]), found))
    points.sort()
    ax.plot(*zip(*points, strict=True), marker="o", label="MPC", **line_of(RUN_STYLES[0]))
    for (label, level), style in zip(levels.items(), RUN_STYLES[1:], strict=False):
        ax.axhline(level, label=label, **line_of(style))
    ax.set_xticks([at for at, _ in points])
    ax.ticklabel_format(axis="y", useOffset=False)
    ax.set_xlabel("Prediction horizon H (h)")
    ax.set_ylabel(_words(value))
    return _legend(ax)


def compare(runs: Runs, ax: Axes | None = None) -> Axes:
    """Share of each tier's customers that is supplied in the outage, the runs side by side.

    Of a day without an outage all steps count.
    """
    ax = _axes(ax)
    named = _named(runs)
    summaries = [run.summary for run in named.values()]
    in_outage = any(share is not None for s in summaries for share in s["served_share"].values())
    key = "served_share" if in_outage else "served_share_connected"
    tiers = [
        tier for tier in summaries[0][key] if any(s[key].get(tier) is not None for s in summaries)
    ]
    width = 0.8 / len(named)
    for i, (label, summary) in enumerate(zip(named, summaries, strict=True)):
        shares = [100.0 * (summary[key].get(tier) or 0.0) for tier in tiers]
        bars = ax.bar(
            np.arange(len(tiers)) + (i - 0.5 * (len(named) - 1)) * width,
            shares,
            width,
            label=label,
            facecolor=RUN_STYLES[i % len(RUN_STYLES)].color,
            edgecolor=WHITE,
            hatch=_HATCHES[i % len(_HATCHES)],
        )
        ax.bar_label(bars, [f"{share:.0f}" for share in shares], fontsize=_SMALL, padding=1)
    ax.set_xticks(range(len(tiers)), tiers)
    ax.set_xlabel("Tier")
    ax.set_ylabel(f"Customers supplied {'in the outage' if in_outage else 'with grid'} (%)")
    ax.set_ylim(0.0, 108.0)
    return _legend(ax)


def scenario(site: Scenario, ax: Sequence[Axes] | None = None) -> Sequence[Axes]:
    """The feeder with its tiers, and below it demand by tier and available PV power."""
    rows = 2.0 + 0.7 * float(tree_layout(site.network).row.max())
    panels = _panels((rows, 3.0), (9.0, min(14.0, rows + 3.4)), ax)
    feeder(site, ax=panels[0])
    below = panels[1]
    grid = site.grid
    edges = pd.date_range(grid.start, periods=grid.n_steps + 1, freq=grid.step)
    times = np.asarray(edges.to_pydatetime())
    for tier, style in zip(site.tiers, cycle(TIER_STYLES), strict=False):
        of_tier = site.customers.tier == tier
        if of_tier.any():
            demand = site.load_kw[:, of_tier].sum(axis=1)
            label = f"demand, {tier} ({int(of_tier.sum())})"
            below.step(times, _held(demand), where="post", label=label, **line_of(style))
    if len(site.pv):
        available = _held(site.pv_kw.sum(axis=1))
        below.step(times, available, where="post", label="PV available", **line_of(_PV))
    _shade(below, times, site.outage)
    below.set_ylabel("Power (kW)")
    below.set_ylim(bottom=0.0)
    _clock(below, times, grid.zone)
    _legend(below)
    return panels


def limit(ax: Axes, value: float, text: str, linestyle: str = "--") -> None:
    """A horizontal limit with its name in the legend, or at the left where there is none."""
    if ax.get_legend() is not None:
        ax.axhline(value, label=text, **_limit_line(linestyle))
        _legend(ax)
        return
    ax.axhline(value, **_limit_line(linestyle))
    ax.annotate(
        text,
        (0.0, value),
        (3.0, 2.0),
        xycoords=ax.get_yaxis_transform(),
        textcoords="offset points",
        fontsize=_SMALL,
        color=GREY,
        bbox={"facecolor": WHITE, "edgecolor": "none", "alpha": 0.7, "pad": 0.5},
    )


def _limit_line(linestyle: str) -> dict[str, Any]:
    return {"color": GREY, "linestyle": linestyle, "linewidth": 1.0}


def _each(runs: Runs) -> Iterator[Run]:
    """The runs one after the other."""
    if isinstance(runs, Mapping):
        return iter(runs.values())
    return iter(runs if isinstance(runs, Sequence) else [runs])


def _record(run: Run) -> Record:
    return _OfTrajectory(run) if isinstance(run, Trajectory) else run


def _named(runs: Runs) -> dict[str, Record]:
    """Runs by label: as given, else by controller and horizon, with a number where that repeats."""
    if isinstance(runs, Mapping):
        named = {str(label): _record(run) for label, run in runs.items()}
    else:
        named = {}
        for run in _each(runs):
            label = label_of(run) if isinstance(run, Trajectory) else str(run.summary["controller"])
            copies = sum(name == label or name.startswith(f"{label} (") for name in named)
            named[f"{label} ({copies + 1})" if copies else label] = _record(run)
    if not 1 <= len(named) <= len(RUN_STYLES):
        raise InputError.of(
            "plot",
            f"draws 1 to {len(RUN_STYLES)} runs in one picture",
            "Give fewer runs.",
            field="runs",
            value=len(named),
        )
    return named


def _axes(ax: Axes | None, size: tuple[float, float] = (8.0, 4.2)) -> Axes:
    """Axes to draw into, with light rules."""
    if ax is None:
        _, ax = pyplot.subplots(figsize=size, layout="constrained")
    ax.grid(True, color=RULE_COLOUR, linewidth=0.5)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    return ax


def _panels(
    heights: Sequence[float], size: tuple[float, float], ax: Sequence[Axes] | None
) -> list[Axes]:
    """Axes below each other, or those that were given."""
    if ax is None:
        _, made = pyplot.subplots(
            len(heights), 1, figsize=size, layout="constrained", height_ratios=heights
        )
        ax = cast(Sequence[Axes], made)
    given = list(ax)
    if len(given) != len(heights):
        raise InputError.of(
            "plot",
            f"needs {len(heights)} Axes",
            f"Give those of matplotlib's subplots({len(heights)}, 1).",
            field="ax",
            value=len(given),
        )
    return given


def _held(values: Floats) -> Floats:
    """Values of steps, the last one again for the end of the last step."""
    return np.append(values, values[-1])


def steps(ax: Axes, run: Record, values: Floats, style: Style, label: str = "_") -> None:
    """A quantity that holds over each step."""
    ax.step(run.edges, _held(values), where="post", label=label, **line_of(style))


def _stack(run: Trajectory, ax: Axes) -> None:
    """Stacked sources of the customers' demand, and the demand not supplied."""
    edges = edges_of(run)
    served, demand = quantity(run, "served_kw"), quantity(run, "load_kw")
    given = {
        "PV": per_step(run, run.pv["self_kw"] + run.pv["export_kw"], run.pv),
        "batteries": per_step(run, run.batteries["discharge_kw"], run.batteries),
    }
    for kind in KINDS.values():
        if kind.table in run.tables:
            sign = 1.0 if kind.gives else -1.0
            power_kw = sign * run.by_step(kind.table, "p_kw").astype(float)
            given[kind.what] = np.maximum(power_kw, 0.0).sum(axis=1)
    below = np.zeros(len(served))
    # What charges batteries supplies no customer yet: the grid gives what the others do not.
    for name, power_kw in {**given, "grid": np.full(len(served), np.inf)}.items():
        above = np.minimum(below + power_kw, served)
        if (above > below + 1e-9).any():
            colour, hatch = _SOURCES.get(name, (GREY, ""))
            _area(ax, edges, (below, above), name, facecolor=colour, edgecolor=WHITE, hatch=hatch)
        below = np.maximum(above, below)
    if (demand > served + 1e-9).any():
        look = {"facecolor": WHITE, "edgecolor": VERMILLION, "hatch": "\\\\\\"}
        _area(ax, edges, (served, demand), "not supplied", **look)


def _area(ax: Axes, edges: Any, ends: tuple[Floats, Floats], label: str, **look: Any) -> None:
    """An area between two quantities that hold over each step."""
    below, above = map(_held, ends)
    ax.fill_between(edges, below, above, step="post", linewidth=0.0, label=label, **look)


def _service(run: Trajectory, ax: Axes) -> None:
    """Share of each tier's customers that is supplied."""
    _axes(ax)
    shares = service_by_tier(run)
    for tier, style in zip(shares.columns, cycle(TIER_STYLES), strict=False):
        values = _held(100.0 * shares[tier].to_numpy(float))
        ax.step(edges_of(run), values, where="post", label=str(tier), **line_of(style))
    ax.set_ylabel("Customers\nsupplied (%)")
    ax.set_ylim(-5.0, 108.0)
    finish(ax, run)


def _branch(ax: Axes, path: tuple[Any, Any], look: int, label: str = "_") -> None:
    """A line or tie in the class of its loading; what is out is crossed."""
    width = _LINE_WIDTHS[look] if look < len(_LINE_WIDTHS) else _LINE_WIDTHS[0]
    style: dict[str, Any] = {"color": GREY, "linewidth": width, "solid_capstyle": "round"}
    if look in (OPEN, OUT_OF_SERVICE):
        style["linestyle"] = (0, (4.0, 3.0))
    if look == OUT_OF_SERVICE:
        style["color"] = VERMILLION
        x, y = (np.mean(values[-2:]) if len(values) else np.nan for values in path)
        ax.scatter(x, y, s=60, marker="x", color=VERMILLION, linewidths=2.0, zorder=4)
    ax.plot(*path, zorder=1, label=label, **style)


def _voltage_colours(run: Trajectory, t: int, ax: Axes) -> list[str]:
    """Colour of each bus by the class of its voltage, with a scale beside the feeder."""
    edges = voltage_edges(run)
    known = voltage_colours(len(edges) - 1)
    classes = voltage_classes(run, run.by_step("buses", "v_ac_pu"))[t]
    scale = ScalarMappable(BoundaryNorm(edges.tolist(), len(known)), ListedColormap(known))
    ax.figure.colorbar(scale, ax=ax, label="AC voltage (pu)", shrink=0.8, pad=0.02)
    if OUT_OF_LIMITS in classes:
        ax.scatter([], [], s=46, c=VERMILLION, edgecolors=BLACK, label="voltage outside its limits")
    return [VERMILLION if c == OUT_OF_LIMITS else known[c] for c in classes]


def _name_bus(ax: Axes, name: str, place: tuple[float, float]) -> None:
    """The name of a bus above it, shortened, and turned where it is longer than a number."""
    is_long = len(name) > _MOST_UPRIGHT
    ax.annotate(
        shortened(name, _MOST_LETTERS),
        place,
        (0.0, 7.0),
        textcoords="offset points",
        ha="left" if is_long else "center",
        va="bottom",
        rotation=40.0 if is_long else 0.0,
        fontsize=7.0,
        color="#444444",
    )


class _Marks:
    """Marks of what is at buses, one kind below the other."""

    def __init__(self, x: Floats, y: Floats, ax: Axes) -> None:
        self.x, self.y, self.ax = x, y, ax
        self._used = np.zeros(len(x), dtype=int)

    def put(self, at: Wholes, label: str, mark: str, colour: str) -> Wholes:
        """A mark at each of some buses, and how many places down each is."""
        level = self._used[at]
        self._used[np.unique(at)] += 1  # one mark for all of the kind at a bus
        look: dict[str, Any] = {
            "s": 28,
            "marker": mark,
            "color": colour,
            "edgecolors": BLACK,
            "linewidths": 0.5,
        }
        self._draw(at, level, zorder=4, **look)
        self.ax.scatter([], [], label=f"{label} ({len(at)})", **look)
        return level

    def cross(self, at: Wholes, level: Wholes) -> None:
        """Cross out marks that are so many places down."""
        self._draw(at, level, zorder=5, s=56, marker="x", color=VERMILLION, linewidths=1.6)

    def _draw(self, at: Wholes, level: Wholes, **look: Any) -> None:
        for down in np.unique(level):
            inches = -(_FIRST_MARK + _NEXT_MARK * down) / _POINTS_PER_INCH
            moved = ScaledTranslation(0.0, inches, self.ax.figure.dpi_scale_trans)
            here = at[level == down]
            place = self.ax.transData + moved
            self.ax.scatter(self.x[here], self.y[here], transform=place, **look)


def _devices(site: Scenario, off: Flags, marks: _Marks) -> None:
    """Customers by tier below their bus, then PV systems, batteries and other units."""

    def at(buses: Iterable[Any]) -> Wholes:
        return np.array([site.network.bus_index[name] for name in buses], dtype=int)

    c = site.customers
    for tier, mark, style in zip(site.tiers, _TIER_MARKS, cycle(TIER_STYLES), strict=False):
        of_tier = c.tier == tier
        if of_tier.any():
            buses, is_off = at(c.bus[of_tier]), off[of_tier]
            level = marks.put(buses, str(tier), mark, style.color)
            marks.cross(buses[is_off], level[is_off])
    if off.any():
        marks.ax.scatter([], [], s=60, marker="x", color=VERMILLION, label="off supply")
    if len(site.pv):
        marks.put(at(site.pv.buses(c)), site.pv.word, "*", ORANGE)
    if len(site.batteries):
        marks.put(at(site.batteries.bus), "batteries", "P", GREEN)
    for (name, kind), (mark, colour) in zip(KINDS.items(), cycle(_UNIT_MARKS), strict=False):
        units = getattr(site, name)
        if len(units):
            marks.put(at(units.buses(c)), kind.what, mark, colour)


def _figure(summary: Mapping[str, Any], value: str) -> float:
    """A key figure of a run."""
    found = flattened(dict(summary)).get(value)
    if not isinstance(found, int | float):
        raise InputError.of(
            "plot",
            "is no number of the run's summary",
            "Give a key of vppres.summarise(run), as resilience or cost_gbp.",
            field="value",
            value=value,
        )
    return float(found)


def _words(value: str) -> str:
    """A key figure in words, with its unit."""
    for key, words, unit, _ in KEY_FIGURES:
        if key == value:
            return f"{words.partition(':')[0]} ({unit})" if unit else words.partition(":")[0]
    return value.replace("_", " ").replace(".", ", ")


def finish(ax: Axes, runs: Runs) -> Axes:
    """Shade outages, put the site's clock below and a legend beside."""
    first = next(_each(runs))
    record = _record(first)
    _shade(ax, record.edges, record.series("outage") > 0)
    zone = first.scenario.grid.zone if isinstance(first, Trajectory) else ""
    _clock(ax, record.edges, zone)
    return _legend(ax)


def _shade(ax: Axes, edges: Any, outage: Flags) -> None:
    """Outages in grey."""
    for i, (first, last) in enumerate(spans_of(outage)):
        label = "_" if i else "outage"
        ax.axvspan(edges[first], edges[last], color=OUTAGE_COLOUR, zorder=0, label=label)


def _clock(ax: Axes, edges: Any, zone: str) -> None:
    """Times as the clocks of the site show them; numbers are hours of a day."""
    ax.set_xlim(edges[0], edges[-1])
    if isinstance(edges[0], int | float | np.number):
        ax.set_xlabel("Hour of the day")
        return
    ticks: Any = dates  # without annotations
    locator = ticks.AutoDateLocator(tz=zone)
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(ticks.ConciseDateFormatter(locator, tz=zone, show_offset=False))
    first = pd.Timestamp(edges[0]).tz_convert(zone)
    ax.set_xlabel(f"Time ({zone}), from {first:%d %B %Y}")


def _legend(ax: Axes) -> Axes:
    """The legend beside the picture."""
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=_SMALL, frameon=False)
    return ax
