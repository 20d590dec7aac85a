"""A scenario that was built in Python, checked against the same table of attributes as files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from annotated_types import Ge, Le
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from vppres.core.errors import InputError, Problem
from vppres.core.text import flaw_of_name
from vppres.io import schema
from vppres.io.checks import RESERVED
from vppres.io.messages import Suggestions, few, folded, shown
from vppres.io.series import TIME
from vppres.kinds.table import SERIES as KIND_SERIES
from vppres.kinds.table import TABLES as KIND_TABLES
from vppres.scenario.assets import OF_HOURS
from vppres.scenario.scenario import Scenario

# Attributes that may have no value (a temperature at the start), or no limit.
_MAY_BE_NAN = {*OF_HOURS, *(name for table in KIND_TABLES.values() for name in table.may_be_nan)}
_MAY_BE_INFINITE = {
    "i_max_a",
    "grid_limit_kw",
    "export_limit_kw",
    *(name for table in KIND_TABLES.values() for name in table.may_be_infinite),
}


def check_scenario(scenario: Scenario) -> None:
    """Refuse names that cannot be shown and numbers that no equipment has, all of them at once.

    Files are checked cell by cell when they are read; this asks the same of arrays.

    Examples
    --------
    >>> from vppres.io.find import load_scenario
    >>> check_scenario(load_scenario("uk-heatwave-2022"))
    """
    numbers = [*_numbers(scenario), *_limits(scenario)]
    problems = folded([*_names(scenario), *_tiers(scenario), *numbers])
    if problems:
        raise InputError(problems)


def _names(scenario: Scenario) -> Iterator[Problem]:
    """Names that cannot be shown, drawn or written."""
    customers = scenario.customers
    pv = scenario.pv
    batteries = scenario.batteries
    texts: list[tuple[str, str, Iterable[object]]] = [
        ("customers", "id", customers.id),
        ("customers", "tier", customers.tier),
        ("pv", "id", pv.id),
        ("batteries", "id", batteries.id),
        *(
            (name, table.names, getattr(getattr(scenario, name), table.names))
            for name, table in KIND_TABLES.items()
            if table.names
        ),
        ("network", "buses", scenario.network.buses),
        ("scenario", "tiers", scenario.tiers),
    ]
    for table, field, names in texts:
        for name in names:
            taken = RESERVED if name == TIME and field == "id" else None
            flaw = taken or flaw_of_name(str(name), schema.MAX_NAME_LENGTH)
            if flaw:
                yield Problem(table, flaw[0], flaw[1], field=field, value=shown(name))
    flaw = flaw_of_name(scenario.title, schema.MAX_TITLE_LENGTH)
    if flaw:
        yield Problem("scenario", flaw[0], flaw[1], field="title", value=shown(scenario.title))


def _tiers(scenario: Scenario) -> Iterator[Problem]:
    """Customers and others of tiers that the scenario does not have."""
    suggestions = Suggestions(scenario.tiers, "Correct it, or add the tier to the scenario's.")
    tiered = {
        name: table.names
        for name, table in KIND_TABLES.items()
        if "tier" in schema.row_of(table.key).model_fields
    }
    for table, names in {"customers": "id", **tiered}.items():
        rows = getattr(scenario, table)
        for name, tier in zip(getattr(rows, names), rows.tier, strict=True):
            if tier not in scenario.tiers:
                yield Problem(
                    table,
                    f"is not a tier of the scenario ({name})",
                    suggestions.cure(str(tier)),
                    field="tier",
                    value=shown(tier),
                )


def _numbers(scenario: Scenario) -> Iterator[Problem]:
    """Numbers out of the bounds of the table of attributes."""
    tables: list[tuple[str, object, type[BaseModel]]] = [
        ("lines", scenario.network, schema.LineRow),
        ("buses", scenario.network, schema.BusRow),
        ("network", scenario.network, schema.NetworkSection),
        ("customers", scenario.customers, schema.CustomerRow),
        ("pv", scenario.pv, schema.PVRow),
        ("batteries", scenario.batteries, schema.BatteryRow),
        *(
            (name, getattr(scenario, name), schema.row_of(table.key))
            for name, table in KIND_TABLES.items()
        ),
        ("load_kw", scenario, schema.LoadSeries),
        ("pv_kw", scenario, schema.PVSeries),
        *((name, scenario, schema.row_of(name)) for name in KIND_SERIES),
        ("system", scenario, schema.SystemSeries),
        ("objective", scenario.objective, schema.ObjectiveSection),
    ]
    for table, owner, model in tables:
        for name, field in model.model_fields.items():
            if owner is scenario.network and name == "export_limit_kw":
                continue  # a series of the scenario, whichever file it comes from
            if name in _MAY_BE_INFINITE or any(isinstance(m, (Ge, Le)) for m in field.metadata):
                yield from _outside(table, name, field, getattr(owner, name))


def _limits(scenario: Scenario) -> Iterator[Problem]:
    """Series of other units, limits of a charge with nothing between, and loads without power."""
    for name, of in KIND_SERIES.items():
        size = (scenario.grid.n_steps, len(getattr(scenario, of)))
        if size[1] and getattr(scenario, name).shape != size:
            yield Problem(
                "scenario",
                f"is not of shape {size}: its steps by its {of}",
                "Give a column for each, with every step.",
                field=name,
                value=str(getattr(scenario, name).shape),
            )
    batteries = scenario.batteries
    for i in np.flatnonzero(~(batteries.soc_min < batteries.soc_max)):
        yield Problem(
            f"battery {batteries.id[i]}",
            f"must be less than soc_max ({batteries.soc_max[i]:g})",
            "Correct one of the limits.",
            field="soc_min",
            value=float(batteries.soc_min[i]),
        )
    power_factor = scenario.customers.power_factor
    for i in np.flatnonzero(np.abs(power_factor) < schema.MIN_POWER_FACTOR):
        yield Problem(
            "customers",
            f"must be at least {schema.MIN_POWER_FACTOR:g} in size",
            schema.cure(schema.CustomerRow.model_fields["power_factor"]),
            row=int(i),
            field="power_factor",
            value=float(power_factor[i]),
        )


def _outside(table: str, name: str, field: FieldInfo, values: object) -> list[Problem]:
    """The values of one attribute that are out of its bounds."""
    array = np.atleast_1d(np.asarray(values, dtype=float))
    low, high = schema.limits(field)
    free = np.zeros(array.shape, dtype=bool)
    if name in _MAY_BE_NAN:
        free = np.isnan(array)
    if name in _MAY_BE_INFINITE:
        free = array == np.inf
    # Not within, rather than outside: that of NaN is true.
    bad = np.argwhere(~((array >= low) & (array <= high)) & ~free)

    def problem(i: int) -> Problem:
        place = tuple(int(k) for k in bad[i])
        return Problem(
            table,
            f"must lie between {low:g} and {high:g}",
            schema.cure(field),
            row=place[0] if array.size > 1 else None,
            field=name,
            value=float(array[place]),
        )

    return few(range(len(bad)), problem)
