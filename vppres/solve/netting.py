"""Batteries that charge and discharge at once, and what they store if they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.model.data import WindowData
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
    soc = data.soc_path(site, charge, discharge)
    netted = replace(dispatch, charge_kw=charge, discharge_kw=discharge, soc=soc)
    return netted, bool((soc <= site.batteries.soc_max + SOC_OVER).all())
