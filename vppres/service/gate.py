"""The last check of set-points before they leave: arithmetic of its own, whatever decided them.

It knows ratings, what a battery holds and what there is to be fed, and neither model nor guard.
What does not pass is not sent; the device gets its default.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.scenario.scenario import Scenario

RATING_SHARE = 2e-3
POWER_KW = 0.02
SOC_SHARE = 1e-3
BAND_C = 0.02
"""What solvers and rounding may be off by."""


class Wanted(Protocol):
    """Set-points as tables by identifier: what decided them does not matter."""

    @property
    def batteries(self) -> pd.DataFrame:
        """``p_kw``, charging positive, and ``q_kvar``."""
        ...

    @property
    def pv(self) -> pd.DataFrame:
        """``p_kw``, ``q_kvar`` and ``available_kw``."""
        ...

    @property
    def customers(self) -> pd.DataFrame:
        """``served``."""
        ...

    @property
    def chargers(self) -> pd.DataFrame | None:
        """``p_kw``, charging positive, and ``p_limit_kw``; None without chargers."""
        ...

    @property
    def thermal_loads(self) -> pd.DataFrame | None:
        """``setpoint_c``; None without thermal loads."""
        ...

    @property
    def gensets(self) -> pd.DataFrame | None:
        """``running`` and ``p_kw``; None without generating sets."""
        ...


def refusals(
    decision: Wanted, scenario: Scenario, soc: Mapping[str, float]
) -> dict[tuple[str, str], str]:
    """What may not be sent, and why.

    Parameters
    ----------
    decision : Wanted
        What is to be sent.
    scenario : Scenario
        The site: ratings and step length.
    soc : mapping of str to float
        State of charge of batteries as far as it is known.

    Returns
    -------
    dict
        Reason by kind, such as ``batteries``, and identifier.
    """
    found: dict[tuple[str, str], str] = {}
    for kind, reasons in (
        ("batteries", _batteries(decision, scenario, soc)),
        ("pv", _pv(decision, scenario)),
        ("customers", _customers(decision)),
        ("chargers", _chargers(decision, scenario)),
        ("thermal_loads", _thermal_loads(decision, scenario)),
        ("gensets", _gensets(decision, scenario)),
    ):
        found.update({(kind, name): reason for name, reason in reasons.items()})
    return found


def _batteries(decision: Wanted, scenario: Scenario, soc: Mapping[str, float]) -> dict[str, str]:
    """Ratings, the inverter's disc, and what is stored."""
    b = scenario.batteries
    table = decision.batteries
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


def _pv(decision: Wanted, scenario: Scenario) -> dict[str, str]:
    """What there is to be fed, and the inverter's disc."""
    pv = scenario.pv
    table = decision.pv
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


def _customers(decision: Wanted) -> dict[str, str]:
    """Served, or not."""
    served = decision.customers["served"]
    return {
        str(name): "supply is neither on nor off"
        for name, value in served.items()
        if not isinstance(value, (bool, np.bool_))
    }


def _chargers(decision: Wanted, scenario: Scenario) -> dict[str, str]:
    """Ratings of chargers."""
    table = decision.chargers
    if table is None:
        return {}
    chargers = scenario.chargers
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


def _thermal_loads(decision: Wanted, scenario: Scenario) -> dict[str, str]:
    """No room is cooled, and none is heated, beyond its comfort band."""
    table = decision.thermal_loads
    if table is None:
        return {}
    loads = scenario.thermal_loads
    setpoint_c = table["setpoint_c"].to_numpy(float)
    below_c = np.where(loads.heats, -np.inf, loads.t_min_c - setpoint_c)
    above_c = np.where(loads.heats, setpoint_c - loads.t_max_c, -np.inf)
    reasons = {
        "cooled below its comfort band": below_c - BAND_C,
        "heated above its comfort band": above_c - BAND_C,
    }
    return _named(list(loads.id), reasons, np.isfinite(setpoint_c))


def _gensets(decision: Wanted, scenario: Scenario) -> dict[str, str]:
    """Ratings of generating sets; what stands still gives nothing."""
    table = decision.gensets
    if table is None:
        return {}
    sets = scenario.gensets
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
