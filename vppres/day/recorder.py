"""The steps of a run, collected one by one and laid out as its tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vppres.core.arrays import Floats, Names
from vppres.day.phases import phases, returning_steps
from vppres.day.trajectory import LOSSES, OPTIONS, SHARE, TIME_ON, Trajectory
from vppres.kinds.kind import Units
from vppres.kinds.table import KINDS, units_of
from vppres.scenario.configuration import Branches
from vppres.scenario.network import BusId, Network
from vppres.scenario.scenario import Scenario

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

ROTATED = "rotated_weight"
"""Column of the customers in runs that share supply within tiers: the weights of the plans."""

OFF_BY_FAULT = "off_by_fault"
"""Column of the customers where lines may be out or open: why the part of each is blacked out."""

OPTIONAL = (ROTATED, SHARE, TIME_ON, LOSSES, OFF_BY_FAULT)


@dataclass(frozen=True, eq=False)
class StepRecord:
    """Record of one step once it is over: a piece of each table."""

    t: int  #: step
    #: The step's row: what the slack bus supplies and the losses in the AC power flow, the
    #: voltages' extremes, how the decision was found (objective, bound, gap, status, time), what
    #: overruled or replaced it and why, and any further figures.
    steps: Mapping[str, Any]
    #: Demand and who was supplied, (C,), (P,), (B,); actual PV power and its split; battery powers
    #: at the terminals, state of charge, efficiencies and cell temperature.
    customers: Mapping[str, NDArray[Any]]
    pv: Mapping[str, Floats]
    batteries: Mapping[str, Floats]
    #: Voltages and flows of the optimisation, and of the AC power flow at the sending end, (N,),
    #: (L,).
    buses: Mapping[str, Floats]
    lines: Mapping[str, Floats]
    #: Voltages that have limits, of the optimisation and of the AC power flow, (m,); with phases
    #: their buses and phases.
    nodes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    #: Record of the units of each kind of flexible power, (n,) each.
    kinds: Mapping[str, Mapping[str, NDArray[Any]]] = field(default_factory=dict)


def voltage_figures(v_model_pu: Floats, v_ac_pu: Floats) -> dict[str, float]:
    """Extremes of a step's AC voltages, and the largest error of the model at any bus.

    Buses of dark parts have none.

    Examples
    --------
    >>> voltage_figures(np.array([1.0, 0.97]), np.array([1.0, 0.99]))["v_error_pu"]
    0.020000000000000018
    """
    live = np.isfinite(v_ac_pu)
    if live.any():
        v_model_pu, v_ac_pu = v_model_pu[live], v_ac_pu[live]
    return {
        "v_min_ac_pu": float(np.min(v_ac_pu)),
        "v_max_ac_pu": float(np.max(v_ac_pu)),
        "v_error_pu": float(np.max(np.abs(v_model_pu - v_ac_pu))),
    }


class Recorder:
    """Collects the steps of a run, in order.

    ``branches`` are the lines and ties, in runs that move switches.
    """

    def __init__(self, scenario: Scenario, branches: Branches | None = None) -> None:
        self._scenario = scenario
        self._lines = scenario.network if branches is None else branches
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
        # Copies: a row would keep the arrays of its whole window.
        tables: dict[str, Any] = {
            name: {column: np.array(values) for column, values in getattr(step, name).items()}
            for name in (*ITEM_COLUMNS, "nodes")
        }
        self._records.append(replace(step, **tables))

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
            name: self._table(name, fixed)
            for name, fixed in _identifiers(self._scenario, self._lines).items()
        }
        steps = self._steps()
        n_seen = self._scenario.grid.steps_in_horizon(float(options["horizon_h"] or 0.0))
        returning = returning_steps(tables["customers"], tables["batteries"], len(steps))
        steps["phase"] = phases(steps["outage"].to_numpy(bool), returning, n_seen)
        return Trajectory(
            scenario=self._scenario,
            steps=steps,
            **tables,
            options=dict(options),
            planned=planned,
            nodes=self._nodes(),
            **{
                KINDS[kind].table: self._of_kind(kind, units)
                for kind, units in units_of(self._scenario).items()
            },
        )

    def _check_shapes(self, step: StepRecord) -> None:
        for table, fixed in _identifiers(self._scenario, self._lines).items():
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

    def _nodes(self) -> pd.DataFrame | None:
        """Voltages by phase; None for a balanced feeder."""
        if not self._scenario.phases:
            return None
        found = [record.nodes for record in self._records]
        return pd.DataFrame(
            {
                "time": self._times().repeat(len(found[0]["bus"])),
                **{name: np.concatenate([nodes[name] for nodes in found]) for name in found[0]},
            }
        )

    def _of_kind(self, kind: str, units: Units) -> pd.DataFrame:
        """A row for each step and unit of a kind of flexible power."""
        buses = _bus_labels(units.buses(self._scenario.customers))
        found = [record.kinds[kind] for record in self._records]
        return pd.DataFrame(
            {
                "time": self._times().repeat(len(units)),
                KINDS[kind].item: np.tile(units.id, len(found)),
                "bus": np.tile(buses, len(found)),
                **{name: np.concatenate([each[name] for each in found]) for name in found[0]},
            }
        )

    def _table(self, name: str, fixed: Mapping[str, NDArray[Any]]) -> pd.DataFrame:
        """A table with items: identifiers repeat in every step."""
        n_steps = len(self._records)
        n_items = len(next(iter(fixed.values())))
        more = [column for column in OPTIONAL if column in getattr(self._records[0], name)]
        changing = {
            column: np.concatenate([getattr(r, name)[column] for r in self._records])
            for column in (*ITEM_COLUMNS[name], *more)
        }
        return pd.DataFrame(
            {
                "time": self._times().repeat(n_items),
                **{column: np.tile(values, n_steps) for column, values in fixed.items()},
                **changing,
            }
        )


def _identifiers(
    scenario: Scenario, lines: Network | Branches
) -> dict[str, dict[str, NDArray[Any]]]:
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
        "lines": {"from_bus": _bus_labels(lines.from_bus), "to_bus": _bus_labels(lines.to_bus)},
    }


def _bus_labels(buses: Names) -> NDArray[Any]:
    """Bus identifiers as integers if all are, else as text: a Parquet column holds one type."""
    labels: list[BusId] = list(buses)
    if all(isinstance(bus, (int, np.integer)) for bus in labels):
        return np.array(labels, dtype=np.int64)
    return np.array([str(bus) for bus in labels], dtype=object)
