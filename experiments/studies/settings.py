"""Settings of a weighted solve, and the paper's experiments seen at one of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from experiments import (
    battery_energy,
    biases,
    efficiency,
    forecast_errors,
    grid_import,
    ideal,
    prediction_horizon,
    random_errors,
    voltage,
)
from experiments.config import Config
from experiments.drawing import FULL
from experiments.jobs import Job
from experiments.results import DayResult
from experiments.rows import Row
from experiments.runner import Results
from experiments.weighted import WeightedChoices
from vppres.core.units import KW_PER_MW

PATIENCE_S = 600.0
"""Time limit of a window: it ends at its gap, on slow machines too."""
SIGNS = {"load_bias": 1, "pv_bias": -1}
"""Sign of the bias with which the plan expects too much need."""


@dataclass(frozen=True)
class Setting:
    """What a user of a solver chooses: nothing else differs between two settings."""

    unit_kw: float = 1.0  #: unit of power in the model in kW
    gap: float = 1e-4  #: relative gap
    solver: str = "highs"  #: name in the table of solvers
    seed: int = 0  #: the solver's

    def __str__(self) -> str:
        units = {1.0: "kW", KW_PER_MW: "MW"}
        unit = units.get(self.unit_kw, f"units of {self.unit_kw:g} kW")
        name = {"highs": "HiGHS", "scip": "SCIP"}.get(self.solver, self.solver)
        return f"{unit}, gap {self.gap:g}, {name}, seed {self.seed}"

    def of(self, job: Job) -> Job:
        """The same day, each window by one weighted solve."""
        limits = replace(job.options.limits, gap_rel=self.gap, time_s=PATIENCE_S)
        options = replace(job.options, solver=self.solver, limits=limits)
        return Job(job.day, options, WeightedChoices(unit_kw=self.unit_kw, seed=self.seed))


@dataclass(frozen=True)
class At(Mapping[Job, DayResult]):
    """Results in which every job is the same day at a setting; as they are without one."""

    setting: Setting | None
    results: Results

    def __getitem__(self, job: Job) -> DayResult:
        return self.results[job if self.setting is None else self.setting.of(job)]

    def __iter__(self) -> Iterator[Job]:
        return iter(self.results)

    def __len__(self) -> int:
        return len(self.results)


def jobs_of(config: Config) -> list[Job]:
    """Days of all rows that are looked at, as they are solved by default."""
    days = [*(ideal.mpc(h) for h in config["horizons_h"]), *ideal.jobs(config)]
    for part in (*_biases(config), *_errors(config)):
        days += [job for job in forecast_errors.jobs(part) if _follows_a_plan(job)]
    for scheme in config["schemes"]:
        days += efficiency.pair(_heated(config), scheme).values()
    return list(dict.fromkeys(days))


def rows_of(config: Config, results: Results) -> list[Row]:
    """Rows of the paper's table that need no other days than these."""
    rows = prediction_horizon.rows(config, results)
    for part in (voltage, battery_energy, grid_import):
        rows += part.rows(config, results)
    for bias in _biases(config):
        rows += _rows_of_bias(bias, results)
    rows += [random_errors.planned_row(part, results, "load error") for part in _errors(config)]
    if config["schemes"]:
        rows += efficiency.rows(_heated(config), results)
    return rows


def _rows_of_bias(part: Config, results: Results) -> list[Row]:
    """R16 or R17, whichever the quantity has."""
    sign = SIGNS[part["field"]]
    of_load = part["field"] == "load_bias"
    less, more = ("R16a", "R16b") if of_load else ("R17a", "R17b")
    return [
        *biases.underprepared(part, results, less, sign=-sign, costs_less=of_load),
        *biases.overprepared(part, results, more, sign=sign),
    ]


def _biases(config: Config) -> list[Config]:
    """Configurations of the two figures of biases, of the packaged day alone."""
    return [_packaged(field, config["biases"], 1) for field in SIGNS]


def _errors(config: Config) -> list[Config]:
    """That of the figure of random load errors, if it is looked at."""
    if not config["error_levels"]:
        return []
    return [_packaged("load_alpha_per_h", config["error_levels"], config["error_seeds"])]


def _packaged(field: str, levels: list[float], seeds: int) -> Config:
    return {"field": field, "levels": levels, "error_seeds": seeds, "builder_seeds": 0}


def _heated(config: Config) -> dict[str, Any]:
    """Configuration of the days with battery heating."""
    first, *others = config["schemes"]
    return {
        "horizon_h": config["heated_horizon_h"],
        "scheme": first,
        "other_schemes": others,
        "builder_seeds": 0,
    }


def _follows_a_plan(job: Job) -> bool:
    return job.options.controller == forecast_errors.CONTROLLERS[FULL]
