"""Connections of the assets of a new phased scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from vppres.core.errors import InputError
from vppres.feeders.feeder import PhasedSource
from vppres.feeders.net.names import name_in
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.earthing import floating
from vppres.scenario.network import Network
from vppres.scenario.phases import LINES, PHASES, PhaseConnection, Phases

LOAD, STORAGE = "load", "storage"


def customer_of(name: str) -> str:
    """Identifier of the customer that a load of a phased source is."""
    return f"c{name}"


def battery_of(name: str) -> str:
    """Identifier of a battery that a phased source has."""
    return f"b{name}"


def loads_of(source: PhasedSource, count: int) -> pd.DataFrame:
    """Loads of a phased source one by one: id, bus, active and reactive power, tier.

    ``attrs["of_load"]`` has no row for any of the ``count`` loads of the tree.
    """
    loads = [load for load in source.loads if load.kind == LOAD and load.p_kw > 0]
    table = {
        "id": [customer_of(load.connection.id) for load in loads],
        "bus": [load.bus for load in loads],
        "p_kw": [load.p_kw for load in loads],
        "q_kvar": [load.q_kvar for load in loads],
        "tier": [load.tier for load in loads],
    }
    found = pd.DataFrame(table).astype({"id": object, "bus": object, "tier": object})
    found.attrs["of_load"] = np.full(count, -1, dtype=int)
    return found


def generator_in(source: PhasedSource, label: str) -> PhaseConnection | None:
    """Connection of a generator of a source by its label there; None where it has no single one."""
    rows = {
        load.connection.id: load.connection
        for load in source.loads
        if load.kind not in (LOAD, STORAGE)
    }
    element = label.partition(" (")[0].replace(" ", "")
    return rows.get(name_in(label)) or rows.get(element)


def connected(
    source: PhasedSource,
    name: str,
    customers: Customers,
    pv: PVSystems,
    batteries: Batteries,
    sets: Mapping[str, str],
) -> Phases:
    """The phases of a source with the connections of a scenario's assets.

    A customer is connected as its load, and so are PV system and battery behind its meter, at
    constant power; a battery with three phases has a coil to ground on each where there is ground.
    ``sets`` are labels of the source by the sets that are made of its generators.
    """
    engines = {name: generator_in(source, label) for name, label in sets.items()}
    loads = {customer_of(load.connection.id): load for load in source.loads if load.kind == LOAD}
    rows = [replace(loads[str(each)].connection, id=str(each)) for each in customers.id]
    for system, owner, bus in zip(pv.id, pv.customer, pv.buses(customers), strict=True):
        own = [
            each
            for each in source.loads
            if each.kind not in (LOAD, STORAGE)
            and each.bus == bus
            and each.connection not in engines.values()
        ]
        if own:
            if len({(load.connection.coils, load.connection.bus) for load in own}) > 1:
                raise InputError.of(
                    name,
                    f"has generators on different phases of bus {bus}",
                    "Leave them out with --pv none or --pv sized.",
                )
            rows.append(_constant(own[0].connection, system))
        else:
            rows.append(_constant(loads[str(owner)].connection, system))
    at_customer = {f"b{each[1:]}": loads[each].connection for each in map(str, customers.id)}
    at_customer |= {f"{key}_added": row for key, row in at_customer.items()}
    at_customer |= {
        battery_of(load.connection.id): load.connection
        for load in source.loads
        if load.kind == STORAGE
    }
    rows += [_of_battery(source.phases, at_customer[str(each)], each) for each in batteries.id]
    rows += [_constant(row, name) for name, row in engines.items() if row is not None]
    return replace(source.phases, connections=tuple(rows))


def _constant(row: PhaseConnection, asset: str) -> PhaseConnection:
    """Connection at constant power."""
    return PhaseConnection(str(asset), row.bus, row.coils, row.kv)


def _of_battery(phases: Phases, row: PhaseConnection, asset: str) -> PhaseConnection:
    """The connection of a battery: three phases to ground where there are three and ground."""
    bus = phases.by_bus[row.bus]
    if not row.three_coils or bus.limits == LINES:
        return _constant(row, asset)
    return PhaseConnection(str(asset), row.bus, " ".join(PHASES), bus.kv / np.sqrt(3))


def with_former(phases: Phases, customers: Customers, batteries: Batteries) -> Batteries:
    """The batteries with one of three phases to form an island, if there is one.

    It is the largest of those in whose islands the fewest customers have a voltage to ground that
    nothing holds.
    """
    anyone = replace(batteries, grid_forming=np.ones(len(batteries), dtype=bool))
    able = np.flatnonzero(phases.formers(anyone))
    if not len(able):
        return batteries
    names = [str(name) for name in customers.id]
    left = {i: len(floating(phases, str(batteries.id[i]), names)) for i in able}
    former = min(able, key=lambda i: (left[i], -batteries.s_max_kva[i]))
    return replace(batteries, grid_forming=np.arange(len(batteries)) == former)


def shunts_in_islands(phases: Phases, network: Network) -> Phases:
    """The phases without the shunts in islands that the network has not there either."""
    at = {row.bus: network.bus_index[row.at] for row in phases.buses}
    shunts = tuple(
        replace(row, island="yes" if network.island[at[row.bus]] else "no") for row in phases.shunts
    )
    return replace(phases, shunts=shunts)
