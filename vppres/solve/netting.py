"""Batteries that charge and discharge at once, and what they store if they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.beyond_paper.at_end import left_kwh
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.assets import Batteries

SOC_OVER = 1e-7
"""By how much a netted battery may exceed its largest SoC: the linear solver's own tolerance."""

EASED_KWH = 1e-5
"""Energy by which every battery may miss what a set needs: five times what the masters accept in a
step of an hour, since a few batteries may lack what the fleet misses. A plan that lives on exactly
the energy it has charged misses it by rounding one step later, and a set that lacks so little is
served."""


def eased_soc(batteries: Batteries) -> Floats:
    """Eased energy as a state of charge, (B,), at most ``SOC_OVER``."""
    return np.minimum(EASED_KWH / batteries.energy_kwh, SOC_OVER)


def net_modes(site: Site, data: WindowData, dispatch: Dispatch) -> tuple[Dispatch, bool]:
    """Cancel charging against simultaneous discharging, and say whether the rest stays as it is.

    The net power stays, so no balance changes; what used to be lost is stored, so only the upper
    SoC limit can forbid it. Nor may what is stored be worth less for it: a full battery has no room
    for later sun.
    """
    net = dispatch.charge_kw - dispatch.discharge_kw
    charge = np.maximum(net, 0.0)
    discharge = np.maximum(-net, 0.0)
    soc = data.soc_path(site, charge, discharge)
    netted = replace(dispatch, charge_kw=charge, discharge_kw=discharge, soc=soc)
    stored = bool((soc <= site.batteries.soc_max + SOC_OVER).all())
    return netted, stored and not _is_worth_less(site, data, dispatch, netted)


def _is_worth_less(site: Site, data: WindowData, before: Dispatch, after: Dispatch) -> bool:
    """Whether a dispatch leaves energy that is worth less than that of another."""
    value = data.stored_value
    if value is None:
        return False
    least, found = (value.at(left_kwh(site, value, data.ahead, each)) for each in (before, after))
    return found < least - SOC_OVER * (1.0 + abs(least))
