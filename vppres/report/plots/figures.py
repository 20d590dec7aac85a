"""All figures of runs by name, what each shows, and their files."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.day.metrics import service_by_tier as share_by_tier
from vppres.day.outages import BELIEF, LIKELY, believed_outages
from vppres.day.phase_figures import phase_figures
from vppres.day.priority import ranks_of
from vppres.day.series import (
    battery_power_kw,
    demand_kw,
    energy_limits_kwh,
    line_values,
    lowest_model_v_pu,
    off_kw,
    pv_available_kw,
    served_kw,
    stored_energy_kwh,
)
from vppres.day.trajectory import Trajectory
from vppres.kinds.table import KINDS as OF_UNITS
from vppres.report.plots.chart import (
    Band,
    Chart,
    Curve,
    Curves,
    Limit,
    Panel,
    Runs,
    named_runs,
    styled,
)
from vppres.report.plots.drawing import (
    BLACK,
    BLUE,
    CIVIDIS,
    GREEN,
    GREY,
    ORANGE,
    RUN_STYLES,
    SERVED,
    TIER_STYLES,
    UNSERVED,
    VERMILLION,
    WHITE,
    Style,
    coloured,
    png_of,
)
from vppres.report.plots.rows import (
    BATTERIES,
    DARK,
    GIVING,
    LIMITED,
    HeatMap,
    Strip,
    Strips,
    Tiles,
    tile_rows,
)
from vppres.report.tree_layout import tree_layout
from vppres.scenario.phases import PHASES

MAX_COUNTED_STEPS = 50
IDLE_SHARE = 0.01  # of the batteries' power
PHASE_GREYS = ("#FFFFFF", "#D0D0D0", "#F0F0F0", "#B8B8B8")
SUN = (WHITE, "#FFE640")

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
    limits = [Limit(value, "limits of the state of charge") for value in (least, most)]
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
    """Grid import; demand, served demand, available PV power, power of the units of each kind."""
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
        looks = (
            style.thin(),
            replace(style, dash="4 2 1 2"),
            Style(style.color, OF_SETS, 1.3),
            replace(style, dash="8 3"),
        )
        for kind, look in zip(OF_UNITS.values(), itertools.cycle(looks), strict=False):
            if kind.table in run.tables:
                power_kw = run.by_step(kind.table, "p_kw").sum(axis=1)
                load.append(Curve(f"{label}: {kind.what}", power_kw, look))
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
        Limit(network.v_min_pu, f"{network.v_min_pu:g} pu, optimisation limit"),
        Limit(network.v_min_ac_pu, f"{network.v_min_ac_pu:g} pu, AC limit", dash=""),
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


def service_by_tier(runs: Runs) -> Chart:
    """Service step by step: a tile per customer, and the share of each tier."""
    named = named_runs(runs)
    panels: list[Panel] = []
    for label, run in named.items():
        title = f"{label}\n" if len(named) > 1 else ""
        panels.append(Tiles(f"{title}Customer", run, tile_rows(run)))
        curves = [
            Curve(str(tier), 100.0 * share.to_numpy(float), style)
            for (tier, share), style in zip(
                share_by_tier(run).items(), itertools.cycle(TIER_STYLES), strict=False
            )
        ]
        panels.append(
            Curves(f"{title}Customers\nsupplied (%)", curves, 110.0, low=-4.0, high=104.0)
        )
    first = next(iter(named.values()))
    return Chart("service_by_tier", "Supply by customer and tier", first, panels)


def timeline(run: Trajectory) -> Chart:
    """Strips of the grid, the batteries, the PV power, and what is off supply."""
    strips = [
        *([_phase_strip(run)] if "phase" in run.steps else []),
        _grid_strip(run),
        *([_battery_strip(run)] if len(run.scenario.batteries) else []),
        *([_sun_strip(run)] if len(run.scenario.pv) else []),
        _off("Off supply", (~run.by_step("customers", "served")).sum(axis=1)),
        _off("kW off", off_kw(run)),
    ]
    return Chart("timeline", "The day at a glance", run, [Strips(strips)])


def _phase_strip(run: Trajectory) -> Strip:
    """Phases of the day as the record names them."""
    phases = run.steps["phase"].astype(str).tolist()
    names = dict.fromkeys(phases)
    greys = {phase: PHASE_GREYS[i % len(PHASE_GREYS)] for i, phase in enumerate(names)}
    return Strip("Phase", [(greys[phase], "", phase) for phase in phases])


def _grid_strip(run: Trajectory) -> Strip:
    """Grid available, limited or out."""
    limit = run.scenario.grid_limit_kw[: len(run.steps)]
    colours = np.select([limit <= 0, np.isfinite(limit)], [DARK, LIMITED], GIVING)
    return Strip("Grid", [(str(colour), "", "") for colour in colours])


def _battery_strip(run: Trajectory) -> Strip:
    """Whether the batteries together charge or discharge."""
    rated = float(run.scenario.batteries.p_max_kw.sum())
    share = battery_power_kw(run) / max(rated, 1e-9)
    states = np.select([share > IDLE_SHARE, share < -IDLE_SHARE], [1, 2], 0)
    looks = ((WHITE, "", ""), (GREEN, "lines", ""), (ORANGE, "dots", ""))
    return Strip(BATTERIES, [looks[state] for state in states])


def _sun_strip(run: Trajectory) -> Strip:
    """PV power as a share of its largest of the day."""
    available = run.scenario.pv_kw[: len(run.steps)].sum(axis=1)
    shares = available / max(float(available.max()), 1e-9)
    return Strip("PV power", [(coloured(SUN, share), "", "") for share in shares])


def _off(name: str, missing: Floats | Wholes) -> Strip:
    """Steps in which something is off, with its number while there is room."""
    counted = len(missing) <= MAX_COUNTED_STEPS
    return Strip(
        name,
        [(UNSERVED if n else SERVED, "", f"{n:.0f}" if n and counted else "") for n in missing],
        [f"{n:.0f}" for n in missing],
    )


GAP_SHOWN = 1e-9
"""Gaps below it lie at the bottom of their axis: they are rounding."""

RATING_SHOWN_FROM = 80.0
"""Largest loading in per cent from which the rating is drawn."""


def _curves(runs: Runs, values: Callable[[Trajectory], Floats]) -> list[Curve]:
    """A quantity of every run."""
    return [
        Curve(label, np.asarray(values(run), dtype=float), style)
        for label, run, style in styled(runs)
    ]


def line_loadings(runs: Runs) -> Chart:
    """Loading of the most loaded line, or the largest current where lines have no rating."""
    named = named_runs(runs)
    rated = all(run.scenario.network.has_ratings for run in named.values())
    largest = _curves(runs, lambda run: np.nanmax(line_values(run, rated), axis=1))
    near = rated and max(float(curve.values.max()) for curve in largest) > RATING_SHOWN_FROM
    return Chart(
        "line_loadings",
        "Line loading, AC power flow",
        next(iter(named.values())),
        [
            Curves(
                "Largest line\nloading (%)" if rated else "Largest line\ncurrent (A)",
                largest,
                180.0,
                low=0.0,
                limits=[Limit(100.0, "rating", dash="")] if near else (),
            )
        ],
    )


def solve_times(runs: Runs) -> Chart:
    """Time of each decision, and its proven relative gap where there is one."""
    gaps = _curves(runs, lambda run: run.steps["gap"].to_numpy(float))
    gap = Curves("Relative gap", gaps, 130.0, low=GAP_SHOWN, logarithmic=True)
    with_gap = any((curve.values > GAP_SHOWN).any() for curve in gaps)
    return Chart(
        "solve_times",
        "Time and optimality gap of each decision",
        next(iter(named_runs(runs).values())),
        [
            Curves(
                "Time for the\ndecision (s)",
                _curves(runs, lambda run: run.steps["solve_s"].to_numpy(float)),
                130.0,
                low=0.0,
            ),
            *([gap] if with_gap else ()),
        ],
    )


def feeder_maps(run: Trajectory) -> Chart:
    """A row per bus with its voltage, and a row per line with its loading, over the day."""
    net = run.scenario.network
    rated = net.has_ratings
    v = run.by_step("buses", "v_ac_pu")
    layout = tree_layout(run.scenario.network)
    order = np.lexsort((layout.column, layout.row))  # neighbours stay together
    lines = order[order > 0] - 1  # by the bus that each feeds
    return Chart(
        "feeder_maps",
        "Voltage of each bus and " + ("loading" if rated else "current") + " of each line",
        run,
        [
            HeatMap(
                "Bus",
                [str(bus) for bus in net.buses[order]],
                v[:, order].T,
                "AC voltage (pu)",
                CIVIDIS,
                of="buses",
                number=order,
            ),
            HeatMap(
                "Line, by the bus that it feeds",
                [str(bus) for bus in net.to_bus[lines]],
                line_values(run, rated)[:, lines].T,
                "Loading (%)" if rated else "Current (A)",
                CIVIDIS[::-1],
                of="lines",
                number=lines,
            ),
        ],
    )


def by_phase(run: Trajectory) -> Chart:
    """Lowest and highest voltage of each phase, power of the source, loading and unbalance."""
    net, steps = run.scenario.network, run.steps
    lowest, highest, power = [], [], []
    for phase, style in zip(PHASES, RUN_STYLES, strict=False):
        least, most, name = _phase_voltages(run, phase)
        if name:
            lowest.append(Curve(f"phase {name}", least, style))
            highest.append(Curve(f"phase {name}: highest", most, style.thin(), in_legend=False))
        power.append(Curve(f"phase {phase}: kVA", source_kva(run, phase), style, in_legend=False))
    rating = phase_figures(run)["former_phase_rating_kva"]
    solid = Style(BLACK, "", 1.5)
    loading = 100.0 * steps["loading_max"].to_numpy(float)
    unbalance = 100.0 * steps["unbalance_max"].to_numpy(float)
    limits = [
        Limit(value, f"AC limits, {net.v_min_ac_pu:g} and {net.v_max_ac_pu:g} pu", dash="")
        for value in (net.v_min_ac_pu, net.v_max_ac_pu)
    ]
    return Chart(
        "by_phase",
        "Voltages, power, loading and unbalance by phase",
        run,
        [
            Curves("Lowest and highest\nvoltage (pu)", [*lowest, *highest], 190.0, limits=limits),
            Curves(
                "Import, or power of\nthe former (kVA)",
                power,
                150.0,
                low=0.0,
                limits=[] if rating is None else [Limit(float(rating), "former's rating")],
            ),
            Curves(
                "Largest\nloading (%)",
                [Curve("loading", loading, solid, in_legend=False)],
                100.0,
                low=0.0,
                limits=[Limit(100.0, "rating", dash="")],
            ),
            Curves(
                "Unbalance\nfactor (%)",
                [Curve("unbalance", unbalance, solid, in_legend=False)],
                80.0,
                low=0.0,
            ),
        ],
    )


def source_kva(run: Trajectory, phase: str) -> Floats:
    """Power of the grid on a phase, or of the former in an island, (T,)."""
    steps = run.steps
    grid, former = (steps[f"{name}_{phase}_kva"].to_numpy(float) for name in ("import", "former"))
    return np.where(np.isnan(grid), former, grid)


def _phase_voltages(run: Trajectory, phase: str) -> tuple[Floats, Floats, str]:
    """Lowest and highest voltage of a phase, or of the pair that begins with it, and its name."""
    assert run.nodes is not None
    own = run.nodes[run.nodes["phase"].astype(str).str[0] == phase]
    at = own.groupby("time")["v_ac_pu"].agg(["min", "max"]).reindex(run.steps["time"])
    name = " and ".join(sorted(own["phase"].astype(str).unique()))
    return at["min"].to_numpy(float), at["max"].to_numpy(float), name


LEADS = {1.0: Style(BLUE, "", 2.6), 3.0: Style(BLUE, "7 3", 1.8), 6.0: Style(BLUE, "2 3", 1.4)}
"""How many hours before a step its probability is shown, and how."""


def has_beliefs(run: Trajectory) -> bool:
    """Whether a run believed something of outages ahead."""
    return run.options.get("outages") in (BELIEF, LIKELY)


def outage_belief(run: Trajectory) -> Chart:
    """Probability of an outage some hours before each step, and what stored energy was worth."""
    believed = believed_outages(run.scenario, run.options)[: len(run.steps), : len(run.steps)]
    dt_h = run.scenario.grid.dt_h
    curves = [
        Curve(f"{lead_h:g} h before", _before(believed, round(lead_h / dt_h)), style)
        for lead_h, style in LEADS.items()
    ]
    values = [curve.values for curve in curves]
    fan = Band(np.fmin.reduce(values), np.fmax.reduce(values), BLUE)
    panels = [Curves("Probability of an outage", curves, 220.0, low=0.0, high=1.02, bands=[fan])]
    if "stored_value_gbp_per_kwh" in run.steps:
        worth = run.steps["stored_value_gbp_per_kwh"].to_numpy(float)
        price = run.steps["price_gbp_per_kwh"].to_numpy(float)
        panels.append(
            Curves(
                "GBP per kWh",
                [
                    Curve("worth of one more stored kWh", worth, Style(VERMILLION, "", 2.0)),
                    Curve("import price", price, Style(BLACK, "2 3", 1.3)),
                ],
                130.0,
            )
        )
    return Chart("outage_belief", "Outage forecasts; grey: actual outages", run, panels)


def _before(believed: Floats, steps: int) -> Floats:
    """Probability of each step as it was known so many steps before, NaN where it was not."""
    found = np.full(len(believed), np.nan)
    if steps < len(believed):
        found[steps:] = np.diagonal(believed, steps)
    return found


ROOM = Style(BLUE, "", 0.6)
MEDIAN = Style(BLACK, "", 2.0)


def indoor(run: Trajectory) -> Chart:
    """Temperature of each room and tank, and their median: those that are cooled, then heated."""
    loads = run.scenario.thermal_loads
    start_c, end_c = (run.by_step("thermal_loads", name) for name in ("t_start_c", "t_end_c"))
    t_c = np.vstack([start_c[:1], end_c])
    kinds = (("Cooled (°C)", ~loads.heats), ("Heated (°C)", loads.heats))
    panels = [_temperatures(run, axis, t_c, chosen) for axis, chosen in kinds if chosen.any()]
    return Chart("indoor", "Temperatures of rooms and tanks", run, panels)


def _temperatures(run: Trajectory, axis: str, t_c: Floats, chosen: Flags) -> Curves:
    """Temperatures of a kind, with the ends of the comfort band if all have the same."""
    loads = run.scenario.thermal_loads
    each = [Curve("each", t_c[:, h], ROOM, in_legend=False) for h in np.flatnonzero(chosen)]
    median = Curve("median", np.median(t_c[:, chosen], axis=1), MEDIAN)
    limits = [
        Limit(float(end_c[chosen][0]), "comfort band")
        for end_c in (loads.t_min_c, loads.t_max_c)
        if np.ptp(end_c[chosen]) == 0.0
    ]
    return Curves(axis, [*each, median], 150.0, limits=limits)


def worth_of_energy(run: Trajectory) -> Chart:
    """The value of one more stored kWh, in customer hours and in GBP."""
    service = worth_per_step(run, "weighted_h")
    cost = worth_per_step(run, "gbp")
    price = run.steps["price_gbp_per_kwh"].to_numpy(float)
    ranks = ranks_of(run.scenario, run.options)
    # In strict order a customer of the last tier weighs 1.
    hours = (
        "weighted customer hours" if ranks is None else f"customer hours of tier {ranks.tiers[-1]}"
    )
    return Chart(
        "worth_of_energy",
        "Value of one more stored kWh",
        run,
        [
            Curves(
                "Customer hours\nper kWh",
                [Curve(f"{hours} per kWh", service, Style(VERMILLION))],
                120.0,
                low=0.0 if not (service < 0.0).any() else None,
            ),
            Curves(
                "GBP per kWh",
                [
                    Curve("GBP per kWh", cost, Style(BLUE)),
                    Curve("import price", price, Style(GREY, "2 3", 1.4)),
                ],
                120.0,
                low=0.0 if not (cost < 0.0).any() and price.min() >= 0.0 else None,
            ),
        ],
    )


def worth_per_step(trajectory: Trajectory, column: str) -> Floats:
    """Largest worth of a stored kWh in any battery, shape (T,); NaN where it is not known."""
    prices = trajectory.shadow_prices
    if prices is None:
        return np.full(len(trajectory.steps), np.nan)
    stored = prices[prices["constraint"] == "stored_energy"]
    best = stored.groupby("time")[column].max()
    return best.reindex(trajectory.steps["time"]).to_numpy(float)


# Figures of one run or of several.
FIGURES: dict[str, Callable[[Runs], Chart]] = {
    "energy_and_price": energy_and_price,
    "import_load_pv": import_load_pv,
    "voltages": voltages,
    "service_by_tier": service_by_tier,
    "line_loadings": line_loadings,
    "solve_times": solve_times,
}

# Figures of one run alone.
RUN_FIGURES: dict[str, Callable[[Trajectory], Chart]] = {
    "timeline": timeline,
    "feeder_maps": feeder_maps,
}

# Figures of one run that has what they show.
SOME_FIGURES: dict[str, tuple[Callable[[Trajectory], bool], Callable[[Trajectory], Chart]]] = {
    "by_phase": (lambda run: bool(run.scenario.phases), by_phase),
    "outage_belief": (has_beliefs, outage_belief),
    "indoor": (lambda run: run.thermal_loads is not None, indoor),
}

FIGURE_TEXTS = {
    "by_phase": "Lowest and, dotted, highest voltage of each phase; what the grid or the battery "
    "that forms the island gives on each phase; the phase nearest to its rating; unbalance.",
    "energy_and_price": "Stored energy, net charging power of all batteries and import price.",
    "import_load_pv": "Import at the slack bus (above); demand, supplied demand, available PV "
    "power, and power of the units of each kind, of vehicles net charging power (below).",
    "indoor": "Temperature of each room and tank, their median, and the ends of the comfort band "
    "if all have the same.",
    "voltages": "Lowest bus voltage of each step, and the largest difference between optimisation "
    "and AC power flow at any bus.",
    "service_by_tier": "Supply of each customer in each step, and the share of each tier.",
    "line_loadings": "The most loaded line of each step, from the AC power flow.",
    "solve_times": "Time from forecast to decision, and relative gap (below 1e-9 at the bottom).",
    "timeline": "The day at a glance; numbers are customers off supply, and their kW.",
    "feeder_maps": "A row per bus with its AC voltage, and a row per line with its loading or "
    "current; dashed: the outage.",
    "outage_belief": "Forecast probability of an outage in each step, some hours before, and the "
    "expected value of one more stored kWh.",
}
"""What each figure shows."""

PNG, SVG = "png", "svg"
KINDS = (PNG, SVG)


def chart_of(runs: Runs, name: str) -> Chart:
    """A figure by its name."""
    if name in FIGURES:
        return FIGURES[name](runs)
    assert isinstance(runs, Trajectory)
    draw = RUN_FIGURES[name] if name in RUN_FIGURES else SOME_FIGURES[name][1]
    return draw(runs)


def figure_names(runs: Runs) -> list[str]:
    """Names of the figures that one run, or several side by side, have."""
    if not isinstance(runs, Trajectory):
        return [*FIGURES]
    some = [name for name, (has, _) in SOME_FIGURES.items() if has(runs)]
    return [*FIGURES, *RUN_FIGURES, *some]


def save_figures(runs: Runs, folder: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Write every figure into a folder, which is made if missing; the files written.

    Those of one run alone are left out for several of the same day, which come by their labels.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = figure_names(runs)
    return [file for name in names for file in save_chart(chart_of(runs, name), folder, kinds)]


def save_chart(chart: Chart, folder: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Write one figure into an existing folder, under its name; equal figures give equal files."""
    svg = chart.svg()
    written = []
    for kind in kinds:
        file = folder / f"{chart.key}.{kind}"
        file.write_bytes(svg.encode() if kind == SVG else png_of(svg))
        written.append(file)
    return written
