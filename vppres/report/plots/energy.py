"""Energy, power, price and voltages over the day."""

from __future__ import annotations

import itertools

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vppres.core.arrays import Floats
from vppres.day.series import (
    battery_power_kw,
    demand_kw,
    edges_of,
    energy_limits_kwh,
    lowest_model_v_pu,
    pv_available_kw,
    served_kw,
    stored_energy_kwh,
)
from vppres.day.trajectory import Trajectory
from vppres.report.plots.base import (
    BLACK,
    GREEN,
    GREY,
    ORANGE,
    RUN_STYLES,
    VERMILLION,
    Runs,
    closed,
    draw_limit,
    draw_steps,
    named_runs,
    panels,
    with_legend,
)


def energy_and_price(runs: Runs) -> Figure:
    """Stored energy, net charging power of all batteries, and the import price."""
    named = named_runs(runs)
    first = next(iter(named.values()))
    figure, (energy, power, price) = panels(named, heights=(3, 2, 1.3), height_in=7.2)
    for (label, run), style in zip(named.items(), itertools.cycle(RUN_STYLES), strict=False):
        energy.plot(edges_of(run), stored_energy_kwh(run), **style.line(label))
        if run.planned is not None:
            energy.plot(edges_of(run), run.planned["energy_kwh"], **style.thin(f"{label}: planned"))
        draw_steps(power, run, battery_power_kw(run), style.line())
    least, most = energy_limits_kwh(first)
    draw_limit(energy, most, "upper SoC limit")
    draw_limit(energy, least, "lower SoC limit")
    energy.set_ylim(bottom=0.0)
    power.axhline(0.0, color=GREY, linewidth=0.8)
    gbp_per_kwh = first.steps["price_gbp_per_kwh"].to_numpy(float)
    draw_steps(price, first, gbp_per_kwh, {"color": BLACK})
    lowest = float(gbp_per_kwh.min())
    if first.scenario.exports:
        earned = first.scenario.export_price[: len(first.steps)]
        dashes = {"color": GREEN, "linestyle": (0, (4, 2)), "label": "export price"}
        draw_steps(price, first, earned, dashes)
        price.legend(loc="upper left", frameon=False, fontsize=7)
        lowest = min(lowest, float(earned.min()))
    if lowest < 0.0:
        price.axhline(0.0, color=GREY, linewidth=0.8)
    else:
        price.set_ylim(bottom=0.0)
    energy.set_ylabel("Stored energy (kWh)")
    power.set_ylabel("Net charging\npower (kW)")
    price.set_ylabel("Price\n(GBP/kWh)")
    figure.suptitle("Battery energy and price")
    return with_legend(figure, energy, columns=len(named))


def import_load_pv(runs: Runs) -> Figure:
    """Grid import, and demand, served demand and available PV power of the feeder."""
    named = named_runs(runs)
    first = next(iter(named.values()))
    figure, (imports, load) = panels(named, heights=(1, 1), height_in=6.4)
    for (label, run), style in zip(named.items(), itertools.cycle(RUN_STYLES), strict=False):
        draw_steps(imports, run, run.steps["p_grid_kw"].to_numpy(), style.line())
        draw_steps(load, run, served_kw(run), style.line(f"{label}: import, and demand served"))
    demand = demand_kw(first)
    available = pv_available_kw(first)
    draw_steps(load, first, demand, {"color": BLACK, "linewidth": 1.0, "label": "demand"})
    draw_steps(
        load,
        first,
        available,
        {"color": ORANGE, "linestyle": (0, (3, 1, 1, 1)), "label": "PV available"},
    )
    if len(named) == 1:
        _fill_unserved(load, first, served_kw(first), demand)
    imports.set_ylabel("Import at the slack bus,\nAC (kW)")
    if any(run.scenario.exports for run in named.values()):
        imports.axhline(0.0, color=GREY, linewidth=0.8)
        imports.set_ylabel("Import at the slack bus,\nAC (kW); export below 0")
        _draw_export_limit(imports, first)
    load.set_ylabel("Power (kW)")
    load.set_ylim(bottom=0.0)
    figure.suptitle("Grid import, demand and PV")
    return with_legend(figure, load, columns=2)


def _draw_export_limit(ax: Axes, run: Trajectory) -> None:
    """The export limit below zero, where it could have been reached."""
    limit_kw = run.scenario.export_max_kw[: len(run.steps)]
    finite = np.isfinite(limit_kw)
    if not (finite & (limit_kw > 0.0)).any():
        return
    shown = np.where(finite, -limit_kw, np.nan)
    draw_steps(ax, run, shown, {"color": BLACK, "linewidth": 1.0, "linestyle": ":"})


def voltages(runs: Runs) -> Figure:
    """Lowest voltage of any bus (AC and optimisation), and the largest difference of the two."""
    named = named_runs(runs)
    network = next(iter(named.values())).scenario.network
    figure, (lowest, error) = panels(named, heights=(3, 1.4), height_in=6.4)
    for (label, run), style in zip(named.items(), itertools.cycle(RUN_STYLES), strict=False):
        draw_steps(
            lowest, run, run.steps["v_min_ac_pu"].to_numpy(), style.line(f"{label}: AC power flow")
        )
        draw_steps(lowest, run, lowest_model_v_pu(run), style.thin(f"{label}: optimisation"))
        draw_steps(error, run, 1000.0 * run.steps["v_error_pu"].to_numpy(), style.line())
    draw_limit(lowest, network.v_min_pu, f"{network.v_min_pu:g} optimisation limit")
    draw_limit(lowest, network.v_min_ac_pu, f"{network.v_min_ac_pu:g} AC limit", linestyle="-")
    lowest.margins(y=0.1)
    lowest.set_ylabel("Lowest bus voltage (pu)")
    error.set_ylabel("Largest\n|optim. - AC|\n(0.001 pu)")
    error.set_ylim(bottom=0.0)
    figure.suptitle("Voltages: optimisation against AC power flow")
    return with_legend(figure, lowest, columns=len(named))


def _fill_unserved(ax: Axes, run: Trajectory, served: Floats, demand: Floats) -> None:
    """Hatch the demand that was not met."""
    ax.fill_between(
        edges_of(run),
        closed(served),
        closed(demand),
        step="post",
        facecolor="none",
        edgecolor=VERMILLION,
        hatch="////",
        linewidth=0.0,
        label="not served",
    )
