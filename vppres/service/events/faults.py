"""Faults of lines and buses: from events to what plans know, and from plans to what was known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import InputError
from vppres.io.messages import did_you_mean
from vppres.scenario.configuration import Branches, forest, in_configuration, out_of_branches
from vppres.scenario.faults import LineFault, OutOfService, parts_by_bus
from vppres.scenario.network import BusId, Network
from vppres.scenario.scenario import Scenario
from vppres.service import payloads
from vppres.service.as_told import closed_by
from vppres.service.clock import written
from vppres.service.events.announced import OPEN
from vppres.service.storage.records import Event

FAULTS = "faults"
"""What a plan says of faults, of now and later."""


def check_fault(said: payloads.Event, scenario: Scenario) -> None:
    """Refuse a fault of what is not there.

    Raises
    ------
    InputError
        For a line or bus that the feeder has not, and the grid's.
    """
    if not isinstance(said, payloads.Fault):
        return
    field = "bus" if said.line is None else "line"
    name = getattr(said, field)
    network = scenario.network
    known = _buses(network)
    if name == str(network.buses[0]):
        cure = "Put an event outage, or give another bus."
        raise InputError.of("event", "is the bus of the grid", cure, field=field, value=name)
    if name not in known:
        message = "is not a bus of the feeder"
        cure = _by_its_line(name, Branches.of(scenario)) if field == "line" else ""
        cure = cure or did_you_mean(name, known, "Give the bus that the line feeds.")
        raise InputError.of("event", message, cure, field=field, value=name)


def _by_its_line(name: str, branches: Branches) -> str:
    """How a line is given that is called by both of its buses, or by its switch; empty for none."""
    network = branches.network
    ends = zip(network.from_bus, network.to_bus, strict=True)
    for line, (a, b) in enumerate(ends):
        if name.removeprefix("line ") in (f"{a}-{b}", f"{b}-{a}", branches.names[line]):
            return f"Give {network.to_bus[line]}: a line is named by the bus that it feeds."
    if name in branches.names:
        return "Send closed, 0, of it as telemetry: a tie has no fault of its own."
    return ""


def faults_at(
    events: Iterable[Event], scenario: Scenario, now: pd.Timestamp
) -> tuple[LineFault, ...]:
    """Faults of a site that are not over, the scenario's own and those of events."""
    said = (event.said for event in events)
    told = (_said(one, scenario.network) for one in said if isinstance(one, payloads.Fault))
    return tuple(one for one in (*scenario.faults, *told) if one.end > now)


def told(
    faults: Iterable[LineFault], network: Network, step: pd.Timedelta, now: pd.Timestamp
) -> list[dict[str, Any]]:
    """Faults in the words of a plan; ``out`` says whether its step is without the line or bus."""
    return [
        {
            "name": one.name(network),
            "line": None if one.line is None else str(one.line),
            "bus": None if one.bus is None else str(one.bus),
            "start": written(one.start),
            "end": None if one.end >= OPEN else written(one.end),
            "out": one.start < now + step,
        }
        for one in faults
        if one.known or one.start < now + step
    ]


def faults_told(
    plans: Sequence[Mapping[str, Any]], network: Network, step: pd.Timedelta
) -> tuple[LineFault, ...]:
    """Faults as plans knew them in their steps; those of the last one up to their ends."""
    last = len(plans) - 1
    found: dict[str, list[LineFault]] = {}
    said = (_of_plan(plan, network, step, k == last) for k, plan in enumerate(plans))
    for fault in chain.from_iterable(said):
        same = found.setdefault(fault.name(network), [])
        if same and same[-1].end >= fault.start:
            same[-1] = replace(same[-1], end=max(fault.end, same[-1].end))
        else:
            same.append(fault)
    return tuple(chain.from_iterable(found.values()))


def behind_faults(
    plan: Mapping[str, Any], scenario: Scenario, now: pd.Timestamp
) -> list[tuple[Mapping[str, Any], set[str]]]:
    """Faults of now as a plan knows them, each with the customers behind it."""
    network = scenario.network
    known = [(one, _told_fault(one, network)) for one in plan.get(FAULTS, ())]
    standing = [(one, fault) for one, fault in known if one["out"] and now < fault.end]
    if not standing:
        return []
    branches = Branches.of(scenario)
    day = in_configuration(scenario, branches, closed_by(plan, branches))
    step = replace(scenario.grid, start=now, n_steps=1)
    out = OutOfService.of((fault for _, fault in standing), network, step, range(1))
    tree = day.scenario.network
    at = [tree.bus_index[bus] for bus in scenario.customers.bus]
    parts = parts_by_bus(tree, day.out_of(out).lines)[0][at]
    names = np.array([str(name) for name in scenario.customers.id])
    found = []
    for one, fault in standing:
        own = OutOfService.of([fault], network, step, range(1))
        lines = day.lines[out_of_branches(own, branches.ends)[0]]
        found.append((one, {*names[np.isin(parts, lines[lines >= 0] + 1)].tolist()}))
    return found


def behind_open(plan: Mapping[str, Any], scenario: Scenario) -> set[str]:
    """Customers that open switches of a plan cut off the grid."""
    branches = Branches.of(scenario)
    net = scenario.network
    closed = np.flatnonzero(closed_by(plan, branches))
    _, block = forest(branches.ends, closed, net.n_buses)
    at = np.array([net.bus_index[bus] for bus in scenario.customers.bus], dtype=int)
    return {str(name) for name in scenario.customers.id[block[at] != 0]}


def _of_plan(
    plan: Mapping[str, Any], network: Network, step: pd.Timedelta, on: bool
) -> Iterator[LineFault]:
    """Faults of a plan, cut to its step if it is not the last one."""
    begin = pd.Timestamp(plan["start"])
    for one in plan.get(FAULTS, ()):
        fault = _told_fault(one, network)
        start, end = max(fault.start, begin), fault.end if on else min(fault.end, begin + step)
        if start < end:
            yield replace(fault, start=start, end=end)


def _told_fault(one: Mapping[str, Any], network: Network) -> LineFault:
    """A fault in the words of a plan as that of a feeder's line or bus."""
    end = OPEN if one["end"] is None else pd.Timestamp(one["end"])
    return _fault(pd.Timestamp(one["start"]), end, one["line"], one["bus"], network)


def _said(said: payloads.Fault, network: Network) -> LineFault:
    """An event as the fault of a feeder's line or bus."""
    start, end = (at.tz_convert("UTC") for at in (said.start, said.end or OPEN))
    return _fault(start, end, said.line, said.bus, network)


def _fault(
    start: pd.Timestamp, end: pd.Timestamp, line: str | None, bus: str | None, network: Network
) -> LineFault:
    """The fault of a line or bus by its name."""
    known = _buses(network)
    return LineFault(start, end, line and known[line], bus and known[bus])


def _buses(network: Network) -> dict[str, BusId]:
    """Buses behind the grid's, by their names."""
    return {str(bus): bus for bus in network.buses[1:].tolist()}
