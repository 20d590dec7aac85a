"""The flows of a phased feeder from each of its sources: the grid, and what forms an island.

Its assets are customers, PV systems, batteries, and the units of each kind of flexible power, in
this order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vppres.core.arrays import Floats, Names, Wholes
from vppres.kinds.table import units_of
from vppres.physics.phases import PhasedFlow
from vppres.scenario.earthing import in_island
from vppres.scenario.formers import island_former
from vppres.scenario.network import Network
from vppres.scenario.phases import Phases

HELD = 0.75
"""Where the voltage of an island's former is at most between the lowest and the highest that keep
the limits at no load: demand lowers it by more than PV power raises it."""


def assets_of(site: Any) -> list[str]:
    """Names of all assets of a scenario or site."""
    tables = (site.customers, site.pv, site.batteries, *units_of(site).values())
    return [str(name) for table in tables for name in table.id]


def buses_of(site: Any) -> Names:
    """Bus of the network of each asset of a scenario or site."""
    customers = site.customers
    units = (each.buses(customers) for each in units_of(site).values())
    return np.concatenate([customers.bus, site.pv.buses(customers), site.batteries.bus, *units])


Labels = tuple[tuple[str, str], ...]
"""Bus and phase of each voltage with limits."""


def labels_by_source(site: Any) -> tuple[Labels, Labels]:
    """Voltages with limits, as many of both: with the grid, and in the island of the former.

    The site is a scenario or site with phases.
    """
    own = site.phases.measured
    former = island_former(site)
    return own, own if former is None else in_island(site.phases, former).measured


def measured_at(phases: Phases, network: Network) -> Wholes:
    """Place of the network's bus at which each voltage with limits is, (m,)."""
    buses = [phases.by_bus[bus].at for bus, _ in phases.measured]
    return np.array([network.bus_index[bus] for bus in buses], dtype=int)


def farthest(v_pu: Floats, at_bus: Wholes, n_buses: int) -> Floats:
    """Voltage of each bus that is farthest from 1 pu, (..., N) of (..., m).

    >>> farthest(np.array([[1.01, 0.98, 1.02]]), np.array([0, 0, 1]), 2)
    array([[0.98, 1.02]])
    """
    order = np.argsort(np.abs(v_pu - 1.0), axis=-1)
    found = np.ones((*v_pu.shape[:-1], n_buses))
    np.put_along_axis(found, at_bus[order], np.take_along_axis(v_pu, order, axis=-1), axis=-1)
    return found


def drawn_uncontrolled(
    load_kw: Floats, load_kvar: Floats, pv_kw: Floats, n_assets: int
) -> tuple[Floats, Floats]:
    """Powers that assets draw without control: all customers, all PV power, the rest idle.

    >>> drawn_uncontrolled(np.array([3.0]), np.array([1.0]), np.array([2.0]), n_assets=3)
    (array([ 3., -2.,  0.]), array([1., 0., 0.]))
    """
    idle = np.zeros(n_assets - len(load_kw) - len(pv_kw))
    p_kw = np.concatenate([load_kw, -pv_kw, idle])
    return p_kw, np.concatenate([load_kvar, np.zeros_like(pv_kw), idle])


def flow_of_grid(phases: Phases, assets: Sequence[str], v_pu: float) -> PhasedFlow:
    """The flow with the grid as source."""
    return PhasedFlow(phases, assets, [(phases.buses[0].bus, v_pu)])


def flow_of_former(
    phases: Phases,
    assets: Sequence[str],
    former: str,
    v_slack_pu: float,
    v_min_pu: float,
    v_max_pu: float,
) -> PhasedFlow:
    """The flow with a device as source, at the voltage that an operator chooses for an island.

    It is the grid's, within the upper part of those that keep all voltages within their limits at
    no load, as demand lowers them; where none does, it is in the middle.
    """
    phases = in_island(phases.islanded, former)
    return PhasedFlow(phases, assets, [_held_by(phases, former, v_slack_pu, v_min_pu, v_max_pu)])


def _held_by(
    phases: Phases, former: str, v_slack_pu: float, v_min_pu: float, v_max_pu: float
) -> tuple[str, float]:
    """Bus of the former of an island, and the voltage that it holds."""
    bus = phases.connection(former).bus
    probe = PhasedFlow(phases, [], [(bus, 1.0)])
    at_rest = probe.v_pu(probe.no_load_v)[probe.measured_lit]
    least, most = v_min_pu / at_rest.min(), v_max_pu / at_rest.max()
    middle, upper = (least + share * (most - least) for share in (0.5, HELD))
    held = np.clip(v_slack_pu, middle, upper) if least < most else middle
    return bus, float(held)


Fed = tuple[tuple[int, str], ...]
"""Parts of a feeder with a source, by their numbers: the name of its former, empty of the grid."""


def flow_of_parts(
    phases: Phases,
    assets: Sequence[str],
    of_bus: Mapping[str, int],
    fed: Fed,
    voltages_pu: tuple[float, float, float],
) -> PhasedFlow:
    """The flow of a feeder that lines which are out cut into parts.

    ``fed`` are the parts that have a source; nothing holds the others. ``voltages_pu`` are the
    grid's, and the lowest and the highest of plans.
    """
    if len(set(of_bus.values())) == 1:
        [(_, former)] = fed
        if former:
            return flow_of_former(phases, assets, former, *voltages_pu)
        return flow_of_grid(phases, assets, voltages_pu[0])
    cut = phases.in_parts(of_bus, {number for number, former in fed if former})
    sources = []
    for number, former in fed:
        if not former:
            sources.append((phases.buses[0].bus, voltages_pu[0]))
            continue
        inside = cut.within({bus for bus, part in of_bus.items() if part == number}, former)
        inside = in_island(inside, former)
        cut = replace(cut, buses=tuple(inside.by_bus.get(row.bus, row) for row in cut.buses))
        sources.append(_held_by(inside, former, *voltages_pu))
    return PhasedFlow(cut, assets, sources)
