"""Limits that keep stored energy while PV power is curtailed, in physical mode.

The paper counts the curtailed energy alone. A battery that gives power beside curtailed PV power,
and takes it back an hour later, loses some on the way and so has less curtailed: nothing is gained
by it, and an outage that lasts longer finds the battery empty. Once it is known who is served, the
demand says of each step whether PV power exceeds it and what the grid takes back: then no battery
gives power. In an island nothing is curtailed otherwise. Fixed generation beyond the limit of
export counts like curtailment. Without it no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.beyond_paper.addition import Addition
from vppres.model.beyond_paper.drawn import beyond_limit_kw
from vppres.model.constraints import Named
from vppres.model.data import Unspent, WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

SPENT_KW = 1e-3
"""Power that is given beside as much curtailed and is no more than rounding."""


def spent_kw(site: Site, data: WindowData, plan: Dispatch) -> Floats:
    """Power that batteries give beside as much that is lost, (W,)."""
    given_kw = (plan.discharge_kw - plan.charge_kw).sum(axis=1)
    curtailed_kw = plan.pv_curtailed_kw.sum(axis=1) - _beyond_inverters_kw(site, data)
    lost_kw = curtailed_kw + beyond_limit_kw(site, data, plan)
    return np.asarray(np.maximum(np.minimum(given_kw, lost_kw), 0.0))


def unspent(site: Site, data: WindowData, plan: Dispatch, network_kw: Floats) -> Unspent:
    """Limits on discharge and curtailment that a plan's supply allows.

    ``network_kw`` is what the network takes in that plan, (W,); the window may say something else
    by now.
    """
    lost_kw = _beyond_inverters_kw(site, data)
    taken_kw = (plan.charge_kw - plan.discharge_kw).sum(axis=1) - plan.p_grid_kw
    left_kw = plan.pv_curtailed_kw.sum(axis=1) - lost_kw + taken_kw + network_kw - data.network_kw
    sold_kw = data.export.limit_kw if data.export else np.zeros(data.n_steps)
    enough = left_kw > np.where(data.dark, 0.0, sold_kw)
    most_kw = np.tile(site.batteries.p_max_kw, (data.n_steps, 1))
    return Unspent(
        np.where(enough[:, None], 0.0, most_kw),
        np.where(data.dark & ~enough, lost_kw, data.pv_kw.sum(axis=1)),
    )


def _beyond_inverters_kw(site: Site, data: WindowData) -> Floats:
    """PV power that no inverter can take, (W,)."""
    return np.asarray(np.maximum(data.pv_kw - site.pv.s_max_kva, 0.0).sum(axis=1))


class StoredIsKept(Addition):
    """Largest power that batteries may give, (W, B), and that all systems may curtail, (W,)."""

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        self.given = cp.Parameter(v.P_dch.shape, name="P_dch_unspent", nonneg=True)
        self.curtailed = cp.Parameter(v.P_grid.size, name="P_curt_unspent", nonneg=True)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether there are such limits."""
        return bool(data.unspent) or None

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """No power from batteries beside curtailed PV power."""
        return {
            "unspent_discharge": v.P_dch <= self.given,
            "unspent_curtailment": cp.sum(v.P_curt, axis=1) <= self.curtailed,
        }

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the limits."""
        write(self.given, data.unspent.discharge_kw)
        write(self.curtailed, data.unspent.curtailed_kw)
