"""Random days: drawings of the paper's day with random outages, and small random feeders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.random import Generator

import data.uk_heatwave_2022.build as builder
from benchmarks.frame.random_feeders import names
from benchmarks.frame.usual_battery import USUAL_BATTERY
from experiments.jobs import Day, scenario
from vppres.contract.forecast import ForecastErrors
from vppres.core.arrays import Floats
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.scenario.timegrid import TimeGrid

DRAWINGS = 5
"""Drawings of the paper's unpublished data; few, since every one has problems of its own."""

LARGE_SHARE = 0.4
SMALL_STEPS = 12
WEIGHT = {"critical": 1.0, "high": 0.1, "low": 0.02}


@dataclass(frozen=True, eq=False)
class RandomDay:
    """A day to run."""

    seed: int  #: makes the same day again
    scenario: Scenario  #: the actual day
    errors: ForecastErrors  #: sizes of its forecast errors


def random_day(seed: int) -> RandomDay:
    """A day from its seed: the paper's feeder in two of five, a small feeder in the others."""
    rng = np.random.default_rng([seed, 8086])
    errors = ForecastErrors(
        *(
            float(x)
            for x in (
                rng.uniform(-0.1, 0.1),
                rng.uniform(0.0, 0.1),
                rng.uniform(-0.2, 0.2),
                rng.uniform(0.0, 0.1),
            )
        )
    )
    if rng.random() < LARGE_SHARE:
        return RandomDay(seed, heatwave_day(rng), errors)
    return RandomDay(seed, small_day(rng, seed), errors)


def heatwave_day(rng: Generator) -> Scenario:
    """A drawing of the paper's day with one outage of 2 to 8 h at any time."""
    drawing = builder.SEED + int(rng.integers(DRAWINGS))
    day = scenario(Day(seed=drawing))
    hours = int(rng.integers(2, 9))
    first = day.grid.times[int(rng.integers(0, day.grid.n_steps - hours + 1))]
    return day.with_outage(first, first + pd.Timedelta(hours=hours))


def small_day(rng: Generator, seed: int) -> Scenario:
    """Twelve hours on a random tree of 5 to 10 buses with one outage of 2 to 6 h."""
    n_buses = int(rng.integers(5, 11))
    bus = np.arange(2, n_buses + 1)
    tier = rng.choice(list(WEIGHT), len(bus))
    peak_kw = rng.uniform(20.0, 150.0, len(bus))
    owners = np.flatnonzero(rng.random(len(bus)) < 0.6)
    panel_kw = peak_kw[owners] * rng.uniform(0.2, 1.0, len(owners))
    hour = np.arange(SMALL_STEPS) + 7.0
    sun = np.clip(np.sin((hour - 5.0) / 15.0 * np.pi), 0.0, None)
    cloud = rng.uniform(0.6, 1.0, (SMALL_STEPS, len(owners)))
    begin = int(rng.integers(1, SMALL_STEPS - 1))
    length = int(rng.integers(2, 7))
    dark = (np.arange(SMALL_STEPS) >= begin) & (np.arange(SMALL_STEPS) < begin + length)
    return Scenario(
        name=f"random-{seed}",
        title="Random feeder",
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(pd.Timestamp("2022-07-19T07:00", tz="UTC"), 60.0, SMALL_STEPS),
        network=_tree(rng, n_buses, peak_kw),
        customers=Customers(
            id=names("c", bus),
            bus=bus.astype(object),
            tier=tier,
            weight=np.array([WEIGHT[name] for name in tier]),
            power_factor=rng.uniform(0.9, 1.0, len(bus)),
        ),
        pv=PVSystems(
            id=names("p", bus[owners]),
            customer=names("c", bus[owners]),
            p_max_kw=panel_kw,
            s_max_kva=1.1 * panel_kw,
        ),
        batteries=_batteries(rng, n_buses, float(peak_kw.sum())),
        load_kw=peak_kw * rng.uniform(0.5, 1.0, (SMALL_STEPS, len(bus))),
        pv_kw=sun[:, None] * panel_kw * cloud,
        price_gbp_per_kwh=rng.uniform(0.1, 0.6, SMALL_STEPS),
        temperature_c=np.full(SMALL_STEPS, 30.0),
        grid_limit_kw=np.where(dark, 0.0, np.inf),
    )


def _tree(rng: Generator, n_buses: int, peak_kw: Floats) -> Network:
    """A random tree, strong enough that full load keeps its voltages, within about 3 %."""
    above = [int(rng.integers(max(1, n - 3), n)) for n in range(2, n_buses + 1)]
    r = rng.uniform(0.3, 1.0, n_buses - 1)
    # The deepest bus lies below all lines at worst: the sum bounds every drop of voltage.
    scale = 0.03 * 1000.0 * 11.0**2 / (float(peak_kw.sum()) * float(r.sum()))
    below = np.arange(2, n_buses + 1).astype(object)
    return Network(
        np.array(above, dtype=object), below, r * scale, 0.6 * r * scale, slack_bus=1, base_kv=11.0
    )


def _batteries(rng: Generator, n_buses: int, peak_kw: float) -> Batteries:
    """One to four batteries that differ in size and state."""
    count = int(rng.integers(1, 5))
    p = peak_kw * rng.uniform(0.05, 0.3, count)
    constants = {**USUAL_BATTERY, "t_initial_c": 30.0}
    return Batteries(
        id=names("b", np.arange(count)),
        bus=rng.integers(2, n_buses + 1, count).astype(object),
        energy_kwh=p * rng.uniform(1.0, 4.0, count),
        p_max_kw=p,
        s_max_kva=1.2 * p,
        soc_initial=rng.uniform(0.15, 0.85, count),
        **{name: np.full(count, value) for name, value in constants.items()},
    )
