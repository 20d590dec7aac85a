"""What a decision's plan foresees for the steps after it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from vppres.contract.decision import Decision
from vppres.contract.gensets import SetsAhead
from vppres.contract.observation import Observation
from vppres.contract.plugged import Plugged
from vppres.contract.rooms import Rooms
from vppres.day.vehicles import SHORT_KWH
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Foreseen:
    """The rest of a plan: what will be decided anew, step by step, with what is known by then.

    Parameters
    ----------
    served : DataFrame of bool, shape (W - 1, C)
        Who is meant to be supplied, by time and customer.
    soc_end : DataFrame, shape (W - 1, B)
        State of charge after each step, by time and battery.
    import_kw : Series, length W - 1
        Power from the grid as the plan has it, by time.
    indoor_c : DataFrame, shape (W - 1, H), or None
        Temperature of rooms and tanks after each step, by time and thermal load; None without any.
    left_short : DataFrame or None
        Vehicles that will leave with less than they need, by charger: ``vehicle``, ``leaves`` and
        ``short_kwh``; None without chargers.
    genset_kw, fuel_litres : DataFrame, shape (W - 1, G), or None
        What each generating set gives, 0 while it is off, and what is left in its tank after each
        step, by time and set; None without any.
    """

    served: pd.DataFrame
    soc_end: pd.DataFrame
    import_kw: pd.Series[float]
    indoor_c: pd.DataFrame | None = None
    left_short: pd.DataFrame | None = None
    genset_kw: pd.DataFrame | None = None
    fuel_litres: pd.DataFrame | None = None

    @classmethod
    def of(cls, decision: Decision, window: Scenario, told: Observation) -> Foreseen:
        """The rows of a decision's plan after its own; none where an answer is for one step."""
        plan = decision.dispatch
        rows = slice(decision.row + 1, plan.n_steps)
        ends = slice(decision.row + 2, plan.n_steps + 1)
        grid = replace(window.grid, n_steps=plan.n_steps - decision.row)
        times = grid.times[1:]
        return cls(
            pd.DataFrame(plan.served[rows], times, [str(name) for name in window.customers.id]),
            pd.DataFrame(plan.soc[ends], times, [str(name) for name in window.batteries.id]),
            pd.Series(plan.p_grid_kw[rows], times),
            _indoor_c(decision, window, told.ahead.rooms, times),
            _left_short(decision, window, told.ahead.plugged),
            *_of_sets(decision, window, told.ahead.gensets, times),
        )


def _indoor_c(
    decision: Decision, window: Scenario, rooms: Rooms | None, times: pd.DatetimeIndex
) -> pd.DataFrame | None:
    """Temperatures that the plan's powers lead to; those without power where it has none."""
    if rooms is None:
        return None
    loads = window.thermal_loads
    power_kw = decision.dispatch.taken_by("thermal_loads", loads)[decision.row :]
    t_c = rooms.part(slice(len(power_kw))).t_c(power_kw)
    return pd.DataFrame(t_c[1:], times[: len(t_c) - 1], [str(i) for i in loads.id])


def _left_short(
    decision: Decision, window: Scenario, plugged: Plugged | None
) -> pd.DataFrame | None:
    """Known vehicles that leave short within the plan; what leaves after it is not judged."""
    if plugged is None:
        return None
    chargers = window.chargers
    power_kw = decision.dispatch.taken_by("chargers", chargers)[decision.row :]
    ahead = plugged.part(slice(len(power_kw)))
    short_kwh = ahead.short_kwh(ahead.energy_kwh(power_kw, chargers, window.grid.dt_h))
    sessions = window.sessions
    _, after = sessions.steps(window.grid)
    rows = []
    for t, k in np.argwhere(ahead.known & (short_kwh > SHORT_KWH)).tolist():
        s = int(window.session_at[t, k])
        if after[s] == t + 1:  # what is due by the window's end alone is no departure
            who = (str(chargers.id[k]), str(sessions.vehicle[s]))
            rows.append((*who, sessions.plug_out[s], float(short_kwh[t, k])))
    return pd.DataFrame(rows, columns=["id", "vehicle", "leaves", "short_kwh"]).set_index("id")


def _of_sets(
    decision: Decision, window: Scenario, sets: SetsAhead | None, times: pd.DatetimeIndex
) -> tuple[pd.DataFrame | None, pd.DataFrame | None]:
    """What sets give and what is left in their tanks; nothing runs where a plan has none."""
    if sets is None:
        return None, None
    units, plan = window.gensets, decision.dispatch
    given_kw = -plan.taken_by("gensets", units)[decision.row :]
    on = plan.running_of("gensets", units)[decision.row :]
    known = sets.part(slice(len(on)))
    litres = known.fuel_litres(units, on, given_kw, window.grid.dt_h)
    names = [str(name) for name in units.id]
    ends = times[: len(on) - 1]
    return pd.DataFrame(given_kw[1:], ends, names), pd.DataFrame(litres[1:], ends, names)
