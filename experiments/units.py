"""The same problem in another unit of power: MW or per unit in place of kW.

Names say what a field is, so they say how it changes: powers and energies are divided by the unit,
what is per kW or per kWh is multiplied by it. Nothing else in a site has power in it but the
objective's weights, and the network, whose impedances in ohm are kept and whose nominal voltage
takes the unit up: ``r P / V²`` stays what it is. The objective stays what it is, too.
"""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.scenario import ObjectiveWeights

T = TypeVar("T")

_POWER = re.compile(r"(^|_)(kw|kvar|kva|kwh)$")
_PER_POWER = re.compile(r"_per_(kw|kwh)$")


def site_in_unit(site: Site, unit_kw: float) -> Site:
    """A site whose powers count in units of so many kW, as a user would write its model.

    Parameters
    ----------
    site : Site
        In kW.
    unit_kw : float
        The unit in kW: 1000 for MW, the base power for per unit.
    """
    weights = site.weights
    return replace(
        site,
        network=replace(site.network, base_kv=site.network.base_kv / np.sqrt(unit_kw)),
        pv=_scaled(site.pv, unit_kw),
        batteries=_scaled(site.batteries, unit_kw),
        weights=ObjectiveWeights(
            lambda_grid=weights.lambda_grid,
            lambda_curt=weights.lambda_curt * unit_kw,
            lambda_l=weights.lambda_l * unit_kw**2,
            lambda_q=weights.lambda_q,
        ),
    )


def window_in_unit(data: WindowData, unit_kw: float) -> WindowData:
    """A window whose powers count in units of so many kW."""
    return _scaled(data, unit_kw)


def dispatch_in_kw(dispatch: Dispatch, unit_kw: float) -> Dispatch:
    """A dispatch found in units of so many kW, in kW."""
    return _scaled(dispatch, 1.0 / unit_kw)


def _scaled(record: T, unit_kw: float) -> T:
    """A dataclass with everything in it that is a power, or per power, in another unit."""
    changed: dict[str, Any] = {}
    for f in fields(record):  # type: ignore[arg-type]
        value = getattr(record, f.name)
        if value is None or not f.init:
            continue
        if is_dataclass(value):
            changed[f.name] = _scaled(value, unit_kw)
        elif factor := _factor(f.name, unit_kw):
            changed[f.name] = _times(value, factor)
    return replace(record, **changed)  # type: ignore[type-var]


def _factor(name: str, unit_kw: float) -> float | None:
    """What a field of this name is multiplied by; None if there is no power in it."""
    if _PER_POWER.search(name):
        return unit_kw
    return 1.0 / unit_kw if _POWER.search(name) else None


def _times(value: Any, factor: float) -> Any:
    """An array, or arrays by kind, times a factor."""
    if isinstance(value, dict):
        return {kind: each * factor for kind, each in value.items()}
    return value * factor
