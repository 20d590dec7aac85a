"""Figure 1d: grid import, load and PV."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments import ideal
from experiments.config import Config
from experiments.drawing import FULL, MPC, day_axis, panels
from experiments.ideal import jobs as jobs
from experiments.results import DayResult
from experiments.rows import Row, asserted, measured
from experiments.runner import Results
from vppres.report import plot

LABEL = "fig:1d"
TITLE = "Grid import, total load, total PV"
PAPER = (
    "The import is largest at hour 2 and, with a grid, smallest at hour 6; it is zero in the "
    "outage, when PV and batteries serve a part of the load. MPC and full horizon nearly "
    "overlap."
)


def figure(config: Config, results: Results) -> Figure:
    """Imports of both controllers, load and PV in one panel."""
    days = ideal.days(config, results)
    picture, (ax,) = panels((1,), 4.8, "Grid import, load and PV, ideal conditions")
    plot.supply(days, ax)
    day_axis([ax], days[MPC])
    return picture


def rows(config: Config, results: Results) -> list[Row]:
    """R12, R22 and R23."""
    days = ideal.days(config, results)
    both = [row for name, day in days.items() for row in _rows_of(name, day)]
    mpc, full = (days[name].series("p_grid_kw") for name in (MPC, FULL))
    overlap = float(np.abs(mpc - full).mean() / mpc.mean())
    return [*both, measured("R12d", overlap, ".4f", reason=days[FULL].evidence)]


def ours(config: Config, results: Results) -> str:
    """What our figure shows."""
    day = ideal.days(config, results)[MPC]
    imported_kw = day.series("p_grid_kw")
    in_outage = day.series("outage") > 0
    served = day.series("served_kw")[in_outage].sum() / day.series("load_kw")[in_outage].sum()
    return (
        f"The MPC's import peaks at hour {imported_kw.argmax()} with {imported_kw.max():,.0f} "
        f"kW and is {imported_kw[6]:,.0f} kW at hour 6. In the outage the AC power flow takes "
        f"only the losses, at most {imported_kw[in_outage].max():.1f} kW, from the slack bus; "
        f"{served:.0%} of the load's energy is served."
    )


def _rows_of(name: str, day: DayResult) -> list[Row]:
    imported_kw = day.series("p_grid_kw")
    connected = day.series("outage") == 0
    island_kw = (imported_kw - day.series("losses_kw"))[~connected]
    curtailed = day.series("pv_curtailed_kw").sum() / day.series("pv_kw").sum()
    return [
        asserted(
            "R12a",
            {"at hour 2": int(imported_kw.argmax()) == 2},
            f"hour {imported_kw.argmax()}, {imported_kw.max():,.0f} kW",
            name,
            day.evidence,
        ),
        measured(
            "R12b", imported_kw[6] / imported_kw[connected].min() - 1.0, ".4f", name, day.evidence
        ),
        measured("R12c", float(np.abs(island_kw).max()), ".3f", name, day.evidence),
        measured(
            "R22", min(day.summary["served_share_connected"].values()), ".4f", name, day.evidence
        ),
        measured("R23", float(curtailed), ".5f", name, day.evidence),
    ]
