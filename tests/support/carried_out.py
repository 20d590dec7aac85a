"""A step put into the pandapower net that its scenario was made from."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pandapower as pp

from vppres.feeders import ImportedFeeder
from vppres.scenario.network import Network

TOLERANCE_PU = 1e-6


def assert_voltages(net: Any, feeder: ImportedFeeder, network: Network, v_pu: Any) -> None:
    """The net's voltages are the recorded ones; buses without supply have none in either."""
    pp.runpp(net, numba=False, tolerance_mva=1e-10, calculate_voltage_angles=False)
    recorded = dict(zip(network.buses, v_pu, strict=True))
    found = net.res_bus["vm_pu"].loc[[*feeder.bus_of]].to_numpy()
    expected = np.array([recorded[bus] for bus in feeder.bus_of.values()])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=TOLERANCE_PU)


def carried_out(net: Any, feeder: ImportedFeeder, run: Any, step: Any) -> Iterator[None]:
    """Put the first step of a run into its net, then a live step; the voltages are theirs."""
    network = run.scenario.network
    first = run.steps["time"].iloc[0]
    for put, v_pu in (
        (partial(run.apply_to, net, feeder, first), run.buses["v_ac_pu"][: network.n_buses]),
        (partial(step.apply_to, net, feeder), step.buses["v_ac_pu"]),
    ):
        put()
        assert_voltages(net, feeder, network, v_pu)
        yield
