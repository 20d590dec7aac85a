"""Readings and set-points of chargers and their vehicles in the service."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from vppres.control.guard.reckoning import SOC_JUMP
from vppres.core.arrays import Flags, Floats
from vppres.kinds.vehicles import NO_CAR, OF_SESSIONS, Chargers, Sessions
from vppres.kinds.vehicles.live import HELD, QUANTITIES, rows_of, sessions_of
from vppres.kinds.vehicles.physics import Garage, stored_by
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import Plan, Plans, expected_by, left_of, said_of
from vppres.service.of_kind import OfKind, Reckoned, Stored, Wrong, beyond_rating, moved
from vppres.service.payloads import OperatorSetpoint
from vppres.service.storage.records import Reading, moment, seconds

HOUR = pd.Timedelta(hours=1)


class ChargingPoints(OfKind):
    """Chargers and the vehicles at them."""

    kind = "chargers"
    source = "chargers"
    direction = "charging_positive"
    states: ClassVar[Mapping[str, float]] = {"plugged": 0.0}
    of_visits = (*HELD, "departure")
    told_once = ("plugged", "energy_needed_kwh", "departure")

    def readings(self, stored: Stored) -> dict[str, Any]:
        """Readings of chargers about their vehicles, by quantity.

        The controller knows the readings before it decided last. What came since counts however
        short it holds: a vehicle is plugged in once, and says once what it needs. One that left
        during its session is not back until its charger says so.
        """
        told: dict[str, Any] = {}
        for name in QUANTITIES:
            newest = stored.readings.newest(name).items()
            since = {k: one.value for k, one in newest if moment(one.time) >= stored.decided_at}
            holding = {} if name == "energy_needed_kwh" else stored.readings.holding(name)
            told[name] = holding | since
        sessions = stored.scenario.sessions
        for name, last in stored.readings.newest("plugged").items():
            at = moment(last.time)
            stays = (sessions.charger == name) & (sessions.plug_in <= at) & (at < sessions.plug_out)
            if last.value == 0.0 and stays.any():
                told["plugged"][name] = 0.0
        leaves = told["departure"].items()
        told["departure"] = {one: moment(int(value)) for one, value in leaves}
        return {name: values or None for name, values in (told | _ordered_kw(stored)).items()}

    def of_those_here(self, readings: list[Reading]) -> list[Reading]:
        """Readings without those of vehicles that have left since."""
        gone = (one for one in readings if one.quantity == "plugged" and one.value == 0.0)
        left = {one.asset: one.time for one in gone}
        return [
            one
            for one in readings
            if one.quantity not in self.of_visits or one.time > left.get(one.asset, -math.inf)
        ]

    def stood(
        self, plan: Plan, one: Reading, before: Reading | None, rejected: Mapping[str, int]
    ) -> float:
        """A vehicle that the plan knows was plugged in; what charging changes is no news."""
        if not (before and before.known):
            here = float(one.asset in expected_by(plan).get("vehicles", {}))
            return here if one.quantity == "plugged" else math.nan
        return one.value if one.quantity in HELD else before.value

    def asked(self, said: Mapping[str, Any]) -> dict[str, Any]:
        """A charger takes what its limit lets it."""
        return {"p_kw": said["p_limit_kw"]}

    def impossible(self, said: OperatorSetpoint, units: Chargers, i: int) -> Iterator[Wrong]:
        """A limit beyond the charger's power."""
        if said.p_limit_kw is not None:
            yield from beyond_rating("p_limit_kw", said.p_limit_kw, units.p_charge_kw[i], "kW")

    def action(self, setpoint: Mapping[str, Any]) -> str:
        """Whether it charges or discharges."""
        return moved(setpoint)

    def told_by_plans(self, scenario: Scenario, stored: Plans) -> Scenario:
        """Vehicles as stored plans tell of them."""
        if not any(expected_by(plan).get("vehicles", {}) for plan in stored):
            return scenario
        return replace(scenario, sessions=_sessions(scenario, stored))

    def state(self, scenario: Scenario, t: int, plan: Plan, reckoned: Floats) -> Floats:
        """Energy of the vehicles that a step was decided on."""
        return said_of(plan, "vehicles", scenario.chargers.id, reckoned, "energy_kwh")

    def reckoned(self, scenario: Scenario, plan: Plan) -> Iterator[tuple[str, str, Reckoned]]:
        """Charge of vehicles: a share of their capacity, or the energy that they need.

        Many take less than they are offered: what a charger gives in half a step is no news.
        """
        told, points = expected_by(plan).get("vehicles", {}), plan.get("setpoints", ())
        told_kw = {one["asset"]: one["p_kw"] for one in points if one["kind"] == self.kind}
        chargers = scenario.chargers
        power_kw = np.array([told_kw.get(str(name), 0.0) for name in chargers.id], dtype=float)
        left_h = left_of(plan, scenario.grid.step) / HOUR
        gains_kwh = stored_by(chargers, power_kw) * left_h
        known = {(row["charger"], row["vehicle"]): row for row in rows_of(scenario.sessions)}
        slacks_kwh = chargers.p_charge_kw * scenario.grid.dt_h / 2.0
        for name, gain_kwh, slack_kwh in zip(chargers.id, gains_kwh, slacks_kwh, strict=True):
            if not (one := told.get(str(name))):
                continue
            begin_kwh, needed_kwh = one["energy_kwh"], one["needed_kwh"]
            row = known.get((str(name), one["vehicle"]))
            if row and _by_charge(row, one):
                full_kwh = row["capacity_kwh"]
                shares = begin_kwh / full_kwh, (begin_kwh + gain_kwh) / full_kwh
                slack = max(SOC_JUMP, slack_kwh / full_kwh)
                yield str(name), "ev_soc", Reckoned(*shares, 0.0, 1.0, slack)
            else:
                begin_kwh = needed_kwh - begin_kwh
                needs_kwh = begin_kwh, max(begin_kwh - gain_kwh, 0.0)
                slack = max(SOC_JUMP * needed_kwh, slack_kwh)
                yield str(name), "energy_needed_kwh", Reckoned(*needs_kwh, 0.0, math.inf, slack)

    def measured(
        self, scenario: Scenario, units: Garage, t: int
    ) -> Iterator[tuple[str, str, float]]:
        """Vehicles, when they leave, and their state of charge or the energy that they need."""
        sessions, held_kwh = scenario.sessions, units.at(t)
        for k, name in enumerate(map(str, scenario.chargers.id)):
            s = int(scenario.session_at[t, k])
            yield "plugged", name, float(s != NO_CAR)
            if s == NO_CAR:
                continue
            yield "departure", name, float(seconds(sessions.plug_out[s]))
            if sessions.by_energy[s]:
                yield "energy_needed_kwh", name, max(sessions.needed_kwh[s] - held_kwh[k], 0.0)
            else:
                yield "ev_soc", name, held_kwh[k] / sessions.full_kwh[s]

    def powers(self, t: int, units: Garage, asked: Mapping[str, Floats], served: Flags) -> Floats:
        """Set-points of chargers."""
        return np.nan_to_num(asked["p_kw"])


