"""Interactive charts of a run (plotly): values under the pointer, zoom, the outage shaded.

Each chart has a static counterpart in :mod:`vppres.report.plots`, which serves the print.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from vppres.core.arrays import Floats
from vppres.day.metrics import service_by_tier
from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock
from vppres.report.plots import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    OUTAGE_COLOUR,
    PURPLE,
    RULE_COLOUR,
    TIER_STYLES,
    VERMILLION,
    battery_power_kw,
    demand_kw,
    edges_of,
    energy_limits_kwh,
    line_values,
    lowest_model_v_pu,
    outage_spans,
    pv_available_kw,
    served_kw,
    stored_energy_kwh,
)

ROW_PX = 190
FRAME_PX = 177
TOP_PX = 48
LEGEND_PX = 66  # below the axis, its times and its name
GAP = 0.06  # between two rows, as a share of the height
DASHES = ("solid", "dash", "dashdot", "dot")


@dataclass(frozen=True)
class Curve:
    """One curve: a value per step, or at every instant between steps where there is one more."""

    name: str
    values: Sequence[float] | Floats
    color: str
    dash: str = "solid"
    text: Sequence[str] = ()


@dataclass(frozen=True)
class Row:
    """Curves over one axis, and limits drawn across: value and name."""

    axis: str
    curves: Sequence[Curve]
    limits: Sequence[tuple[float, str]] = ()
    from_zero: bool = True


def service_chart(run: Trajectory) -> go.Figure:
    """Share of each tier's customers that are served."""
    curves = [
        Curve(_literal(tier), 100.0 * share.to_numpy(), style.color, dash)
        for (tier, share), style, dash in zip(
            service_by_tier(run).items(),
            itertools.cycle(TIER_STYLES),
            itertools.cycle(DASHES),
            strict=False,
        )
    ]
    return _chart(run, [Row("Customers<br>served (%)", curves)])


def energy_chart(run: Trajectory) -> go.Figure:
    """Stored energy, battery power, demand and PV, import, and price."""
    stored = [Curve("stored energy (kWh)", stored_energy_kwh(run), BLUE)]
    if run.planned is not None:
        stored.append(Curve("planned energy (kWh)", run.planned["energy_kwh"], PURPLE, "dot"))
    least, most = energy_limits_kwh(run)
    limits = [(most, "upper limit"), (least, "lower limit")]
    return _chart(
        run,
        [
            Row("Stored energy<br>(kWh)", stored, limits if len(run.scenario.batteries) else ()),
            Row(
                "Power (kW)",
                [
                    Curve("demand (kW)", demand_kw(run), BLACK),
                    Curve("demand served (kW)", served_kw(run), BLUE, "dash"),
                    Curve("PV available (kW)", pv_available_kw(run), ORANGE, "dashdot"),
                    Curve(_grid_name(run), run.steps["p_grid_kw"].to_numpy(), VERMILLION, "dot"),
                    Curve(
                        "net charging of batteries (kW)", battery_power_kw(run), GREEN, "longdash"
                    ),
                ],
                from_zero=False,
            ),
            Row(
                "Price<br>(GBP/kWh)",
                _prices(run),
            ),
        ],
    )


def _grid_name(run: Trajectory) -> str:
    """What the power at the slack bus is called."""
    return "import, export below 0 (kW)" if run.scenario.exports else "import (kW)"


def _prices(run: Trajectory) -> list[Curve]:
    """Import price, and what export earns where there is one."""
    curves = [Curve("import price (GBP/kWh)", run.steps["price_gbp_per_kwh"].to_numpy(), GREY)]
    if run.scenario.exports:
        earned = run.scenario.export_price[: len(run.steps)]
        curves.append(Curve("export price (GBP/kWh)", earned, GREEN, "dash"))
    return curves


def grid_chart(run: Trajectory) -> go.Figure:
    """Voltages of the AC power flow with their limits, and the most loaded line."""
    net = run.scenario.network
    v = run.buses["v_ac_pu"].to_numpy(float).reshape(len(run.steps), -1)
    lowest = v.argmin(axis=1)
    highest = v.argmax(axis=1)
    at_lowest = [f"bus {_literal(bus)}" for bus in net.buses[lowest]]
    at_highest = [f"bus {_literal(bus)}" for bus in net.buses[highest]]
    return _chart(
        run,
        [
            Row(
                "Voltage (pu)",
                [
                    Curve("highest voltage (pu)", v.max(axis=1), ORANGE, "dash", at_highest),
                    Curve("lowest voltage (pu)", v.min(axis=1), BLUE, "solid", at_lowest),
                    Curve(
                        "lowest voltage of the optimisation (pu)",
                        lowest_model_v_pu(run),
                        PURPLE,
                        "dot",
                    ),
                ],
                limits=[(net.v_min_ac_pu, "lower AC limit")],
                from_zero=False,
            ),
            _line_row(run),
        ],
    )


def _line_row(run: Trajectory) -> Row:
    """Loading of the most loaded line where lines have ratings, else the largest current."""
    net = run.scenario.network
    rated = run.scenario.network.has_ratings
    values = np.nan_to_num(line_values(run, rated))
    lines = [_literal(f"line {net.from_bus[i]} to {net.to_bus[i]}") for i in values.argmax(axis=1)]
    name = "largest line loading (%)" if rated else "largest line current (A)"
    return Row(
        "Line<br>loading (%)" if rated else "Line<br>current (A)",
        [Curve(name, values.max(axis=1), BLACK, "solid", lines)],
        limits=[(100.0, "rating")] if rated and values.max() > 80 else (),
    )


