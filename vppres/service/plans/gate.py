"""The last check of set-points before they leave: arithmetic of its own, whatever decided them.

It knows ratings, what a battery holds and what there is to be fed, and neither model nor guard.
What does not pass is not sent; the device gets its default.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.kinds.batteries.physics import BatteriesAhead, power_beyond_kw
from vppres.kinds.table import parts
from vppres.live.range import POWER_KW, above_rating, slack_kw
from vppres.scenario.scenario import Scenario

SOC_SHARE = 1e-3
"""What solvers and rounding may be off by."""


def refusals(
    wanted: Mapping[str, pd.DataFrame], scenario: Scenario, soc: Mapping[str, float]
) -> dict[tuple[str, str], str]:
    """Set-points that may not be sent, with reasons.

    Reasons are by kind, such as ``batteries``, and identifier. ``soc`` has the states of charge of
    batteries as far as they are known.
    """
    found: dict[tuple[str, str], str] = {}
    for kind, table in wanted.items():
        numbers, excesses_of = CHECKS[kind]
        known = np.isfinite(table[list(numbers)].to_numpy(float)).all(axis=1)
        excesses = excesses_of(table, scenario, soc)
        for i, name in enumerate(getattr(scenario, kind).id):
            beyond = [reason for reason, excess in excesses.items() if excess[i] > 0]
            if beyond or not known[i]:
                found[kind, str(name)] = beyond[0] if known[i] else "no number"
    return found


Excesses = dict[str, Any]  # by how much each device exceeds a limit, by what is said of it


def _batteries(table: pd.DataFrame, scenario: Scenario, soc: Mapping[str, float]) -> Excesses:
    """Ratings, the inverter's disc, and what is stored."""
    b = scenario.batteries
    p_kw, q_kvar = _numbers(table, "p_kw", "q_kvar")
    held = np.array([soc.get(name, np.nan) for name in b.id], dtype=float)
    known = BatteriesAhead(b, held, b.eta_charge, b.eta_discharge, scenario.grid.dt_h)
    over, under = known.soc_beyond(known.after(p_kw))  # NaN where the charge is not known
    beyond = power_beyond_kw(b, np.maximum(p_kw, 0.0), np.maximum(-p_kw, 0.0), q_kvar)
    return {
        "power above its rating": beyond["power"] - slack_kw(b.p_max_kw),
        "apparent power above its rating": beyond["inverter"] - slack_kw(b.s_max_kva),
        "energy above its upper limit": over - SOC_SHARE,
        "energy below its lower limit": under - SOC_SHARE,
    }


def _pv(table: pd.DataFrame, scenario: Scenario, _: Mapping[str, float]) -> Excesses:
    """Check of PV power against what is available and the inverter's disc."""
    pv = scenario.pv
    p_kw, q_kvar, available_kw = _numbers(table, "p_kw", "q_kvar", "available_kw")
    return {
        "negative power": -p_kw - POWER_KW,
        "power above the available power": p_kw - available_kw - slack_kw(pv.p_max_kw),
        "apparent power above its rating": above_rating(np.hypot(p_kw, q_kvar), pv.s_max_kva),
    }


def _customers(table: pd.DataFrame, _: Scenario, __: Mapping[str, float]) -> Excesses:
    """Served, or not."""
    odd = [not isinstance(value, (bool, np.bool_)) for value in table["served"]]
    return {"supply is neither on nor off": odd}


def _of_kind(live: Any) -> Callable[..., Excesses]:
    """The check of a kind of flexible power, which asks for no state of charge."""
    return lambda table, scenario, _: live.excesses(table, scenario)


CHECKS: dict[str, tuple[tuple[str, ...], Callable[..., Excesses]]] = {
    "batteries": (("p_kw", "q_kvar"), _batteries),
    "pv": (("p_kw", "q_kvar"), _pv),
    "customers": ((), _customers),
    **{kind: (live.NUMBERS, _of_kind(live)) for kind, live in parts("live").items()},
}
"""Of each kind what must be a number, and what may exceed a limit."""


def _numbers(table: pd.DataFrame, *names: str) -> Iterator[Floats]:
    return (table[name].to_numpy(float) for name in names)
