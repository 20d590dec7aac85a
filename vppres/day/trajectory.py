"""The record of a run: tidy tables of what happened, step by step, and their files.

Values are realised ones unless a column's name says ``model``. Times are the beginnings of steps.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vppres.core.arrays import Flags, Floats, Names
from vppres.core.errors import InputError, Problem
from vppres.core.notebook import facts_html
from vppres.day.phases import phases, returning_steps
from vppres.io.scenario_folder import read_scenario
from vppres.scenario.network import BusId
from vppres.scenario.scenario import Scenario

TABLES = ("steps", "customers", "pv", "batteries", "buses", "lines")
EXPLAINING_TABLES = ("explanations", "shadow_prices")
OPTIONS = ("controller", "horizon_h", "solver", "method", "seed")
OPTIONS_FILE = "options.json"

# Columns of the run folder's tables, each with the field of StepRecord that fills it.
_STEPS = {
    name: name
    for name in (
        "p_grid_kw",
        "q_grid_kvar",
        "losses_kw",
        "v_min_ac_pu",
        "v_max_ac_pu",
        "v_error_pu",
        "objective",
        "bound",
        "gap",
        "status",
        "solve_s",
        "corrected",
        "correction_reason",
        "fallback",
        "fallback_reason",
        "estimated",
        "ac_failed",
    )
}
_CUSTOMERS = {
    "p_load_kw": "load_kw",
    "q_load_kvar": "load_kvar",
    "served": "served",
    "shed": "shed",
}
_PV = {
    "available_kw": "pv_available_kw",
    "self_kw": "pv_self_kw",
    "export_kw": "pv_export_kw",
    "curtailed_kw": "pv_curtailed_kw",
    "q_kvar": "pv_q_kvar",
}
_BATTERIES = {
    "charge_kw": "charge_kw",
    "discharge_kw": "discharge_kw",
    "q_kvar": "batt_q_kvar",
    "soc_start": "soc_start",
    "soc_end": "soc_end",
    "eta_charge": "eta_charge",
    "eta_discharge": "eta_discharge",
    "temperature_c": "temperature_c",
    "mismatch_kw": "mismatch_kw",
}
_BUSES = {"v_model_pu": "v_model_pu", "v_ac_pu": "v_ac_pu"}
_LINES = {name: name for name in ("p_model_kw", "q_model_kvar", "p_ac_kw", "q_ac_kvar")}


@dataclass(frozen=True, eq=False)
class StepRecord:
    """Everything that is known of one step once it is over.

    Parameters
    ----------
    t : int
        Step.
    served : array of bool, shape (C,)
        Who was supplied.
    load_kw, load_kvar : array, shape (C,)
        Actual demand, served or not.
    pv_available_kw, pv_self_kw, pv_export_kw, pv_curtailed_kw, pv_q_kvar : array, shape (P,)
        Actual PV power and its split, and reactive power.
    charge_kw, discharge_kw, batt_q_kvar : array, shape (B,)
        Battery powers at the terminals.
    soc_start, soc_end : array, shape (B,)
        State of charge at the beginning and the end of the step.
    eta_charge, eta_discharge, temperature_c : array, shape (B,)
        Efficiencies that held in the step, and the cell temperature they follow from.
    v_model_pu, v_ac_pu : array, shape (N,)
        Voltages of the optimisation and of the AC power flow, slack bus first.
    p_model_kw, q_model_kvar, p_ac_kw, q_ac_kvar : array, shape (L,)
        Line flows of the optimisation, and at the sending end in the AC power flow.
    p_grid_kw, q_grid_kvar, losses_kw : float
        What the slack bus supplies, and the losses, in the AC power flow.
    objective, bound, gap : float
        Value of the accepted dispatch, proven bound and relative gap of the window's solve.
    status : str
        Outcome of the solve.
    solve_s : float
        Time from forecast to decision in s.
    corrected : bool
        Whether the planned dispatch had to be replaced.
    correction_reason : str
        Which check failed; empty if none.
    fallback : str
        What took the place of the controller's answer: ``none``, ``voltage``, ``service``,
        ``previous_plan``, ``rule`` or ``critical``.
    fallback_reason : str
        Why, and what it leaves open; empty if nothing did.
    estimated : str
        Measurements that were estimated and batteries that were out; empty if none.
    ac_failed : str
        What was shed because the AC power flow had no solution, and why; empty if it had one.
    notes : mapping of str to float or str
        Further columns of the steps table.
    mismatch_kw : array, shape (B,), optional
        What each grid-forming battery of an island gave beyond its set-point; zeros if not given.
    shed : array of bool, shape (C,), optional
        Who was to be served and was cut off in an island; nobody if not given.
    """

    t: int
    served: Flags
    load_kw: Floats
    load_kvar: Floats
    pv_available_kw: Floats
    pv_self_kw: Floats
    pv_export_kw: Floats
    pv_curtailed_kw: Floats
    pv_q_kvar: Floats
    charge_kw: Floats
    discharge_kw: Floats
    batt_q_kvar: Floats
    soc_start: Floats
    soc_end: Floats
    eta_charge: Floats
    eta_discharge: Floats
    temperature_c: Floats
    v_model_pu: Floats
    v_ac_pu: Floats
    p_model_kw: Floats
    q_model_kvar: Floats
    p_ac_kw: Floats
    q_ac_kvar: Floats
    p_grid_kw: float
    q_grid_kvar: float
    losses_kw: float
    objective: float
    bound: float
    gap: float
    status: str
    solve_s: float
    corrected: bool = False
    correction_reason: str = ""
    fallback: str = "none"
    fallback_reason: str = ""
    estimated: str = ""
    ac_failed: str = ""
    notes: Mapping[str, float | str] = field(default_factory=dict)
    mismatch_kw: Floats | None = None
    shed: Flags | None = None

    def __post_init__(self) -> None:
        if self.mismatch_kw is None:
            object.__setattr__(self, "mismatch_kw", np.zeros(len(self.charge_kw)))
        if self.shed is None:
            object.__setattr__(self, "shed", np.zeros(len(self.served), dtype=bool))

    @property
    def v_min_ac_pu(self) -> float:
        """Lowest AC voltage of any bus."""
        return float(np.min(self.v_ac_pu))

    @property
    def v_max_ac_pu(self) -> float:
        """Highest AC voltage of any bus."""
        return float(np.max(self.v_ac_pu))

    @property
    def v_error_pu(self) -> float:
        """Largest difference of any bus between optimisation and AC: ``max |V_model - V_ac|``."""
        return float(np.max(np.abs(self.v_model_pu - self.v_ac_pu)))


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A finished run: the scenario, one tidy table for each kind of item, and how it was made.

    Parameters
    ----------
    scenario : Scenario
        The day as it was run.
    steps : DataFrame
        One row per step.
    customers, pv, batteries, buses, lines : DataFrame
        One row per step and item, in the order of time, then of the scenario.
    options : mapping
        At least ``controller``, ``horizon_h``, ``solver``, ``method`` and ``seed``; values that
        JSON can hold.
    planned : mapping, optional
        What a full-horizon plan promised: ``served``, nested lists of bool, shape (T, C);
        ``energy_kwh``, the stored energy at the beginning of each step and at the end, shape
        (T + 1,); and what else is worth keeping.
    explanations, shadow_prices : DataFrame, optional
        A reason for every action, and what one more unit of what was scarce would have bought;
        :func:`vppres.explain.day.explain_day` makes them.
    """

    scenario: Scenario
    steps: pd.DataFrame
    customers: pd.DataFrame
    pv: pd.DataFrame
    batteries: pd.DataFrame
    buses: pd.DataFrame
    lines: pd.DataFrame
    options: Mapping[str, Any]
    planned: Mapping[str, Any] | None = None
    explanations: pd.DataFrame | None = None
    shadow_prices: pd.DataFrame | None = None

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The six tables by name, and those of the explanation if there is one."""
        found = {name: getattr(self, name) for name in (*TABLES, *EXPLAINING_TABLES)}
        return {name: table for name, table in found.items() if table is not None}

    def _repr_html_(self) -> str:
        """The run in a few figures, for a notebook."""
        steps = self.steps
        return facts_html(
            f"Run of {self.scenario.name}",
            {
                "controller": f"{self.options['controller']}, {self.options['horizon_h']:g} h",
                "steps": len(steps),
                "steps without grid": int(steps["outage"].sum()),
                "customers served": f"{self.customers['served'].mean():.1%} of all steps",
                "lowest AC voltage": f"{steps['v_min_ac_pu'].min():.4f} pu",
                "tables": ", ".join(self.tables),
            },
        )


class Recorder:
    """Collects the steps of a run, in order.

    Parameters
    ----------
    scenario : Scenario
        The day that is run.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._records: list[StepRecord] = []

    @property
    def records(self) -> tuple[StepRecord, ...]:
        """The steps so far."""
        return tuple(self._records)

    def add(self, step: StepRecord) -> None:
        """Append the record of the next step.

        Raises
        ------
        ValueError
            If the step is not the next one, or an array does not fit the scenario.
        """
        if step.t != len(self._records):
            raise ValueError(f"step {step.t} recorded, expected step {len(self._records)}")
        self._check_shapes(step)
        self._records.append(step)

    def finish(
        self, options: Mapping[str, Any], planned: Mapping[str, Any] | None = None
    ) -> Trajectory:
        """The run so far as tables.

        Raises
        ------
        ValueError
            If no step was recorded, or an option is missing.
        """
        missing = [name for name in OPTIONS if name not in options]
        if missing or not self._records:
            raise ValueError(
                f"missing in options: {', '.join(missing)}" if missing else "no step was recorded"
            )
        tables = {
            name: self._table(fixed, columns)
            for name, (fixed, columns) in _layout(self._scenario).items()
        }
        steps = self._steps()
        n_seen = self._scenario.grid.steps_in_horizon(float(options["horizon_h"] or 0.0))
        returning = returning_steps(tables["customers"], tables["batteries"], len(steps))
        steps["phase"] = phases(steps["outage"].to_numpy(bool), returning, n_seen)
        return Trajectory(
            scenario=self._scenario, steps=steps, **tables, options=dict(options), planned=planned
        )

    def _check_shapes(self, step: StepRecord) -> None:
        for table, (fixed, columns) in _layout(self._scenario).items():
            length = len(next(iter(fixed.values())))
            for name in columns.values():
                shape = np.shape(getattr(step, name))
                if shape != (length,):
                    raise ValueError(
                        f"{name} has shape {shape}, the scenario's {table} need ({length},)"
                    )

    def _times(self) -> pd.DatetimeIndex:
        return self._scenario.grid.times[: len(self._records)]

    def _steps(self) -> pd.DataFrame:
        n_steps = len(self._records)
        table = pd.DataFrame(
            {
                "time": self._times(),
                "outage": self._scenario.outage[:n_steps],
                "price_gbp_per_kwh": self._scenario.price_gbp_per_kwh[:n_steps],
                **{
                    column: [getattr(r, name) for r in self._records]
                    for column, name in _STEPS.items()
                },
            }
        )
        notes = pd.DataFrame([dict(r.notes) for r in self._records], index=table.index)
        return table.join(notes)

    def _table(self, fixed: Mapping[str, NDArray[Any]], columns: Mapping[str, str]) -> pd.DataFrame:
        n_items = len(next(iter(fixed.values())))
        return pd.DataFrame(
            {
                "time": self._times().repeat(n_items),
                **{column: np.tile(values, len(self._records)) for column, values in fixed.items()},
                **{
                    column: np.concatenate([getattr(r, name) for r in self._records])
                    for column, name in columns.items()
                },
            }
        )


