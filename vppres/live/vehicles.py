"""What is measured of vehicles, laid over the sessions of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.live.door import Door
from vppres.scenario.scenario import Scenario
from vppres.scenario.vehicles import NO_CAR, OF_SESSIONS, Sessions

QUANTITIES = ("plugged", "ev_soc", "energy_needed_kwh", "departure")
"""What can be known of the vehicle at a charger."""


@dataclass(frozen=True, eq=False)
class Held:
    """Energy of the vehicles at chargers, and since when they are plugged in, (K,) each.

    ``since`` is the time of plug-in as text, empty without a vehicle.
    """

    since: tuple[str, ...]
    kwh: Floats

    @classmethod
    def of(cls, scenario: Scenario, t: int, kwh: Floats) -> Held:
        """The vehicles of a step with their energy at its end."""
        return cls(_since(scenario, t), kwh)

    def at(self, scenario: Scenario, t: int) -> Floats:
        """Energy of the vehicles of a step that have been here before, NaN of others, (K,)."""
        now = _since(scenario, t)
        pairs = zip(now, self.since, strict=True)
        stays = [name != "" and name == before for name, before in pairs]
        return np.where(stays, self.kwh, np.nan)


def _since(scenario: Scenario, t: int) -> tuple[str, ...]:
    """When the vehicle at each charger was plugged in."""
    rows = scenario.session_at[t].tolist()
    plug_in = scenario.sessions.plug_in
    return tuple("" if row == NO_CAR else plug_in[row].isoformat() for row in rows)


def with_vehicles(
    door: Door, scenario: Scenario, told: Mapping[str, Any]
) -> tuple[Scenario, Floats]:
    """The scenario with sessions as they are measured, and energies that were read, (K,).

    A charger without a vehicle ends its session; that is named. A vehicle that tells the energy
    that it needs has a session from now on; its departure is that of the session before if it tells
    none. One that is plugged in after its departure, or of which none is known, stays for this
    step, and is named. Energies are NaN if no state of charge was read.
    """
    chargers = scenario.chargers
    none = np.full(len(chargers), np.nan)
    plugged, soc, needed_kwh = (
        door.values(name, told.get(name), chargers.id, none) for name in QUANTITIES[:3]
    )
    departure = door.moments("departure", told.get("departure"), chargers.id)
    held_kwh = none.copy()
    if door.problems or not len(chargers):
        return scenario, held_kwh
    rows = rows_of(scenario.sessions)
    end = door.begun + scenario.grid.step
    gone = set()
    for k, name in enumerate(chargers.id):
        s = int(scenario.session_at[door.t, k])
        if s == NO_CAR and plugged[k] == 1.0:
            s = _last_before(scenario.sessions, str(name), door.begun, end)
        now = None if s == NO_CAR else rows[s]
        if plugged[k] == 0.0:
            if now is not None:
                gone.add(s)
                door.left_out.append(f"vehicle {now['vehicle']} left {name} before its departure")
            continue
        leaves = departure[k] or (None if now is None else now["plug_out"])
        here = plugged[k] == 1.0 or np.isfinite(needed_kwh[k])
        if here and (leaves is None or leaves <= door.begun):
            if leaves is not None or np.isfinite(needed_kwh[k]):
                vehicle = name if now is None else now["vehicle"]
                known = "after its departure" if leaves else "and its departure is not known"
                door.left_out.append(f"vehicle {vehicle} at {name} is here {known}")
            leaves = end
        if np.isfinite(needed_kwh[k]):
            gone.add(s)
            row = _needing(scenario, str(name), now, needed_kwh[k])
            rows.append({**row, "plug_in": door.begun, "plug_out": leaves})
        elif now is not None:
            rows[s] = {**now, "plug_out": max(leaves or now["plug_out"], door.begun)}
            held_kwh[k] = soc[k] * scenario.sessions.full_kwh[s]
    kept = [row for s, row in enumerate(rows) if s not in gone]
    return replace(scenario, sessions=sessions_of(kept)), held_kwh


def _last_before(sessions: Sessions, charger: str, begun: pd.Timestamp, end: pd.Timestamp) -> int:
    """The session of a charger that was over last, unless another one begins in this step."""
    own = np.flatnonzero(sessions.charger == charger)
    over = [int(s) for s in own if sessions.plug_out[s] <= begun]
    if not over or any(begun < sessions.plug_in[s] < end for s in own):
        return NO_CAR
    return max(over, key=lambda s: sessions.plug_out[s])


def rows_of(sessions: Sessions) -> list[dict[str, Any]]:
    """Sessions one by one."""
    names = [f.name for f in fields(sessions)]
    columns = (getattr(sessions, name) for name in names)
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def sessions_of(rows: Sequence[Mapping[str, Any]]) -> Sessions:
    """Sessions from their rows."""
    columns: dict[str, Any] = {f.name: [row[f.name] for row in rows] for f in fields(Sessions)}
    return Sessions(**columns)


def _needing(
    scenario: Scenario, charger: str, before: Mapping[str, Any] | None, needed_kwh: float
) -> dict[str, Any]:
    """A session of a vehicle that tells the energy that it needs; without a name its charger's.

    One of which no tier is known has the weight of the least.
    """
    least = float(scenario.sessions.weight.min(initial=np.inf))
    unknown = {
        "vehicle": charger,
        "tier": scenario.tiers[-1],
        "weight": least if np.isfinite(least) else 1.0,
    }
    nothing = dict.fromkeys(OF_SESSIONS, np.nan)
    own = {**(before or unknown), "charger": charger, "announced": True}
    return {**own, **nothing, "energy_needed_kwh": needed_kwh}
