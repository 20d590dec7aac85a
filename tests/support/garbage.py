"""Garbage at the Python door: a controller refuses it by name or answers within ratings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator

from benchmarks.frame.random_feeders import random_scenario
from vppres.core.arrays import Names
from vppres.core.errors import VppresError
from vppres.day.options import RunOptions
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.live.set_points import SetPoints
from vppres.scenario.scenario import Scenario

MEASUREMENTS = 30
STEPS = 4
TOLERANCE = 1e-6
"""On ratings (kW, kVA) and states of charge: rounding, nothing else."""

INTERNAL = "The step failed"
"""How a controller words an error that nobody foresaw: there must be none."""


class Silent:
    """A value that cannot even be shown."""

    def __str__(self) -> str:
        raise RuntimeError("no text")

    __repr__ = __str__


ODD_VALUES: tuple[Any, ...] = (
    "", "0.5", "nan", "\x00", "\x1b[31mred", "$x$", "../..", [], [0.5], {}, {"soc": 0.5}, None,
    pd.NA, pd.NaT, float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 5e-324, 10**400, True,
    np.bool_(False), 1j, Decimal("0.5"), Fraction(1, 3), object(), Silent(), b"0.5",
    np.array([1.0, 2.0]), np.array(0.5), np.float32(0.5), np.int64(1), -0.0, -1.0,
    pd.Timestamp("2022-07-19T00:00Z"), print, {1, 2}, (1, 2), range(3),
    np.datetime64("2022-07-19"),
)  # fmt: skip

ODD_NAMES: tuple[Any, ...] = (
    "", "c999", "\x00", "\x1b", "c1 ", 5, 5.0, None, True, ("c1", "c2"), float("nan"), b"c1",
    "x" * 1000, pd.Timestamp("2022-07-19"),
)  # fmt: skip

ODD_TIMES: tuple[Any, ...] = (
    None, "", "noon", "2022-07-19", "2022-07-19T00:00", "2022-13-45T00:00Z", 0, 1e308, pd.NaT,
    pd.NA, "1-01-01T00:00Z", pd.Timestamp("2022-07-19"), np.datetime64("2022-07-19"), [], {},
    Silent(), "2022-07-19T00:00:00.5Z", "9999-12-31T23:59Z", True,
)  # fmt: skip

ODD_TABLES: tuple[Any, ...] = (
    5, "soc", [0.5], {0.5}, np.zeros(3), pd.Series(dtype=float), pd.DataFrame(), pd.Index(["c1"]),
    pd.Series([1.0, 2.0], index=["c1", "c1"]),
    pd.Series([1.0], index=pd.MultiIndex.from_tuples([("c1", "a")])),
    pd.DataFrame([[1.0, 2.0]], columns=["c1", "c1"]), pd.DataFrame({"c1": ["a"]}),
    pd.DataFrame({"c1": [1.0]}, index=pd.DatetimeIndex(["2022-07-19"])), Silent(), print,
)  # fmt: skip


def run_one(seed: int, count: int = MEASUREMENTS) -> tuple[int, list[str]]:
    """Give a controller of a random feeder measurement after measurement.

    Returns how many were refused by name, and what is wrong: any other error, and set-points beyond
    what devices can do.
    """
    rng = np.random.default_rng([seed, 4711])
    scenario = random_scenario(seed, n_steps=STEPS)
    mode = "physical" if seed % 4 == 3 else "paper"
    options = RunOptions(horizon_h=0.0, isolate=False, guard=seed % 5 != 4, mode=mode)
    controller = Controller.of(scenario, options)
    refused, wrong = 0, list[str]()
    for number in range(count):
        now = scenario.grid.times[min(STEPS * number // count, STEPS - 1)]
        try:
            found = beyond_limits(scenario, controller.step(garbage(rng, scenario, now)))
        except VppresError as error:
            refused += 1
            found = [str(error)] if str(error).startswith(INTERNAL) else []
        except Exception as error:
            found = [f"{type(error).__name__}: {error}"]
        wrong += [f"seed {seed}, measurement {number}: {text}" for text in found]
    return refused, wrong


def garbage(rng: Generator, scenario: Scenario, now: pd.Timestamp) -> Measurement:
    """A measurement that is odd in no, some or all places."""
    odd = float(rng.choice([0.0, 0.01, 0.1, 0.7], p=[0.3, 0.3, 0.3, 0.1]))
    b = scenario.batteries
    rating = float(b.s_max_kva.max(initial=1.0))
    draws: dict[str, Callable[[], Any]] = {
        "soc": lambda: _table(rng, odd, b.id, lambda: _extreme(rng, 0.0, 1.0)),
        "load_kw": lambda: _table(
            rng, odd, scenario.customers.id, lambda: _extreme(rng, -10.0, 300.0, 1e6)
        ),
        "pv_kw": lambda: _table(rng, odd, scenario.pv.id, lambda: _extreme(rng, -1.0, 100.0, 1e6)),
        "price_gbp_per_kwh": lambda: _value(rng, odd, _extreme(rng, -0.5, 1.0, 1e4)),
        "grid_limit_kw": lambda: _value(rng, odd, _extreme(rng, 0.0, 500.0, 1e9)),
        "eta_charge": lambda: _table(rng, odd, b.id, lambda: _extreme(rng, 0.1, 1.0)),
        "eta_discharge": lambda: _table(rng, odd, b.id, lambda: _extreme(rng, 0.1, 1.0)),
        "battery_kw": lambda: _table(rng, odd, b.id, lambda: _extreme(rng, -rating, rating)),
        "online": lambda: _table(rng, odd, b.id, lambda: bool(rng.random() < 0.7)),
        "import_kw": lambda: _value(rng, odd, _extreme(rng, -100.0, 1000.0, 1e7)),
    }
    given = {name: draw() for name, draw in draws.items() if rng.random() < 0.5}
    moment: Any = now if rng.random() < 0.5 else now.isoformat()
    return Measurement(_pick(rng, ODD_TIMES) if rng.random() < odd else moment, **given)


def beyond_limits(scenario: Scenario, done: SetPoints) -> list[str]:
    """Set-points that no device can carry out, each in words."""
    b = scenario.batteries
    p = done.batteries["p_kw"].to_numpy(float)
    q = done.batteries["q_kvar"].to_numpy(float)
    soc = done.batteries["soc_end"].to_numpy(float)
    pv_p = done.pv["p_kw"].to_numpy(float)
    pv_s = np.hypot(pv_p, done.pv["q_kvar"].to_numpy(float))
    excess = {
        "battery rating": np.abs(p) - np.minimum(b.p_max_kw, b.s_max_kva),
        "battery disc": np.hypot(p, q) - b.s_max_kva,
        "state of charge": np.maximum(soc - b.soc_max, b.soc_min - soc),
        "pv disc": pv_s - scenario.pv.s_max_kva,
        "pv sign": -pv_p,
    }
    # NaN is beyond every limit.
    return [
        f"{name} by {np.max(values):g}"
        for name, values in excess.items()
        if len(values) and not np.max(values) <= TOLERANCE
    ]


def _table(rng: Generator, odd: float, names: Names, draw: Callable[[], Any]) -> Any:
    """Values by identifier, some of which are left out, odd or of nobody."""
    if rng.random() < odd:
        return _pick(rng, ODD_TABLES)
    kept = [name for name in names if rng.random() < 0.8]
    values = {name: _value(rng, odd, draw()) for name in kept}
    if rng.random() < odd:
        values[_pick(rng, ODD_NAMES)] = draw()
    return pd.Series(values, dtype=object) if rng.random() < 0.3 else values


def _value(rng: Generator, odd: float, usual: Any) -> Any:
    return _pick(rng, ODD_VALUES) if rng.random() < odd else usual


def _extreme(rng: Generator, low: float, high: float, largest: float | None = None) -> float:
    """A usual number, an end of its range, a tiny one, nothing, or the largest that passes."""
    kind = rng.random()
    if kind < 0.8:
        return float(rng.uniform(low, high))
    ends = [low, high, 0.0, 1e-300, float("nan"), high if largest is None else largest]
    return float(rng.choice(ends))


def _pick(rng: Generator, pool: Sequence[Any]) -> Any:
    return pool[int(rng.integers(len(pool)))]
