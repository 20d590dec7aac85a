"""Course of a decision's plan in the steps after it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pandas as pd

from vppres.contract.decision import Decision
from vppres.contract.observation import Observation
from vppres.kinds.kind import UnitPlan
from vppres.kinds.live_fields import ForeseenOfKinds
from vppres.kinds.table import parts
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Foreseen(ForeseenOfKinds):
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

    @classmethod
    def of(cls, decision: Decision, window: Scenario, known: Observation) -> Foreseen:
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
            **_of_kinds(decision, window, known, times),
        )


def _of_kinds(
    decision: Decision, window: Scenario, known: Observation, times: pd.DatetimeIndex
) -> dict[str, pd.DataFrame]:
    """Planned course of each kind, of as many steps as the plan has."""
    found: dict[str, pd.DataFrame] = {}
    live, plan = parts("live"), decision.dispatch
    for kind, of in known.ahead.by_kind.items():
        units = getattr(window, kind)
        taken_kw = plan.taken_by(kind, units)[decision.row :]
        running = plan.running_of(kind, units)[decision.row :]
        on = units.connected(window.customers, plan.served[decision.row :])
        later = times[: len(taken_kw) - 1]
        ahead = of.part(slice(len(taken_kw)))
        of_units = UnitPlan(taken_kw, running, on)
        found |= live[kind].foreseen(window, ahead, of_units, later)
    return found
