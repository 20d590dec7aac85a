"""Reconfiguration of a scenario: its loads at a step, and the scenario that has the result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InputError
from vppres.core.text import iso
from vppres.feeders.reconfiguration.loops import SwitchedNetwork
from vppres.feeders.reconfiguration.search import Configuration
from vppres.scenario.configuration import Branches
from vppres.scenario.faults import LineFault
from vppres.scenario.network import LINE_DEFAULTS, Network
from vppres.scenario.scenario import Scenario
from vppres.scenario.source import SourceDeviation
from vppres.scenario.switches import OF_THE_LINE, Switches


def step_of(scenario: Scenario, time: pd.Timestamp | None) -> int:
    """Step that holds a time, or the one of the largest demand.

    Raises
    ------
    InputError
        If the time lies outside the scenario.
    """
    if time is None:
        return int(scenario.load_kw.sum(axis=1).argmax())
    grid = scenario.grid
    step = int((time - grid.start) // grid.step)
    if not 0 <= step < grid.n_steps:
        raise InputError.of(
            "options",
            "lies outside the scenario's day",
            f"The day is {iso(grid.start)} to {iso(grid.end)}.",
            field="at",
            value=iso(time),
        )
    return step


def injection_at(scenario: Scenario, step: int) -> tuple[Floats, Floats]:
    """Net injection of every bus in kW and kvar, (N,) each: all customers, and all PV power.

    Batteries and other assets rest.
    """
    network, customers = scenario.network, scenario.customers
    drawn = network.place(customers.bus)
    given = network.place(scenario.pv.buses(customers))
    p_kw = given @ scenario.pv_kw[step] - drawn @ scenario.load_kw[step]
    return p_kw, -(drawn @ scenario.load_kvar[step])


def with_configuration(
    scenario: Scenario, feeder: SwitchedNetwork, best: Configuration
) -> Scenario:
    """Scenario with the switches of a configuration: its lines, and its table of switches.

    A line that is opened without having a switch gets one. Faults stay with their lines, which may
    feed their other ends now; an open line has no fault. The differences from the source's power
    flow are those of another configuration, and are left out.
    """
    network = scenario.network
    is_open = np.isin(np.arange(network.n_lines + feeder.n_loops), best.opened)
    kept, ties = ~is_open[: network.n_lines], feeder.ties.rows(~is_open[network.n_lines :])
    own: dict[str, Any] = {
        name: np.append(getattr(network, name)[kept], getattr(ties, name))
        for name in ("from_bus", "to_bus", *OF_THE_LINE)
    }
    own |= {
        name: np.append(getattr(network, name)[kept], np.full(len(ties), LINE_DEFAULTS[name]))
        for name in LINE_DEFAULTS
        if name not in own
    }
    changed = replace(network, **own)
    return replace(
        scenario,
        network=changed,
        faults=tuple(_faults_of(scenario, changed, kept)),
        switches=_moved(network, scenario.switches, ~kept, ties),
        source=replace(scenario.source, deviation=SourceDeviation()),
    )


def _faults_of(scenario: Scenario, changed: Network, kept: Flags) -> Iterator[LineFault]:
    """Faults of lines that are kept, each by the bus that its line feeds in the changed network."""
    old = scenario.network
    ends = zip(changed.from_bus, changed.to_bus, strict=True)
    fed = {frozenset(pair): pair[1] for pair in ends}
    for fault in scenario.faults:
        line = fault.at(old) - 1
        if fault.line is None:
            yield fault
        elif kept[line]:
            yield replace(fault, line=fed[frozenset((old.from_bus[line], old.to_bus[line]))])


def _moved(network: Network, switches: Switches, opened: Any, closed: Switches) -> Switches:
    """Switches after some lines were opened, and some ties closed."""
    standing = Branches(network, switches).switch[: network.n_lines].copy()
    without = np.flatnonzero(opened & (standing < 0))
    more = Switches(
        id=np.array(_new_names(network, without, {*map(str, switches.id)}), dtype=object),
        from_bus=network.from_bus[without],
        to_bus=network.to_bus[without],
        kind=np.full(len(without), "sectionaliser", dtype=object),
        closed=np.ones(len(without), dtype=bool),
    )
    values: dict[str, Any] = {
        f.name: np.concatenate([getattr(switches, f.name), getattr(more, f.name)])
        for f in fields(switches)
    }
    standing[without] = len(switches) + np.arange(len(without))
    moved = standing[opened]
    values["closed"][moved] = False
    for name in OF_THE_LINE:
        values[name][moved] = getattr(network, name)[opened]
    now_closed = np.isin(values["id"], closed.id)
    values["closed"][now_closed] = True
    for name, none in zip(OF_THE_LINE, (np.nan, np.nan, np.inf), strict=True):
        values[name][now_closed] = none
    return Switches(**values)


def _new_names(network: Network, lines: Any, known: set[str]) -> list[str]:
    """Names for switches of lines that have none, by their buses."""
    names = []
    for line in lines:
        name = ends = f"{network.from_bus[line]}-{network.to_bus[line]}"
        number = 1
        while name in known:
            number += 1
            name = f"{ends} ({number})"
        known.add(name)
        names.append(name)
    return names
