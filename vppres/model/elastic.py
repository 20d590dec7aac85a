"""A network whose voltage limits have given way, so that a window has a dispatch at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.scenario.network import Network

ROUNDING_PU = 1e-3
"""Limits are widened to the next multiple, so that windows with like needs share problems."""


def widened(network: Network, slack_pu2: float) -> Network:
    """The network with its squared voltage limits widened, rounded outwards.

    Examples
    --------
    >>> net = Network([1], [2], [0.1], [0.1], slack_bus=1, base_kv=11.0)
    >>> wide = widened(net, 0.01)
    >>> wide.v_min_pu, wide.v_max_pu
    (0.941, 1.058)
    """
    # The slack is of voltages referred to the slack bus; behind a ratio it is larger or smaller.
    slack_pu2 = slack_pu2 * float((network.bus_ratio**2).max())
    low = np.sqrt(max(network.v_min_pu**2 - slack_pu2, 0.0))
    high = np.sqrt(network.v_max_pu**2 + slack_pu2)
    return with_limits(
        network,
        float(np.round(np.floor(low / ROUNDING_PU) * ROUNDING_PU, 6)),
        float(np.round(np.ceil(high / ROUNDING_PU) * ROUNDING_PU, 6)),
    )


def with_limits(network: Network, v_min_pu: float, v_max_pu: float) -> Network:
    """The network with other limits of the optimisation's voltages."""
    return replace(network, v_min_pu=v_min_pu, v_max_pu=v_max_pu)
