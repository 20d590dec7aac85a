"""The record of a run: tidy tables of what happened, step by step, and their files.

Values are realised ones unless a column's name says ``model``. Times are the beginnings of steps.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vppres.core.arrays import Floats, Names
from vppres.core.errors import InputError, Problem
from vppres.core.notebook import facts_html
from vppres.day.phases import phases, returning_steps
from vppres.io.scenario_folder import read_scenario
from vppres.scenario.network import BusId
from vppres.scenario.scenario import Scenario

if TYPE_CHECKING:
    from vppres.feeders.actuate import Powers

TABLES = ("steps", "customers", "pv", "batteries", "buses", "lines")
EXPLAINING_TABLES = ("explanations", "shadow_prices")
OPTIONS = ("controller", "horizon_h", "solver", "method", "seed")
OPTIONS_FILE = "options.json"

STEP_COLUMNS = (
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
"""Columns that the table of steps always has, besides time, outage and price."""

ITEM_COLUMNS = {
    "customers": ("p_load_kw", "q_load_kvar", "served", "shed"),
    "pv": ("available_kw", "self_kw", "export_kw", "curtailed_kw", "q_kvar"),
    "batteries": (
        "charge_kw",
        "discharge_kw",
        "q_kvar",
        "soc_start",
        "soc_end",
        "eta_charge",
        "eta_discharge",
        "temperature_c",
        "mismatch_kw",
    ),
    "buses": ("v_model_pu", "v_ac_pu"),
    "lines": ("p_model_kw", "q_model_kvar", "p_ac_kw", "q_ac_kvar"),
}
"""Columns of the other tables that change from step to step; identifiers come before them."""


@dataclass(frozen=True, eq=False)
class StepRecord:
    """Everything that is known of one step once it is over: a piece of each table.

    Parameters
    ----------
    t : int
        Step.
    steps : mapping of str to float, bool or str
        The step's row: what the slack bus supplies and the losses in the AC power flow, the
        voltages' extremes, how the decision was found (objective, bound, gap, status, time), what
        overruled or replaced it and why, and any further figures.
    customers, pv, batteries : mapping of str to array, shape (C,), (P,), (B,)
        Demand and who was supplied; actual PV power and its split; battery powers at the
        terminals, state of charge, efficiencies and cell temperature.
    buses, lines : mapping of str to array, shape (N,), (L,)
        Voltages and flows of the optimisation, and of the AC power flow at the sending end.
    """

    t: int
    steps: Mapping[str, Any]
    customers: Mapping[str, NDArray[Any]]
    pv: Mapping[str, Floats]
    batteries: Mapping[str, Floats]
    buses: Mapping[str, Floats]
    lines: Mapping[str, Floats]


def voltage_figures(v_model_pu: Floats, v_ac_pu: Floats) -> dict[str, float]:
    """Extremes of a step's AC voltages, and the largest error of the model at any bus.

    Examples
    --------
    >>> voltage_figures(np.array([1.0, 0.97]), np.array([1.0, 0.99]))["v_error_pu"]
    0.020000000000000018
    """
    return {
        "v_min_ac_pu": float(np.min(v_ac_pu)),
        "v_max_ac_pu": float(np.max(v_ac_pu)),
        "v_error_pu": float(np.max(np.abs(v_model_pu - v_ac_pu))),
    }


class Feeder(Protocol):
    """What :func:`vppres.feeders.sources.import_network` yields; only the buses matter here."""

    @property
    def bus_of(self) -> Mapping[int, BusId]:
        """Bus of the scenario for every bus of the source."""


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
    def imported_kw(self) -> Floats:
        """Import in the AC power flow, shape (T,); an import-only meter counts backwards too."""
        p_grid_kw = self.steps["p_grid_kw"].to_numpy(float)
        if self.scenario.exports:
            p_grid_kw = np.maximum(p_grid_kw, 0.0)
        return np.where(self.steps["outage"].to_numpy(bool), 0.0, p_grid_kw)

    @property
    def exported_kw(self) -> Floats:
        """Export in the AC power flow, shape (T,); a surplus of an import-only meter is none."""
        if not self.scenario.exports:
            return np.zeros(len(self.steps))
        p_grid_kw = self.steps["p_grid_kw"].to_numpy(float)
        return np.where(self.steps["outage"].to_numpy(bool), 0.0, np.maximum(-p_grid_kw, 0.0))

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The six tables by name, and those of the explanation if there is one."""
        found = {name: getattr(self, name) for name in (*TABLES, *EXPLAINING_TABLES)}
        return {name: table for name, table in found.items() if table is not None}

    def apply_to(self, net: Any, feeder: Feeder, time: pd.Timestamp | str) -> None:
        """Put what happened in a step into the pandapower net that the scenario was made from.

        What the scenario took over (loads, generators, storages) is switched off in the net, and
        customers, PV systems and batteries are put back with their powers. In an outage the grid is
        opened; where batteries hold the island, a source at the bus of the largest holds its
        voltage and gives nothing; in the dark there is none. A power flow of the net is then that
        of the record, as far as the feeder is exact.

        Parameters
        ----------
        net : pandapowerNet
            The net, changed in place; branches that were opened for the import have to be open.
        feeder : ImportedFeeder
            What :func:`vppres.feeders.sources.import_network` made of it.
        time : pandas.Timestamp or str
            Beginning of a step, with time zone.

        Raises
        ------
        InputError
            If there is no such step, or the net is not that of the scenario.
        """
        from vppres.feeders.actuate import put_into_net

        known = {str(bus): bus for bus in self.scenario.network.buses}
        bus_of = {source: known.get(str(bus), bus) for source, bus in feeder.bus_of.items()}
        put_into_net(net, bus_of, self._powers(self._step_at(time)))

    def _step_at(self, time: pd.Timestamp | str) -> int:
        """The step that begins at a time."""
        times = pd.DatetimeIndex(self.steps["time"])
        try:
            found = np.flatnonzero(times == pd.Timestamp(time))
        except (ValueError, TypeError):
            found = np.empty(0, dtype=int)
        if not len(found):
            raise InputError(
                Problem(
                    "run",
                    "is not the beginning of a step",
                    f"Give one of {times[0].isoformat()} to {times[-1].isoformat()}, with its "
                    "time zone.",
                    field="time",
                    value=time,
                )
            )
        return int(found[0])

    def _powers(self, t: int) -> Powers:
        """Powers of a step by identifier."""
        from vppres.feeders.actuate import Feeding, Powers

        day = self.scenario
        rows = {name: self._rows(name, t) for name in ("customers", "pv", "batteries")}
        c, pv, b = rows["customers"], rows["pv"], rows["batteries"]
        on = c["served"].to_numpy(bool)
        return Powers(
            _powers(
                day.customers.id, day.customers.bus, c["p_load_kw"] * on, c["q_load_kvar"] * on
            ),
            _powers(
                day.pv.id,
                day.pv.buses(day.customers),
                pv["self_kw"] + pv["export_kw"],
                pv["q_kvar"],
            ),
            _powers(
                day.batteries.id, day.batteries.bus, b["charge_kw"] - b["discharge_kw"], b["q_kvar"]
            ),
            Feeding.of(
                day,
                bool(self.steps["outage"].iloc[t]),
                str(self.options.get("mode", "paper")),
                self._rows("buses", t)["v_ac_pu"].to_numpy(float),
            ),
        )

    def _rows(self, name: str, t: int) -> pd.DataFrame:
        """The rows of a table that belong to a step."""
        table: pd.DataFrame = getattr(self, name)
        count = len(table) // len(self.steps)
        return table.iloc[t * count : (t + 1) * count]

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
        self._records.append(_alone(step))

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
            name: self._table(name, fixed) for name, fixed in _identifiers(self._scenario).items()
        }
        steps = self._steps()
        n_seen = self._scenario.grid.steps_in_horizon(float(options["horizon_h"] or 0.0))
        returning = returning_steps(tables["customers"], tables["batteries"], len(steps))
        steps["phase"] = phases(steps["outage"].to_numpy(bool), returning, n_seen)
        return Trajectory(
            scenario=self._scenario, steps=steps, **tables, options=dict(options), planned=planned
        )

    def _check_shapes(self, step: StepRecord) -> None:
        for table, fixed in _identifiers(self._scenario).items():
            length = len(next(iter(fixed.values())))
            for name in ITEM_COLUMNS[table]:
                shape = np.shape(getattr(step, table)[name])
                if shape != (length,):
                    raise ValueError(
                        f"{name} has shape {shape}, the scenario's {table} need ({length},)"
                    )

    def _times(self) -> pd.DatetimeIndex:
        return self._scenario.grid.times[: len(self._records)]

    def _steps(self) -> pd.DataFrame:
        n_steps = len(self._records)
        known = pd.DataFrame(
            {
                "time": self._times(),
                "outage": self._scenario.outage[:n_steps],
                "price_gbp_per_kwh": self._scenario.price_gbp_per_kwh[:n_steps],
            }
        )
        steps = known.join(pd.DataFrame([dict(r.steps) for r in self._records]))
        if self._scenario.exports:
            steps["export_limit_kw"] = self._scenario.export_max_kw[:n_steps]
            steps["export_price_gbp_per_kwh"] = self._scenario.export_price[:n_steps]
        return steps

    def _table(self, name: str, fixed: Mapping[str, NDArray[Any]]) -> pd.DataFrame:
        """A table with items: identifiers repeat in every step."""
        n_steps = len(self._records)
        n_items = len(next(iter(fixed.values())))
        changing = {
            column: np.concatenate([getattr(r, name)[column] for r in self._records])
            for column in ITEM_COLUMNS[name]
        }
        return pd.DataFrame(
            {
                "time": self._times().repeat(n_items),
                **{column: np.tile(values, n_steps) for column, values in fixed.items()},
                **changing,
            }
        )


