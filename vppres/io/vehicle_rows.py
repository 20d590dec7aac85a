"""What is wrong with rows of ``ev_sessions.csv``."""

from __future__ import annotations

from itertools import pairwise

from vppres.core.errors import Problem
from vppres.io import schema
from vppres.io.rows import Rows
from vppres.io.tables import Table
from vppres.io.times import iso

STATES = ("capacity_kwh", "soc_at_plug_in", "soc_needed")


def check_sessions(table: Table, rows: Rows) -> list[Problem]:
    """Sessions that contradict themselves, or another one at their charger."""
    found = [problem for row, each in rows.items() for problem in _of_session(table, row, each)]
    return found + _overlaps(table, rows)


def _of_session(table: Table, row: int, session: schema.Row) -> list[Problem]:
    """A session that ends before it begins, or says its energy twice or not at all."""
    found = []
    if not session.plug_out > session.plug_in:
        message, cure = "does not come after plug_in", "Give the time of departure."
        found.append(table.problem(row, "plug_out", message, cure, iso(session.plug_out)))
    kwh = session.energy_needed_kwh
    told = [name for name in STATES if getattr(session, name) is not None]
    if kwh is not None and {"soc_needed", "soc_at_plug_in"} & {*told}:
        message = "is said beside states of charge"
        cure = "Keep the energy, or capacity_kwh, soc_at_plug_in and soc_needed."
        found.append(table.problem(row, "energy_needed_kwh", message, cure, kwh))
    if kwh is not None and session.capacity_kwh is not None and kwh > session.capacity_kwh:
        message = f"is more than the vehicle holds (capacity_kwh {session.capacity_kwh:g})"
        cure = "Give at most capacity_kwh, or correct capacity_kwh."
        found.append(table.problem(row, "energy_needed_kwh", message, cure, kwh))
    for name in STATES:
        if kwh is None and name not in told:
            message = "is missing, and so is energy_needed_kwh"
            cure = "Give capacity_kwh, soc_at_plug_in and soc_needed, or energy_needed_kwh."
            found.append(table.problem(row, name, message, cure))
    return found


def _overlaps(table: Table, rows: Rows) -> list[Problem]:
    """Vehicles that are plugged in before the one before has left its charger."""
    by_charger: dict[str, list[tuple[int, schema.Row]]] = {}
    for row, session in sorted(rows.items(), key=lambda item: item[1].plug_in):
        by_charger.setdefault(session.charger, []).append((row, session))
    cure = "Correct one of the two sessions: a charger has one vehicle at a time."
    return [
        table.problem(
            row,
            "plug_in",
            f"begins before the vehicle of row {before} has left",
            cure,
            iso(session.plug_in),
        )
        for sessions in by_charger.values()
        for (before, other), (row, session) in pairwise(sessions)
        if session.plug_in < other.plug_out
    ]
