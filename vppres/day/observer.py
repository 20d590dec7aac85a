"""Observations of a run's controller: what it knows at the beginning of each step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from vppres.contract.ahead import KindsAhead, past_days_of
from vppres.contract.forecast import Forecast
from vppres.contract.observation import Observation
from vppres.contract.terminal import Terminal
from vppres.day.forecasting import DayForecasts
from vppres.day.outages import GridSeen, OutageView, grid_history
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Observer:
    """Observations of a scenario's steps, as its controller gets them or did."""

    scenario: Scenario
    options: Mapping[str, Any]  #: options of the run, as they are recorded
    forecaster: DayForecasts
    outages: OutageView  #: what it knows of outages

    @classmethod
    def of(
        cls, scenario: Scenario, options: Mapping[str, Any], forecaster: DayForecasts
    ) -> Observer:
        """Observations of a scenario, of outages as the options say."""
        return cls(scenario, options, forecaster, OutageView.create(scenario, options))

    def at(
        self,
        steps: range,
        states: Mapping[str, Any],
        forecast: Forecast | None = None,
        **measured: Any,
    ) -> Observation:
        """Observation of a window's steps: of outages no more than can be known at the first.

        ``states`` are those of the units by kind, and ``measured`` the other fields of the
        observation. The forecast is that of the forecaster if not given.
        """
        t = steps.start
        forecast = forecast or self.forecaster.at(t, steps)
        ends = steps.stop == self.scenario.grid.n_steps
        seen = Observation(
            t,
            forecast,
            ahead=KindsAhead.of(self.scenario, steps, states, self.past_days),
            terminal=Terminal.of(self.options.get("soc_end"), forecast, ends),
            ends=ends,
            **measured,
        )
        return self.outages.told(seen, self._grid_seen[t], self.scenario, t, self.forecaster)

    @cached_property
    def past_days(self) -> dict[str, Any]:
        """Past days that windows are expected to be like, by kind; None where none are."""
        return past_days_of(self.scenario, int(self.options["seed"]))

    @cached_property
    def _grid_seen(self) -> list[GridSeen]:
        return grid_history(self.scenario)
