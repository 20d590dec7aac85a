"""Parameters of a sweep: options of a run and numbers of a scenario, each by its name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.day.options import RunOptions
from vppres.io import schema
from vppres.io.atomic import scratch_folder
from vppres.io.messages import did_you_mean
from vppres.io.scenario_folder import read_scenario
from vppres.io.scenario_writer import fill_scenario_folder
from vppres.scenario.assets import Batteries
from vppres.scenario.option_table import OPTIONS, Option
from vppres.scenario.scenario import ObjectiveWeights, Scenario

Value = float | int | str
ChangeScenario = Callable[[Scenario, float], Scenario]

OPTION_OF = {option.name: option for option in OPTIONS if option.sweep}
"""Options that a sweep varies: those of `vppres run`, and some that only Python has."""

_KINDS: dict[type, str] = {float: "a finite number", int: "a whole number"}
_MAX_POINTS = 1000
_DIGITS = 12  # of a point of a range: 0.3, not 0.30000000000000004


@dataclass(frozen=True)
class Parameter:
    """Parameter that a sweep varies: its name, and ``float``, ``int`` or ``str``.

    ``change`` takes scenario, options and a value to the scenario and options with that value.
    """

    name: str
    kind: type
    change: Callable[[Scenario, RunOptions, Any], tuple[Scenario, RunOptions]]


def find_parameter(name: str, scenario: Scenario) -> Parameter:
    """The parameter of that name; underscores count as hyphens in the names of options."""
    option = name.replace("_", "-")
    if option in OPTION_OF:
        row = OPTION_OF[option]
        return Parameter(option, row.kind, partial(_change_option, row))
    changes = scenario_changes(scenario)
    if name in changes:
        change = changes[name]
        return Parameter(name, float, lambda day, options, value: (change(day, value), options))
    known = [*OPTION_OF, *changes]
    raise InputError.of(
        "sweep",
        "is not a parameter",
        did_you_mean(name, known, f"Use one of: {', '.join(known)}."),
        field="--param",
        value=name,
    )


def scenario_changes(scenario: Scenario) -> dict[str, ChangeScenario]:
    """Changes that can be made in a scenario, by name."""
    limits = [name for name in schema.NetworkSection.model_fields if name != "slack_bus"]
    battery = [f.name for f in fields(Batteries) if f.name not in ("id", "bus", "grid_forming")]
    return {
        "outage.hours": _with_outage_hours,
        "scale.load": lambda day, factor: replace(day, load_kw=day.load_kw * factor),
        "scale.pv": _with_scaled_pv,
        "scale.batteries": _with_scaled_batteries,
        "scale.price": lambda day, factor: replace(
            day, price_gbp_per_kwh=day.price_gbp_per_kwh * factor
        ),
        **{f"tiers.{tier}": partial(_with_tier_weight, tier) for tier in scenario.tiers},
        **{f"network.{name}": partial(_with_limit, name) for name in limits},
        **{f"objective.{f.name}": partial(_with_weight, f.name) for f in fields(ObjectiveWeights)},
        **{f"batteries.{name}": partial(_with_battery, name) for name in battery},
    }


def chosen_values(parameter: Parameter, values: str | None, range_: str | None) -> list[Value]:
    """The values of a sweep, written as a list or as a range."""
    if values is not None and range_ is None:
        return read_values(parameter, values)
    if range_ is not None and values is None:
        return read_range(parameter, range_)
    raise InputError.of(
        "sweep",
        "needs either --values or --range",
        "Give one of them, for example --values 1,2,3 or --range 0:5:6.",
    )


def read_values(parameter: Parameter, text: str) -> list[Value]:
    """Values that are separated by commas."""
    values = []
    wrong: list[tuple[str, str]] = []
    for part in (part.strip() for part in text.split(",")):
        value = _read(parameter.kind, part)
        if value is None:
            message = f"{part or 'nothing'} is not {_KINDS.get(parameter.kind, 'a word')}"
            wrong.append((message, f"Give values of {parameter.name}, separated by commas."))
        elif value in values:
            wrong.append((f"{part} comes twice", "Give each value once."))
        else:
            values.append(value)
    if wrong:
        raise InputError(
            [Problem("sweep", *words, field="--values", value=text) for words in wrong]
        )
    return values


def read_range(parameter: Parameter, text: str) -> list[Value]:
    """Equidistant values ``start:stop:n``, both ends included."""
    parts = text.split(":")
    numbers = [_read(float, part) for part in parts[:2]]
    count = _read(int, parts[2]) if len(parts) == 3 else None
    if count is None or None in numbers or not 2 <= int(count) <= _MAX_POINTS:
        raise InputError.of(
            "sweep",
            f"is not start:stop:n with n from 2 to {_MAX_POINTS}",
            "Write for example 0:5:6 for the values 0, 1, 2, 3, 4, 5.",
            field="--range",
            value=text,
        )
    if parameter.kind is str:
        raise InputError.of(
            "sweep",
            f"{parameter.name} takes words, not numbers",
            "Use --values.",
            field="--range",
            value=text,
        )
    start, stop = (float(number) for number in numbers if number is not None)
    points = np.linspace(start, stop, int(count)).tolist()
    return read_values(
        parameter, ",".join(value_text(float(f"{point:.{_DIGITS}g}")) for point in points)
    )


def value_text(value: Value) -> str:
    """A value in as few characters as read back to it.

    >>> value_text(2.0), value_text(0.1), value_text("mpc")
    ('2', '0.1', 'mpc')
    """
    return str(value).removesuffix(".0")


def changed(
    parameter: Parameter, value: Value, scenario: Scenario, options: RunOptions
) -> tuple[Scenario, RunOptions]:
    """Scenario and options with a value of the parameter, checked like a scenario folder."""
    try:
        day, options = parameter.change(scenario, options, value)
        return (day if day is scenario else _checked(day)), options
    except InputError as error:
        where = f"{parameter.name} = {value_text(value)}"
        problem = error.problems[0]  # the others are mostly the same one for the next battery
        if isinstance(problem, Problem):
            problem = replace(problem, where=f"{where}: {problem.where}")
        raise InputError(problem) from error


def _checked(day: Scenario) -> Scenario:
    """The scenario after a round trip through a folder, which checks everything."""
    with scratch_folder() as aside:
        fill_scenario_folder(day, aside)
        return read_scenario(aside)


def _read(kind: type, text: str) -> Value | None:
    if kind is str:
        return text or None
    try:
        value: Value = int(text) if kind is int else float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _change_option(
    option: Option, scenario: Scenario, options: RunOptions, value: Value
) -> tuple[Scenario, RunOptions]:
    """Replace a field of the options, or of a group in them."""
    return scenario, options.on(scenario).having({option.field: value})


def _with_outage_hours(day: Scenario, hours: float) -> Scenario:
    """The only outage, from its beginning, for another time; 0 is none."""
    steps = np.flatnonzero(day.outage)
    if len(steps) == 0 or np.any(np.diff(steps) != 1):
        raise InputError.of(
            "scenario",
            "has not exactly one outage",
            "Sweep the hours of a scenario with one outage.",
        )
    n_steps = hours / day.grid.dt_h
    left = day.grid.n_steps - int(steps[0])
    if not (0 <= n_steps <= left and float(n_steps).is_integer()):
        raise InputError.of(
            "scenario",
            f"the outage must last from 0 to {left * day.grid.dt_h:g} h in steps of "
            f"{day.grid.dt_h:g} h",
            "Give another duration.",
        )
    start = day.grid.times[steps[0]]
    return day.with_outage(start, start + pd.Timedelta(hours=hours))


def _with_scaled_pv(day: Scenario, factor: float) -> Scenario:
    """All PV systems larger or smaller, with their series; none at 0."""
    if factor == 0:
        return replace(day, pv=day.pv.rows(slice(0)), pv_kw=day.pv_kw[:, :0])
    pv = replace(day.pv, p_max_kw=day.pv.p_max_kw * factor, s_max_kva=day.pv.s_max_kva * factor)
    return replace(day, pv=pv, pv_kw=day.pv_kw * factor)


def _with_scaled_batteries(day: Scenario, factor: float) -> Scenario:
    """All batteries larger or smaller in energy and power; none at 0."""
    if factor == 0:
        return replace(day, batteries=day.batteries.rows(slice(0)))
    sizes = ("energy_kwh", "p_max_kw", "s_max_kva")
    return replace(
        day,
        batteries=replace(
            day.batteries, **{name: getattr(day.batteries, name) * factor for name in sizes}
        ),
    )


def _with_tier_weight(tier: str, day: Scenario, weight: float) -> Scenario:
    customers = day.customers
    weights = np.where(customers.tier == tier, weight, customers.weight)
    return replace(day, customers=replace(customers, weight=weights))


def _with_limit(name: str, day: Scenario, value: float) -> Scenario:
    new: dict[str, Any] = {name: value}
    return replace(day, network=replace(day.network, **new))


def _with_weight(name: str, day: Scenario, value: float) -> Scenario:
    return replace(day, objective=replace(day.objective, **{name: value}))


def _with_battery(name: str, day: Scenario, value: float) -> Scenario:
    column = np.full(len(day.batteries), value)
    return replace(day, batteries=replace(day.batteries, **{name: column}))
