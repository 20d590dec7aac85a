"""AC power flow of a feeder in any state of its branches: closed loops, parts, islands.

The equations are those of :mod:`vppres.physics.newton`, on the admittances of the closed branches
of one part. Voltages are referred as those of the network's tree are, whatever branches are closed:
a branch between buses of different ratio is an ideal transformer then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Complexes, Flags, Floats, Wholes
from vppres.core.units import kva_to_a, kw_to_mw, mw_to_kw, us_to_kw_at_1_pu
from vppres.physics.newton import Newton
from vppres.physics.powerflow import LARGEST_TOLERANCE_MVA, TOLERANCE_MVA
from vppres.scenario.network import Network
from vppres.scenario.switches import Switches


@dataclass(frozen=True, eq=False)
class PartFlow:
    """Power flow of one part of a feeder."""

    v_pu: Floats  #: voltages of its buses; NaN elsewhere, (N,)
    current_a: Floats  #: currents of its branches; 0 elsewhere, (E,)
    source_kva: complex  #: what the reference bus gives beyond its own injection
    #: What it would give if all its phases did what the fullest does; 0 if balanced.
    fullest_kva: float = 0.0


class MeshedFlow:
    """Solver of the parts of one feeder in any state of its branches.

    Branches are the lines of the network, in its order, and after them the switches: ``E = L + K``.
    """

    def __init__(self, network: Network, ties: Switches) -> None:
        self.network = network
        index, own = network.bus_index, network.bus_ratio
        sides = ties.from_bus, ties.to_bus
        at_tie = [np.array([index[bus] for bus in side], dtype=int) for side in sides]
        self.start = np.append(network.parent, at_tie[0])
        self.end = np.append(np.arange(network.n_lines) + 1, at_tie[1])
        # The impedance of a line stands behind its transformer, that of a switch has none.
        self.at_side = np.append(own[1:], own[at_tie[0]])
        z_ohm = np.append(network.r_ohm + 1j * network.x_ohm, ties.r_ohm + 1j * ties.x_ohm)
        self.series = network.base_kv**2 * self.at_side**2 / z_ohm
        self.turns = np.append(np.ones(network.n_lines), own[at_tie[1]] / own[at_tie[0]])
        grids = {False: network, True: network.islanded}
        self._shunt = {island: _mva(net.shunt_kw, net.shunt_kvar) for island, net in grids.items()}
        at_1_pu = 0.5 * own[1:] ** 2
        g_kw, b_kvar = (
            us_to_kw_at_1_pu(us, network.base_kv) for us in (network.g_us, network.b_us)
        )
        self._half = _mva(at_1_pu * g_kw, -at_1_pu * b_kvar)
        self.i_max_a = np.append(network.i_max_a, ties.i_max_a)

    def solve(
        self, inside: Flags, closed: Flags, reference: int, p_kw: Floats, q_kvar: Floats
    ) -> PartFlow | None:
        """Flow of a part, None if none is found.

        ``inside`` are its buses, (N,), ``closed`` the branches that are closed, (E,), and
        ``reference`` is the position of the bus with its source.
        """
        net = self.network
        buses = np.flatnonzero(inside)
        lines = np.flatnonzero(closed & inside[self.start])
        y = self._admittances(buses, lines, self._shunts(reference != 0, lines))
        injected = (p_kw - net.p_fixed_kw) + 1j * (q_kvar - net.q_fixed_kvar)
        s_mva = _mva(injected.real, -injected.imag)[buses]
        at = int(np.searchsorted(buses, reference))
        v_source = float(net.held_pu[reference] / net.bus_ratio[reference])
        v = _solved(y, at, v_source, s_mva)
        if v is None:
            return None
        v_pu, current_a = np.full(net.n_buses, np.nan), np.zeros(len(closed))
        v_pu[buses] = np.abs(v) * net.bus_ratio[buses]
        referred = np.zeros(net.n_buses, dtype=complex)
        referred[buses] = v
        across = referred[self.start[lines]] - self.turns[lines] * referred[self.end[lines]]
        kva = mw_to_kw(np.abs(self.series[lines] * across)) / self.at_side[lines]
        current_a[lines] = kva_to_a(kva, net.base_kv)
        given = complex((v * np.conj(y @ v))[at] - s_mva[at])
        return PartFlow(v_pu, current_a, complex(mw_to_kw(given.real), mw_to_kw(given.imag)))

    def _admittances(self, buses: Wholes, lines: Wholes, shunts: Complexes) -> sp.csr_matrix:
        """Admittances for 1 MVA of some buses and the branches between them."""
        place = np.full(self.network.n_buses, -1)
        place[buses] = np.arange(len(buses))
        start, end = place[self.start[lines]], place[self.end[lines]]
        series, turns = self.series[lines], self.turns[lines]
        values = (series, turns**2 * series, -turns * series, -turns * series, shunts[buses])
        rows = np.concatenate([start, end, start, end, place[buses]])
        columns = np.concatenate([start, end, end, start, place[buses]])
        shape = (len(buses), len(buses))
        y: sp.csr_matrix = sp.csr_matrix((np.concatenate(values), (rows, columns)), shape=shape)
        y.sum_duplicates()
        return y

    def _shunts(self, islanded: bool, lines: Wholes) -> Complexes:
        """Shunts at 1 MVA of all buses, (N,), with the charging of closed lines alone."""
        shunt = self._shunt[islanded].copy()
        opened = np.ones(self.network.n_lines, dtype=bool)
        opened[lines[lines < len(opened)]] = False
        for side in (self.start, self.end):
            np.subtract.at(shunt, side[: len(opened)][opened], self._half[opened])
        return shunt


def _mva(p_kw: Floats, q_kvar: Floats) -> Complexes:
    """Admittances that draw some power at 1 pu and 1 MVA."""
    return kw_to_mw(p_kw) - 1j * kw_to_mw(q_kvar)


def _solved(y: sp.csr_matrix, at: int, v_source: float, s_mva: Complexes) -> Complexes | None:
    """Voltages of a part, of one bus too; None if Newton's method does not find them."""
    if len(s_mva) == 1:
        return np.array([complex(v_source)])
    newton = Newton(y, at, v_source)
    tries = (TOLERANCE_MVA, LARGEST_TOLERANCE_MVA)
    found = (newton.solve(newton.flat(), s_mva, tolerance) for tolerance in tries)
    return next((v for v in found if v is not None), None)
