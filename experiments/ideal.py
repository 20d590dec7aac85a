"""The ideal day: perfect forecasts and fixed efficiencies, shared by the four parts of figure 1."""

from __future__ import annotations

from experiments.config import Config
from experiments.drawing import FULL, MPC
from experiments.jobs import Job
from experiments.results import DayResult
from experiments.runner import Results
from vppres.day.options import RunOptions

FULL_HORIZON = Job(options=RunOptions(controller="full-horizon"))


def mpc(horizon_h: float) -> Job:
    """The MPC's ideal day."""
    return Job(options=RunOptions(horizon_h=float(horizon_h)))


def jobs(config: Config) -> list[Job]:
    """The ideal day of both controllers."""
    return [mpc(config["horizon_h"]), FULL_HORIZON]


def days(config: Config, results: Results) -> dict[str, DayResult]:
    """Both ideal days by controller."""
    return {MPC: results[mpc(config["horizon_h"])], FULL: results[FULL_HORIZON]}
