"""A run as it looks in the configuration of one of its steps: a tree, its buses and its lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Wholes
from vppres.day.trajectory import SWITCHES_OPEN, Trajectory, of_a_row
from vppres.scenario.configuration import Branches, in_configuration


def configurations_of(run: Trajectory) -> list[Flags] | None:
    """Branches that are closed in each step, (E,); None for a run that moves no switches."""
    if SWITCHES_OPEN not in run.steps:
        return None
    branches = Branches.of(run.scenario)
    return [branches.closed_but(of_a_row(words)) for words in run.steps[SWITCHES_OPEN]]


def run_in(run: Trajectory, closed: Flags) -> Trajectory:
    """The run with the network of a configuration, and buses and lines in its order.

    Flows and voltages of steps in other configurations stand where they mean least: at the buses,
    and over the lines that both have.
    """
    branches = Branches.of(run.scenario)
    day = in_configuration(run.scenario, branches, closed)
    net = day.scenario.network
    n_steps = len(run.steps)
    buses = _rows(run.buses, n_steps, np.argsort(day.buses))
    branch_of = np.zeros(net.n_lines, dtype=int)
    there = day.lines >= 0
    branch_of[day.lines[there]] = np.flatnonzero(there)
    lines = _rows(run.lines, n_steps, branch_of)
    turned = np.tile(day.sign[branch_of] < 0, n_steps)
    for name in ("p_model_kw", "q_model_kvar", "p_ac_kw", "q_ac_kvar"):
        lines[name] = lines[name].where(~turned, -lines[name])
    ends = lines["from_bus"].where(~turned, lines["to_bus"])
    lines["to_bus"] = lines["to_bus"].where(~turned, lines["from_bus"])
    lines["from_bus"] = ends
    return replace(run, scenario=day.scenario, buses=buses, lines=lines)


def _rows(table: pd.DataFrame, n_steps: int, which: Wholes) -> pd.DataFrame:
    """Some items of each step of a table, in another order."""
    n_items = len(table) // n_steps
    at = (np.arange(n_steps)[:, None] * n_items + which).ravel()
    found: pd.DataFrame = table.iloc[at].reset_index(drop=True)
    return found
