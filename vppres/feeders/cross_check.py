"""The package's own AC power flow against pandapower's, on the network of a scenario."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.core.errors import VerificationError
from vppres.core.units import kw_to_mw
from vppres.feeders.closeness import extreme_steps
from vppres.feeders.net.empty_net import empty_net
from vppres.physics.powerflow import TOLERANCE_MVA, ACPowerFlow
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario

AGREEMENT_PU = 1e-6
"""Largest difference in voltage between two solutions of the same equations: far below what matters
to a limit, far above what a mismatch of 1 mW at each bus makes of it."""


@dataclass(frozen=True)
class CrossCheck:
    """How far the two power flows are apart, in steps that both have solved; None without any.

    Examples
    --------
    >>> print(CrossCheck(4, 7e-12))
    The AC power flow is pandapower's within 7e-12 pu in 4 steps of extreme demand and generation.
    """

    steps: int
    difference_pu: float | None

    def __str__(self) -> str:
        if self.difference_pu is None:
            return (
                "No AC power flow to compare with pandapower's: with all customers served there is "
                "no solution."
            )
        words = "is pandapower's within" if self.agrees else "differs from pandapower's by"
        return (
            f"The AC power flow {words} {self.difference_pu:.1g} pu in {self.steps} steps of "
            "extreme demand and generation."
        )

    @property
    def agrees(self) -> bool:
        """Whether no voltage differs by more than rounding and tolerances explain."""
        return self.difference_pu is None or self.difference_pu <= AGREEMENT_PU


def cross_check(scenario: Scenario) -> CrossCheck:
    """Solve the steps of largest and least demand and generation in both power flows."""
    flow = ACPowerFlow(scenario.network)
    found = []
    for p_kw, q_kvar in extreme_steps(scenario):
        theirs = _by_pandapower(scenario.network, p_kw, q_kvar)
        try:
            ours = flow.solve(p_kw, q_kvar).v_pu
        except VerificationError:
            continue
        if theirs is not None:
            found.append(float(np.abs(ours - theirs).max()))
    return CrossCheck(len(found), max(found, default=None))


def _by_pandapower(network: Network, p_kw: Floats, q_kvar: Floats) -> Floats | None:
    """Voltages in pu in the network's order, or None where pandapower finds none."""
    import pandapower as pp

    net = as_pandapower(network)
    pp.create_loads(
        net,
        net.bus.index,
        p_mw=kw_to_mw(network.p_fixed_kw - p_kw),
        q_mvar=kw_to_mw(network.q_fixed_kvar - q_kvar),
    )
    try:
        pp.runpp(net, tolerance_mva=TOLERANCE_MVA, calculate_voltage_angles=False, numba=False)
    except pp.LoadflowNotConverged:
        return None
    return np.asarray(net.res_bus["vm_pu"]) * network.bus_ratio


def as_pandapower(network: Network) -> Any:
    """A network as a pandapower net without loads, in voltages referred to the slack bus.

    Lines of 1 km without charging, and shunts, which have the charging.
    """
    import pandapower as pp

    net = empty_net()
    buses = pp.create_buses(net, network.n_buses, vn_kv=network.base_kv)
    pp.create_ext_grid(net, buses[0], vm_pu=network.v_slack_pu)
    # The rating only serves pandapower's loading figure, which is not used.
    pp.create_lines_from_parameters(
        net,
        from_buses=network.parent,
        to_buses=np.arange(1, network.n_buses),
        length_km=1.0,
        r_ohm_per_km=network.referred_r_ohm,
        x_ohm_per_km=network.referred_x_ohm,
        c_nf_per_km=0.0,
        max_i_ka=1.0,
    )
    for bus in np.flatnonzero((network.shunt_kw != 0) | (network.shunt_kvar != 0)):
        p_mw, q_mvar = kw_to_mw([network.shunt_kw[bus], network.shunt_kvar[bus]])
        pp.create_shunt(net, buses[bus], p_mw=p_mw, q_mvar=q_mvar)
    return net
