"""Forecasts of load and PV power in a run: a forecaster by name."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from vppres.contract.forecast import Forecast, ForecastErrors
from vppres.contract.forecast import Forecaster as PaperForecaster
from vppres.core.errors import InputError
from vppres.day.options import PERFECT, RunOptions
from vppres.forecasts.interface import ForecastMethod, LoadAndPV
from vppres.forecasts.quantile_file import read_quantiles
from vppres.forecasts.references import Climatology
from vppres.forecasts.seasonal import Seasonal
from vppres.scenario.history import History
from vppres.scenario.scenario import Scenario

PAPER = "paper"
FORECASTERS: dict[str, ForecastMethod] = {"seasonal": Seasonal(), "climatology": Climatology()}
"""Those that learn from what was measured, by the name of the option."""
MEMORY_DAYS = 80
"""Days before the present one that any of them looks at."""
FILE = "file"
BASIS = "forecast_basis"
OWN_SERIES = "the scenario's own series"


class DayForecasts(Protocol):
    """Forecasts of a scenario's day, as a run asks for them."""

    def at(self, t0: int, steps: range) -> Forecast:
        """Forecast at the beginning of step ``t0``; that step itself exactly."""
        ...


def basis_of(forecasts: DayForecasts, t: int) -> dict[str, str]:
    """Basis of a step's forecast, for its record; none for the paper's."""
    if not isinstance(forecasts, MeasuredForecasts):
        return {}
    return {BASIS: forecasts.bases.get(t, "")}


def forecasts_of(scenario: Scenario, options: RunOptions, errors: ForecastErrors) -> DayForecasts:
    """The forecasts of a run; ``errors`` are those of the paper's forecaster.

    Raises
    ------
    InputError
        If there are errors of the paper's forecaster for another one.
    """
    name = PAPER if options.controller == PERFECT else options.forecaster
    if name != PAPER and options.errors != ForecastErrors():
        raise InputError.of(
            "options",
            "makes its own errors, so that none can be given",
            f"Leave out biases and errors, or take the forecaster {PAPER}.",
            field="forecaster",
            value=name,
        )
    return named_forecasts(scenario, name, errors, options.seed, options.forecast_file)


def named_forecasts(
    scenario: Scenario, name: str, errors: ForecastErrors, seed: int, file: str | None = None
) -> DayForecasts:
    """Forecasts of a day by the forecaster's name.

    Raises
    ------
    InputError
        If forecasts are to come from a file and there is none, or with its problems.
    """
    if name == PAPER:
        return PaperForecaster(scenario, errors, seed)
    if name == FILE:
        if file is None:
            cure = "Give the file: --forecast-file FILE."
            raise InputError.of(
                "options", "needs a file of quantiles", cure, field="forecaster", value=FILE
            )
        step = scenario.grid.step
        return MeasuredForecasts(
            scenario, read_quantiles(file, scenario.customers.id, scenario.pv.id, lag=step)
        )
    return MeasuredForecasts(scenario, FORECASTERS[name])


class MeasuredForecasts:
    """Forecasts from what has been measured by the step, that step included, and nothing later.

    Prices, temperature and grid availability are those of the scenario. Of an item that was never
    measured, and of everything until a whole day has been, the scenario's own series are the
    forecast; ``bases`` says for each step what its forecast rested on.
    """

    def __init__(self, scenario: Scenario, forecaster: ForecastMethod) -> None:
        self.scenario = scenario
        self.forecaster = forecaster
        self.bases: dict[int, str] = {}
        self._given = PaperForecaster(scenario, ForecastErrors(), 0)
        self._before = history_before(scenario)

    def at(self, t0: int, steps: range) -> Forecast:
        """Forecast at the beginning of step ``t0``; that step itself exactly."""
        given = self._given.at(t0, steps)
        first = t0 + 1
        if steps.stop <= first:
            return given
        ahead = self._ahead(t0, steps.stop - first)
        load_kw, pv_kw = ahead.point()
        s = self.scenario
        rows = np.array(steps) - first
        later = (rows >= 0)[:, np.newaxis]
        return replace(
            given,
            load_kw=np.where(later & ~np.isnan(load_kw[rows]), load_kw[rows], given.load_kw),
            pv_kw=np.where(
                later & ~np.isnan(pv_kw[rows]), np.minimum(pv_kw[rows], s.pv.p_max_kw), given.pv_kw
            ),
        )

    def paths(self, t0: int, n_steps: int) -> LoadAndPV:
        """The forecast of the steps behind ``t0`` in full."""
        return self._ahead(t0, n_steps)

    def _ahead(self, t0: int, n_steps: int) -> LoadAndPV:
        grid = self.scenario.grid
        known = self._before.followed_by(
            grid.start, self.scenario.load_kw[: t0 + 1], self.scenario.pv_kw[: t0 + 1]
        ).last_days(MEMORY_DAYS + n_steps * grid.dt_h / 24.0)
        found = self.forecaster.forecast(known, grid.start + (t0 + 1) * known.step, n_steps)
        self._check_paths(found, t0, n_steps)
        unknown = found.basis in ("recent values", "nothing")
        self.bases[t0] = OWN_SERIES if unknown else found.basis
        if not unknown:
            return found
        none = np.full_like
        return replace(found, load_kw=none(found.load_kw, np.nan), pv_kw=none(found.pv_kw, np.nan))

    def _check_paths(self, found: LoadAndPV, t0: int, n_steps: int) -> None:
        """Refuse other steps or items and impossible powers, as your own forecaster may give."""
        shapes = [
            ("load_kw", n_steps, len(self.scenario.customers)),
            ("pv_kw", n_steps, len(self.scenario.pv)),
        ]
        for name, steps, items in shapes:
            values = np.asarray(getattr(found, name, None))
            shape = values.shape
            if len(shape) != 3 or shape[1:] != (steps, items):
                raise InputError.of(
                    f"forecast after step {t0}",
                    f"must have the shape (paths, {steps}, {items})",
                    "Return a LoadAndPV with an axis for paths, steps and items each.",
                    field=name,
                    value=str(shape),
                )
            odd = values[(values < 0.0) | np.isinf(values)]
            if len(odd):
                raise InputError.of(
                    f"forecast after step {t0}",
                    "must be 0 or more, and finite",
                    "NaN stands for what is not known: the scenario's own series are taken there.",
                    field=name,
                    value=float(odd[0]),
                )


def history_before(scenario: Scenario) -> History:
    """Measurements before a day, in its steps; empty where there are none."""
    grid = scenario.grid
    if scenario.history is None:
        none = (np.empty((0, len(scenario.customers))), np.empty((0, len(scenario.pv))))
        return History(grid.start, grid.step_minutes, *none, zone=grid.zone)
    return scenario.history.in_steps_of(grid.step_minutes).before(grid.start)
