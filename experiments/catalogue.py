"""All experiments: those of the paper in its order, and further ones."""

from __future__ import annotations

from typing import Protocol

from matplotlib.figure import Figure

from experiments import (
    battery_energy,
    efficiency,
    grid_import,
    load_bias,
    load_error,
    prediction_horizon,
    pv_bias,
    pv_error,
    sensitivities,
    switching,
    voltage,
)
from experiments.config import Config
from experiments.jobs import Job
from experiments.rows import Row
from experiments.runner import Results


class Experiment(Protocol):
    """What a module of one figure or table offers."""

    @property
    def LABEL(self) -> str:  # the module's constant
        """The figure's label in the paper."""

    @property
    def TITLE(self) -> str:
        """The figure's title in the paper."""

    @property
    def PAPER(self) -> str:
        """What the paper says that it shows."""

    def jobs(self, config: Config) -> list[Job]:
        """Days it needs."""

    def figure(self, config: Config, results: Results) -> Figure:
        """Its figure."""

    def rows(self, config: Config, results: Results) -> list[Row]:
        """Its statements, beside what was found."""

    def ours(self, config: Config, results: Results) -> str:
        """What the figure shows, in a sentence."""


EXPERIMENTS: dict[str, Experiment] = {
    "prediction_horizon": prediction_horizon,
    "voltage": voltage,
    "battery_energy": battery_energy,
    "grid_import": grid_import,
    "load_error": load_error,
    "load_bias": load_bias,
    "pv_error": pv_error,
    "pv_bias": pv_bias,
    "efficiency": efficiency,
    "sensitivities": sensitivities,
}
"""By name, which is that of the module, of its configuration and of its figure's files."""

FURTHER: dict[str, Experiment] = {
    "switching": switching,
}
"""Beyond the paper: run only where they are named."""

ALL = EXPERIMENTS | FURTHER
