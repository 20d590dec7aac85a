"""The offset of the delta form of LinDistFlow (paper, Section 3.2), from an AC operating point.

What the network itself draws is constant over a window too: at the voltages of the same point.

Chaining the deltas over a window cancels every intermediate point, so each line keeps one constant:
``delta = u_j_ac - u_i_ac + 2 (r P_ac + x Q_ac)``. Which flows are meant by ``P_ac, Q_ac`` matters:
the sending-end AC flows include the losses (the paper's literal reading); the lossless flows of the
same injections match the lossless flows of the model and are about three times as accurate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.contract.operating_point import Centre, OperatingPoint
from vppres.core.arrays import ByStep, Flags, Floats, Wholes
from vppres.model.formulas import lossless_flows, voltage_offset_pu2
from vppres.scenario.network import Network


def delta_offset(
    network: Network, point: OperatingPoint | None, centre: Centre = "lossless"
) -> Floats:
    """Offset of each line in pu², (L,), zero before the first AC solution.

    ``centre`` says which flows belong to the AC voltages; ``none`` gives plain LinDistFlow.

    Examples
    --------
    >>> net = Network([1], [2], [0.1], [0.1], slack_bus=1, base_kv=11.0)
    >>> delta_offset(net, None)
    array([0.])
    """
    if point is None or centre == "none":
        return np.zeros(network.n_lines)
    if centre == "literal":
        p = point.p_flow_kw
        q = point.q_flow_kvar
    else:
        was = network.islanded if point.island else network
        drawn_kw, drawn_kvar = was.drawn(point.v_pu)
        p = lossless_flows(network, point.p_injection_kw - drawn_kw)
        q = lossless_flows(network, point.q_injection_kvar - drawn_kvar)
    return voltage_offset_pu2(network, network.u_pu2(point.v_pu), p, q)


@dataclass(frozen=True, eq=False)
class Drawn(ByStep):
    """Power that the network itself draws in a window: shunts, charging and fixed demand."""

    #: At each bus, (W, N); negative where it gives power.
    kw: Floats
    kvar: Floats

    def at(self, buses: Flags) -> Drawn:
        """Power drawn at some buses of each step, (W, N), or in some steps, (W, 1)."""
        return Drawn(self.kw * buses, self.kvar * buses)


def drawn_by(network: Network, v_pu: Floats | None, island: Flags, of_bus: Wholes) -> Drawn:
    """Power that a network draws in the steps of a window, absent if it never draws anything.

    An island of the paper's mode is lossless: as with losses, the slack bus supplies what the
    network draws, so that the sum over the buses is zero. Behind a line that is out the first bus
    does so.

    ``v_pu`` are the voltages of the last AC point, without one those at no load; ``of_bus`` has the
    first bus of the part of each bus, (W, N).

    Examples
    --------
    >>> net = Network([1], [2], [0.1], [0.1], slack_bus=1, base_kv=11.0, drawing_bus=[2],
    ...               q_shunt_kvar=[-100.0])
    >>> one = np.zeros((2, 2), dtype=int)
    >>> drawn_by(net, np.array([1.0, 0.9]), np.array([False, True]), one).kvar.round(3).tolist()
    [[0.0, -81.0], [81.0, -81.0]]
    """
    if not network.draws:
        return Drawn.absent()
    at_no_load = network.v_slack_pu * network.bus_ratio
    if v_pu is not None:
        at_no_load = np.where(np.isnan(v_pu), at_no_load, v_pu)
    v_pu = np.tile(at_no_load, (len(island), 1))
    alone = island[:, None] | (of_bus != 0)
    found = drawn_at(network, v_pu, alone)
    for values in (found.kw, found.kvar):
        for t, numbers in enumerate(of_bus):
            for first in np.unique(numbers[alone[t]]):
                values[t, first] -= values[t, numbers == first].sum()
    return found


def drawn_at(network: Network, v_pu: Floats, island: Flags) -> Drawn:
    """Power that a network draws at each step's voltages, with grid and in islands, (W, N) each."""
    with_grid, alone = network.drawn(v_pu), network.islanded.drawn(v_pu)
    return Drawn(*(np.where(island, *pair) for pair in zip(alone, with_grid, strict=True)))
