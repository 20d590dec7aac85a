"""Capacitors that the grid-forming batteries of an island cannot hold."""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Flags
from vppres.scenario.network import Network


def too_large(network: Network, formers_kva: float) -> Flags:
    """Buses with capacitors that grid-forming batteries cannot hold at no load, (N,).

    In an island these batteries take the reactive power of capacitors and charging lines before any
    customer is connected. If their ratings are too small together, the largest capacitors are too
    large.

    Parameters
    ----------
    network : Network
        The feeder, as it is in an island.
    formers_kva : float
        Inverter rating of all grid-forming batteries together.

    Examples
    --------
    >>> net = Network([1, 2], [2, 3], [0.1, 0.1], [0.1, 0.1], slack_bus=1, base_kv=10.0,
    ...               drawing_bus=[2, 3], q_shunt_kvar=[-300.0, -50.0])
    >>> too_large(net, 100.0).tolist()
    [False, True, False]
    """
    at_no_load = network.v_slack_pu * network.bus_ratio
    given_kvar = np.maximum(-network.q_shunt_kvar, 0.0) * at_no_load**2
    shunts_kvar = network.drawn(at_no_load)[1] - network.q_fixed_kvar
    of_lines_kvar = -float(shunts_kvar.sum() + given_kvar.sum())
    smallest_first = np.argsort(given_kvar, kind="stable")
    together_kvar = np.empty(network.n_buses)
    together_kvar[smallest_first] = of_lines_kvar + np.cumsum(given_kvar[smallest_first])
    return (given_kvar > 0.0) & (together_kvar > formers_kva)
