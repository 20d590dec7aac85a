"""A step put into the pandapower net that its scenario was made from."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import pandapower as pp
import pytest

from vppres.feeders import ImportedFeeder


def carried_out(net: Any, feeder: ImportedFeeder, run: Any, step: Any) -> Iterator[None]:
    """Put the first step of a run into its net, then a live step; the voltages are theirs."""
    network = run.scenario.network
    first = run.steps["time"].iloc[0]
    at = [network.bus_index[bus] for bus in feeder.bus_of.values()]
    for put, v_pu in (
        (partial(run.apply_to, net, feeder, first), run.buses["v_ac_pu"][: network.n_buses]),
        (partial(step.apply_to, net, feeder), step.buses["v_ac_pu"]),
    ):
        put()
        pp.runpp(net, numba=False, tolerance_mva=1e-10, calculate_voltage_angles=False)
        found = net.res_bus["vm_pu"].loc[[*feeder.bus_of]].to_numpy()
        assert found == pytest.approx(v_pu.to_numpy()[at], abs=1e-6)
        yield
