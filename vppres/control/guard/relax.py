"""Relaxations of an infeasible window, in order: voltage limits, then all but this step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.network import Network
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution

SolverOf = Callable[[Site], WindowSolver]
# Solution, the voltage limits it holds, and what was given up in words.
Answer = tuple[WindowSolution, tuple[float, float], str]

SLACK_MARGIN_PU2 = 1e-4
"""Added to the least slack, which interior points find within their tolerance."""

ROUNDING_PU = 1e-3
"""Limits are widened to the next multiple, so that windows with like needs share problems."""


def relaxed_answers(
    site: Site, data: WindowData, solver_of: SolverOf
) -> Iterator[tuple[str, Callable[[], Answer]]]:
    """Fallbacks of an infeasible window by name, each to be called in turn until one answers."""
    yield "voltage", partial(_with_ac_limits, site, data, solver_of)
    yield "voltage", partial(_elastic, site, data, solver_of)
    yield "service", partial(_step_alone, site, data, solver_of)


def _with_ac_limits(site: Site, data: WindowData, solver_of: SolverOf) -> Answer:
    """The window with the limits that the AC voltages must hold instead of the tighter ones."""
    net = site.network
    return _solved(
        with_limits(net, min(net.v_min_pu, net.v_min_ac_pu), max(net.v_max_pu, net.v_max_ac_pu)),
        site,
        data,
        solver_of,
    )


def _elastic(site: Site, data: WindowData, solver_of: SolverOf) -> Answer:
    """The window with limits as wide as they have to be."""
    slack = solver_of(site).least_slack(data) + SLACK_MARGIN_PU2
    return _solved(widened(site.network, slack), site, data, solver_of)


def _step_alone(site: Site, data: WindowData, solver_of: SolverOf) -> Answer:
    """The first step without switching rules: customers it cannot supply are disconnected."""
    alone = replace(data.first(1), switching=None)
    solution, limits_pu, words = _elastic(site, alone, solver_of)
    return solution, limits_pu, f"the step alone, {words}"


def _solved(network: Network, site: Site, data: WindowData, solver_of: SolverOf) -> Answer:
    solution = solver_of(replace(site, network=network)).solve(data)
    v = solution.dispatch.v_pu[0, 1:]
    net = site.network
    beyond = max(float((net.v_min_pu - v).max()), float((v - net.v_max_pu).max()), 0.0)
    words = (
        f"voltage limits widened to {network.v_min_pu:.3f} .. {network.v_max_pu:.3f} pu, "
        f"this step {beyond:.4f} pu beyond its own"
    )
    return solution, (network.v_min_pu, network.v_max_pu), words


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
