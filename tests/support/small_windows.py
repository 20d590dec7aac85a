"""Windows of two buses that are solved by hand, and windows cut from days."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from benchmarks.frame.usual_battery import USUAL_BATTERY
from vppres.contract.forecast import Forecast
from vppres.contract.observation import Observation
from vppres.control.step_state import StepState
from vppres.core.arrays import Floats
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import Owed, SwitchingState
from vppres.kinds.export.physics import Export
from vppres.model.data import WindowData
from vppres.model.parts import Parts
from vppres.model.site import Site
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.scenario.timegrid import TimeGrid

CHECKER_TOLERANCE = 1e-5
DARK, OPEN = 0.0, np.inf


def two_buses(
    load_kw: Sequence[Sequence[float]],
    weights: Sequence[float],
    grid_limit_kw: Sequence[float],
    price: Sequence[float] | float = 0.3,
    r_ohm: float = 0.01,
) -> Scenario:
    """Customers of power factor 1 at bus 2, without devices; hourly steps."""
    steps, count = np.shape(load_kw)
    return Scenario(
        name="two-buses",
        title="Two buses",
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(pd.Timestamp("2022-07-19", tz="UTC"), 60.0, steps),
        network=Network([1], [2], [r_ohm], [r_ohm], slack_bus=1, base_kv=11.0),
        customers=Customers(
            id=[f"c{i}" for i in range(count)],
            bus=[2] * count,
            tier=["critical"] * count,
            weight=weights,
            power_factor=[1.0] * count,
        ),
        pv=PVSystems(id=[], customer=[], p_max_kw=[], s_max_kva=[]),
        batteries=battery(count=0),
        load_kw=load_kw,
        pv_kw=np.zeros((steps, 0)),
        grid_limit_kw=grid_limit_kw,
        price_gbp_per_kwh=np.broadcast_to(price, steps),
        temperature_c=np.full(steps, 25.0),
    )


def battery(
    energy_kwh: float = 100.0,
    p_max_kw: float = 50.0,
    s_max_kva: float = 100.0,
    soc: float = 0.15,
    count: int = 1,
) -> Batteries:
    """A battery at bus 2 with the paper's efficiencies and limits."""
    values = {
        "energy_kwh": energy_kwh,
        "p_max_kw": p_max_kw,
        "s_max_kva": s_max_kva,
        "soc_initial": soc,
        **USUAL_BATTERY,
    }
    return Batteries(
        id=[f"b{i}" for i in range(count)],
        bus=[2] * count,
        **{name: np.full(count, value) for name, value in values.items()},
    )


def full_of(energy_kwh: float) -> Batteries:
    """A battery that can give this much energy at its terminals, and any power."""
    return battery(2e3, 1e3, 1e3, soc=0.15 + energy_kwh / 0.95 / 2e3)


def island(
    load_kw: Sequence[Sequence[float]], weights: Sequence[float], energy_kwh: float
) -> Scenario:
    """A dark feeder whose battery can give this much energy at its terminals, and any power."""
    day = two_buses(load_kw, weights, [DARK] * len(load_kw))
    return replace(day, batteries=full_of(energy_kwh))


def with_pv(scenario: Scenario, pv_kw: Sequence[float], s_max_kva: float = 100.0) -> Scenario:
    """The scenario with a PV system of customer ``c0``."""
    pv = PVSystems(id=["p0"], customer=["c0"], p_max_kw=[max(pv_kw)], s_max_kva=[s_max_kva])
    return replace(scenario, pv=pv, pv_kw=np.reshape(pv_kw, (-1, 1)))


def window(scenario: Scenario, steps: slice = slice(None), soc: float | None = None) -> WindowData:
    """The true series of some steps as a window, with plain LinDistFlow."""
    b, n_steps = scenario.batteries, len(scenario.price_gbp_per_kwh[steps])
    return WindowData(
        scenario.load_kw[steps],
        scenario.pv_kw[steps],
        scenario.price_gbp_per_kwh[steps],
        scenario.grid_limit_kw[steps],
        b.soc_initial if soc is None else np.full(len(b), soc),
        b.eta_charge,
        b.eta_discharge,
        np.zeros((n_steps, scenario.network.n_lines)),
        export=Export.of(scenario, steps) or Export.absent(),
        owed=Owed.of(scenario.customers, scenario.grid.dt_h),
        parts=Parts.one(scenario.network, len(b), n_steps),
    )


def observed(day: Scenario, t0: int, forecast: Forecast, soc: Floats) -> Observation:
    """Observation of a step of customers who were all supplied for long."""
    b, dt_h = day.batteries, day.grid.dt_h
    free = SwitchingState.of(SwitchingRules(), day.customers, dt_h)
    owed = Owed.of(day.customers, dt_h)
    able = np.ones(len(b), dtype=bool)
    return Observation(t0, forecast, soc, b.eta_charge, b.eta_discharge, free, owed, able)


def first_step(scenario: Scenario, data: WindowData) -> StepState:
    """State that a guard knows in the first step of a window, all batteries there."""
    online = np.ones(len(data.soc), dtype=bool)
    nobody = np.zeros(len(scenario.customers), dtype=bool)
    return StepState(Site.of(scenario), data.first(1), online, due=nobody)
