"""Rows of ``ev_chargers.csv`` and ``ev_sessions.csv``: what is wrong with them; both tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import Problem
from vppres.io import checks, schema
from vppres.io.settings import SCENARIO_FILE
from vppres.io.tables import Table
from vppres.io.times import iso
from vppres.scenario.network import BusId
from vppres.scenario.vehicles import OF_SESSIONS, Chargers, Sessions

Rows = Mapping[int, schema.Row]
STATES = ("capacity_kwh", "soc_at_plug_in", "soc_needed")


def check_vehicles(
    chargers: Table,
    sessions: Table,
    charger_rows: Rows,
    session_rows: Rows,
    tiers: Mapping[str, float],
) -> list[Problem]:
    """Every check of chargers and sessions that needs more than one cell."""
    known = chargers.column("id").values()
    message = f"is not a charger of {chargers.file}"
    found = checks.check_known(sessions, "charger", known, message)
    if tiers:
        message = f"is not a tier of {SCENARIO_FILE}"
        found += checks.check_known(sessions, "tier", tiers, message)
    found += [
        p for row, each in charger_rows.items() for p in _of_charger(chargers.file, row, each)
    ]
    found += [
        p for row, each in session_rows.items() for p in _of_session(sessions.file, row, each)
    ]
    return found + _overlaps(sessions.file, session_rows)


def _of_charger(file: str, row: int, charger: schema.Row) -> list[Problem]:
    """A charger at no place or at two, or whose least power is above its largest."""
    found = []
    if bool(charger.customer) == bool(charger.bus):
        found.append(
            Problem(
                file,
                "has a customer too" if charger.bus else "has neither a customer nor a bus",
                "Give the customer behind whose switch it is, or the bus at which it stands alone.",
                row=row,
                field="bus",
                value=charger.bus or charger.id,
            )
        )
    if charger.p_charge_min_kw > charger.p_charge_kw:
        found.append(
            Problem(
                file,
                f"must not exceed p_charge_kw ({charger.p_charge_kw:g})",
                "Correct one of the powers.",
                row=row,
                field="p_charge_min_kw",
                value=charger.p_charge_min_kw,
            )
        )
    return found


def _of_session(file: str, row: int, session: schema.Row) -> list[Problem]:
    """A session that ends before it begins, or says its energy twice or not at all."""
    found = []
    if not session.plug_out > session.plug_in:
        found.append(
            Problem(
                file,
                "does not come after plug_in",
                "Give the time of departure.",
                row=row,
                field="plug_out",
                value=iso(pd.Timestamp(session.plug_out)),
            )
        )
    by_energy = session.energy_needed_kwh is not None
    told = [name for name in STATES if getattr(session, name) is not None]
    if by_energy and {"soc_needed", "soc_at_plug_in"} & {*told}:
        found.append(
            Problem(
                file,
                "is said beside states of charge",
                "Keep the energy, or capacity_kwh, soc_at_plug_in and soc_needed.",
                row=row,
                field="energy_needed_kwh",
                value=session.energy_needed_kwh,
            )
        )
    for name in STATES:
        if not by_energy and name not in told:
            found.append(
                Problem(
                    file,
                    "is missing, and so is energy_needed_kwh",
                    "Give capacity_kwh, soc_at_plug_in and soc_needed, or energy_needed_kwh.",
                    row=row,
                    field=name,
                )
            )
    return found


def _overlaps(file: str, rows: Rows) -> list[Problem]:
    """Vehicles that are plugged in before the one before has left its charger."""
    by_charger: dict[str, list[tuple[int, schema.Row]]] = {}
    for row, session in sorted(rows.items(), key=lambda item: item[1].plug_in):
        by_charger.setdefault(session.charger, []).append((row, session))
    return [
        Problem(
            file,
            f"begins before the vehicle of row {before} has left",
            "Correct one of the two sessions: a charger has one vehicle at a time.",
            row=row,
            field="plug_in",
            value=iso(pd.Timestamp(session.plug_in)),
        )
        for sessions in by_charger.values()
        for (before, other), (row, session) in pairwise(sessions)
        if session.plug_in < other.plug_out
    ]


def _columns(rows: Rows, model: Any) -> dict[str, Any]:
    """Rows turned into one list per attribute."""
    return {name: [getattr(row, name) for row in rows.values()] for name in model.model_fields}


def chargers_of(rows: Rows, read_bus: Callable[[str], BusId]) -> Chargers:
    """The chargers of sound rows."""
    columns = _columns(rows, schema.ChargerRow)
    columns["bus"] = [read_bus(bus) if bus else None for bus in columns["bus"]]
    return Chargers(**columns)


def sessions_of(rows: Rows, tiers: Mapping[str, float]) -> Sessions:
    """The sessions of sound rows; a vehicle without a tier is of the last."""
    columns = _columns(rows, schema.SessionRow)
    columns["vehicle"] = [row.vehicle or row.charger for row in rows.values()]
    columns["tier"] = [row.tier or list(tiers)[-1] for row in rows.values()]
    columns["weight"] = [
        tiers[tier] if weight is None else weight
        for tier, weight in zip(columns["tier"], columns["weight"], strict=True)
    ]
    for name in ("plug_in", "plug_out"):
        columns[name] = [pd.Timestamp(time) for time in columns[name]]
    for name in OF_SESSIONS:
        columns[name] = [np.nan if value is None else value for value in columns[name]]
    columns["announced"] = [row.announced == "yes" for row in rows.values()]
    return Sessions(**columns)


def vehicle_frames(chargers: Chargers, sessions: Sessions) -> dict[str, pd.DataFrame]:
    """Both tables as they are written; none without a charger."""
    if not len(chargers):
        return {}
    told = {name: getattr(sessions, name) for name in schema.SessionRow.model_fields}
    told |= {name: [iso(time) for time in told[name]] for name in ("plug_in", "plug_out")}
    told["announced"] = np.where(sessions.announced, "yes", "no")
    return {
        "ev_chargers": pd.DataFrame(
            {name: getattr(chargers, name) for name in schema.ChargerRow.model_fields}
        ),
        "ev_sessions": pd.DataFrame(told).dropna(axis="columns", how="all"),
    }
