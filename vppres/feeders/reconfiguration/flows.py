"""AC power flows of many radial configurations at once.

Each is solved by the fixed point of the backward-forward sweep (Shirmohammadi et al., IEEE
Transactions on Power Systems 3(2), 1988, DOI 10.1109/59.192932). The sweep goes over the tree of
the present configuration for all of them, so that it is the same for every column of an array.
Currents of the loops make those of the open branches zero; the voltages across open branches close
the loops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Complexes, Floats, Wholes
from vppres.core.units import kva_to_a, ohm_to_pu2_per_kw, us_to_kw_at_1_pu
from vppres.feeders.reconfiguration.loops import SwitchedNetwork

TOLERANCE_PU = 1e-9
"""Change of a voltage in a sweep at which a configuration counts as solved."""

MOST_SWEEPS = 60
"""Sweeps after which a configuration counts as one without a solution. One that is solved later
drops a third of its voltage or more, as each sweep shrinks the error by no less than that."""

LEAST_PU = 0.1
"""Voltage below which a configuration counts as one without a solution."""


@dataclass(frozen=True, eq=False)
class Flows:
    """Figures of each of T configurations, (T,) each; infinite losses where no flow was found."""

    losses_kw: Floats  #: active losses of all lines, and what leakage and shunts draw
    #: Lowest and highest voltage of a bus.
    v_min_pu: Floats
    v_max_pu: Floats
    bus_min: Wholes  #: position of the bus with the lowest voltage
    loading: Floats  #: largest current over its rating; 0 where no branch has one


class ConfigurationFlows:
    """Solver of the configurations of one feeder for one injection."""

    def __init__(self, feeder: SwitchedNetwork, p_kw: Floats, q_kvar: Floats) -> None:
        net, ties = feeder.network, feeder.ties
        self.network = net
        start, end = feeder.ends
        ratio = net.bus_ratio
        r, x = (
            np.append(line, ohm_to_pu2_per_kw(ohm / ratio[start] ** 2, net.base_kv))
            for line, ohm in ((net.r_pu2_per_kw, ties.r_ohm), (net.x_pu2_per_kvar, ties.x_ohm))
        )
        self._z = r + 1j * x
        down = net.downstream.toarray()
        own = np.eye(feeder.n_loops)
        self._loops = np.vstack([down[:, start] - feeder.ratios * down[:, end], own])
        # Voltage that is left around each loop at no load, where ratios differ along it.
        self._left = net.v_slack_pu * (1.0 - feeder.ratios)
        self._drawn = (net.p_fixed_kw - p_kw) + 1j * (net.q_fixed_kvar - q_kvar)
        self._shunt = net.shunt_kw + 1j * net.shunt_kvar
        # Half the charging of each line at each end, which goes when the line is opened.
        g_kw, b_kvar = (us_to_kw_at_1_pu(us, net.base_kv) for us in (net.g_us, net.b_us))
        half = 0.5 * ratio[1:] ** 2 * (g_kw - 1j * b_kvar)
        self._half = np.append(half, np.zeros(feeder.n_loops))
        at_line = np.arange(net.n_lines)
        self._ends = np.append(net.parent, start), np.append(at_line + 1, end)
        at_end = np.append(ratio[1:], ratio[start])
        ratings = np.append(net.i_max_a, ties.i_max_a)
        self._kva_max = ratings / kva_to_a(1.0, net.base_kv) * at_end

    def solve(self, opened: Wholes) -> Flows:
        """Flows of configurations, given by their open branches, (T, K)."""
        count, n_buses = len(opened), self.network.n_buses
        found = Flows(
            np.full(count, np.inf),
            np.full(count, np.nan),
            np.full(count, np.nan),
            np.zeros(count, dtype=int),
            np.full(count, np.inf),
        )
        inverse = np.linalg.inv(self._loops[opened])
        shunt = self._shunts(opened)
        v = np.full((n_buses, count), complex(self.network.v_slack_pu))
        left = np.arange(count)
        for _ in range(MOST_SWEEPS):
            new, flow = self._swept(v, opened[left], inverse[left], shunt)
            with np.errstate(invalid="ignore"):
                change = np.abs(new - v).max(axis=0)
                lost = ~(np.abs(new).min(axis=0) >= LEAST_PU)
            solved = (change < TOLERANCE_PU) & ~lost
            if solved.any():
                columns = shunt if shunt.shape[1] == 1 else shunt[:, solved]
                self._note(found, left[solved], new[:, solved], flow[:, solved], columns)
            going = ~(solved | lost)
            if not going.any():
                break
            if not going.all():
                left, new = left[going], new[:, going]
                shunt = shunt if shunt.shape[1] == 1 else shunt[:, going]
            v = new
        return found

    def _shunts(self, opened: Wholes) -> Complexes:
        """Power of shunts at 1 pu, (N, T), or (N, 1) where no configuration changes it."""
        if not self._half.any():
            return self._shunt[:, None]
        shunt = np.repeat(self._shunt[:, None], len(opened), axis=1)
        each = np.arange(len(opened))[:, None]
        for side in self._ends:
            np.subtract.at(shunt, (side[opened], each), self._half[opened])
        return shunt

    def _swept(
        self, v: Complexes, opened: Wholes, inverse: Floats, shunt: Complexes
    ) -> tuple[Complexes, Complexes]:
        """Voltages (N, T) and currents of the branches (L + K, T) after one sweep."""
        parent, n_lines = self.network.parent, self.network.n_lines
        flow = np.zeros((len(self._z), v.shape[1]), dtype=complex)
        tree = flow[:n_lines]
        np.conjugate((self._drawn[:, None] / v + shunt * np.conj(v))[1:], out=tree)
        for line in range(n_lines - 1, -1, -1):
            if parent[line]:
                tree[parent[line] - 1] += tree[line]
        each = np.arange(v.shape[1])[:, None]
        around = -np.einsum("tij,tj->ti", inverse, flow[opened, each])
        flow += self._loops @ around.T
        drop = self._z[:, None] * flow
        across = (self._left[:, None] - self._loops.T @ drop).T
        drop[opened, each] += np.einsum("tji,tj->ti", inverse, across)
        new = np.empty_like(v)
        new[0] = self.network.v_slack_pu
        for line in range(n_lines):
            np.subtract(new[parent[line]], drop[line], out=new[line + 1])
        return new, flow

    def _note(
        self, found: Flows, rows: Wholes, v: Complexes, flow: Complexes, shunt: Complexes
    ) -> None:
        """Write down what the solved configurations have."""
        magnitude = np.abs(v)
        current = np.abs(flow)
        found.losses_kw[rows] = self._z.real @ current**2 + (shunt.real * magnitude**2).sum(axis=0)
        v_pu = magnitude * self.network.bus_ratio[:, None]
        found.bus_min[rows] = v_pu.argmin(axis=0)
        found.v_min_pu[rows] = v_pu.min(axis=0)
        found.v_max_pu[rows] = v_pu.max(axis=0)
        found.loading[rows] = (current / self._kva_max[:, None]).max(axis=0)