def write_tables(trajectory: Trajectory, folder: Path) -> None:
    """Write the tables as Parquet, options and plan as JSON, into an existing folder."""
    for name, table in trajectory.tables.items():
        table.to_parquet(_table_file(folder, name), index=False)
    record = {"options": trajectory.options, "planned": trajectory.planned}
    (folder / OPTIONS_FILE).write_text(
        json.dumps(json_safe(record), indent=2) + "\n", encoding="utf-8"
    )


def read_run(folder: Path) -> Trajectory:
    """Read a run folder back.

    Raises
    ------
    InputError
        If the folder is not a whole run folder, with every missing file, or its scenario is wrong.
    """
    files = [folder / OPTIONS_FILE, *(_table_file(folder, name) for name in TABLES)]
    problems = [
        Problem(str(folder), f"has no {file.name}", "Give a folder written by a run.")
        for file in files
        if not file.is_file()
    ]
    if problems:
        raise InputError(problems)
    record = json.loads((folder / OPTIONS_FILE).read_text(encoding="utf-8"))
    explained = [name for name in EXPLAINING_TABLES if _table_file(folder, name).is_file()]
    tables = {name: pd.read_parquet(_table_file(folder, name)) for name in (*TABLES, *explained)}
    return Trajectory(
        scenario=read_scenario(folder / "scenario"),
        **tables,
        options=record["options"],
        planned=record["planned"],
    )


