"""What a decision's plan foresees for the steps after it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pandas as pd

from vppres.contract.decision import Decision
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
    """

    served: pd.DataFrame
    soc_end: pd.DataFrame
    import_kw: pd.Series[float]

    @classmethod
    def of(cls, decision: Decision, window: Scenario) -> Foreseen:
        """The rows of a decision's plan after its own; none where an answer is for one step.

        Parameters
        ----------
        decision : Decision
            What was decided.
        window : Scenario
            The site, beginning with the step that was decided.
        """
        plan = decision.dispatch
        rows = slice(decision.row + 1, plan.n_steps)
        ends = slice(decision.row + 2, plan.n_steps + 1)
        grid = replace(window.grid, n_steps=plan.n_steps - decision.row)
        times = grid.times[1:]
        return cls(
            pd.DataFrame(plan.served[rows], times, [str(name) for name in window.customers.id]),
            pd.DataFrame(plan.soc[ends], times, [str(name) for name in window.batteries.id]),
            pd.Series(plan.p_grid_kw[rows], times),
        )
