"""What stored plans say of vehicles and generating sets, for their replay.

A plan says which vehicles were plugged in when it was decided, and how sets were.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names
from vppres.kinds.gensets.data import Gensets, GensetState
from vppres.kinds.vehicles.data import OF_SESSIONS, Sessions
from vppres.kinds.vehicles.live import rows_of, sessions_of
from vppres.scenario.scenario import Scenario

Plan = Mapping[str, Any]
Plans = Sequence[Plan | None]  # by step, None for a step without


def expected_by(plan: Plan | None) -> Mapping[str, Any]:
    """What a plan expects of its step; nothing where it is none of the controller's."""
    return (plan or {}).get("expected") or {}


def said_of(
    plan: Plan | None, what: str, ids: Names, reckoned: Floats, field: str | None = None
) -> Floats:
    """What a step was decided on, by unit; as reckoned where its plan does not say it."""
    told = expected_by(plan).get(what, {})
    values = [told.get(str(name)) for name in ids]
    found = [one[field] if field is not None and one is not None else one for one in values]
    return np.where([one is None for one in found], reckoned, np.array(found, dtype=float))


def with_told(scenario: Scenario, stored: Plans) -> Scenario:
    """The scenario with vehicles as plans tell of them, and sets as the first plan does."""
    told = expected_by(stored[0]).get("gensets", {})
    scenario = replace(scenario, gensets=_sets_at_first(scenario.gensets, told))
    if not any(expected_by(plan).get("vehicles", {}) for plan in stored):
        return scenario
    return replace(scenario, sessions=_sessions(scenario, stored))


def set_state(scenario: Scenario, t: int, plan: Plan | None, reckoned: GensetState) -> GensetState:
    """Generating sets that a step was decided on; as reckoned without a plan.

    Plans count what is delivered at the beginning of their step.
    """
    told = expected_by(plan).get("gensets", {})
    names = [str(name) for name in scenario.gensets.id]
    if not names or not all(name in told for name in names):
        return reckoned
    hours, power_kw, litres = (
        np.array([told[name][field] for name in names], dtype=float)
        for field in ("hours_before", "p_before_kw", "fuel_litres")
    )
    before = litres - scenario.refuelled_litres[t]
    return GensetState(hours > 0.0, np.abs(hours), power_kw, before)


def _sets_at_first(sets: Gensets, told: Mapping[str, Any]) -> Gensets:
    """Sets that begin as a plan says."""
    names = [str(name) for name in sets.id]
    if not names or not all(name in told for name in names):
        return sets
    litres = [told[name]["fuel_litres"] for name in names]
    hours = [told[name]["hours_before"] for name in names]
    return replace(
        sets, fuel_level_litres=np.minimum(litres, sets.tank_litres), on_before_h=np.array(hours)
    )


def _sessions(scenario: Scenario, stored: Plans) -> Sessions:
    """Sessions of past days, stays that plans tell of, and the scenario's sessions after them."""
    own = rows_of(scenario.sessions)
    told = max(t for t, plan in enumerate(stored) if plan is not None) + 1
    end = scenario.grid.start + told * scenario.grid.step
    past = [row for row in own if row["plug_out"] <= scenario.grid.start]
    return sessions_of(
        [*past, *_stays(scenario, stored), *(row for row in own if row["plug_in"] >= end)]
    )


def _stays(scenario: Scenario, stored: Plans) -> Iterator[dict[str, Any]]:
    """Each vehicle once for as long as plans tell of it, as a session.

    One that leaves early ends then; a vehicle with a new need begins a new session.
    """
    own = {(row["charger"], row["vehicle"]): row for row in rows_of(scenario.sessions)}
    unknown = {
        **dict.fromkeys(OF_SESSIONS, np.nan),
        "tier": scenario.tiers[-1],
        "weight": 1.0,
        "announced": True,
    }
    for charger in map(str, scenario.chargers.id):
        begun: Mapping[str, Any] | None = None
        row: dict[str, Any] = {}
        for time, plan in zip(scenario.grid.times, stored, strict=False):
            if not expected_by(plan):
                continue
            told = expected_by(plan).get("vehicles", {}).get(charger)
            if begun and told and all(told[one] == begun[one] for one in ("vehicle", "needed_kwh")):
                row["plug_out"] = pd.Timestamp(told["leaves"])
                continue
            if begun is not None:
                yield {**row, "plug_out": min(row["plug_out"], time)}
            begun = told
            if told is not None:
                row = _session(own.get((charger, told["vehicle"]), unknown), charger, time, told)
        if begun is not None:
            yield row


def _session(
    known: Mapping[str, Any], charger: str, time: pd.Timestamp, told: Mapping[str, Any]
) -> dict[str, Any]:
    """A vehicle that a plan tells of, with the capacity that is known of it, if any is."""
    row = {
        **known,
        "charger": charger,
        "vehicle": told["vehicle"],
        "plug_in": time,
        "plug_out": pd.Timestamp(told["leaves"]),
    }
    if np.isclose(row["soc_needed"] * row["capacity_kwh"], told["needed_kwh"]):
        return {**row, "soc_at_plug_in": told["energy_kwh"] / row["capacity_kwh"]}
    return {**row, **dict.fromkeys(OF_SESSIONS, np.nan), "energy_needed_kwh": told["needed_kwh"]}
