"""Batteries that charge and discharge at once, and what they store if they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.data import WindowData
from vppres.model.formulas import cell_kw, soc_after
from vppres.model.site import Site

SOC_OVER = 1e-7
"""By how much a netted battery may exceed its largest SoC: the linear solver's own tolerance."""


def net_modes(site: Site, data: WindowData, dispatch: Dispatch) -> tuple[Dispatch, bool]:
    """Cancel charging against simultaneous discharging, and say whether every battery can take it.

    The net power stays, so no balance changes; what used to be lost is stored, so only the upper
    SoC limit can forbid it.
    """
    net = dispatch.charge_kw - dispatch.discharge_kw
    charge = np.maximum(net, 0.0)
    discharge = np.maximum(-net, 0.0)
    soc = soc_path(site, data, charge, discharge)
    netted = replace(dispatch, charge_kw=charge, discharge_kw=discharge, soc=soc)
    return netted, bool((soc <= site.batteries.soc_max + SOC_OVER).all())


def soc_path(site: Site, data: WindowData, charge_kw: Floats, discharge_kw: Floats) -> Floats:
    """State of charge before every step and after the last, shape (W + 1, B)."""
    stored_kw = cell_kw(charge_kw, discharge_kw, data.eta_charge, data.eta_discharge)
    total_kw = np.cumsum(stored_kw, axis=0)
    return np.vstack([data.soc, soc_after(data.soc, total_kw, site.batteries, site.dt_h)])