CHARTS = {"service": service_chart, "energy": energy_chart, "grid": grid_chart}


def chart_json(run: Trajectory, name: str) -> str:
    """A chart as JSON that can stand inside a script element."""
    text: str = CHARTS[name](run).to_json()
    return text.replace("<", "\\u003c")


def plotly_script() -> str:
    """The plotly library itself, some 5 MB of JavaScript."""
    script: str = get_plotlyjs()
    return script


def _literal(name: object) -> str:
    """Others' words for a chart: plotly reads tags and links in them."""
    return escape(str(name), quote=False)


def _chart(run: Trajectory, rows: Sequence[Row]) -> go.Figure:
    """Rows over one time axis; a click or the pointer counts in all of them."""
    times = [time.strftime("%Y-%m-%dT%H:%M:%S") for time in edges_of(run)]
    figure = go.Figure(
        [
            _trace(curve, number, times)
            for number, row in enumerate(rows, start=1)
            for curve in row.curves
        ]
    )
    plot_px = ROW_PX * len(rows)
    height = (1.0 - GAP * (len(rows) - 1)) / len(rows)
    axes = {
        _axis("yaxis", number): {
            "title": {"text": row.axis},
            "rangemode": "tozero" if row.from_zero else "normal",
            "domain": [
                max(0.0, 1 - number * height - (number - 1) * GAP),
                1 - (number - 1) * (height + GAP),
            ],
            "gridcolor": RULE_COLOUR,
            "zerolinecolor": GREY,
        }
        for number, row in enumerate(rows, start=1)
    }
    figure.update_layout(
        **axes,
        template="none",
        hovermode="x unified",
        hoversubplots="axis",
        xaxis={
            "type": "date",
            "anchor": _axis("y", len(rows)),
            "gridcolor": "#E8E8E8",
            "title": {"text": Clock.of(run).axis},
            "range": [times[0], times[-1]],
            "hoverformat": "%d %b %H:%M",
        },
        # The toolbar has the top to itself, whatever the width.
        legend={"orientation": "h", "yanchor": "top", "y": -LEGEND_PX / plot_px, "x": 0},
        margin={"l": 80, "r": 20, "t": TOP_PX, "b": 50},
        height=plot_px + FRAME_PX,
        shapes=[_cursor(times[0]), *_shades(run, times), *_limit_lines(rows)],
        annotations=list(_notes(run, rows, times)),
        font={"size": 12},
    )
    return figure


def _trace(curve: Curve, row: int, times: Sequence[str]) -> go.Scatter:
    """A quantity of a step as a level line to its end, a state at an instant as points joined."""
    values = np.asarray(curve.values, dtype=float)
    of_steps = len(values) < len(times)
    values = np.append(values, values[-1]) if of_steps else values
    text = [*curve.text, curve.text[-1]] if curve.text else None
    return go.Scatter(
        x=times,
        y=values,
        name=curve.name,
        xaxis="x",
        yaxis=_axis("y", row),
        mode="lines",
        text=text,
        line={
            "color": curve.color,
            "dash": curve.dash,
            "width": 2,
            "shape": "hv" if of_steps else "linear",
        },
        hovertemplate="%{y:.5~g}" + (" at %{text}" if curve.text else ""),
    )


def _axis(name: str, number: int) -> str:
    """Plotly counts axes from 2; the first has no number."""
    return name if number == 1 else f"{name}{number}"


def _cursor(time: str) -> dict[str, Any]:
    """A line at the step that the diagram shows; scripts move it."""
    return {
        "type": "line",
        "x0": time,
        "x1": time,
        "yref": "paper",
        "y0": 0,
        "y1": 1,
        "line": {"color": VERMILLION, "width": 1.5, "dash": "dot"},
    }


def _shades(run: Trajectory, times: Sequence[str]) -> Iterable[dict[str, Any]]:
    for first, last in outage_spans(run):
        yield {
            "type": "rect",
            "x0": times[first],
            "x1": times[last],
            "yref": "paper",
            "y0": 0,
            "y1": 1,
            "fillcolor": OUTAGE_COLOUR,
            "line": {"width": 0},
            "layer": "below",
        }


def _limit_lines(rows: Sequence[Row]) -> Iterable[dict[str, Any]]:
    for number, row in enumerate(rows, start=1):
        for value, _ in row.limits:
            yield {
                "type": "line",
                "xref": "paper",
                "x0": 0,
                "x1": 1,
                "yref": _axis("y", number),
                "y0": value,
                "y1": value,
                "line": {"color": GREY, "width": 1, "dash": "dash"},
            }


def _notes(run: Trajectory, rows: Sequence[Row], times: Sequence[str]) -> Iterable[dict[str, Any]]:
    """Names of the outages and of the limits."""
    for first, last in outage_spans(run):
        yield {
            "x": times[(first + last) // 2],
            "y": 1,
            "yref": "paper",
            "text": "outage",
            "showarrow": False,
            "yanchor": "bottom",
        }
    for number, row in enumerate(rows, start=1):
        for value, name in row.limits:
            yield {
                "xref": "paper",
                "x": 1,
                "xanchor": "right",
                "yref": _axis("y", number),
                "y": value,
                "yanchor": "bottom",
                "text": f"{name} {value:.5g}",
                "showarrow": False,
                "font": {"size": 10, "color": GREY},
            }
