"""A recheck of a finished run, and what it writes: tables, a summary and a figure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from vppres.core.plain import json_safe
from vppres.day.trajectory import Trajectory
from vppres.feeders.actuate import Feeding
from vppres.feeders.dss.recheck import Recheck, recheck_opendss
from vppres.io.atomic import atomic_folder
from vppres.physics.phased_sources import former_of
from vppres.report.plots.files import save_chart
from vppres.report.plots.phases import voltages_per_phase
from vppres.scenario.formers import largest_forming_battery

DECIMALS = 6


def recheck_run(run: Trajectory, source: Path) -> Recheck:
    """Solve the steps of a finished run on the circuit of an OpenDSS script.

    See :func:`vppres.feeders.dss.recheck.recheck_opendss`; in an island of physical mode the
    largest battery that forms it holds the voltage, or without any a generating set.
    """
    mode = str(run.options.get("mode", "paper"))
    network = run.scenario.network
    phases = run.scenario.phases
    if phases is not None:
        from vppres.feeders.dss.phased_recheck import recheck_phased

        batteries = run.scenario.batteries
        former = former_of(phases, batteries)
        name = None if former is None else str(batteries.id[former])
        return recheck_phased(run.tables, phases, source, name)
    no_battery = largest_forming_battery(run.scenario) is None
    forms = run.scenario.gensets.grid_forming if no_battery else None
    holder = Feeding.of(run.scenario, True, mode, np.ones(network.n_buses), forms).bus
    opened = [*network.drawing_bus[~network.island]]
    held = None if holder == network.slack_bus else holder
    return recheck_opendss(run.tables, source, held, opened)


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
