"""By how much the voltage limits have to give so that a window has a dispatch at all."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np

from vppres.model.constraints import voltage_limits
from vppres.model.data import WindowData
from vppres.model.forms import Form, WindowModel
from vppres.model.numerics import require_dpp
from vppres.model.site import Site
from vppres.scenario.network import Network

ROUNDING_PU = 1e-3
"""Limits are widened to the next multiple, so that windows with like needs share problems."""


class ElasticModel:
    """A window without binaries whose voltage limits give, by the least that is possible.

    Parameters
    ----------
    site : Site
        Fixed data.
    n_steps : int
        Steps W of the window.
    polygon_sides : int
        Sides of the outer polygons in place of the inverters' discs.
    exporting : bool
        Whether export is part of the problem.

    Attributes
    ----------
    problem : cvxpy.Problem
        Minimises the slack of the squared limits.
    """

    def __init__(
        self, site: Site, n_steps: int, polygon_sides: int = 16, exporting: bool = False
    ) -> None:
        form = Form("service", "relaxed", "relaxed", polygon_sides, outer=True, exporting=exporting)
        self.window = WindowModel(site, n_steps, form)
        self.slack = cp.Variable(name="slack", nonneg=True)
        giving = voltage_limits(site, self.window.v, self.window.p, self.slack)
        named = self.window.constraints | giving
        self.problem = cp.Problem(cp.Minimize(self.slack), list(named.values()))
        require_dpp(self.problem, f"elastic window of {n_steps} steps")

    def fill(self, data: WindowData) -> None:
        """Write the window's data."""
        self.window.fill(data)


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
