"""The record of a run: what was done, as a dispatch of all its steps, and notes of each."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vppres.contract.decision import batteries_out
from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.day.metrics import line_loading
from vppres.day.priority import site_of, weighed
from vppres.day.trajectory import Trajectory
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.record import off_before_h
from vppres.kinds.table import KINDS, units_of
from vppres.model.parts import at_items
from vppres.scenario.faults import parts_by_bus
from vppres.scenario.network import BusId


class Recorded:
    """A finished run, step by step.

    Columns that only some modes write are used where they are there. Without a ``weight``, (C,),
    plans have that of the scenario.
    """

    def __init__(self, trajectory: Trajectory, weight: Floats | None = None) -> None:
        self.trajectory = trajectory
        self.scenario = trajectory.scenario
        self.options = trajectory.options
        self.site = site_of(trajectory.scenario, trajectory.options)
        self.counted = 1.0
        if weight is not None:
            total = self.site.customers.weight.sum()
            self.site = weighed(self.site, trajectory.scenario, trajectory.options, weight)
            self.counted = float(self.site.customers.weight.sum() / total)
        self.n_steps = len(trajectory.steps)
        self.load_kw = trajectory.by_step("customers", "p_load_kw")
        self.done = done_in(trajectory)

    @cached_property
    def battery_kw(self) -> Floats:
        """Power of each battery, charging positive, shape (T, B).

        Made once: every step keeps its row, and with it the whole array.
        """
        return np.asarray(self.done.charge_kw - self.done.discharge_kw)

    @cached_property
    def off_before_h(self) -> Floats:
        """How long each customer had been off at the beginning of each step in h, (T, C)."""
        return off_before_h(self.done.served, self.scenario.grid.dt_h)

    def of_items(self, t: int, table: str, column: str, nothing: object = 0.0) -> NDArray[Any]:
        """A column of a table in a step, a value for each item; nothing where there is none."""
        rows = self.trajectory.rows(table, t)
        return rows[column].to_numpy() if column in rows else np.full(len(rows), nothing)

    @property
    def rules(self) -> bool:
        """Whether switching rules can have restrained who is served."""
        rules = SwitchingRules(**self.options.get("switching", {}))
        return rules.restrain(self.scenario.grid.dt_h)

    def note(self, t: int, column: str) -> str:
        """A column of text of the steps table, empty where there is none."""
        steps = self.trajectory.steps
        value = steps[column].iloc[t] if column in steps else None
        return "" if pd.isna(value) else str(value)

    def flag(self, t: int, column: str) -> bool:
        """A column of yes and no of the steps table, no where there is none."""
        return self.note(t, column) in ("True", "1", "1.0")

    @cached_property
    def _parts(self) -> Wholes:
        """Number of the part of each bus in each step, (T, N)."""
        out = self.scenario.out_of_service(range(self.n_steps))
        return parts_by_bus(self.scenario.network, out.lines)

    def behind(self, t: int, bus: BusId) -> str:
        """The line between a bus and the part with the grid in a step; empty for none."""
        number = int(self._parts[t, self.scenario.network.bus_index[bus]])
        return self.scenario.behind(number, t) if number else ""

    def cut_off(self, t: int) -> Flags:
        """Customers that lines which are out or open cut off the grid's bus in a step, (C,)."""
        return np.asarray(at_items(self._parts[[t]] != 0, self.site.customer_bus)[0])

    def beside(self, t: int, bus: BusId) -> Flags:
        """Batteries in the same part of the feeder as a bus in a step, (B,)."""
        inside = self._parts[[t]] == self._parts[t, self.scenario.network.bus_index[bus]]
        return np.asarray(at_items(inside, self.site.battery_bus)[0])

    def soc_start(self, t: int) -> Floats:
        """States of charge at the beginning of a step, (B,)."""
        return np.asarray(self.of_items(t, "batteries", "soc_start"))

    def left_out(self, t: int) -> Flags:
        """Batteries that could not be used in a step, shape (B,)."""
        return batteries_out(self.note(t, "estimated"), self.site.batteries.id)

    @cached_property
    def loading(self) -> Floats:
        """AC current of each line as a share of its rating, (T, L); NaN for a line without one."""
        return line_loading(self.trajectory)


def done_in(run: Trajectory) -> Dispatch:
    """A run as a dispatch of all its steps; flows and voltages are those of AC.

    States of charge are those at the ends of steps, whatever was measured after them.
    """
    first, ends = (run.by_step("batteries", name) for name in ("soc_start", "soc_end"))
    kinds = {kind: KINDS[kind].table for kind in units_of(run.scenario)}
    gives = {kind: -1.0 if KINDS[kind].gives else 1.0 for kind in kinds}
    of_formers = {kind: table for kind, table in kinds.items() if "q_kvar" in run.tables[table]}
    return Dispatch(
        served=run.by_step("customers", "served"),
        share=run.supplied,
        soc=np.vstack([first[:1], ends]),
        p_grid_kw=run.steps["p_grid_kw"].to_numpy(float),
        q_grid_kvar=run.steps["q_grid_kvar"].to_numpy(float),
        v_pu=run.by_step("buses", "v_ac_pu"),
        p_flow_kw=run.by_step("lines", "p_ac_kw"),
        q_flow_kvar=run.by_step("lines", "q_ac_kvar"),
        v_node_pu=None if run.nodes is None else run.by_step("nodes", "v_ac_pu"),
        taken_kw={kind: gives[kind] * run.by_step(table, "p_kw") for kind, table in kinds.items()},
        given_kvar={kind: run.by_step(table, "q_kvar") for kind, table in of_formers.items()},
        pv_self_kw=run.by_step("pv", "self_kw"),
        pv_export_kw=run.by_step("pv", "export_kw"),
        pv_curtailed_kw=run.by_step("pv", "curtailed_kw"),
        pv_q_kvar=run.by_step("pv", "q_kvar"),
        charge_kw=run.by_step("batteries", "charge_kw"),
        discharge_kw=run.by_step("batteries", "discharge_kw"),
        batt_q_kvar=run.by_step("batteries", "q_kvar"),
    )