def _ordered_kw(stored: Stored) -> dict[str, dict[str, float]]:
    """Mean power that chargers were ordered since the controller decided, where others were."""
    found = stored.ordered("chargers", "p_kw")
    if found is None or found[0] >= stored.at:
        return {}
    begun, told = found
    means = {}
    for name, power_kw in told.items():
        ends = [*power_kw.index[1:], stored.at]
        hours = [(end - time) / HOUR for time, end in zip(power_kw.index, ends, strict=True)]
        energy_kwh = float(np.dot(power_kw.fillna(0.0), hours))
        means[name] = energy_kwh / ((stored.at - begun) / HOUR)
    return {"charger_ordered_kw": means}


def _sessions(scenario: Scenario, stored: Plans) -> Sessions:
    """Sessions of past days, stays that plans tell of, and the scenario's sessions after them."""
    own = rows_of(scenario.sessions)
    told = max(t for t, plan in enumerate(stored) if plan) + 1
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
    if _by_charge(row, told):
        return {**row, "soc_at_plug_in": told["energy_kwh"] / row["capacity_kwh"]}
    return {**row, **dict.fromkeys(OF_SESSIONS, np.nan), "energy_needed_kwh": told["needed_kwh"]}


def _by_charge(row: Mapping[str, Any], told: Mapping[str, Any]) -> bool:
    """Whether a plan knows a vehicle by its charge and capacity, not by the energy it needs."""
    return bool(np.isclose(row["soc_needed"] * row["capacity_kwh"], told["needed_kwh"]))


SERVICE = ChargingPoints()
