"""Key findings of a run: limits exceeded, plans corrected, gaps above the tolerance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from vppres.core.text import counted
from vppres.day.metrics import (
    blackouts,
    cautions,
    import_above_limit_kw,
    island_figures,
    line_loading,
)
from vppres.day.options import RULES
from vppres.day.trajectory import Trajectory
from vppres.plant.plant import CLIP_TOLERANCE_KW, NOBODY
from vppres.report.clock import Clock
from vppres.scenario.configuration import Branches
from vppres.scenario.remarks import darkness, unknown_phases

LIMIT_TOLERANCE_PU = 1e-6
PROVEN = ("optimal", "blacked_out")
"""Statuses of decisions that a closed gap proves, or that had nothing to decide."""
ISLAND_TOLERANCE_KW = 0.5


def findings(run: Trajectory) -> list[str]:
    """One sentence for each exception; empty if there is none."""
    return [*doubts(run), *remarks(run)]


def doubts(run: Trajectory) -> list[str]:
    """Doubts about the answer: islands that nothing forms, blackouts, unknown phases."""
    dark = darkness(run.scenario, run.options.get("mode", "paper"))
    return [*([dark] if dark else []), *blackouts(run), *unknown_phases(run.scenario)]


def remarks(run: Trajectory) -> list[str]:
    """The other exceptions."""
    known = doubts(run)
    return [
        *(words for words in cautions(run) if words not in known),
        *_estimates(run),
        *_voltages(run),
        *_loadings(run),
        *_import(run),
        *_island(run),
        *_decisions(run),
        *_answers(run),
    ]


def _voltages(run: Trajectory) -> Iterator[str]:
    """Voltages of the AC power flow outside its limits."""
    net = run.scenario.network
    live = run.buses[run.buses["v_ac_pu"] > 0]
    v = live["v_ac_pu"]
    for words, limit, beyond in (
        ("below", net.v_min_ac_pu, net.v_min_ac_pu - v),
        ("above", net.v_max_ac_pu, v - net.v_max_ac_pu),
    ):
        wrong = live[beyond > LIMIT_TOLERANCE_PU]
        if len(wrong):
            row = live.iloc[int(beyond.to_numpy().argmax())]
            n_buses = wrong["bus"].nunique()
            yield (
                f"Voltage {words} the AC limit of {limit:g} pu in "
                f"{counted(wrong['time'].nunique(), 'step')} at {n_buses} "
                f"{'bus' if n_buses == 1 else 'buses'}: the farthest is "
                f"{row['v_ac_pu']:.4f} pu at bus {row['bus']}, {_time(run, row['time'])}."
            )


def _loadings(run: Trajectory) -> Iterator[str]:
    """Lines above their rating, by phase if there are phases."""
    if run.scenario.phases:
        yield from _phases_loaded(run)
        return
    loading = np.nan_to_num(line_loading(run))
    if (loading > 1.0).any():
        t, line = np.unravel_index(int(loading.argmax()), loading.shape)
        lines = Branches.of(run.scenario)
        yield (
            f"Lines above their rating in {counted(int((loading > 1).any(axis=1).sum()), 'step')}: "
            f"at most {loading.max():.0%}, line {lines.from_bus[line]} to {lines.to_bus[line]}, "
            f"{_time(run, run.steps['time'].iloc[int(t)])}."
        )


def _phases_loaded(run: Trajectory) -> Iterator[str]:
    """Phases of lines and transformers above their rating."""
    loading = run.steps["loading_max"].fillna(0.0)
    if (loading > 1.0).any():
        t = int(loading.argmax())
        yield (
            f"A phase above its rating in {counted(int((loading > 1.0).sum()), 'step')}: at most "
            f"{loading.iloc[t]:.0%}, {run.steps['loading_at'].iloc[t]}, "
            f"{_time(run, run.steps['time'].iloc[t])}."
        )


def _import(run: Trajectory) -> Iterator[str]:
    """Import beyond the limit of the grid: losses that plans of the paper's mode leave out."""
    excess_kw = import_above_limit_kw(run)
    beyond = excess_kw > ISLAND_TOLERANCE_KW
    if beyond.any():
        yield (
            f"Import above its limit in {counted(int(beyond.sum()), 'step')}, by up to "
            f"{np.nanmax(excess_kw):,.1f} kW."
        )


def _island(run: Trajectory) -> Iterator[str]:
    """Power that the AC check draws from the slack bus during an outage."""
    island = island_figures(run)
    drawn = island["island_import_max_kw"] or 0.0
    surplus = island["island_export_max_kw"] or 0.0
    if drawn > ISLAND_TOLERANCE_KW:
        yield (
            f"During the outage the AC power flow draws up to {drawn:,.1f} kW from the slack bus: "
            "losses and mismatch that no battery covers."
        )
    if surplus > ISLAND_TOLERANCE_KW:
        yield (
            f"During the outage generation exceeded demand and losses by up to {surplus:,.1f} kW."
        )


def _decisions(run: Trajectory) -> Iterator[str]:
    """Plans that were not carried out as decided."""
    steps = run.steps
    corrected = steps[steps["corrected"].astype(bool)]
    if len(corrected):
        reasons = sorted({str(reason) for reason in corrected["correction_reason"] if reason})
        why = f" ({'; '.join(reasons)})" if reasons else ""
        yield f"The plan was corrected in {counted(len(corrected), 'step')}{why}."
    if "fallback" in steps:
        kinds = steps.loc[steps["fallback"] != "none", "fallback"]
        if len(kinds):
            counts = ", ".join(f"{_plain(kind)} ({n})" for kind, n in kinds.value_counts().items())
            yield f"Fallback decisions: {counts}."
    if "clipped_kw" in steps and (steps["clipped_kw"] > CLIP_TOLERANCE_KW).any():
        yield (
            "Set-points clipped to device limits in "
            f"{counted(int((steps['clipped_kw'] > CLIP_TOLERANCE_KW).sum()), 'step')}, by up to "
            f"{steps['clipped_kw'].max():,.2f} kW."
        )


def _answers(run: Trajectory) -> Iterator[str]:
    """Decisions with a gap above the tolerance."""
    if run.options["controller"] in RULES:
        return
    status = run.steps["status"].astype(str)
    others = status[~status.isin(PROVEN)]
    if len(others):
        kinds = ", ".join(f"{name} ({count})" for name, count in others.value_counts().items())
        yield f"Gap above the tolerance in {counted(len(others), 'step')}, status {kinds}."


def _estimates(run: Trajectory) -> Iterator[str]:
    """AC power flows without a solution, and estimated measurements."""
    steps = run.steps
    failed = steps.get("ac_failed", pd.Series("", steps.index))
    not_found = failed.astype(str).str.startswith(NOBODY)
    estimated = steps.get("estimated", pd.Series("", steps.index))
    for where, words in (
        (failed.astype(bool) & ~not_found, "AC power flow had no solution"),
        (not_found, "AC power flow did not converge (no load shed)"),
        (estimated.astype(bool), "Measurements were estimated"),
    ):
        if where.any():
            yield f"{words} in {counted(int(where.sum()), 'step')}."


def _plain(name: object) -> str:
    return str(name).replace("_", " ")


def _time(run: Trajectory, time: object) -> str:
    return Clock.of(run).full(pd.Timestamp(str(time)))
