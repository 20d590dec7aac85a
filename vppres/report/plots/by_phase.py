"""Voltages, power, loadings and unbalance of a phased feeder over the day, phase by phase."""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Floats
from vppres.day.phase_figures import phase_figures
from vppres.day.trajectory import Trajectory
from vppres.report.plots.chart import Chart, Curve, Curves, Limit
from vppres.report.plots.palette import BLACK, RUN_STYLES, Style
from vppres.scenario.phases import PHASES


def by_phase(run: Trajectory) -> Chart:
    """Lowest and highest voltage of each phase, power of the source, loading and unbalance."""
    net, steps = run.scenario.network, run.steps
    lowest, highest, power = [], [], []
    for phase, style in zip(PHASES, RUN_STYLES, strict=False):
        least, most, name = _voltages(run, phase)
        if name:
            lowest.append(Curve(f"phase {name}", least, style))
            highest.append(Curve(f"phase {name}: highest", most, style.thin(), in_legend=False))
        power.append(Curve(f"phase {phase}: kVA", source_kva(run, phase), style, in_legend=False))
    rating = phase_figures(run)["former_phase_rating_kva"]
    solid = Style(BLACK, "", 1.5)
    loading = 100.0 * steps["loading_max"].to_numpy(float)
    unbalance = 100.0 * steps["unbalance_max"].to_numpy(float)
    limits = [
        Limit(net.v_min_ac_pu, f"{net.v_min_ac_pu:g} AC limit", dash=""),
        Limit(net.v_max_ac_pu, f"{net.v_max_ac_pu:g} AC limit", dash=""),
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
    """What the grid gives on a phase, or in an island its former, (T,)."""
    steps = run.steps
    grid, former = (steps[f"{name}_{phase}_kva"].to_numpy(float) for name in ("import", "former"))
    return np.where(np.isnan(grid), former, grid)


def _voltages(run: Trajectory, phase: str) -> tuple[Floats, Floats, str]:
    """Lowest and highest voltage of a phase, or of the pair that begins with it, and its name."""
    assert run.nodes is not None
    own = run.nodes[run.nodes["phase"].astype(str).str[0] == phase]
    at = own.groupby("time")["v_ac_pu"].agg(["min", "max"]).reindex(run.steps["time"])
    name = " and ".join(sorted(own["phase"].astype(str).unique()))
    return at["min"].to_numpy(float), at["max"].to_numpy(float), name
