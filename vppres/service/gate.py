"""The last check of set-points before they leave: arithmetic of its own, whatever decided them.

It knows ratings, what a battery holds and what there is to be fed, and neither model nor guard.
What does not pass is not sent; the device gets its default.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.scenario.assets import PVSystems
from vppres.scenario.gensets import Gensets
from vppres.scenario.scenario import Scenario
from vppres.scenario.thermal_loads import ThermalLoads
from vppres.scenario.vehicles import Chargers

RATING_SHARE = 2e-3
POWER_KW = 0.02
SOC_SHARE = 1e-3
BAND_C = 0.02
"""What solvers and rounding may be off by."""


def refusals(
    wanted: Mapping[str, pd.DataFrame], scenario: Scenario, soc: Mapping[str, float]
) -> dict[tuple[str, str], str]:
    """What may not be sent, and why.

    Parameters
    ----------
    wanted : mapping of str to DataFrame
        Set-points by kind of device, each by identifier.
    scenario : Scenario
        The site: ratings and step length.
    soc : mapping of str to float
        State of charge of batteries as far as it is known.

    Returns
    -------
    dict
        Reason by kind, such as ``batteries``, and identifier.
    """
    checks: dict[str, Callable[[pd.DataFrame], dict[str, str]]] = {
        "batteries": lambda table: _batteries(table, scenario, soc),
        "pv": lambda table: _pv(table, scenario.pv),
        "customers": _customers,
        "chargers": lambda table: _chargers(table, scenario.chargers),
        "thermal_loads": lambda table: _thermal_loads(table, scenario.thermal_loads),
        "gensets": lambda table: _gensets(table, scenario.gensets),
    }
    return {
        (kind, name): reason
        for kind, table in wanted.items()
        for name, reason in checks[kind](table).items()
    }


def _batteries(table: pd.DataFrame, scenario: Scenario, soc: Mapping[str, float]) -> dict[str, str]:
    """Ratings, the inverter's disc, and what is stored."""
    b = scenario.batteries
    p_kw = table["p_kw"].to_numpy(float)
    q_kvar = table["q_kvar"].to_numpy(float)
    held = np.array([soc.get(name, np.nan) for name in b.id], dtype=float)
    stored_kw = np.where(p_kw > 0.0, p_kw * b.eta_charge, p_kw / b.eta_discharge)
    after = held + stored_kw * scenario.grid.dt_h / b.energy_kwh
    # What is outside already may stay there, and come back; what is not known is not checked.
    over = after - np.maximum(b.soc_max, held)
    under = np.minimum(b.soc_min, held) - after
    reasons = {
        "power above its rating": np.abs(p_kw) - b.p_max_kw - _slack(b.p_max_kw),
        "apparent power above its rating": np.hypot(p_kw, q_kvar)
        - b.s_max_kva
        - _slack(b.s_max_kva),
        "energy above its upper limit": over - SOC_SHARE,
        "energy below its lower limit": under - SOC_SHARE,
    }
    return _named(list(b.id), reasons, np.isfinite(p_kw) & np.isfinite(q_kvar))


def _pv(table: pd.DataFrame, pv: PVSystems) -> dict[str, str]:
    """What there is to be fed, and the inverter's disc."""
    p_kw = table["p_kw"].to_numpy(float)
    q_kvar = table["q_kvar"].to_numpy(float)
    available_kw = table["available_kw"].to_numpy(float)
    reasons = {
        "negative power": -p_kw - POWER_KW,
        "power above the available power": p_kw - available_kw - _slack(pv.p_max_kw),
        "apparent power above its rating": np.hypot(p_kw, q_kvar)
        - pv.s_max_kva
        - _slack(pv.s_max_kva),
    }
    return _named(list(pv.id), reasons, np.isfinite(p_kw) & np.isfinite(q_kvar))


def _customers(table: pd.DataFrame) -> dict[str, str]:
    """Served, or not."""
    return {
        str(name): "supply is neither on nor off"
        for name, value in table["served"].items()
        if not isinstance(value, (bool, np.bool_))
    }


def _chargers(table: pd.DataFrame, chargers: Chargers) -> dict[str, str]:
    """Ratings of chargers."""
    p_kw = table["p_kw"].to_numpy(float)
    limit_kw = table["p_limit_kw"].to_numpy(float)
    most_kw = np.maximum(p_kw, limit_kw)
    reasons = {
        "power above its rating": most_kw - chargers.p_charge_kw - _slack(chargers.p_charge_kw),
        "discharge above its rating": -p_kw
        - chargers.p_discharge_kw
        - _slack(chargers.p_discharge_kw),
    }
    return _named(list(chargers.id), reasons, np.isfinite(p_kw) & np.isfinite(limit_kw))


def _thermal_loads(table: pd.DataFrame, loads: ThermalLoads) -> dict[str, str]:
    """No room is cooled, and none is heated, beyond its comfort band."""
    setpoint_c = table["setpoint_c"].to_numpy(float)
    below_c = np.where(loads.heats, -np.inf, loads.t_min_c - setpoint_c)
    above_c = np.where(loads.heats, setpoint_c - loads.t_max_c, -np.inf)
    reasons = {
        "cooled below its comfort band": below_c - BAND_C,
        "heated above its comfort band": above_c - BAND_C,
    }
    return _named(list(loads.id), reasons, np.isfinite(setpoint_c))


def _gensets(table: pd.DataFrame, sets: Gensets) -> dict[str, str]:
    """Ratings of generating sets; what stands still gives nothing."""
    on = table["running"].to_numpy(bool)
    p_kw = table["p_kw"].to_numpy(float)
    reasons = {
        "power above its rating": p_kw - sets.p_max_kw - _slack(sets.p_max_kw),
        "power below its least": np.where(on, sets.p_min_kw - p_kw, -p_kw) - _slack(sets.p_max_kw),
        "power without running": np.where(on, -np.inf, p_kw - POWER_KW),
    }
    return _named(list(sets.id), reasons, np.isfinite(p_kw))


def _slack(rating: Floats) -> Floats:
    return POWER_KW + RATING_SHARE * rating


def _named(names: list[Any], reasons: Mapping[str, Floats], numbers: Any) -> dict[str, str]:
    """The first reason of each item that has one."""
    found: dict[str, str] = {}
    for i, name in enumerate(names):
        if not numbers[i]:
            found[str(name)] = "no number"
            continue
        for reason, excess in reasons.items():
            if excess[i] > 0:
                found[str(name)] = reason
                break
    return found
