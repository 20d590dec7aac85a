"""Figure 2b: bias of the load forecast."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments import biases, forecast_errors
from experiments.config import Config
from experiments.forecast_errors import jobs as jobs
from experiments.forecast_errors import ours as ours
from experiments.rows import Row
from experiments.runner import Results

LABEL = "fig:2b"
TITLE = "Effect of load forecasting bias"
PAPER = (
    "Where the load is underestimated, the full horizon charges less, pays less and loses "
    "resilience. Where it is overestimated, the plan charges more and costs more, and "
    "resilience falls too: planned discharge exceeds the actual load, and the corrections "
    "exhaust the batteries early. The MPC keeps its resilience under both."
)


def figure(config: Config, results: Results) -> Figure:
    """Resilience and cost against the bias."""
    return forecast_errors.figure(
        config, results, "Load forecast bias", "Bias of the load forecast (share)"
    )


def rows(config: Config, results: Results) -> list[Row]:
    """R13, R14, R16 and R18."""
    return [
        *forecast_errors.rows(config, results, "load bias"),
        *biases.underprepared(config, results, "R16a", sign=-1, costs_less=True),
        *biases.overprepared(config, results, "R16b", sign=1),
    ]
