"""Checks across the tables of a scenario folder; one named question per function."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection

import numpy as np

from vppres.core.arrays import Floats
from vppres.core.errors import Problem
from vppres.io import schema
from vppres.io.messages import Suggestions
from vppres.io.rows import Rows
from vppres.io.series import TIME
from vppres.io.tables import Table
from vppres.kinds.table import TABLES
from vppres.scenario.assets import SOC_ROUNDING
from vppres.scenario.network import BusId

# Series are written with few digits: a peak may exceed its rating by this share.
RATING_TOLERANCE = 1e-3
_INTEGER = re.compile(r"-?[0-9]{1,18}")


def bus_reader(lines: Table) -> Callable[[str], BusId]:
    """How the scenario writes buses: as integers if every bus of the lines is one."""
    texts = [*lines.column("from_bus").values(), *lines.column("to_bus").values()]
    if not all(_INTEGER.fullmatch(text) for text in texts):
        return str
    return lambda text: int(text) if _INTEGER.fullmatch(text) else text


LIMITS = (
    (
        "pv",
        "p_max_kw",
        "s_max_kva",
        "Give the larger inverter, or cap p_max_kw and the series at its rating.",
    ),
    ("batteries", "p_max_kw", "s_max_kva", "Correct the power or the inverter rating."),
    ("batteries", "soc_min", "soc_max", ""),
    *((table.key, *each) for table in TABLES.values() for each in table.limits),
)
"""Columns that must not exceed another one of their row, and the cure where it is a special one.

What a customer uses of its own PV power is an equality in the model, so power that the inverter
cannot carry would force the customer to be shed.
"""

APART = ("soc_min", "t_min_c")
"""Those that must not equal it either."""


def check_limits(table: Table, key: str, rows: Rows) -> list[Problem]:
    """Values above the limit that the same row gives."""
    problems = []
    for row, item in rows.items():
        for field, most, cure in (limit[1:] for limit in LIMITS if limit[0] == key):
            value, limit = getattr(item, field), getattr(item, most)
            apart = field in APART
            if value is not None and (value > limit or (apart and value == limit)):
                words = "must be less than" if apart else "must not exceed"
                message = f"{words} {most} ({limit:g})"
                cure = cure or "Correct one of the two."
                problems.append(table.problem(row, field, message, cure, value))
    return problems


RESERVED = ("is reserved for the time column", "Choose another identifier.")
"""Message and cure of an identifier that is the name of that column."""


def check_ids(table: Table) -> list[Problem]:
    """Identifiers that appear twice, or that a series could not use as a column."""
    reserved = [
        table.problem(row, "id", *RESERVED, text)
        for row, text in table.column("id").items()
        if text == TIME
    ]
    twice = check_once(table, "id", "Give each row its own identifier.")
    return sorted(twice + reserved, key=lambda problem: problem.row or 0)


def check_once(
    table: Table, field: str, cure: str, message: str = "is already used in row {}"
) -> list[Problem]:
    """Cells of a column that repeat an earlier one."""
    first: dict[str, int] = {}
    problems = []
    for row, text in table.column(field).items():
        if text in first:
            problems.append(table.problem(row, field, message.format(first[text]), cure, text))
        first.setdefault(text, row)
    return problems


def check_any(customers: Table) -> list[Problem]:
    """A scenario without customers."""
    if len(customers.frame) > 0:
        return []
    return [
        Problem(
            customers.file,
            "has no row",
            "Give at least one customer: without any there is nothing to serve.",
        )
    ]


def check_buses(table: Table, lines: Table, field: str = "bus") -> list[Problem]:
    """Assets at buses that no line reaches."""
    read_bus = bus_reader(lines)
    ends = [*lines.column("from_bus").values(), *lines.column("to_bus").values()]
    known = {read_bus(text) for text in ends}
    suggestions = Suggestions(sorted(map(str, known)), "Correct the bus.")
    message = f"is not a bus of {lines.file}"
    return [
        table.problem(row, field, message, suggestions.cure(text), text)
        for row, text in table.column(field).items()
        if known and read_bus(text) not in known
    ]


def check_known(table: Table, field: str, known: Collection[str], message: str) -> list[Problem]:
    """Cells that refer to something that does not exist."""
    names = set(known)
    suggestions = Suggestions(known, f"Correct the {field}.")
    return [
        table.problem(row, field, message, suggestions.cure(text), text)
        for row, text in table.column(field).items()
        if text not in names
    ]


def check_parts(table: Table, customers: Rows) -> list[Problem]:
    """Identifiers that the parts of customers in several parts, or of their PV systems, will have.

    The parts of ``C7`` are ``C7/1``, ``C7/2`` and so on.
    """
    most = max((row.shed_steps for row in customers.values()), default=1)
    known = set(table.column("id").values())
    problems = []
    for row, text in table.column("id").items():
        whole, _, part = text.rpartition("/")
        if whole in known and part.isdecimal() and 1 <= int(part) <= most:
            message = f"is reserved for a part of {whole} while customers have several shed_steps"
            problems.append(table.problem(row, "id", message, "Choose another identifier.", text))
    return problems


def check_places(table: Table) -> list[Problem]:
    """PV systems or chargers with a customer and a bus, or with neither."""
    owner = table.column("customer")
    bus = table.column("bus")
    problems = []
    for row, name in table.column("id").items():
        if row in owner and row in bus:
            cure = "Leave one of them empty: it is at its customer's bus, or stands alone."
            problems.append(table.problem(row, "bus", "has a customer too", cure, bus[row]))
        elif row not in owner and row not in bus:
            message = "has neither a customer nor a bus"
            cure = "Give the customer that owns it, or the bus at which it stands alone."
            problems.append(table.problem(row, "id", message, cure, name))
    return problems


def check_one_pv_each(pv: Table) -> list[Problem]:
    """Customers with several PV systems: the model has one self-consumption per customer."""
    cure = "Join the two systems: a customer has at most one."
    return check_once(pv, "customer", cure, "already has the PV system of row {}")


def check_soc_initial(table: Table, batteries: Rows) -> list[Problem]:
    """States of charge at the start that are outside their limits."""
    problems = []
    for row, battery in batteries.items():
        low, high, start = battery.soc_min, battery.soc_max, battery.soc_initial
        outside = start is not None and not low - SOC_ROUNDING <= start <= high + SOC_ROUNDING
        if outside and low < high:
            message = f"must lie between soc_min ({low:g}) and soc_max ({high:g})"
            cure = "Correct the state of charge at the start or the limits."
            problems.append(table.problem(row, "soc_initial", message, cure, start))
    return problems


def check_pv_series(series: Table, name: str, values: Floats, p_max_kw: float) -> list[Problem]:
    """Available PV power above the system's rating."""
    over = np.flatnonzero(values > p_max_kw * (1 + RATING_TOLERANCE))
    message = f"exceeds the system's p_max_kw ({p_max_kw:g})"
    cure = "Correct the series or the rating."
    return series.problems(over, name, message, cure)


def check_one_export_limit(file: schema.TomlSection | None, system: Table) -> list[Problem]:
    """Whether the export has its limit in one place only."""
    if not file or file.network.export_limit_kw is None:
        return []
    if "export_limit_kw" not in system.names:
        return []
    return [
        Problem(
            "scenario.toml",
            f"is also a column of {system.file}",
            "Keep the key for one limit of all steps, or the column for one of each step.",
            field="network.export_limit_kw",
            value=file.network.export_limit_kw,
        )
    ]
