"""Prices and import limits of steps that are over, as they were known when each was decided."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.scenario.scenario import Scenario
from vppres.service.announced import limits_kw, prices
from vppres.service.records import Event, seconds
from vppres.service.store import Store
from vppres.service.window import Window


@dataclass(frozen=True, eq=False)
class Told:
    """What was known of steps.

    Parameters
    ----------
    price_gbp_per_kwh, limit_kw : array, shape (T,)
        Import price and limit.
    """

    price_gbp_per_kwh: Floats
    limit_kw: Floats

    @classmethod
    def of(
        cls, scenario: Scenario, stored: Sequence[Mapping[str, Any] | None], store: Store
    ) -> Told:
        """What plans say of their steps; of those without one, what events said by then.

        Parameters
        ----------
        scenario : Scenario
            The steps, with the profile's prices and limits.
        stored : sequence of dict or None
            The plan of each.
        store : Store
            All versions of the events.
        """
        price = scenario.price_gbp_per_kwh.copy()
        limit = scenario.grid_limit_kw.copy()
        versions = store.events_ever()
        for t, (time, plan) in enumerate(zip(scenario.grid.times, stored, strict=True)):
            expected = (plan or {}).get("expected") or {}
            if "price_gbp_per_kwh" in expected:
                price[t] = expected["price_gbp_per_kwh"]
                limit[t] = _limit(expected["grid_limit_kw"])
            elif versions:
                window = _alone(scenario, t)
                said = _known_by(versions, time if plan is None else plan["generated_at"])
                price[t] = prices(said, window)[0]
                limit[t] = limits_kw(said, window)[0]
        return cls(price, limit)


def _limit(limit_kw: float | None) -> float:
    return np.inf if limit_kw is None else limit_kw


def _alone(scenario: Scenario, t: int) -> Window:
    """The window of one step."""
    row = slice(t, t + 1)
    step = pd.Timedelta(minutes=scenario.grid.step_minutes)
    series = {name: values[row] for name, values in scenario.series.items()}
    return Window(scenario.grid.times[row], step, series)


def _known_by(versions: Sequence[Sequence[Event]], time: Any) -> list[Event]:
    """Of each event what was said last by a time, those left out that were withdrawn."""
    at = seconds(pd.Timestamp(time))
    last = [next((one for one in reversed(each) if one.made_at <= at), None) for each in versions]
    return [one for one in last if one is not None and one.body]
