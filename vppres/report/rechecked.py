"""A recheck of a finished run, and what it writes: tables, a summary and a figure."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.errors import InputError
from vppres.core.plain import json_safe
from vppres.core.text import counted
from vppres.day.trajectory import Trajectory
from vppres.feeders.actuate import holder_of
from vppres.feeders.dss.recheck import PHASE_NAMES, Recheck, Tables, recheck_opendss
from vppres.io.atomic import atomic_folder
from vppres.report.plots.chart import Chart, Curve, Curves, Limit
from vppres.report.plots.drawing import BLACK, RUN_STYLES, Style
from vppres.report.plots.figures import save_chart
from vppres.scenario.configuration import Branches
from vppres.scenario.formers import island_former, largest_forming_battery, named_units

DECIMALS = 6


def recheck_run(run: Trajectory, source: Path) -> Recheck:
    """Solve the steps of a finished run on the circuit of an OpenDSS script.

    See :func:`vppres.feeders.dss.recheck.recheck_opendss`; in an island of physical mode the
    largest battery that forms it holds the voltage, or without any a generating set. Steps in which
    lines are out, or switches stand otherwise than in the script, are left out.
    """
    tables, left_out = _as_imported(run)
    found = _rechecked(run, tables, source)
    return replace(found, notes=(*found.notes, left_out)) if left_out else found


def _as_imported(run: Trajectory) -> tuple[Tables, str]:
    """Tables of the steps in which all lines and no ties carry, and a note on the others."""
    steps = range(len(run.steps))
    closed = Branches.of(run.scenario).closed
    same = np.array([np.array_equal(run.carries(t), closed) for t in steps], dtype=bool)
    if same.all():
        return run.tables, ""
    what = "in which lines are out or switches stand otherwise than in the script"
    if not same.any():
        cure = "Recheck a run without faults in which switches do not move."
        raise InputError.of("run", f"has only steps {what}", cure)
    times = run.steps["time"][same]
    tables = {name: table[table["time"].isin(times)] for name, table in run.tables.items()}
    return tables, f"Not compared: {counted(int((~same).sum()), 'step')} {what}."


def _rechecked(run: Trajectory, tables: Tables, source: Path) -> Recheck:
    """Some steps of a run on the circuit of a script."""
    mode = str(run.options.get("mode", "paper"))
    network = run.scenario.network
    phases = run.scenario.phases
    if phases:
        from vppres.feeders.dss.phased_recheck import recheck_phased

        return recheck_phased(tables, phases, source, island_former(run.scenario))
    no_battery = largest_forming_battery(run.scenario) is None
    forms = named_units(run.scenario) if no_battery else {}
    holder = holder_of(run.scenario, True, mode, forms)
    opened = [*network.drawing_bus[~network.island]]
    held = None if holder == network.slack_bus else holder
    return recheck_opendss(tables, source, held, opened)


def write_recheck(run: Trajectory, found: Recheck, folder: Path) -> dict[str, Any]:
    """Write a recheck's folder, whole or not at all; returns the summary.

    ``voltages.csv`` has a row for each step, bus and phase, ``steps.csv`` one for each step,
    ``summary.json`` what :func:`summary_of` gives; ``voltages_per_phase`` is the figure.
    """
    summary = summary_of(found)
    with atomic_folder(folder) as aside:
        for name, table in (("voltages", found.voltages), ("steps", found.steps)):
            table.round(DECIMALS).to_csv(aside / f"{name}.csv", index=False, lineterminator="\n")
        text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
        (aside / "summary.json").write_text(text, encoding="utf-8", newline="\n")
        save_chart(voltages_per_phase(run, found), aside)
    return summary


def summary_of(found: Recheck) -> dict[str, Any]:
    """The figures of a recheck: of the largest difference, by phase, and what was assumed."""
    worst = found.worst
    pu = ("v_pu", "v_plan_pu", "difference_pu")
    largest = (
        worst
        if worst is None
        else {
            "time": worst["time"].isoformat(),
            "bus": str(worst["bus"]),
            "phase": str(worst["phase"]),
            **{name: round(float(worst[name]), DECIMALS) for name in pu},
        }
    )
    phases = found.by_phase().round(DECIMALS).astype(float)
    safe: dict[str, Any] = json_safe(
        {
            "largest": largest,
            "cause": found.cause,
            "phases": phases.to_dict("index"),
            "notes": found.notes,
        }
    )
    return safe


def voltages_per_phase(run: Trajectory, found: Recheck) -> Chart:
    """Lowest voltage of each phase and of the plan, and the largest difference of a step."""
    network = run.scenario.network
    curves = []
    for phase, style in zip(PHASE_NAMES.values(), RUN_STYLES, strict=False):
        own = found.voltages[found.voltages["phase"] == phase]
        if not own.empty:
            curves.append(Curve(f"phase {phase}", _by_step(run, own, "v_pu"), style))
    plan = _by_step(run, found.voltages, "v_plan_pu")
    curves.append(Curve("plan", plan, Style(BLACK, "2 3", 1.5)))
    limit = Limit(network.v_min_ac_pu, f"{network.v_min_ac_pu:g} pu, AC limit", dash="")
    largest = 1000.0 * _by_step(run, found.steps, "difference_max_pu")
    apart = Curve("largest difference", largest, Style(BLACK, "", 1.5), in_legend=False)
    return Chart(
        "voltages_per_phase",
        "Voltages: the original feeder, phase by phase, against the plan",
        run,
        [
            Curves("Lowest bus voltage (pu)", curves, 220.0, limits=[limit]),
            Curves("Largest\ndifference\n(0.001 pu)", [apart], 105.0, low=0.0),
        ],
    )


def _by_step(run: Trajectory, table: pd.DataFrame, column: str) -> Floats:
    """The lowest value of each step, NaN where there is none."""
    grouped = table.groupby("time")[column].min()
    return np.asarray(grouped.reindex(run.steps["time"]), dtype=float)
