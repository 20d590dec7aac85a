"""A scenario's day as its devices live it: what they measure, and what comes of their set-points.

Behind it stands the plant, with the true demand, sun and grid; it knows nothing of a service.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.decision import Decision, Switched
from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Names
from vppres.day.options import RunOptions
from vppres.day.recorder import StepRecord
from vppres.day.simulate import Day
from vppres.kinds.batteries.physics import BatteriesAhead
from vppres.live.by_phase import GRID, ByPhase
from vppres.scenario.formers import forming_kinds
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import Plan
from vppres.service.clock import written
from vppres.service.of_kind import every
from vppres.service.plans.document import at
from vppres.service.telemetry.phased_readings import SUMMED, phases_of

Series = Mapping[str, Any]  # readings as ``POST /v1/telemetry`` takes them


class World:
    """The plant of a scenario, step after step.

    Mode, switching rules and heating of the options say how it behaves.
    """

    def __init__(self, scenario: Scenario, options: RunOptions) -> None:
        self.scenario = scenario
        self.day = Day(scenario, options)
        self.records: list[StepRecord] = []
        of_kinds = every()
        self._kinds = {kind: of_kinds[kind] for kind in self.day.plant.units}

    def begin_as(self, plan: Plan, t: int) -> None:
        """Begin a step with the units of each kind as a plan knew them."""
        plant = self.day.plant
        plant.begin_with(
            {
                kind: of.state(self.scenario, t, plan, plant.units[kind].state)
                for kind, of in self._kinds.items()
            }
        )

    def readings(self, t: int) -> list[Series]:
        """Readings at the beginning of a step and over the one before, by source."""
        site, now = self.scenario, self.scenario.grid.times[t]
        found = [
            *self._each("batteries", "soc", now, site.batteries.id, self.day.state.soc),
            *self._each("meters", "load_kw", now, site.customers.id, site.load_kw[t]),
            *self._each("meters", "pv_kw", now, site.pv.id, site.pv_kw[t]),
            self._one("substation", "grid_on", now, GRID, site.grid_limit_kw[t] > 0.0),
            *(
                self._one(of.source, quantity, now, name, value)
                for kind, of in self._kinds.items()
                for quantity, name, value in of.measured(site, self.day.plant.units[kind], t)
            ),
        ]
        return found if t == 0 else [*found, *self._means(site.grid.times[t - 1])]

    def _means(self, begun: pd.Timestamp) -> Iterator[Series]:
        """Means that devices measure over the last step."""
        site, day, record = self.scenario, self.day, self.records[-1]
        if day.battery_kw is not None:
            names = site.batteries.id
            yield from self._each("batteries", "battery_kw", begun, names, day.battery_kw)
        if day.import_kw is not None:
            yield self._one("substation", "import_kw", begun, GRID, day.import_kw)
        for kind, of in self._kinds.items():
            for quantity in of.live.MEANS:
                ids = getattr(site, kind).id
                yield from self._each(of.source, quantity, begun, ids, record.kinds[kind]["p_kw"])
        if by_phase := ByPhase.of(site, record):
            source = by_phase.source
            teller = "substation" if source == GRID else "batteries"
            for kind, units in forming_kinds(self.scenario).items():
                teller = kind if source in units.id else teller
            for phase, kva in by_phase.source_kva.items():
                yield self._one(teller, "source_kva", begun, source, kva, str(phase))
            for (bus, phase), v_pu in zip(by_phase.nodes.index, by_phase.nodes, strict=True):
                yield self._one("meters", "v_pu", begun, bus, v_pu, phase)

    def _each(
        self, source: str, quantity: str, time: pd.Timestamp, ids: Names, values: Any
    ) -> Iterator[Series]:
        """A reading of each asset; of a power one for each phase where there are several."""
        for asset, value in zip(ids, values, strict=True):
            summed = quantity in SUMMED
            phases = phases_of(self.scenario, quantity, str(asset)) if summed else []
            for phase in phases or ("",):
                yield self._one(source, quantity, time, asset, value / max(len(phases), 1), phase)

    def _one(
        self,
        source: str,
        quantity: str,
        time: pd.Timestamp,
        asset: Any,
        value: Any,
        phase: str = "",
    ) -> Series:
        """One reading, for a step."""
        return {
            "source": source,
            "asset": str(asset),
            "quantity": quantity,
            **({"phase": phase} if phase else {}),
            "start": written(time),
            "resolution": f"PT{round(self.scenario.grid.step_minutes * 60)}S",
            "values": [float(value)],
        }

    def obey(
        self, t: int, setpoints: Iterable[Mapping[str, Any]], closed: Flags | None = None
    ) -> StepRecord:
        """Carry out the last set-points for a step; what is over leaves its default.

        Lines and ties that are ``closed``, (E,), are the scenario's if not given.
        """
        middle = self.scenario.grid.times[t] + self.scenario.grid.step / 2
        told = {(one["kind"], one["asset"]): at(one, middle) for one in setpoints}
        switched = None if closed is None else Switched(closed)
        record = self.day.settle(t, Decision(self._dispatch(t, told), switched=switched))
        self.records.append(record)
        return record

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
                kind: of.powers(
                    t,
                    self.day.plant.units[kind],
                    {name: values(kind, name, np.nan)[0] for name in of.live.NUMBERS},
                    served[0],
                )[np.newaxis]
                for kind, of in self._kinds.items()
            },
            running={kind: values(kind, "running", 0.0) > 0.0 for kind in self._kinds},
        )


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
    soc = record.batteries["soc_start"]
    known = BatteriesAhead(b, soc, b.eta_charge, b.eta_discharge, scenario.grid.dt_h)
    there_kw = float(record.pv["available_kw"].sum() + known.most_kw()[1].sum())
    there_kw += float(scenario.grid_limit_kw[record.t])
    there_kw += sum(every()[kind].able_kw(scenario, row) for kind, row in record.kinds.items())
    return there_kw >= float(record.customers["p_load_kw"][first].sum())
