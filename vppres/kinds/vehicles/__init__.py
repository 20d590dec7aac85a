"""Chargers of electric vehicles and the times in which a vehicle is plugged in: frozen tables.

A site without chargers has tables of length 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names, Wholes, given_or, no_items
from vppres.core.errors import Problem
from vppres.core.text import counted, iso, named
from vppres.kinds.kind import Kind, KindTable
from vppres.scenario.assets import Owned
from vppres.scenario.timegrid import TimeGrid

NO_CAR = -1
"""Session of a charger at which no vehicle is plugged in."""

OF_SESSIONS = (
    "capacity_kwh",
    "soc_at_plug_in",
    "soc_needed",
    "energy_needed_kwh",
    "v2g_soc_floor",
)
"""Columns of sessions that are NaN if not given."""

STATES = ("capacity_kwh", "soc_at_plug_in", "soc_needed")
"""Columns of vehicles that tell their state of charge."""

ROUNDING = 1e-9
"""Share of a step by which a time may miss its beginning."""


@dataclass(frozen=True, eq=False)
class Chargers(Owned, KindTable):
    """Chargers of vehicles, shape (K,) each.

    ``customer`` is the customer behind whose switch a charger is; one that stands alone has none
    (empty text) and names its ``bus``, others have None there. ``p_discharge_kw`` is 0 for a
    charger that only charges. Chargers have a power factor of 1.
    """

    key = "ev_chargers"
    model = "ChargerRow"
    about = "A charger of electric vehicles."
    references = (("customer", "customers", "customer"),)
    limits = (("p_charge_min_kw", "p_charge_kw", ""),)

    id: Names = field(default_factory=no_items)
    bus: Names = field(default_factory=no_items)
    customer: Names = field(default_factory=no_items)
    p_charge_kw: Floats = field(default_factory=no_items)
    p_charge_min_kw: Floats = field(default_factory=no_items)
    p_discharge_kw: Floats = field(default_factory=no_items)
    eta_charge: Floats = field(default_factory=no_items)
    eta_discharge: Floats = field(default_factory=no_items)

    @property
    def two_way(self) -> Flags:
        """Chargers that discharge vehicles too, (K,)."""
        return np.asarray(self.p_discharge_kw > 0.0)

    def most_taken_kw(self, scenario: Any) -> Floats:
        """Largest power of each charger that has a vehicle, 0 of others, (T, K)."""
        return np.where(scenario.session_at >= 0, self.p_charge_kw, 0.0)

    @property
    def largest_kw(self) -> Floats:
        """Largest power of each charger."""
        return self.p_charge_kw


@dataclass(frozen=True, eq=False)
class Sessions(KindTable):
    """Times in which a vehicle is plugged in, shape (S,) each, as the file says them.

    Times are of type :class:`pandas.Timestamp`. Numbers are NaN where the file has none;
    :attr:`held_kwh` and the properties beside it say what follows in kWh.
    """

    key = "ev_sessions"
    model = "SessionRow"
    about = "A time in which a vehicle is plugged in at a charger."
    references = (("charger", "ev_chargers", "charger"),)
    names = "vehicle"
    may_be_nan = OF_SESSIONS

    charger: Names = field(default_factory=no_items)
    vehicle: Names = field(default_factory=no_items)
    plug_in: Names = field(default_factory=no_items)
    plug_out: Names = field(default_factory=no_items)
    capacity_kwh: Floats = field(default_factory=no_items)
    soc_at_plug_in: Floats = field(default_factory=no_items)
    soc_needed: Floats = field(default_factory=no_items)
    energy_needed_kwh: Floats = field(default_factory=no_items)
    v2g_soc_floor: Floats = field(default_factory=no_items)
    tier: Names = field(default_factory=no_items)
    weight: Floats = field(default_factory=no_items)
    announced: Flags = field(default_factory=no_items)

    @classmethod
    def of_columns(cls, columns: dict[str, Any], tiers: Mapping[str, float]) -> Sessions:
        """Sessions; a vehicle without a tier is of the last, without a name that of its charger."""
        pairs = zip(columns["vehicle"], columns["charger"], strict=True)
        named = [vehicle or charger for vehicle, charger in pairs]
        tier = [tier or [*tiers][-1] for tier in columns["tier"]]
        weight = given_or(columns["weight"], [tiers[each] for each in tier])
        return cls(**columns | {"vehicle": named, "tier": tier, "weight": weight})

    @classmethod
    def problems(cls, table: Any, rows: Mapping[int, Any]) -> list[Problem]:
        """Sessions that contradict themselves, or another one at their charger."""
        found = [problem for row, each in rows.items() for problem in _of_session(table, row, each)]
        return found + _overlaps(table, rows)

    def over(self, time: pd.Timestamp) -> Flags:
        """Sessions that ended by a time, (S,)."""
        return np.array([end <= time for end in self.plug_out], dtype=bool)

    @property
    def by_energy(self) -> Flags:
        """Sessions of vehicles that tell no state of charge, but the energy that they need."""
        return ~np.isnan(self.energy_needed_kwh)

    @property
    def held_kwh(self) -> Floats:
        """Energy in the vehicle when it is plugged in; counted from 0 if it tells none."""
        return np.where(self.by_energy, 0.0, self.soc_at_plug_in * self.capacity_kwh)

    @property
    def needed_kwh(self) -> Floats:
        """Energy that it is to have when it leaves."""
        soc_kwh = self.soc_needed * self.capacity_kwh
        return np.where(self.by_energy, self.energy_needed_kwh, soc_kwh)

    @property
    def full_kwh(self) -> Floats:
        """Energy that it holds at most."""
        return np.where(self.by_energy, self.energy_needed_kwh, self.capacity_kwh)

    @property
    def floor_kwh(self) -> Floats:
        """Energy below which it is not discharged: what it needs, if nothing else is said."""
        said = self.v2g_soc_floor * self.full_kwh
        return np.where(np.isnan(self.v2g_soc_floor), self.needed_kwh, said)

    def remark(self, scenario: Any) -> str:
        """Vehicles that are plugged in for no whole step of the time grid."""
        grid = scenario.grid
        first, after = self.steps(grid)
        brief = self.vehicle[(after == first) & (first >= 0) & (first < grid.n_steps)]
        if not len(brief):
            return ""
        return (
            f"Plugged in for no whole step of {grid.step_minutes:g} min, and so not charged: "
            f"{named(brief, 5)}. Use shorter steps."
        )

    def steps(self, grid: TimeGrid) -> tuple[Wholes, Wholes]:
        """First step of each session and the one after its last, (S,) each, within the grid or not.

        A step counts if the vehicle is plugged in for the whole of it.
        """
        start, step = grid.start.value, grid.step.value
        begins, ends = (
            np.array([(time.value - start) / step for time in times], dtype=float)
            for times in (self.plug_in, self.plug_out)
        )
        first = np.ceil(begins - ROUNDING).astype(int)
        return first, np.maximum(np.floor(ends + ROUNDING).astype(int), first)


def sessions_by_step(chargers: Chargers, sessions: Sessions, grid: TimeGrid) -> Wholes:
    """Which session each charger has in each step, (T, K): its row, or :data:`NO_CAR`."""
    found = np.full((grid.n_steps, len(chargers)), NO_CAR)
    column = {name: k for k, name in enumerate(chargers.id)}
    first, after = sessions.steps(grid)
    for s, charger in enumerate(sessions.charger):
        found[max(first[s], 0) : max(after[s], 0), column[charger]] = s
    return found


def _of_session(table: Any, row: int, session: Any) -> list[Problem]:
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


def _overlaps(table: Any, rows: Mapping[int, Any]) -> list[Problem]:
    """Vehicles that are plugged in before the one before has left its charger."""
    by_charger: dict[str, list[tuple[int, Any]]] = {}
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


KIND = Kind(
    {"chargers": Chargers, "sessions": Sessions},
    what="vehicles",
    table="vehicles",
    item="charger",
    subject="vehicle",
    sign="charger",
    element=("storage", "charger"),
    takes_less=True,
)


def contents(content: Mapping[str, Any]) -> str:
    """Chargers and sessions in words, from the numbers of what a scenario holds."""
    sessions = counted(content["ev_sessions"], "session")
    return f"{counted(content['chargers'], 'charger')} with {sessions}"
