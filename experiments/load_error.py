"""Figure 2a: random errors of the load forecast."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments import forecast_errors, random_errors
from experiments.config import Config
from experiments.forecast_errors import jobs as jobs
from experiments.forecast_errors import ours as ours
from experiments.rows import Row
from experiments.runner import Results

LABEL = "fig:2a"
TITLE = "Effect of load forecasting error"
PAPER = (
    "With growing random error of the load forecast the MPC keeps its resilience. The full "
    "horizon's plan degrades moderately; what it reaches in fact degrades severely, since "
    "plans become infeasible and are replaced by one-step decisions without look-ahead."
)


def figure(config: Config, results: Results) -> Figure:
    """Resilience and cost against the error level."""
    return forecast_errors.figure(
        config,
        results,
        "Random load forecast error",
        "Growth of the standard deviation, alpha (1/h)",
    )


def rows(config: Config, results: Results) -> list[Row]:
    """R13, R14, R14b, R15 and R18."""
    return [
        *forecast_errors.rows(config, results, "load error, alpha ="),
        random_errors.actual_row(config, results, "load error"),
        random_errors.planned_row(config, results, "load error"),
    ]
