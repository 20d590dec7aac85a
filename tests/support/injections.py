"""Dispatches as columns of the program in the network."""

from __future__ import annotations

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.solve.network.injections import Injections


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
