"""Energy, power, price and voltages over the day."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.day.series import (
    battery_power_kw,
    demand_kw,
    energy_limits_kwh,
    lowest_model_v_pu,
    pv_available_kw,
    served_kw,
    stored_energy_kwh,
)
from vppres.day.trajectory import Trajectory
from vppres.report.plots.chart import Band, Chart, Curve, Curves, Limit, Runs, styled
from vppres.report.plots.palette import BLACK, GREEN, ORANGE, VERMILLION, Style

ZERO = Limit(0.0, dash="")
"""A line at zero, without a name."""

OF_SETS = "5 2 1 2"
"""Dashes of what generating sets give."""


def energy_and_price(runs: Runs) -> Chart:
    """Stored energy, net charging power of all batteries, and the import price."""
    energy = []
    power = []
    every = styled(runs)
    first = every[0][1]
    for label, run, style in every:
        energy.append(Curve(label, stored_energy_kwh(run), style))
        if run.planned is not None:
            planned = np.asarray(run.planned["energy_kwh"], dtype=float)
            energy.append(Curve(f"{label}: planned", planned, style.thin()))
        power.append(Curve(label, battery_power_kw(run), style))
    least, most = energy_limits_kwh(first)
    limits = [Limit(most, "upper SoC limit"), Limit(least, "lower SoC limit")]
    stored = [
        Curves("Stored energy (kWh)", energy, 210.0, low=0.0, limits=limits),
        Curves("Net charging\npower (kW)", power, 140.0, limits=[ZERO]),
    ]
    with_batteries = any(len(run.scenario.batteries) for _, run, _ in every)
    return Chart(
        "energy_and_price",
        "Battery energy and price",
        first,
        [*(stored if with_batteries else ()), _price_panel(first)],
    )


def _price_panel(run: Trajectory) -> Curves:
    """Import price, and what export earns."""
    paid = run.steps["price_gbp_per_kwh"].to_numpy(float)
    prices = [Curve("import price", paid, Style(BLACK, "", 1.5))]
    if run.scenario.exports:
        earned = np.asarray(run.scenario.export_price[: len(run.steps)], dtype=float)
        prices.append(Curve("export price", earned, Style(GREEN, "5 3", 1.5)))
    negative = min(float(curve.values.min()) for curve in prices) < 0.0
    return Curves(
        "Price\n(GBP/kWh)",
        prices,
        95.0,
        low=None if negative else 0.0,
        limits=[ZERO] if negative else (),
    )


def import_load_pv(runs: Runs) -> Chart:
    """Grid import; demand, served demand, available PV power, vehicles, machines and sets."""
    imports = []
    load = []
    every = styled(runs)
    first = every[0][1]
    for label, run, style in every:
        drawn = run.steps["p_grid_kw"].to_numpy(float)
        imports.append(Curve(f"{label}: import", drawn, style, in_legend=False))
        load.append(Curve(f"{label}: import, and supplied demand", served_kw(run), style))
    demand = demand_kw(first)
    load.append(Curve("demand", demand, Style(BLACK, "", 1.2)))
    load.append(Curve("PV available", pv_available_kw(first), Style(ORANGE, "6 2 2 2", 1.8)))
    lowest_kw: float | None = 0.0
    for label, run, style in every:
        for table, words, look in (
            ("vehicles", "vehicles", style.thin()),
            ("gensets", "generating sets", Style(style.color, OF_SETS, 1.3)),
            ("thermal_loads", "cooling and heat", replace(style, dash="4 2 1 2")),
        ):
            if table in run.tables:
                power_kw = run.by_step(table, "p_kw").sum(axis=1)
                load.append(Curve(f"{label}: {words}", power_kw, look))
                lowest_kw = None if (power_kw < 0.0).any() else lowest_kw
    unserved = Band(served_kw(first), demand, VERMILLION, "not supplied")
    exports = any(run.scenario.exports for _, run, _ in every)
    below = "; export below 0" if exports else ""
    return Chart(
        "import_load_pv",
        "Grid import, demand and PV",
        first,
        [
            Curves(
                f"Import at the slack bus,\nAC (kW){below}",
                [*imports, *(_export_limit(first) if exports else ())],
                170.0,
                limits=[ZERO],
            ),
            Curves(
                "Power (kW)",
                load,
                200.0,
                low=lowest_kw,
                limits=[ZERO] if lowest_kw is None else (),
                bands=[unserved] if len(every) == 1 else (),
            ),
        ],
    )


def _export_limit(run: Trajectory) -> list[Curve]:
    """The export limit below zero, if it could have been reached."""
    limit_kw = np.asarray(run.scenario.export_max_kw[: len(run.steps)], dtype=float)
    finite = np.isfinite(limit_kw)
    if not (finite & (limit_kw > 0.0)).any():
        return []
    return [Curve("export limit", np.where(finite, -limit_kw, np.nan), Style(BLACK, "2 3", 1.2))]


def voltages(runs: Runs) -> Chart:
    """Lowest voltage of any bus (AC and optimisation), and the largest difference of the two."""
    lowest = []
    error = []
    every = styled(runs)
    first = every[0][1]
    network = first.scenario.network
    for label, run, style in every:
        found = run.steps["v_min_ac_pu"].to_numpy(float)
        lowest.append(Curve(f"{label}: lowest, AC power flow", found, style))
        lowest.append(Curve(f"{label}: lowest, optimisation", lowest_model_v_pu(run), style.thin()))
        apart = 1000.0 * run.steps["v_error_pu"].to_numpy(float)
        error.append(Curve(f"{label}: difference (0.001 pu)", apart, style, in_legend=False))
    if len(every) == 1:
        highest = first.steps["v_max_ac_pu"].to_numpy(float)
        lowest.append(Curve("highest bus voltage", highest, Style(ORANGE, "6 3", 1.4)))
    limits = [
        Limit(network.v_min_pu, f"{network.v_min_pu:g} optimisation limit"),
        Limit(network.v_min_ac_pu, f"{network.v_min_ac_pu:g} AC limit", dash=""),
    ]
    return Chart(
        "voltages",
        "Voltages: optimisation against AC power flow",
        first,
        [
            Curves("Bus voltage (pu)", lowest, 220.0, limits=limits),
            Curves("Largest\n|optim. \N{MINUS SIGN} AC|\n(0.001 pu)", error, 105.0, low=0.0),
        ],
    )
