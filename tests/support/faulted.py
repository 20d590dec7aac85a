"""Random feeders with a fault, and their windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from benchmarks.frame.usual_battery import USUAL_BATTERY
from tests.support.small_windows import window
from vppres.model.data import WindowData
from vppres.model.parts import parts_of
from vppres.model.site import Site
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.faults import LineFault, OutOfService
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.scenario.timegrid import TimeGrid

START = pd.Timestamp("2022-07-19T10:00Z")
HOUR = pd.Timedelta(hours=1)
STEPS = 4
WEIGHT = {"critical": 1.0, "high": 0.1, "low": 0.02}


def faulted_day(seed: int, steps: int = STEPS) -> Scenario:
    """A random feeder with up to two faults, and in every third day an outage beside them."""
    rng = np.random.default_rng(seed)
    N = int(rng.integers(6, 13))
    at = np.arange(2, N + 1)
    parent = [int(rng.integers(max(1, bus - 3), bus)) for bus in at]
    C, B = N - 1, int(rng.integers(1, 4))
    owners = np.sort(rng.choice(C, size=C // 2, replace=False))
    tier = rng.choice([*WEIGHT], size=C).tolist()
    pv_max_kw = rng.uniform(10.0, 60.0, len(owners)).round(1)
    limit_kw = np.full(steps, np.inf)
    if seed % 3 == 0:
        limit_kw[1:3] = 0.0
    each = {name: np.full(B, value) for name, value in USUAL_BATTERY.items()}
    soc = rng.uniform(0.16, 0.84, B).round(3)
    batteries = Batteries(
        id=[f"b{i}" for i in range(B)],
        bus=rng.choice(at, B),
        energy_kwh=rng.uniform(100.0, 300.0, B).round(),
        p_max_kw=np.full(B, 60.0),
        s_max_kva=np.full(B, 80.0),
        soc_initial=soc,
        **each,
        grid_forming=np.ones(B, dtype=bool),
    )
    return Scenario(
        name=f"faulted-{seed}",
        title="A random feeder with a fault",
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(START, 60.0, steps),
        network=Network(
            parent,
            at,
            rng.uniform(0.05, 0.4, N - 1).round(3),
            rng.uniform(0.05, 0.3, N - 1).round(3),
            slack_bus=1,
            base_kv=11.0,
        ),
        customers=Customers(
            id=[f"c{bus}" for bus in at],
            bus=at,
            tier=tier,
            weight=[WEIGHT[name] for name in tier],
            power_factor=rng.uniform(0.9, 1.0, C).round(2),
        ),
        pv=PVSystems(
            id=[f"p{i}" for i in owners],
            customer=[f"c{at[i]}" for i in owners],
            p_max_kw=pv_max_kw,
            s_max_kva=pv_max_kw * 1.1,
        ),
        batteries=batteries,
        load_kw=rng.uniform(10.0, 60.0, (steps, C)).round(1),
        pv_kw=rng.uniform(0.2, 1.0, (steps, len(owners))).round(2) * pv_max_kw,
        price_gbp_per_kwh=rng.uniform(0.1, 0.5, steps).round(3),
        temperature_c=np.full(steps, 25.0),
        grid_limit_kw=limit_kw,
        faults=tuple(_faults(rng, at, steps)),
    )


def _faults(rng: np.random.Generator, at: np.ndarray, steps: int) -> list[LineFault]:
    found = []
    for place in rng.choice(at, size=int(rng.integers(1, 3)), replace=False).tolist():
        begin = int(rng.integers(0, steps - 1))
        end = int(rng.integers(begin + 1, steps + 1))
        of_bus = rng.random() < 0.2
        found.append(
            LineFault(
                START + begin * HOUR,
                START + end * HOUR,
                None if of_bus else place,
                place if of_bus else None,
                bool(rng.random() < 0.5),
            )
        )
    return found


def faulted_window(day: Scenario) -> WindowData:
    """All steps as one window that knows all faults."""
    data = window(day)
    out = OutOfService.of(day.faults, day.network, day.grid, range(day.grid.n_steps))
    site = Site.of(day)
    return replace(data, parts=parts_of(site, out, data.soc, data.dark, False))
