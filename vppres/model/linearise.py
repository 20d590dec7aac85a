"""The offset of the delta form of LinDistFlow (paper, Section 3.2), from an AC operating point.

Chaining the deltas over a window cancels every intermediate point, so each line keeps one constant:
``delta = u_j_ac - u_i_ac + 2 (r P_ac + x Q_ac)``. Which flows are meant by ``P_ac, Q_ac`` matters:
the sending-end AC flows include the losses (the paper's literal reading); the lossless flows of the
same injections match the lossless flows of the model and are about three times as accurate.
"""

from __future__ import annotations

import numpy as np

from vppres.contract.operating_point import Centre, OperatingPoint
from vppres.core.arrays import Floats
from vppres.model.formulas import lossless_flows, voltage_offset_pu2
from vppres.scenario.network import Network


def delta_offset(
    network: Network, point: OperatingPoint | None, centre: Centre = "lossless"
) -> Floats:
    """Offset of each line in pu², zero before the first AC solution.

    Parameters
    ----------
    network : Network
        The feeder.
    point : OperatingPoint or None
        The last AC operating point.
    centre : {"lossless", "literal", "none"}
        Which flows belong to the AC voltages; ``none`` gives plain LinDistFlow.

    Returns
    -------
    array, shape (L,)

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
        p = lossless_flows(network, point.p_injection_kw)
        q = lossless_flows(network, point.q_injection_kvar)
    return voltage_offset_pu2(network, point.v_pu**2, p, q)
