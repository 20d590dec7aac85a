"""A step in which lines are out: each part of the feeder settles by itself.

A part is the whole plant in which nothing outside of it is served, gives or takes. The part with
the grid goes on as with grid, each other one is an island of its own former, or blacked out.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vppres.contract.decision import Decision
from vppres.core.arrays import Flags
from vppres.physics.powerflow import ACPowerFlow, ACResult
from vppres.plant.collapse import realise
from vppres.plant.island import IslandPlant, PartOfPlant, Settled
from vppres.plant.plant import BatteryState, Plant, Realised
from vppres.scenario.faults import OutOfService, parts_by_bus
from vppres.scenario.formers import formers_within
from vppres.scenario.network import Network


class FlowOfPart(ACPowerFlow):
    """Power flow of a part: of the whole feeder, where nothing outside the part draws or gives.

    Parameters
    ----------
    network : Network
        The feeder.
    buses, lines : array of bool, shape (N,), (L,)
        Those of the part.
    """

    def __init__(self, network: Network, buses: Flags, lines: Flags) -> None:
        super().__init__(network.drawing_inside(buses, lines))
        self.buses = buses
        self.lines = lines

    def solve(self, p_kw: ArrayLike, q_kvar: ArrayLike, reference: int = 0) -> ACResult:
        """Power flow of the injections inside the part."""
        p, q = (np.where(self.buses, np.asarray(each, float), 0.0) for each in (p_kw, q_kvar))
        return super().solve(p, q, reference)


@dataclass(frozen=True, eq=False)
class SettledPart:
    """A part of the feeder and its step; flows and devices outside of it mean nothing."""

    inside: PartOfPlant
    lines: Flags
    done: Settled


class PlantInParts:
    """Plant of steps in which lines are out.

    Parameters
    ----------
    plant : Plant
        The actual day.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.network = plant.scenario.network
        self._flows: dict[tuple[bytes, bytes, bool], FlowOfPart] = {}

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

        Parameters
        ----------
        t : int
            The step.
        decision : Decision
            Set-points of all parts.
        state : BatteryState
            State before the step.
        out : OutOfService
            What is out, of which the first step counts.
        held : bool
            Whether the part with the grid's bus is an island too that holds itself.
        online : array of bool, shape (B,)
            Batteries that are able to work.
        """
        of_bus = parts_by_bus(self.network, out.lines[:1])[0]
        found = [
            self._settled(t, decision, state, out, of_bus == number, held, online)
            for number in np.unique(of_bus)
        ]
        return _joined(found)

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
        lines = buses[1:] & ~out.lines[0]
        inside = PartOfPlant.of(self.plant.places, buses)
        own = replace(decision, dispatch=self._of_part(t, decision, inside))
        if number == 0 and not held:
            flow = self._flow(buses, lines, bool(self.plant.scenario.outage[t]))
            return SettledPart(inside, lines, realise(self.plant, flow, t, own, state))
        flow = self._flow(buses, lines, island=True)
        planned = self.plant.apply(t, own, state)
        bus_out = self.network.buses[buses & out.buses[0]]
        if len(bus_out):
            done = IslandPlant(self.plant, flow, inside).dark(
                t, planned, state, f"bus {bus_out[0]} is out"
            )
            return SettledPart(inside, lines, done)
        where = f"behind {scenario.behind(number, t)}" if number else "at the grid's bus"
        island = IslandPlant(self.plant, flow, inside, where)
        island.formers = formers_within(scenario, inside.batteries) & online
        return SettledPart(inside, lines, island.settle(t, planned, state))

    def _of_part(self, t: int, decision: Decision, inside: PartOfPlant) -> Any:
        """The decision's dispatch without what is outside of a part."""
        plan, row = decision.dispatch, decision.row
        changed: dict[str, Any] = {}
        for name, which in (
            ("served", inside.customers),
            ("charge_kw", inside.batteries),
            ("discharge_kw", inside.batteries),
            ("batt_q_kvar", inside.batteries),
            ("pv_q_kvar", inside.pv),
        ):
            changed[name] = _in_row(getattr(plan, name), row, which, 0)
        pv_kw = self.plant.scenario.pv_kw[t]
        changed["pv_curtailed_kw"] = _in_row(plan.pv_curtailed_kw, row, inside.pv, pv_kw)
        for name in ("taken_kw", "running"):
            changed[name] = {
                kind: _in_row(values, row, inside.units[kind], 0)
                for kind, values in getattr(plan, name).items()
            }
        return replace(plan, **changed)

    def _flow(self, buses: Flags, lines: Flags, island: bool) -> FlowOfPart:
        """Power flow of a part, made once."""
        key = buses.tobytes(), lines.tobytes(), island
        if key not in self._flows:
            network = self.network.islanded if island else self.network
            self._flows[key] = FlowOfPart(network, buses, lines)
        return self._flows[key]


def _in_row(values: Any, row: int, inside: Flags, outside: Any) -> Any:
    """Values of all steps with others outside a part in one of them."""
    changed = np.array(values)
    changed[row] = np.where(inside, changed[row], outside)
    return changed


def _joined(parts: list[SettledPart]) -> Settled:
    """The step of the whole feeder."""
    first = parts[0].done
    others = [part.done for part in parts[1:]]
    every = [first, *others]
    realised = reduce(_with_part, parts[1:], _with_part(first.realised, parts[0]))
    dark = [done.dark_reason for done in every]
    reasons = np.full(len(realised.served), "", dtype=object)
    for part in parts:
        reasons[part.inside.customers] = part.done.dark_reason
    former = next((done.former for done in every if done.former), "")
    failed = [done.ac_failed for done in every if done.ac_failed]
    return Settled(
        realised,
        _joined_flow(parts),
        sum((done.mismatch_kw for done in others), start=first.mismatch_kw),
        np.any([part.done.shed & part.inside.customers for part in parts], axis=0),
        "; ".join(dict.fromkeys(dark)) if all(dark) else "",
        "; ".join(failed),
        sum(done.by_set_kw for done in every),
        former,
        reasons,
    )


def _with_part(so_far: Realised, part: SettledPart) -> Realised:
    """A step whose devices in a part did what they did there."""
    own, inside = part.done.realised, part.inside
    of_items = {
        "served": inside.customers,
        "load_kw": inside.customers,
        **dict.fromkeys(("pv_self_kw", "pv_export_kw", "pv_curtailed_kw", "pv_q_kvar"), inside.pv),
        **dict.fromkeys(("charge_kw", "discharge_kw", "batt_q_kvar", "soc_end"), inside.batteries),
        **dict.fromkeys(("p_injection_kw", "q_injection_kvar"), inside.buses),
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
        forming=so_far.forming or own.forming,
    )


def _joined_flow(parts: list[SettledPart]) -> ACResult:
    """Voltages and flows of all parts; NaN and 0 in dark ones, and over lines that are out."""
    first = parts[0].done.ac
    at_buses = {"v_pu", "v_node_pu"}
    at_lines = {"p_from_kw", "q_from_kvar", "p_to_kw", "q_to_kvar"}
    values: dict[str, Any] = {}
    for f in fields(first):
        if f.name not in at_buses | at_lines:
            continue
        on_lines = f.name in at_lines
        found = np.zeros_like(getattr(first, f.name))
        for part in parts:
            which = part.lines if on_lines else part.inside.buses
            found[which] = getattr(part.done.ac, f.name)[which]
        values[f.name] = found
    return replace(
        first,
        **values,
        losses_kw=sum(part.done.ac.losses_kw for part in parts),
        converged=all(part.done.ac.converged for part in parts),
    )
