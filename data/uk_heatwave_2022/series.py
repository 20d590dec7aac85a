"""The day's totals: real shapes, moved as little as possible until the published aggregates hold.

Each series ``x`` minimises ``sum_h (x_h - s_h)² / s_h`` for a real shape ``s`` under the paper's
aggregates as equalities, and under margins that keep each published extreme unique. Hours that no
margin binds keep the real shape exactly: they all move by one common factor.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cvxpy as cp
import numpy as np
import pandas as pd

from data.uk_heatwave_2022 import published
from vppres.core.arrays import Floats, freeze
from vppres.core.errors import InputError, Problem

PUBLIC_FIGURES = Path(__file__).with_name("public_figures.csv")

LOAD_MARGIN_KW = 10.0
PV_MARGIN_KW = 5.0
PRICE_MARGIN_GBP_PER_KWH = 0.005
TEMPERATURE_MARGIN_C = 0.3
# What a kWh sold at hour 6 must earn above the price of buying it back at hour 7.
RECHARGE_GAIN = 1.02
PRICES = ("A", "B")

# Totals are rounded coarsely enough that the solver's last digits cannot show.
POWER_DIGITS = 1
PRICE_DIGITS = 4
TEMPERATURE_DIGITS = 1


@cache
def public_figures() -> pd.DataFrame:
    """The public hourly figures of the day, 24 rows; README.md names their sources."""
    return pd.read_csv(PUBLIC_FIGURES, index_col="hour_utc")


@cache
def load_and_pv_kw() -> tuple[Floats, Floats]:
    """Total load and total PV power in kW, shape (24,) each; the net peak ties them together."""
    load_shape = _scaled(public_figures()["gb_transmission_demand_mw"], published.LOAD_PEAK_KW)
    pv_shape = _scaled(public_figures()["gb_embedded_solar_mw"], published.PV_TOTAL_KW)
    sun = np.flatnonzero(pv_shape > 0)
    load_kw = cp.Variable(published.STEPS)
    pv_kw = cp.Variable(published.STEPS)
    constraints = [
        cp.sum(load_kw) == published.LOAD_ENERGY_KWH,
        cp.sum(pv_kw) == published.PV_ENERGY_KWH,
        pv_kw[np.flatnonzero(pv_shape == 0)] == 0,
        *_peak(load_kw, published.LOAD_PEAK_HOUR, published.LOAD_PEAK_KW, LOAD_MARGIN_KW),
        *_peak(pv_kw, published.PV_PEAK_HOUR, published.PV_TOTAL_KW, PV_MARGIN_KW),
        *_peak(load_kw - pv_kw, published.NET_PEAK_HOUR, published.NET_PEAK_KW, LOAD_MARGIN_KW),
    ]
    _solve(_distance(load_kw, load_shape) + _distance(pv_kw[sun], pv_shape[sun]), constraints)
    return (
        freeze(np.round(load_kw.value, POWER_DIGITS)),
        freeze(np.abs(np.round(pv_kw.value, POWER_DIGITS))),
    )


@cache
def price_gbp_per_kwh(option: str) -> Floats:
    """Import price in GBP/kWh, shape (24,).

    Parameters
    ----------
    option : {"A", "B"}
        "A" meets the printed mean and extremes, the local minimum at hour 2 and the local maximum
        at hour 6. "B" also makes hour 7 the cheapest of the hours 7 to 11, and a kWh sold at hour
        6 worth buying back at hour 7: the paper tells that the full horizon's plan recharges
        there.
    """
    if option not in PRICES:
        raise InputError(
            Problem(
                "build",
                "is not a rebuild of the price",
                "Choose A or B.",
                field="price",
                value=option,
            )
        )
    real = public_figures()["gb_day_ahead_eur_per_mwh"].to_numpy()
    shape = real * published.PRICE_MEAN_GBP_PER_KWH / real.mean()
    price = cp.Variable(published.STEPS)
    constraints = _price_extremes(price)
    if option == "B":
        constraints += _recharging_at_the_alert(price)
    _solve(_distance(price, shape), constraints)
    return freeze(np.round(price.value, PRICE_DIGITS))


@cache
def temperature_c() -> Floats:
    """Ambient temperature in °C, shape (24,): reanalysis plus the smoothest correction.

    The correction takes hour 0 to the paper's initial ambient temperature and hour 15 to the
    record, which stays the day's only maximum.
    """
    real = public_figures()["reanalysis_temperature_c"].to_numpy()
    correction = cp.Variable(published.STEPS)
    hottest = 15  # the record stood by 15:12 UTC
    constraints = [
        correction[0] == published.T_AMBIENT_START_C - real[0],
        *_peak(real + correction, hottest, published.HOTTEST_C, TEMPERATURE_MARGIN_C),
    ]
    _solve(cp.sum_squares(cp.diff(correction)), constraints)
    return freeze(np.round(real + correction.value, TEMPERATURE_DIGITS))


def _price_extremes(price: cp.Variable) -> list[cp.Constraint]:
    """Mean, extremes, the local minimum and the local maximum."""
    margin = PRICE_MARGIN_GBP_PER_KWH
    trough = published.PRICE_LOCAL_MIN_HOUR
    top = published.PRICE_LOCAL_MAX_HOUR
    return [
        cp.sum(price) == published.STEPS * published.PRICE_MEAN_GBP_PER_KWH,
        *_peak(price, published.PRICE_MAX_HOUR, published.PRICE_MAX_GBP_PER_KWH, margin),
        *_peak(-price, published.PRICE_MIN_HOUR, -published.PRICE_MIN_GBP_PER_KWH, margin),
        price[trough] + margin <= price[[trough - 1, trough + 1]],
        price[top] - margin >= price[[top - 1, top + 1]],
    ]


def _recharging_at_the_alert(price: cp.Variable) -> list[cp.Constraint]:
    """Hour 7 is the cheapest of 7 to 11, and refills at a gain what was sold at hour 6."""
    alert = published.ALERT_HOUR
    round_trip = published.EFFICIENCY**2
    return [
        price[alert] + PRICE_MARGIN_GBP_PER_KWH <= price[alert + 1 : published.OUTAGE_START_HOUR],
        RECHARGE_GAIN * price[alert] <= round_trip * price[published.PRICE_LOCAL_MAX_HOUR],
    ]


def _peak(values: cp.Expression, hour: int, peak: float, margin: float) -> list[cp.Constraint]:
    """The only maximum, at an hour and of a value."""
    others = np.delete(np.arange(published.STEPS), hour)
    return [values[hour] == peak, values[others] <= peak - margin]


def _scaled(shape: pd.Series[float], peak: float) -> Floats:
    """A shape with its largest value at ``peak``."""
    values = np.asarray(shape, dtype=np.float64)
    return values * (peak / float(values.max()))


def _distance(values: cp.Expression, shape: Floats) -> cp.Expression:
    return cp.sum(cp.multiply(1 / shape, cp.square(values - shape)))


def _solve(distance: cp.Expression, constraints: list[cp.Constraint]) -> None:
    """Solve; an aggregate that cannot be met is an error, never a near miss."""
    problem = cp.Problem(cp.Minimize(distance), constraints)
    problem.solve(solver=cp.CLARABEL)
    if problem.status != cp.OPTIMAL:
        raise InputError("The published aggregates contradict each other.")
