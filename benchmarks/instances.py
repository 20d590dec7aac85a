"""The benchmark's windows as data: each row of ``instances.csv`` determines one window."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.forecast import Forecaster, ForecastErrors
from vppres.contract.observation import Observation
from vppres.contract.operating_point import OperatingPoint
from vppres.core.errors import InputError, Problem
from vppres.io import find_scenario, read_scenario
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import Owed, SwitchingState
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.scenario import Scenario

FILE = Path(__file__).with_name("instances.csv")
FIRST_ROW = 2
"""Line of the first data row in a file."""
SCENARIO = "uk-heatwave-2022"
GROUPS = ("ordinary", "stressed")
PLACES = ("before", "across", "inside", "after")


@dataclass(frozen=True)
class Instance:
    """One window of the packaged scenario."""

    name: str  #: unique name
    group: str  #: stressed: more load than the voltages allow, or more sun than anybody can use
    #: First step and number of steps.
    t0: int
    steps: int
    #: Range of the batteries' states of charge, drawn uniformly.
    soc_low: float
    soc_high: float
    soc_seed: int  #: seed of that draw
    #: Multiples of the packaged series.
    load_factor: float
    pv_factor: float
    #: Forecast errors, as in :class:`vppres.contract.forecast.ForecastErrors`.
    load_bias: float
    load_alpha_per_h: float
    pv_bias: float
    pv_alpha_per_h: float
    error_seed: int  #: seed of the random forecast errors
    #: 1 takes the voltages' offset from the AC power flow of the step before, with everybody served
    #: and the batteries idle; 0 is plain LinDistFlow.
    offset: int

    @cached_property
    def place(self) -> str:
        """Where the window lies: before, across, inside or after the outage."""
        dark = packaged().outage[self.t0 : self.t0 + self.steps]
        if dark.all():
            return "inside"
        if dark.any():
            return "across"
        return "before" if self.t0 < int(np.argmax(packaged().outage)) else "after"

    @property
    def errors(self) -> ForecastErrors:
        """Forecast errors."""
        return ForecastErrors(
            self.load_bias, self.load_alpha_per_h, self.pv_bias, self.pv_alpha_per_h
        )


@cache
def packaged() -> Scenario:
    """The scenario that all instances are taken from."""
    return read_scenario(find_scenario(SCENARIO))


def read_instances(file: Path = FILE) -> list[Instance]:
    """All instances of a table.

    Raises
    ------
    InputError
        With every problem of the table.
    """
    table = pd.read_csv(file)
    expected = [f.name for f in fields(Instance)]
    if list(table.columns) != expected:
        raise InputError(
            Problem(
                file.name,
                "has other columns than an instance",
                f"Write exactly: {', '.join(expected)}.",
            )
        )
    rows: list[dict[str, Any]] = [
        {str(k): v for k, v in row.items()} for row in table.to_dict("records")
    ]
    instances = [Instance(**row) for row in rows]
    problems = [
        replace(p, where=file.name, row=None if p.row is None else p.row + FIRST_ROW)
        for i, instance in enumerate(instances)
        for p in _problems(i, instance)
    ]
    problems += [
        Problem(
            file.name,
            "is given twice",
            "Give every instance its own name.",
            row=int(row) + 2,
            field="name",
            value=instances[row].name,
        )
        for row in np.flatnonzero(table["name"].duplicated())
    ]
    if problems:
        raise InputError(problems)
    return instances


def _problems(row: int, instance: Instance) -> list[Problem]:
    """What is wrong with a row."""
    last = packaged().grid.n_steps
    found = []
    if instance.group not in GROUPS:
        found.append(
            Problem(
                "instances",
                "is not a known group",
                f"Use one of: {', '.join(GROUPS)}.",
                row=row,
                field="group",
                value=instance.group,
            )
        )
    if not (instance.t0 >= 0 and 1 <= instance.steps <= last - instance.t0):
        found.append(
            Problem(
                "instances",
                "does not fit into the day",
                f"t0 + steps may be at most {last}.",
                row=row,
                field="steps",
                value=instance.steps,
            )
        )
    return found


def window_data(instance: Instance) -> WindowData:
    """The window that an instance stands for."""
    day = packaged()
    scaled = replace(
        day, load_kw=day.load_kw * instance.load_factor, pv_kw=day.pv_kw * instance.pv_factor
    )
    steps = range(instance.t0, instance.t0 + instance.steps)
    forecast = Forecaster(scaled, instance.errors, instance.error_seed).at(instance.t0, steps)
    b = day.batteries
    soc = np.random.default_rng(instance.soc_seed).uniform(
        instance.soc_low, instance.soc_high, len(b)
    )
    point = operating_point(instance.t0 - 1) if instance.offset and instance.t0 > 0 else None
    seen = Observation(
        instance.t0,
        forecast,
        np.clip(soc, b.soc_min, b.soc_max),
        b.eta_charge,
        b.eta_discharge,
        SwitchingState.of(SwitchingRules(), day.customers, day.grid.dt_h),
        Owed.of(day.customers, day.grid.dt_h),
        np.ones(len(b), dtype=bool),
        operating_point=point,
    )
    return WindowData.of(seen, Site.of(day), "lossless")


@cache
def operating_point(t: int) -> OperatingPoint:
    """AC power flow of a step of the packaged day: everybody served, batteries idle."""
    day = packaged()
    net = day.network
    index = day.network.bus_index
    p = np.zeros(net.n_buses)
    q = np.zeros(net.n_buses)
    at = [index[bus] for bus in day.customers.bus]
    np.add.at(p, at, -day.load_kw[t])
    np.add.at(q, at, -day.load_kvar[t])
    owners = day.pv.owner(day.customers)
    np.add.at(p, np.array(at)[owners], np.minimum(day.pv_kw[t], day.pv.s_max_kva))
    result = ACPowerFlow(net).solve(p, q)
    none_out = np.zeros(net.n_lines, dtype=bool)
    flows = result.p_from_kw, result.q_from_kvar
    return OperatingPoint(result.v_pu, *flows, p, q, lines_out=none_out)
