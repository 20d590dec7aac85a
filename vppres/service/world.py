"""A scenario's day as its devices live it: what they measure, and what comes of their set-points.

Behind it stands the plant, with the true demand, sun and grid; it knows nothing of a service.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats
from vppres.day.options import RunOptions
from vppres.day.recorder import StepRecord
from vppres.day.simulate import Day
from vppres.live.by_phase import GRID, ByPhase
from vppres.scenario.scenario import Scenario
from vppres.scenario.vehicles import NO_CAR
from vppres.service.clock import written
from vppres.service.phased_readings import phases_of
from vppres.service.plans import at
from vppres.service.records import seconds

Series = Mapping[str, Any]  # readings as ``POST /v1/telemetry`` takes them


class World:
    """The plant of a scenario, step after step.

    Parameters
    ----------
    scenario : Scenario
        What comes.
    options : RunOptions
        Of which the mode, the switching rules and heating say how the plant behaves.
    """

    def __init__(self, scenario: Scenario, options: RunOptions) -> None:
        self.scenario = scenario
        self.day = Day(scenario, options)
        self.records: list[StepRecord] = []
        self.start_fault = np.zeros(len(scenario.gensets), dtype=bool)

    def readings(self, t: int) -> list[Series]:
        """What devices measure at the beginning of a step, and of the one before, by source."""
        day = self.day
        now = self.scenario.grid.times[t]
        ids = {name: list(getattr(self.scenario, name).id) for name in KINDS}
        grid_on = float(self.scenario.grid_limit_kw[t] > 0.0)
        found = [
            *self._series("batteries", "soc", now, ids["batteries"], day.state.soc),
            *self._powers("meters", "load_kw", now, ids["customers"], self.scenario.load_kw[t]),
            *self._powers("meters", "pv_kw", now, ids["pv"], self.scenario.pv_kw[t]),
            *self._series("substation", "grid_on", now, [GRID], [grid_on]),
        ]
        rooms = list(self.scenario.thermal_loads.id)
        found += self._series("thermostats", "indoor_c", now, rooms, day.plant.climate.t_c)
        found += self._vehicles(t, now)
        sets = list(self.scenario.gensets.id)
        engines = day.plant.engines
        for quantity, values in (
            ("running", engines.state.on),
            ("fuel_litres", engines.tank_litres(t)),
            ("start_fault", self.start_fault),
        ):
            found += self._series("gensets", quantity, now, sets, values)
        if t == 0:
            return found
        begun = self.scenario.grid.times[t - 1]
        if day.battery_kw is not None:
            found += self._powers(
                "batteries", "battery_kw", begun, ids["batteries"], day.battery_kw
            )
        if day.import_kw is not None:
            found += self._series("substation", "import_kw", begun, [GRID], [day.import_kw])
        if sets:
            given_kw = self.records[-1].kinds["gensets"]["p_kw"]
            found += self._series("gensets", "genset_kw", begun, sets, given_kw)
        by_phase = ByPhase.of(self.scenario, self.records[-1])
        if by_phase is not None:
            source = by_phase.source
            teller = "substation" if source == GRID else "batteries"
            for phase, kva in by_phase.source_kva.items():
                found += self._series(teller, "source_kva", begun, [source], [kva], str(phase))
            for (bus, phase), v_pu in zip(by_phase.nodes.index, by_phase.nodes, strict=True):
                found += self._series("meters", "v_pu", begun, [bus], [v_pu], phase)
        return found

    def _vehicles(self, t: int, now: pd.Timestamp) -> list[Series]:
        """What chargers tell of their vehicles: a state of charge, or the energy that they need."""
        sessions, garage = self.scenario.sessions, self.day.plant.garage
        found: list[Series] = []
        held_kwh = garage.held_kwh(t)
        for k, name in enumerate(self.scenario.chargers.id):
            s = int(self.scenario.session_at[t, k])
            told: dict[str, float] = {"plugged": float(s != NO_CAR)}
            if s != NO_CAR:
                told["departure"] = float(seconds(sessions.plug_out[s]))
                if sessions.by_energy[s]:
                    told["energy_needed_kwh"] = max(sessions.needed_kwh[s] - held_kwh[k], 0.0)
                else:
                    told["ev_soc"] = held_kwh[k] / sessions.full_kwh[s]
            for quantity, value in told.items():
                found += self._series("chargers", quantity, now, [name], [value])
        return found

    def _powers(
        self, source: str, quantity: str, time: pd.Timestamp, ids: list[Any], values: Any
    ) -> list[Series]:
        """Powers of assets, each phase by itself where there are several."""
        found: list[Series] = []
        for asset, value in zip(ids, values, strict=True):
            phases = phases_of(self.scenario, quantity, str(asset))
            for phase in phases or (None,):
                part = [value / max(len(phases), 1)]
                found += self._series(source, quantity, time, [asset], part, phase)
        return found

    def obey(self, t: int, setpoints: Iterable[Mapping[str, Any]]) -> StepRecord:
        """Carry out the last set-points for a step; what is over leaves its default."""
        middle = self.scenario.grid.times[t] + self._step / 2
        told = {(one["kind"], one["asset"]): at(one, middle) for one in setpoints}
        record = self.day.settle(t, Decision(self._dispatch(t, told)))
        self.records.append(record)
        return record

    @property
    def _step(self) -> pd.Timedelta:
        return self.scenario.grid.step

    def _series(
        self,
        source: str,
        quantity: str,
        time: pd.Timestamp,
        ids: list[Any],
        values: Any,
        phase: str | None = None,
    ) -> list[Series]:
        """One reading for each item."""
        resolution = f"PT{round(self.scenario.grid.step_minutes * 60)}S"
        return [
            {
                "source": source,
                "asset": str(asset),
                "quantity": quantity,
                **({} if phase is None else {"phase": phase}),
                "start": written(time),
                "resolution": resolution,
                "values": [float(value)],
            }
            for asset, value in zip(ids, values, strict=True)
        ]

    def _dispatch(self, t: int, told: Mapping[tuple[str, str], Mapping[str, Any]]) -> Dispatch:
        """Set-points of devices, as the plant reads them; a device without one does its default."""

        def values(kind: str, name: str, default: float) -> Floats:
            ids = getattr(self.scenario, kind).id
            row = [float(told.get((kind, str(i)), {}).get(name, default)) for i in ids]
            return np.array([row], dtype=np.float64)

        p_kw = values("batteries", "p_kw", 0.0)
        served = values("customers", "served", 1.0) > 0.0
        dims = self.scenario.customers.dimmable.any()
        pv_q_kvar = values("pv", "q_kvar", 0.0)
        asked_c = values("thermal_loads", "setpoint_c", np.nan)[0]
        setpoints_c = np.where(np.isnan(asked_c), self.scenario.thermal_loads.held_c, asked_c)
        machines_kw = self.day.plant.climate.thermostat_kw(t, setpoints_c, served[0])
        nothing = np.full((1, 1), np.nan)
        network = self.scenario.network
        return Dispatch(
            served=served,
            pv_self_kw=np.full_like(pv_q_kvar, np.nan),
            pv_export_kw=np.full_like(pv_q_kvar, np.nan),
            pv_curtailed_kw=values("pv", "curtailed_kw", 0.0),
            pv_q_kvar=pv_q_kvar,
            charge_kw=np.maximum(p_kw, 0.0),
            discharge_kw=np.maximum(-p_kw, 0.0),
            batt_q_kvar=values("batteries", "q_kvar", 0.0),
            soc=np.full((2, p_kw.shape[1]), np.nan),
            p_grid_kw=nothing[0],
            q_grid_kvar=nothing[0],
            v_pu=np.full((1, network.n_buses), np.nan),
            p_flow_kw=np.full((1, network.n_buses - 1), np.nan),
            q_flow_kvar=np.full((1, network.n_buses - 1), np.nan),
            share=served * values("customers", "share", 1.0) if dims else None,
            taken_kw={
                "chargers": values("chargers", "p_kw", 0.0),
                "thermal_loads": machines_kw[np.newaxis],
                "gensets": -values("gensets", "p_kw", 0.0),
            },
            running={"gensets": values("gensets", "running", 0.0) > 0.0},
        )


KINDS = ("customers", "batteries", "pv")


def critical_off(scenario: Scenario, record: StepRecord) -> Flags:
    """Which customers of the first tier were off in a step, (C,)."""
    first = np.asarray(scenario.customers.tier == scenario.tiers[0])
    off = ~np.asarray(record.customers["served"], dtype=bool)
    return np.asarray(first & off, dtype=bool)


def energy_allowed(scenario: Scenario, record: StepRecord) -> bool:
    """Whether a step's sun, stored energy and grid carry all customers of the first tier.

    A sum over the feeder, without network and losses, and without a thought for later steps.
    """
    b = scenario.batteries
    first = np.asarray(scenario.customers.tier == scenario.tiers[0])
    held_kwh = np.maximum(record.batteries["soc_start"] - b.soc_min, 0.0) * b.energy_kwh
    from_batteries_kw = np.minimum(b.p_max_kw, held_kwh * b.eta_discharge / scenario.grid.dt_h)
    there_kw = float(record.pv["available_kw"].sum() + from_batteries_kw.sum())
    there_kw += float(scenario.grid_limit_kw[record.t])
    if sets := record.kinds.get("gensets"):
        least_litres = scenario.gensets.least_litres(scenario.grid.dt_h)
        fuelled = sets["fuel_start_litres"] >= least_litres
        there_kw += float(scenario.gensets.p_max_kw[fuelled].sum())
    return there_kw >= float(record.customers["p_load_kw"][first].sum())