def json_safe(value: Any) -> Any:
    """A copy that strict JSON can hold: numpy scalars as Python's, NaN and infinities as None.

    >>> json_safe({"gap": np.float64("nan"), "seed": np.int64(3), "errors": (0.1, float("inf"))})
    {'gap': None, 'seed': 3, 'errors': [0.1, None]}
    """
    if isinstance(value, Mapping):
        return {str(key): json_safe(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_safe(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _table_file(folder: Path, name: str) -> Path:
    return folder / f"{name}.parquet"


def _layout(scenario: Scenario) -> dict[str, tuple[dict[str, NDArray[Any]], dict[str, str]]]:
    """Of each table with items: columns that no step changes, and columns taken from the steps."""
    c = scenario.customers
    pv = scenario.pv
    b = scenario.batteries
    net = scenario.network
    owner_bus = c.bus[pv.owner(c)] if len(pv) else c.bus[:0]
    return {
        "customers": (
            {"id": c.id, "bus": _bus_labels(c.bus), "tier": c.tier, "weight": c.weight},
            _CUSTOMERS,
        ),
        "pv": ({"id": pv.id, "customer": pv.customer, "bus": _bus_labels(owner_bus)}, _PV),
        "batteries": ({"id": b.id, "bus": _bus_labels(b.bus)}, _BATTERIES),
        "buses": ({"bus": _bus_labels(net.buses)}, _BUSES),
        "lines": (
            {"from_bus": _bus_labels(net.from_bus), "to_bus": _bus_labels(net.to_bus)},
            _LINES,
        ),
    }


def _bus_labels(buses: Names) -> NDArray[Any]:
    """Bus identifiers as integers if all are, else as text: a Parquet column holds one type."""
    labels: list[BusId] = list(buses)
    if all(isinstance(bus, (int, np.integer)) for bus in labels):
        return np.array(labels, dtype=np.int64)
    return np.array([str(bus) for bus in labels], dtype=object)
