"""Capacitors that the grid-forming batteries of an island cannot hold."""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.scenario.network import Network
from vppres.scenario.phases import PHASES, Phases, coils_of


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
    given_kvar, of_lines_kvar = _at_no_load(network)
    smallest_first = np.argsort(given_kvar, kind="stable")
    together_kvar = np.empty(network.n_buses)
    together_kvar[smallest_first] = of_lines_kvar + np.cumsum(given_kvar[smallest_first])
    return (given_kvar > 0.0) & (together_kvar > formers_kva)


def too_large_by_phase(network: Network, phases: Phases, former_kva: float) -> Flags:
    """Buses with capacitors that a third of a battery cannot hold on one of their phases, (N,)."""
    _, of_lines_kvar = _at_no_load(network)
    held_kvar = np.full(len(PHASES), of_lines_kvar / len(PHASES))
    off = np.zeros(network.n_buses, dtype=bool)
    there = [row for row in phases.shunts if row.q_kvar < 0.0 and row.island != "no"]
    for row in sorted(there, key=lambda row: -row.q_kvar):
        # Half of a coil between two phases is on each.
        ends = [end for first, other in coils_of(row.coils) for end in (first, other or first)]
        share = np.bincount(ends, minlength=len(PHASES)) / len(ends)
        together_kvar = held_kvar - row.q_kvar * share
        if (together_kvar[share > 0.0] > former_kva / len(PHASES)).any():
            off[network.bus_index[phases.by_bus[row.bus].at]] = True
        else:
            held_kvar = together_kvar
    return off


def _at_no_load(network: Network) -> tuple[Floats, float]:
    """Reactive power in kvar at no load: of capacitors, (N,), and of all lines' charging."""
    at_no_load = network.v_slack_pu * network.bus_ratio
    given_kvar = np.maximum(-network.q_shunt_kvar, 0.0) * at_no_load**2
    shunts_kvar = network.drawn(at_no_load)[1] - network.q_fixed_kvar
    return given_kvar, -float(shunts_kvar.sum() + given_kvar.sum())
