"""Dispatches as columns of the program in the network, and its master."""

from __future__ import annotations

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.data import WindowData
from vppres.model.numerics import POLYGON_SIDES
from vppres.model.site import Site
from vppres.solve.cache import ModelCache
from vppres.solve.network.decide import network_master
from vppres.solve.network.injections import Injections
from vppres.solve.network.master import NetworkMaster
from vppres.solve.result import SolveLimits
from vppres.solve.solvers import find_solver
from vppres.solve.task import WindowTask


def columns_of(model: Injections, d: Dispatch) -> Floats:
    """The columns of a window of the paper that a dispatch is."""
    x = np.zeros(model.size)
    for name, values in {
        "x_served": d.served,
        "P_ch": d.charge_kw,
        "P_dch": d.discharge_kw,
        "SoC": d.soc,
        "Q_batt": d.batt_q_kvar,
        "P_curt": d.pv_curtailed_kw,
        "Q_pv": d.pv_q_kvar,
        "P_grid": d.p_grid_kw,
        "Q_grid": d.q_grid_kvar,
    }.items():
        if model.at(name).size:
            x[model.at(name)] = values
    return x


def in_network(site: Site, data: WindowData, time_s: float = 20.0) -> NetworkMaster:
    """The master in the network of a window, which has none from other tests."""
    limits, highs = SolveLimits(time_s=time_s), find_solver("highs")
    task = WindowTask(data, ModelCache(site), limits, highs, POLYGON_SIDES)
    found = network_master(task)
    assert found is not None
    return found