def _alone(step: StepRecord) -> StepRecord:
    """The record without what its arrays are parts of: a row would keep its whole window."""
    tables: dict[str, Any] = {
        name: {column: np.array(values) for column, values in getattr(step, name).items()}
        for name in ITEM_COLUMNS
    }
    return replace(step, **tables)


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


def _powers(names: Names, buses: Names, p_kw: Any, q_kvar: Any) -> pd.DataFrame:
    """Powers by identifier."""
    columns = {"bus": buses, "p_kw": np.asarray(p_kw), "q_kvar": np.asarray(q_kvar)}
    return pd.DataFrame(columns, index=pd.Index(names, name="id"))


def _table_file(folder: Path, name: str) -> Path:
    return folder / f"{name}.parquet"


def _identifiers(scenario: Scenario) -> dict[str, dict[str, NDArray[Any]]]:
    """The columns of each table with items that no step changes."""
    c = scenario.customers
    pv = scenario.pv
    b = scenario.batteries
    net = scenario.network
    return {
        "customers": {"id": c.id, "bus": _bus_labels(c.bus), "tier": c.tier, "weight": c.weight},
        "pv": {"id": pv.id, "customer": pv.customer, "bus": _bus_labels(pv.buses(c))},
        "batteries": {"id": b.id, "bus": _bus_labels(b.bus)},
        "buses": {"bus": _bus_labels(net.buses)},
        "lines": {"from_bus": _bus_labels(net.from_bus), "to_bus": _bus_labels(net.to_bus)},
    }


def _bus_labels(buses: Names) -> NDArray[Any]:
    """Bus identifiers as integers if all are, else as text: a Parquet column holds one type."""
    labels: list[BusId] = list(buses)
    if all(isinstance(bus, (int, np.integer)) for bus in labels):
        return np.array(labels, dtype=np.int64)
    return np.array([str(bus) for bus in labels], dtype=object)
