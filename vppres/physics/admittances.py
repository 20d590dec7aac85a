"""Admittances of a network, from its series impedances and shunts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Wholes
from vppres.core.units import kw_to_mw
from vppres.scenario.network import Network


@dataclass(frozen=True, eq=False)
class Admittances:
    """A network for 1 MVA."""

    bus: sp.csr_matrix  #: currents into the network by voltages, (N, N)
    #: Currents into the lines at either end, (L, N).
    sending: sp.csr_matrix
    receiving: sp.csr_matrix
    #: Positions of the buses at the ends, (L,).
    from_bus: Wholes
    to_bus: Wholes


def admittances_of(network: Network) -> Admittances:
    """Series admittances of the lines, and what shunts and charging draw, at the buses.

    Voltages are referred to the slack bus, so that no line has a ratio.

    Examples
    --------
    A line of 2 + 1j ohm at 10 kV is 40 - 20j for 1 MVA:

    >>> of_line = admittances_of(Network([1], [2], [2.0], [1.0], slack_bus=1, base_kv=10.0))
    >>> of_line.sending.toarray().round(9).tolist()
    [[(40-20j), (-40+20j)]]
    """
    lines = np.arange(network.n_lines)
    sends = network.parent
    receives = lines + 1
    base_ohm = network.base_kv**2
    series = 1.0 / (network.referred_r_ohm / base_ohm + 1j * (network.referred_x_ohm / base_ohm))
    shunt = kw_to_mw(network.shunt_kw) - 1j * kw_to_mw(network.shunt_kvar)

    ends = np.tile(lines, 2), np.concatenate([sends, receives])
    shape = (network.n_lines, network.n_buses)
    sending: sp.csr_matrix = sp.csr_matrix((np.concatenate([series, -series]), ends), shape=shape)
    receiving: sp.csr_matrix = -sending
    at_sends = sp.csr_matrix((np.ones(len(lines)), (lines, sends)), shape=shape)
    at_receives = sp.csr_matrix((np.ones(len(lines)), (lines, receives)), shape=shape)
    bus: sp.csr_matrix = at_sends.T @ sending + at_receives.T @ receiving + sp.diags(shunt)
    return Admittances(_sorted(bus), _sorted(sending), _sorted(receiving), sends, receives)


def _sorted(matrix: Any) -> sp.csr_matrix:
    """The entries of each row in the order of their columns: sums are rounded in that order.

    It is pandapower's, and the answers are equal to the last bit.
    """
    rows: sp.csr_matrix = matrix.tocsr()
    rows.eliminate_zeros()
    rows.sort_indices()
    return rows
