"""A balanced feeder stated with phases: three equal ones without coupling, and devices on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from vppres.physics.phased_sources import assets_of, buses_of
from vppres.scenario.phases import PhaseBus, PhaseConnection, PhaseLine, Phases
from vppres.scenario.scenario import Scenario

ON_ALL: Mapping[str, str] = MappingProxyType({})


def three_phases(day: Scenario, coils: Mapping[str, str] = ON_ALL) -> Scenario:
    """The day of a feeder without ratios and shunts; devices that are not named have all phases."""
    net = day.network
    buses = tuple(PhaseBus(str(bus), bus, net.base_kv, "a b c") for bus in net.buses)
    lines = tuple(
        PhaseLine(str(above), str(below), z_ohm * np.eye(3), np.zeros((3, 3)))
        for above, below, z_ohm in zip(
            net.from_bus, net.to_bus, net.r_ohm + 1j * net.x_ohm, strict=True
        )
    )
    connections = tuple(
        PhaseConnection(name, str(bus), coils.get(name, "a b c"), net.base_kv / np.sqrt(3.0))
        for name, bus in zip(assets_of(day), buses_of(day), strict=True)
    )
    return replace(day, phases=Phases(buses, lines, connections=connections))
