"""A day's faults, drawn."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from vppres.day.faults import (
    QUANTITIES,
    SOLVER_FAULTS,
    BatteryTrip,
    FaultPlan,
    MeasurementFault,
    Quantity,
    SolverOutage,
)
from vppres.scenario.scenario import Scenario

PV_FORECAST_OFF = 0.5


def drawn_faults(scenario: Scenario, seed: int) -> FaultPlan:
    """A day's faults, drawn: each kind appears on about every other day.

    Parameters
    ----------
    scenario : Scenario
        The day.
    seed : int
        Seed; the same seed and scenario give the same faults.
    """
    rng = np.random.default_rng([seed, 20220719])
    steps = scenario.grid.n_steps
    failing = np.flatnonzero(rng.random(steps) < rng.choice([0.0, 0.1, 0.3]))
    solver = {
        int(t): SolverOutage(rng.choice(np.array(SOLVER_FAULTS)).item(), bool(rng.random() < 0.7))
        for t in failing
    }
    measurements = tuple(
        _draw_measurement(rng, scenario, quantity) for quantity in QUANTITIES if rng.random() < 0.4
    )
    n_batteries = len(scenario.batteries)
    trips = (_draw_trip(rng, n_batteries, steps),) if n_batteries and rng.random() < 0.5 else ()
    bias = float(rng.choice([0.0, -PV_FORECAST_OFF, PV_FORECAST_OFF]))
    return FaultPlan(solver, measurements, trips, bias)


def _draw_measurement(rng: Generator, scenario: Scenario, quantity: Quantity) -> MeasurementFault:
    """A fault of some hours, of all items or of about a third of them."""
    count = {
        "soc": len(scenario.batteries),
        "load": len(scenario.customers),
        "pv": len(scenario.pv),
    }[quantity]
    start, end = _draw_interval(rng, scenario.grid.n_steps)
    some = tuple(int(i) for i in np.flatnonzero(rng.random(count) < 1 / 3))
    return MeasurementFault(
        quantity, bool(rng.random() < 0.5), start, end, some if rng.random() < 0.5 else None
    )


def _draw_trip(rng: Generator, n_batteries: int, n_steps: int) -> BatteryTrip:
    """A battery out for some hours or the rest of the day, reported or silently."""
    start, end = _draw_interval(rng, n_steps)
    return BatteryTrip(
        int(rng.integers(n_batteries)),
        start,
        n_steps if rng.random() < 0.5 else end,
        bool(rng.random() < 0.3),
    )


def _draw_interval(rng: Generator, n_steps: int) -> tuple[int, int]:
    """Some steps from anywhere in the day on, at least one and at most a third of the day."""
    start = int(rng.integers(n_steps))
    return start, min(n_steps, start + int(rng.integers(1, max(n_steps // 3, 1) + 1)))
