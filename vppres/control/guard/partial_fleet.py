"""A fleet without the batteries that are out: another site, and its dispatch filled up again."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.core.arrays import Flags, Floats
from vppres.model.site import Site
from vppres.scenario.assets import Batteries


def site_with(site: Site, online: Flags) -> Site:
    """The site with the batteries that are online, shape (B,); itself if all are."""
    if online.all():
        return site
    left = Batteries(**{f.name: getattr(site.batteries, f.name)[online] for f in fields(Batteries)})
    return replace(site, batteries=left)


def reduced_observation(seen: Observation, batteries: Batteries) -> Observation:
    """The observation of the batteries that are online; the others count as empty."""
    online = seen.online
    if online.all():
        return seen
    unusable_kwh = float((batteries.energy_kwh * batteries.soc_min)[~online].sum())
    return replace(
        seen,
        soc=seen.soc[online],
        eta_charge=seen.eta_charge[online],
        eta_discharge=seen.eta_discharge[online],
        battery_kw=None,
        online=online[online],
        soc_age_h=None,
        stored_value=seen.stored_value and seen.stored_value.beside(unusable_kwh),
    )


def whole_fleet(dispatch: Dispatch, online: Flags, soc: Floats) -> Dispatch:
    """A dispatch of the batteries online as one of all; those that are out rest at their SoC."""
    if online.all():
        return dispatch
    rest = {name: np.zeros(len(online)) for name in ("charge_kw", "discharge_kw", "batt_q_kvar")}
    filled: dict[str, Any] = {}
    for name, values in {**rest, "soc": soc}.items():
        part = getattr(dispatch, name)
        whole = np.tile(values, (len(part), 1))
        whole[:, online] = part
        filled[name] = whole
    return replace(dispatch, **filled)
