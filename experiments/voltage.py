"""Figure 1b: lowest voltage in the optimisation and in the AC power flow."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments import ideal
from experiments.config import Config
from experiments.drawing import FULL, MPC, STYLES, day_axis, panels
from experiments.ideal import jobs as jobs
from experiments.published import V_MIN_AC_PU, V_MIN_MODEL_PU
from experiments.results import DayResult
from experiments.rows import Row, measured
from experiments.runner import Results
from vppres.report import plot

LABEL = "fig:1b"
TITLE = "Voltage comparison"
PAPER = (
    "The lowest voltage of the optimisation stays at or above its limit of 0.947 pu and the "
    "AC voltage above the limit of 0.94 pu, for both controllers. Averaged over the day the "
    "lowest AC voltage is 0.9607 pu (MPC) and 0.9601 pu (full horizon). The MPC's two "
    "voltages differ by less than 0.005 pu in every hour."
)


def figure(config: Config, results: Results) -> Figure:
    """Lowest voltages above, difference of optimisation and AC below."""
    days = ideal.days(config, results)
    picture, (lowest, error) = panels((3, 1.4), 5.8, "Lowest bus voltage, ideal conditions")
    plot.voltages(days, lowest)
    for name, day in days.items():
        plot.steps(error, day, 1000 * day.series("v_error_pu"), STYLES[name])
    plot.limit(lowest, V_MIN_MODEL_PU, "0.947 pu, optimisation limit")
    plot.limit(lowest, V_MIN_AC_PU, "0.94 pu, AC limit", "-")
    plot.limit(error, 5.0, "5")
    error.set_ylabel("Largest\n|optim. \N{MINUS SIGN} AC|\n(0.001 pu)")
    error.set_ylim(bottom=0.0)
    day_axis([lowest, error], days[MPC])
    return picture


def rows(config: Config, results: Results) -> list[Row]:
    """R4 to R7."""
    days = ideal.days(config, results)
    model = min(day.series("v_min_model_pu").min() for day in days.values())
    ac = min(day.summary["v_min_ac_pu"] for day in days.values())
    return [
        measured("R4", model, ".5f", reason=days[FULL].evidence),
        measured("R5", ac, ".4f", reason=days[FULL].evidence),
        measured(
            "R6a", days[MPC].summary["v_mean_of_min_ac_pu"], ".4f", reason=_means_text(days[MPC])
        ),
        measured(
            "R6b", days[FULL].summary["v_mean_of_min_ac_pu"], ".4f", reason=_means_text(days[FULL])
        ),
        measured("R7", days[MPC].summary["v_error_max_pu"], ".4f", reason=days[MPC].evidence),
    ]


def ours(config: Config, results: Results) -> str:
    """What our figure shows."""
    mpc, full = (day.summary for day in ideal.days(config, results).values())
    return (
        f"The lowest AC voltage is {mpc['v_min_ac_pu']:.4f} pu (MPC) and "
        f"{full['v_min_ac_pu']:.4f} pu (full horizon), its mean over the day "
        f"{mpc['v_mean_of_min_ac_pu']:.4f} and {full['v_mean_of_min_ac_pu']:.4f} pu. The "
        f"voltages of the optimisation are off by at most {mpc['v_error_max_pu']:.4f} and "
        f"{full['v_error_max_pu']:.4f} pu."
    )


def _means_text(day: DayResult) -> str:
    """Where the mean over the day comes from."""
    lowest_pu = day.series("v_min_ac_pu")
    in_outage = day.series("outage") > 0
    return (
        f"Mean with grid {lowest_pu[~in_outage].mean():.4f} pu, in the outage "
        f"{lowest_pu[in_outage].mean():.4f} pu; power factors and places of PV systems are "
        "drawn, and the sensitivities give the mean of every drawing."
    )
