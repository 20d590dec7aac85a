"""Figure 2d: bias of the PV forecast."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments import biases, forecast_errors
from experiments.config import Config
from experiments.forecast_errors import jobs as jobs
from experiments.forecast_errors import ours as ours
from experiments.rows import Row
from experiments.runner import Results

LABEL = "fig:2d"
TITLE = "Effect of PV forecasting bias"
PAPER = (
    "The mirror image of the load bias. PV power that is overestimated leaves batteries short "
    "and resilience low; PV power that is underestimated gives a surplus in the island that "
    "cannot be exported, corrections, and early depletion. The MPC keeps its resilience under "
    "both."
)


def figure(config: Config, results: Results) -> Figure:
    """Resilience and cost against the bias."""
    return forecast_errors.figure(
        config, results, "PV forecast bias", "Bias of the PV forecast (share)"
    )


def rows(config: Config, results: Results) -> list[Row]:
    """R13, R14, R17 and R18."""
    return [
        *forecast_errors.rows(config, results, "PV bias"),
        *biases.underprepared(config, results, "R17a", sign=1, costs_less=False),
        *biases.overprepared(config, results, "R17b", sign=-1),
    ]
