"""A step in which lines are out: each part of the feeder settles by itself.

A part is the whole plant in which nothing outside of it is served, gives or takes. The part with
the grid goes on as with grid, each other one is an island of its own former, or blacked out.
"""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Wholes
from vppres.physics.feeder import PowerFlow, flow_of_part
from vppres.physics.phased_sources import measured_at
from vppres.physics.powerflow import ACResult
from vppres.plant.collapse import realise
from vppres.plant.island import IslandPlant, PartOfPlant, Settled
from vppres.plant.plant import BatteryState, Plant
from vppres.scenario.faults import OutOfService, parts_by_bus
from vppres.scenario.formers import formers_within

SettledPart = tuple[PartOfPlant, Settled]
"""A part of the feeder and its step; flows and devices outside of it mean nothing."""


class PlantInParts:
    """Plant of steps in which lines are out."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.network = plant.scenario.network
        phases = plant.scenario.phases
        every = np.arange(self.network.n_buses)
        self._bus_of_node = measured_at(phases, self.network) if phases else every
        self._flows: dict[tuple[bytes, bytes, bool], PowerFlow] = {}

    def settle(
        self,
        t: int,
        decision: Decision,
        state: BatteryState,
        out: OutOfService,
        held: bool,
        online: Flags,
    ) -> Settled:
        """Outcome of a decision, part by part.

        The first step of ``out`` counts. With ``held`` the part with the grid's bus is an island
        too that holds itself.
        """
        of_bus = parts_by_bus(self.network, out.lines[:1])[0]
        found = [
            self._settled(t, decision, state, out, of_bus == number, held, online)
            for number in np.unique(of_bus)
        ]
        return _joined(found, self._bus_of_node)

    def _settled(
        self,
        t: int,
        decision: Decision,
        state: BatteryState,
        out: OutOfService,
        buses: Flags,
        held: bool,
        online: Flags,
    ) -> SettledPart:
        """The part of some buses."""
        scenario = self.plant.scenario
        number = int(np.argmax(buses))
        inside = PartOfPlant.of(self.plant.places, buses, buses[1:] & ~out.lines[0])
        own = Decision(self._of_part(t, decision.step, inside))
        if number == 0 and not held:
            flow = self._flow(inside, bool(self.plant.scenario.outage[t]))
            return inside, realise(self.plant, flow, t, own, state)
        flow = self._flow(inside, island=True)
        planned = self.plant.apply(t, own, state)
        bus_out = self.network.buses[buses & out.buses[0]]
        if len(bus_out):
            island = IslandPlant(self.plant, flow, inside)
            return inside, island.dark(t, planned, state, f"bus {bus_out[0]} is out")
        where = f"behind {scenario.behind(number, t)}" if number else "at the grid's bus"
        island = IslandPlant(self.plant, flow, inside, where)
        island.formers = formers_within(scenario, inside.batteries) & online
        return inside, island.settle(t, planned, state)

    def _of_part(self, t: int, step: Dispatch, inside: PartOfPlant) -> Dispatch:
        """A planned step without what is outside of a part."""
        of_items = {
            "served": inside.customers,
            "pv_q_kvar": inside.pv,
            **dict.fromkeys(("charge_kw", "discharge_kw", "batt_q_kvar"), inside.batteries),
        }
        changed: dict[str, Any] = {
            name: _inside(which, getattr(step, name)) for name, which in of_items.items()
        }
        pv_kw = self.plant.scenario.pv_kw[t]
        changed["pv_curtailed_kw"] = np.where(inside.pv, step.pv_curtailed_kw, pv_kw)
        for name in ("taken_kw", "running"):
            changed[name] = {
                kind: _inside(inside.units[kind], values)
                for kind, values in getattr(step, name).items()
            }
        return replace(step, **changed)

    def _flow(self, part: PartOfPlant, island: bool) -> PowerFlow:
        """Power flow of a part, made once."""
        key = part.buses.tobytes(), part.lines.tobytes(), island
        if key not in self._flows:
            self._flows[key] = flow_of_part(self.plant.scenario, part.buses, part.lines, island)
        return self._flows[key]


def _inside(which: Flags, values: Any) -> Any:
    """Values of some items, and none of the others."""
    return np.where(which, values, np.zeros_like(values))


def _joined(parts: list[SettledPart], bus_of_node: Wholes) -> Settled:
    """The step of the whole feeder, whose voltages by phase are at these buses."""
    every = [done for _, done in parts]
    whole = reduce(_with_part, parts, every[0])
    dark = [done.dark_reason for done in every]
    reasons = np.full(len(whole.served), "", dtype=object)
    for inside, done in parts:
        reasons[inside.customers] = done.dark_reason
    formed = [done for done in every if done.former]
    failed = [done.ac_failed for done in every if done.ac_failed]
    return replace(
        whole,
        ac=_joined_flow(parts, bus_of_node),
        mismatch_kw=sum((done.mismatch_kw for done in every[1:]), start=every[0].mismatch_kw),
        shed=np.any([done.shed & inside.customers for inside, done in parts], axis=0),
        dark_reason="; ".join(dict.fromkeys(dark)) if all(dark) else "",
        ac_failed="; ".join(failed),
        by_set_kw=sum(done.by_set_kw for done in every),
        former=formed[0].former if formed else "",
        off=reasons,
        former_kva=formed[0].ac.source_kva if formed else None,
    )


def _with_part(so_far: Settled, part: SettledPart) -> Settled:
    """A step whose devices in a part did what they did there."""
    inside, own = part
    of_items = {
        "served": inside.customers,
        "load_kw": inside.customers,
        **dict.fromkeys(("pv_self_kw", "pv_export_kw", "pv_curtailed_kw", "pv_q_kvar"), inside.pv),
        **dict.fromkeys(("battery_kw", "batt_q_kvar", "soc_end"), inside.batteries),
        **dict.fromkeys(("p_injection_kw", "q_injection_kvar"), inside.places),
    }
    changed: dict[str, Any] = {
        name: np.where(which, getattr(own, name), getattr(so_far, name))
        for name, which in of_items.items()
    }
    shares = [np.broadcast_to(each.share, so_far.served.shape) for each in (own, so_far)]
    for name in ("taken_kw", "running"):
        mine, theirs = getattr(own, name), getattr(so_far, name)
        changed[name] = {k: np.where(inside.units[k], mine[k], theirs[k]) for k in theirs}
    return replace(
        so_far,
        **changed,
        share=np.where(inside.customers, *shares),
        clipped_kw=max(own.clipped_kw, so_far.clipped_kw),
        forming=tuple(dict.fromkeys((*so_far.forming, *own.forming))),
    )


def _joined_flow(parts: list[SettledPart], bus_of_node: Wholes) -> ACResult:
    """Voltages and flows of all parts; NaN and 0 in dark ones, and over lines that are out."""
    flows = [done.ac for _, done in parts]
    first = flows[0]
    of_buses = [inside.buses for inside, _ in parts]
    of_nodes = [buses[bus_of_node] for buses in of_buses]
    of_lines = [inside.lines for inside, _ in parts]
    places = {"v_pu": of_buses, "v_node_pu": of_nodes}
    places |= {name: of_lines for name in ("p_from_kw", "q_from_kvar", "p_to_kw", "q_to_kvar")}
    values: dict[str, Any] = {}
    for name, of_parts in places.items():
        found = np.zeros_like(getattr(first, name))
        for ac, which in zip(flows, of_parts, strict=True):
            found[which] = getattr(ac, name)[which]
        values[name] = found
    lit = [ac for ac in flows if np.isfinite(ac.loading)]
    if first.phases:
        labels = np.array([ac.nodes for ac in flows], dtype=object)
        of_part = np.argmax(of_nodes, axis=0)
        own = labels[of_part, np.arange(len(of_part))].tolist()
        values["nodes"] = tuple((bus, phase) for bus, phase in own)
        unbalance = np.array([ac.unbalance for ac in flows])
        values["unbalance"] = float(np.fmax.reduce(unbalance))
    if lit:
        fullest = max(lit, key=lambda ac: ac.loading)
        values |= {"loading": fullest.loading, "loading_at": fullest.loading_at}
    return replace(
        first,
        **values,
        losses_kw=sum(ac.losses_kw for ac in flows),
        converged=all(ac.converged for ac in flows),
    )
