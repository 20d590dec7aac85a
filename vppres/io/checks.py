"""Checks across the tables of a scenario folder; one named question per function."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping

import numpy as np

from vppres.core.arrays import Floats
from vppres.core.errors import Problem
from vppres.io import schema
from vppres.io.messages import Suggestions, few
from vppres.io.tables import Table, cell_text
from vppres.scenario.assets import SOC_ROUNDING
from vppres.scenario.network import BusId

# Series are written with few digits: a peak may exceed its rating by this share.
RATING_TOLERANCE = 1e-3
_RESERVED = "time"
_INTEGER = re.compile(r"-?[0-9]{1,18}")


def bus_reader(lines: Table) -> Callable[[str], BusId]:
    """How the scenario writes buses: as integers if every bus of the lines is one."""
    texts = [*lines.column("from_bus").values(), *lines.column("to_bus").values()]
    if not all(_INTEGER.fullmatch(text) for text in texts):
        return str
    return lambda text: int(text) if _INTEGER.fullmatch(text) else text


def check_ids(table: Table) -> list[Problem]:
    """Identifiers that appear twice, or that a series could not use as a column."""
    reserved = [
        Problem(
            table.file,
            "is reserved for the time column",
            "Choose another identifier.",
            row=row,
            field="id",
            value=text,
        )
        for row, text in table.column("id").items()
        if text == _RESERVED
    ]
    twice = check_once(table, "id", "Give each row its own identifier.")
    return sorted(twice + reserved, key=lambda problem: problem.row or 0)


def check_once(table: Table, field: str, cure: str) -> list[Problem]:
    """Cells of a column that repeat an earlier one."""
    first: dict[str, int] = {}
    problems = []
    for row, text in table.column(field).items():
        if text in first:
            message = f"is already used in row {first[text]}"
            problems.append(Problem(table.file, message, cure, row=row, field=field, value=text))
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


def check_buses(table: Table, lines: Table) -> list[Problem]:
    """Assets at buses that no line reaches."""
    read_bus = bus_reader(lines)
    ends = [*lines.column("from_bus").values(), *lines.column("to_bus").values()]
    known = {read_bus(text) for text in ends}
    suggestions = Suggestions(sorted(map(str, known)), "Correct the bus.")
    return [
        Problem(
            table.file,
            f"is not a bus of {lines.file}",
            suggestions.cure(text),
            row=row,
            field="bus",
            value=text,
        )
        for row, text in table.column("bus").items()
        if known and read_bus(text) not in known
    ]


def check_known(table: Table, field: str, known: Collection[str], message: str) -> list[Problem]:
    """Cells that refer to something that does not exist."""
    names = set(known)
    suggestions = Suggestions(known, f"Correct the {field}.")
    return [
        Problem(table.file, message, suggestions.cure(text), row=row, field=field, value=text)
        for row, text in table.column(field).items()
        if text not in names
    ]


def check_parts(table: Table, customers: Mapping[int, schema.Row]) -> list[Problem]:
    """Identifiers that the parts of customers in several parts, or of their PV systems, will have.

    The parts of ``C7`` are ``C7/1``, ``C7/2`` and so on.
    """
    most = max((row.shed_steps for row in customers.values()), default=1)
    known = set(table.column("id").values())
    problems = []
    for row, text in table.column("id").items():
        whole, _, part = text.rpartition("/")
        if whole in known and part.isdecimal() and 1 <= int(part) <= most:
            problems.append(
                Problem(
                    table.file,
                    f"is reserved for a part of {whole} while customers have several shed_steps",
                    "Choose another identifier.",
                    row=row,
                    field="id",
                    value=text,
                )
            )
    return problems


def check_places(pv: Table) -> list[Problem]:
    """PV systems with a customer and a bus, or with neither."""
    owner = pv.column("customer")
    bus = pv.column("bus")
    problems = []
    for row, name in pv.column("id").items():
        if row in owner and row in bus:
            problems.append(
                Problem(
                    pv.file,
                    "has a customer too",
                    "Leave one of them empty: a system is at its customer's bus, or stands alone.",
                    row=row,
                    field="bus",
                    value=bus[row],
                )
            )
        elif row not in owner and row not in bus:
            problems.append(
                Problem(
                    pv.file,
                    "has neither a customer nor a bus",
                    "Give the customer that owns it, or the bus at which it stands alone.",
                    row=row,
                    field="id",
                    value=name,
                )
            )
    return problems


def check_one_pv_each(pv: Table) -> list[Problem]:
    """Customers with several PV systems: the model has one self-consumption per customer."""
    first: dict[str, int] = {}
    problems = []
    for row, text in pv.column("customer").items():
        if text in first:
            problems.append(
                Problem(
                    pv.file,
                    f"already has the PV system of row {first[text]}",
                    "Join the two systems: a customer has at most one.",
                    row=row,
                    field="customer",
                    value=text,
                )
            )
        first.setdefault(text, row)
    return problems


def check_pv_ratings(file: str, rows: dict[int, schema.Row]) -> list[Problem]:
    """PV systems larger than their inverter.

    What a customer uses of its own PV power is an equality in the model, so power that the
    inverter cannot carry would force the customer to be shed.
    """
    return [
        Problem(
            file,
            f"must not exceed s_max_kva ({pv.s_max_kva:g})",
            "Give the larger inverter, or cap p_max_kw and the series at its rating.",
            row=row,
            field="p_max_kw",
            value=pv.p_max_kw,
        )
        for row, pv in rows.items()
        if pv.p_max_kw > pv.s_max_kva
    ]


def check_batteries(file: str, rows: dict[int, schema.Row]) -> list[Problem]:
    """Ratings and state-of-charge limits that contradict each other."""
    problems = []
    for row, battery in rows.items():
        if battery.p_max_kw > battery.s_max_kva:
            problems.append(
                Problem(
                    file,
                    f"must not exceed s_max_kva ({battery.s_max_kva:g})",
                    "Correct the power or the inverter rating.",
                    row=row,
                    field="p_max_kw",
                    value=battery.p_max_kw,
                )
            )
        low = battery.soc_min
        high = battery.soc_max
        start = battery.soc_initial
        if not low < high:
            problems.append(
                Problem(
                    file,
                    f"must be less than soc_max ({high:g})",
                    "Correct one of the limits.",
                    row=row,
                    field="soc_min",
                    value=low,
                )
            )
        elif start is not None and not (low - SOC_ROUNDING <= start <= high + SOC_ROUNDING):
            problems.append(
                Problem(
                    file,
                    f"must lie between soc_min ({low:g}) and soc_max ({high:g})",
                    "Correct the state of charge at the start or the limits.",
                    row=row,
                    field="soc_initial",
                    value=start,
                )
            )
    return problems


def check_pv_series(series: Table, name: str, values: Floats, p_max_kw: float) -> list[Problem]:
    """Available PV power above the system's rating."""
    over = np.flatnonzero(values > p_max_kw * (1 + RATING_TOLERANCE))
    return few(
        over,
        lambda i: Problem(
            series.file,
            f"exceeds the system's p_max_kw ({p_max_kw:g})",
            "Correct the series or the rating.",
            row=int(series.frame.index[i]),
            field=name,
            value=cell_text(series.frame[name].iloc[i]),
        ),
    )


def check_one_export_limit(file: schema.Section | None, system: Table | None) -> list[Problem]:
    """Whether the export has its limit in one place only."""
    if file is None or file.network.export_limit_kw is None or system is None:
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
