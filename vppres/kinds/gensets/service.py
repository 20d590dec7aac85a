"""Readings and set-points of generating sets in the service."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats
from vppres.kinds.gensets import Gensets, GensetState
from vppres.kinds.gensets.live import STILL_SHARE
from vppres.kinds.gensets.physics import Engines
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import Plan, expected_by
from vppres.service.of_kind import OfKind, Reckoned, Stored, Wrong
from vppres.service.payloads import OperatorSetpoint
from vppres.service.storage.records import DECIDED, Reading, moment, versions


class Sets(OfKind):
    """Generating sets."""

    kind = "gensets"
    source = "gensets"
    states: ClassVar[Mapping[str, float]] = {"start_fault": 0.0, "running": math.nan}

    def readings(self, stored: Stored) -> dict[str, Any]:
        """Readings of sets, and the orders of other senders than the controller.

        Whether one runs counts if it was read since its set-point. A fault counts however old
        it is, and a start that a device rejected is one; that there is none counts while it is
        fresh.
        """
        by_others = _ordered_by_others(stored.plans, stored.at)
        runs = stored.readings.newest("running")
        since = {name for name, one in runs.items() if moment(one.time) > stored.decided_at}
        running = {name: float(runs) for name, (runs, _) in by_others.items()}
        running |= {k: v for k, v in stored.readings.holding("running").items() if k in since}
        return super().readings(stored) | {
            "running": running or None,
            "genset_ordered_kw": {name: kw for name, (_, kw) in by_others.items()} or None,
            "start_fault": _faults(stored) or None,
        }

    def stood(
        self, plan: Plan, one: Reading, before: Reading | None, rejected: Mapping[str, int]
    ) -> float:
        """A start that was rejected since the last reading is a fault.

        A set that follows its set-point is no news.
        """
        if one.quantity == "running" and before:
            points = plan.get("setpoints", ())
            told = {at["asset"]: at["running"] for at in points if at["kind"] == self.kind}
            obeys = told.get(one.asset) == (one.value == 1.0)
            return one.value if obeys else super().stood(plan, one, before, rejected)
        at = rejected.get(one.asset)
        if at and not (before and before.time > at):
            return 1.0
        return super().stood(plan, one, before, rejected)

    def asked(self, said: Mapping[str, Any]) -> dict[str, Any]:
        """A set runs if it is to give power."""
        return {"running": said["p_kw"] > 0.0}

    def impossible(self, said: OperatorSetpoint, units: Gensets, i: int) -> Iterator[Wrong]:
        """A power at which it cannot run."""
        least_kw, most_kw = units.p_min_kw[i], units.p_max_kw[i]
        if said.p_kw and not least_kw <= said.p_kw <= most_kw:
            words = f"is not from {least_kw:g} to {most_kw:g} kW"
            yield "p_kw", said.p_kw, words, "Give a power that it can run at, or 0 to stop it."

    def action(self, setpoint: Mapping[str, Any]) -> str:
        """Whether it runs."""
        return "ran" if setpoint["running"] else ""

    def begun(self, units: Gensets, state: GensetState) -> Gensets:
        """Sets that begin with this fuel, and have run, or rested, for so long."""
        litres = np.clip(state.fuel_litres, 0.0, units.tank_litres)
        hours = np.where(state.on, state.hours, -state.hours)
        return replace(units, fuel_level_litres=litres, on_before_h=hours)

    def state(self, scenario: Scenario, t: int, plan: Plan, reckoned: GensetState) -> GensetState:
        """Sets that a step was decided on; plans count what is delivered at its beginning."""
        told = _told_of_all(scenario, plan)
        if told is None:
            return reckoned
        hours, power_kw, litres = (
            np.array([one[field] for one in told], dtype=float)
            for field in ("hours_before", "p_before_kw", "fuel_litres")
        )
        before = litres - scenario.refuelled_litres[t]
        return GensetState(hours > 0.0, np.abs(hours), power_kw, before)

    def out(self, plan: Plan) -> list[str]:
        """Sets that a plan does without."""
        return [name for name, one in expected_by(plan).get("gensets", {}).items() if one["out"]]

    def reckoned(self, scenario: Scenario, plan: Plan) -> Iterator[tuple[str, str, Reckoned]]:
        """Fuel in the tanks."""
        told = expected_by(plan).get("gensets", {})
        for name, tank in zip(scenario.gensets.id, scenario.gensets.tank_litres, strict=True):
            if one := told.get(str(name)):
                litres = one["fuel_litres"], one["fuel_end_litres"]
                yield str(name), "fuel_litres", Reckoned(*litres, 0.0, tank, STILL_SHARE * tank)

    def formers(self, scenario: Scenario, plan: Plan) -> Iterator[tuple[str, str]]:
        """Sets that are named."""
        sets = scenario.gensets
        told = expected_by(plan).get("gensets", {})
        least_litres = sets.least_litres(scenario.grid.dt_h)
        for g in np.flatnonzero(sets.grid_forming):
            name = str(sets.id[g])
            litres = told.get(name, {}).get("fuel_litres")
            empty = litres is not None and litres < least_litres[g]
            yield name, "it has no fuel for a step" if empty else ""

    def able_kw(self, scenario: Scenario, recorded: Mapping[str, Any]) -> float:
        """Largest power of the sets that have fuel for the step."""
        sets = scenario.gensets
        fuelled = recorded["fuel_start_litres"] >= sets.least_litres(scenario.grid.dt_h)
        return float(sets.p_max_kw[fuelled].sum())

    def held_kwh(self, scenario: Scenario, plan: Plan) -> tuple[float, float]:
        """Energy of full tanks and of what is in them, at full power, of sets that start."""
        sets = scenario.gensets
        told = expected_by(plan).get("gensets", {})
        per_kwh = sets.litres_per_kwh + sets.litres_per_h_idle / sets.p_max_kw
        full_kwh = left_kwh = 0.0
        for g, name in enumerate(map(str, sets.id)):
            if name in told and not told[name]["out"]:
                full_kwh += float(sets.tank_litres[g] / per_kwh[g])
                left_kwh += float(told[name]["fuel_litres"] / per_kwh[g])
        return full_kwh, left_kwh

    def measured(
        self, scenario: Scenario, units: Engines, t: int
    ) -> Iterator[tuple[str, str, float]]:
        """Whether sets run, what is in their tanks, and that none failed to start."""
        on, litres = units.state.on, units.tank_litres(t)
        for g, name in enumerate(map(str, scenario.gensets.id)):
            yield "running", name, float(on[g])
            yield "fuel_litres", name, float(litres[g])
            yield "start_fault", name, 0.0

    def powers(self, t: int, units: Engines, asked: Mapping[str, Floats], served: Flags) -> Floats:
        """Set-points of sets, negative as power that is given."""
        return -np.nan_to_num(asked["p_kw"])


def _told_of_all(scenario: Scenario, plan: Plan) -> list[Mapping[str, Any]] | None:
    """Values of a plan for each set; None unless it has them for all."""
    told = expected_by(plan).get("gensets", {})
    names = [str(name) for name in scenario.gensets.id]
    return [told[name] for name in names] if names and all(n in told for n in names) else None


def _faults(stored: Stored) -> dict[str, float]:
    """Sets that failed to start, 1, and those that say that they did not, 0.

    One that was read to run since has started.
    """
    fault = stored.readings.newest("start_fault")
    runs = stored.readings.newest("running")
    ran = {name: one.time for name, one in runs.items() if one.value == 1.0}
    faults = {
        k: value for k, value in stored.readings.holding("start_fault").items() if value == 0.0
    }
    failed = {name: one.time for name, one in fault.items() if one.value == 1.0}
    names = {str(name) for name in stored.scenario.gensets.id}
    for name, at in stored.store.refusing("gensets").items():
        if name in names and not (name in fault and fault[name].time > at):
            failed[name] = at
    return faults | {name: 1.0 for name, at in failed.items() if ran.get(name, -math.inf) < at}


def _ordered_by_others(
    plans: Sequence[Mapping[str, Any]], now: pd.Timestamp
) -> dict[str, tuple[bool, float]]:
    """Whether sets are to run now and the most that they were to give since.

    Nothing where the controller decided all of it.
    """
    said = [one for plan in plans for one in versions(plan)]
    if all(one["status"] in DECIDED for one in said):
        return {}
    found: dict[str, tuple[bool, float]] = {}
    for one in said:
        for point in one["setpoints"]:
            if point["kind"] == "gensets":
                over = now > pd.Timestamp(point["valid_until"])
                runs = bool((point["default"] if over else point)["running"])
                most_kw = max(float(point["p_kw"]), found.get(point["asset"], (False, 0.0))[1])
                found[point["asset"]] = (runs, most_kw)
    return found


SERVICE = Sets()
