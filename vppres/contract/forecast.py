"""Forecast of the steps ahead: the actual series with forecast errors (paper).

A forecast error is a bias that holds in full from the next step on and a random error whose
standard deviation grows with the distance. The current step is known exactly; prices, grid
availability and temperature are known perfectly, as in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from vppres.core.arrays import Floats, Wholes, freeze_arrays
from vppres.core.errors import InputError
from vppres.kinds.export.physics import Export
from vppres.scenario.faults import OutOfService
from vppres.scenario.option_table import check_group
from vppres.scenario.scenario import Scenario

Kind = Literal["load", "pv"]

STREAM_OF_KIND: dict[Kind, int] = {"load": 0, "pv": 1}
"""Last entry of the key of a random stream. Changing it changes every seeded result."""


@dataclass(frozen=True)
class ForecastErrors:
    """Size of the forecast errors, all zero by default."""

    #: Share by which the forecast is too high (negative: too low), from -1.
    load_bias: float = 0.0
    #: Growth of the relative standard deviation per hour ahead.
    load_alpha_per_h: float = 0.0
    pv_bias: float = 0.0
    pv_alpha_per_h: float = 0.0

    def __post_init__(self) -> None:
        check_group("errors", self)


@dataclass(frozen=True, eq=False)
class Forecast:
    """Forecast of a window of W steps; the arrays are read-only."""

    load_kw: Floats  #: demand of each customer if served, (W, C)
    pv_kw: Floats  #: available power of each PV system, (W, P)
    #: Import price, largest import, ambient temperature, (W,).
    price_gbp_per_kwh: Floats
    grid_limit_kw: Floats
    temperature_c: Floats
    #: What the grid takes back, None where the connection imports only.
    export: Export | None = None
    out: OutOfService = field(kw_only=True)  #: lines and buses that are out, as far as it is known

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def first(self, n_steps: int) -> Forecast:
        """The first steps alone."""
        steps = slice(n_steps)
        return Forecast(
            self.load_kw[steps],
            self.pv_kw[steps],
            self.price_gbp_per_kwh[steps],
            self.grid_limit_kw[steps],
            self.temperature_c[steps],
            self.export and self.export.part(steps),
            out=self.out.part(steps),
        )

    @property
    def in_parts_now(self) -> bool:
        """Whether lines are out in the first step."""
        return bool(self.out.lines[0].any())

    @property
    def export_now_kw(self) -> float:
        """Largest export in the first step, 0 where the connection imports only."""
        return 0.0 if self.export is None else float(self.export.limit_kw[0])


class Forecaster:
    """Forecasts of a scenario's day.

    The errors are drawn afresh at every cycle ``t0``, each step and kind from its own stream, keyed
    by seed, ``t0``, step and kind. A forecast therefore depends neither on the length of the window
    nor on what was asked before.

    Parameters
    ----------
    scenario : Scenario
        The actual day.
    errors : ForecastErrors
        Size of the errors.
    seed : int
        Seed of all streams, not negative.

    Raises
    ------
    InputError
        If the seed is negative.
    """

    def __init__(self, scenario: Scenario, errors: ForecastErrors, seed: int) -> None:
        if seed < 0:
            raise InputError.of(
                "options",
                "must not be negative",
                "Give a whole number from zero.",
                field="seed",
                value=seed,
            )
        self.scenario = scenario
        self.errors = errors
        self.seed = seed

    def at(self, t0: int, steps: range) -> Forecast:
        """Forecast that is issued at the beginning of step ``t0``.

        Parameters
        ----------
        t0 : int
            The current step.
        steps : range
            Steps to forecast, none before ``t0`` or after the end of the day.

        Returns
        -------
        Forecast
            ``W = len(steps)``.

        Raises
        ------
        InputError
            If a step lies outside ``t0 .. T - 1``.
        """
        rows = self._checked(t0, steps)
        s = self.scenario
        e = self.errors
        load_error = e.load_bias + self._random("load", e.load_alpha_per_h, t0, rows)
        pv_error = e.pv_bias + self._random("pv", e.pv_alpha_per_h, t0, rows)
        load = np.maximum(s.load_kw[rows] * (1.0 + load_error), 0.0)
        pv = np.clip(s.pv_kw[rows] * (1.0 + pv_error), 0.0, s.pv.p_max_kw)
        ahead = (rows > t0)[:, np.newaxis]
        return Forecast(
            np.where(ahead, load, s.load_kw[rows]),
            np.where(ahead, pv, s.pv_kw[rows]),
            s.price_gbp_per_kwh[rows],
            s.grid_limit_kw[rows],
            s.temperature_c[rows],
            Export.of(s, rows),
            out=s.out_of_service(steps, known_at=t0),
        )

    def _checked(self, t0: int, steps: range) -> Wholes:
        """The steps as an array, none of them in the past or after the day."""
        rows = np.array(steps, dtype=np.int64)
        last = self.scenario.grid.n_steps - 1
        outside = rows[(rows < t0) | (rows > last)]
        if len(outside):
            raise InputError.of(
                "forecast",
                f"lies outside {t0} .. {last}",
                "Ask for steps from the current one to the last of the day.",
                field="step",
                value=int(outside[0]),
            )
        return rows

    def _random(self, kind: Kind, alpha_per_h: float, t0: int, rows: Wholes) -> Floats:
        """Normal draws whose standard deviation grows with the hours ahead, shape (W, items)."""
        items = len(self.scenario.customers if kind == "load" else self.scenario.pv)
        spread = np.zeros((len(rows), items))
        for row, step in enumerate(rows) if alpha_per_h else ():
            key = np.random.SeedSequence([self.seed, t0, int(step), STREAM_OF_KIND[kind]])
            draws = np.random.Generator(np.random.PCG64(key)).standard_normal(items)
            spread[row] = draws * (step - t0) * self.scenario.grid.dt_h
        return alpha_per_h * spread
