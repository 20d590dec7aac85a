"""Figure 2c: random errors of the PV forecast."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments import forecast_errors, random_errors
from experiments.config import Config
from experiments.forecast_errors import jobs as jobs
from experiments.forecast_errors import ours as ours
from experiments.rows import Row
from experiments.runner import Results

LABEL = "fig:2c"
TITLE = "Effect of PV forecasting error"
PAPER = (
    "As for the load: the MPC stays robust under growing random error of the PV forecast, "
    "while the full horizon's actual performance degrades."
)


def figure(config: Config, results: Results) -> Figure:
    """Resilience and cost against the error level."""
    return forecast_errors.figure(
        config, results, "Random PV forecast error", "Growth of the standard deviation, alpha (1/h)"
    )


def rows(config: Config, results: Results) -> list[Row]:
    """R13, R14, R14b, R15 and R18."""
    return [
        *forecast_errors.rows(config, results, "PV error, alpha ="),
        random_errors.actual_row(config, results, "PV error"),
        random_errors.planned_row(config, results, "PV error"),
    ]
