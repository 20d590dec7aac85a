"""Whether a network carries a dispatch with reactive power that is at hand: by products alone.

A search for reactive power says yes or no and takes a while; this says yes or nothing, at once.
"""

from __future__ import annotations

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.network.reactance import Reactance

SHARES = np.linspace(0.0, 1.0, 5)
"""Shares of what all discs leave that are tried where the grid takes up the rest."""


def plainly_carried(site: Site, reactance: Reactance, data: WindowData, dispatch: Dispatch) -> bool:
    """Whether equal shares of what the discs leave keep all voltages of a dispatch in their limits.

    Active power is that of the dispatch. In the dark the share is what customers need; otherwise
    each step takes any of ``SHARES``, since more reactive power only raises voltages. False says
    nothing, nor is anything said of physical mode or of what a network draws itself.
    """
    if data.physics is not None or data.drawn is not None:
        return False
    net = site.network
    pv_kw = dispatch.pv_self_kw + dispatch.pv_export_kw
    charge_kw = dispatch.charge_kw - dispatch.discharge_kw
    load_kw = data.load_kw * dispatch.served
    needed_kvar = load_kw * site.customers.q_per_p
    injected_kw = (
        pv_kw @ site.pv_bus.T - charge_kw @ site.battery_bus.T - load_kw @ site.customer_bus.T
    )
    left_pv = np.sqrt(np.maximum(site.pv.s_max_kva**2 - pv_kw**2, 0.0))
    left_batteries = np.sqrt(np.maximum(site.batteries.s_max_kva**2 - charge_kw**2, 0.0))
    left_kvar = left_pv @ site.pv_bus.T + left_batteries @ site.battery_bus.T
    begin = net.v_slack_pu**2 + reactance.along(data.delta_pu2)
    plain = reactance.raised(begin, injected_kw, -needed_kvar @ site.customer_bus.T)
    raised = reactance.raised(0.0, np.zeros_like(injected_kw), left_kvar)
    needed = needed_kvar.sum(axis=1)
    left = left_kvar.sum(axis=1)
    grid_kvar = data.grid_q_max_kvar(site)
    balancing = np.divide(needed, left, out=np.full_like(left, np.inf), where=left > 0.0)
    shares = np.where(grid_kvar > 0.0, SHARES[:, None], balancing)
    from_grid = np.where(
        grid_kvar > 0.0, np.abs(needed - shares * left) <= grid_kvar, shares <= 1.0
    )
    u = plain + np.minimum(shares, 1.0)[:, :, None] * raised
    within = ((u >= net.u_min_pu2) & (u <= net.u_max_pu2))[:, :, 1:].all(axis=2)
    return bool((from_grid & within).any(axis=0).all())
