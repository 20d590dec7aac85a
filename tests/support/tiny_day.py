"""A day small enough to solve by hand: four buses, three customers, six hours, two of them dark."""

from __future__ import annotations

import numpy as np
import pandas as pd

from benchmarks.frame.usual_battery import USUAL_BATTERY
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.scenario.timegrid import TimeGrid


def tiny_scenario() -> Scenario:
    """Bus 1 feeds 2, which feeds 3 and 4; steps 3 and 4 (13:00 to 15:00) are an outage."""
    return Scenario(
        name="tiny",
        title="Four buses, six hours",
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(pd.Timestamp("2022-07-19T10:00:00Z"), 60.0, 6),
        network=Network(
            [1, 2, 2], [2, 3, 4], [0.3, 0.4, 0.5], [0.2, 0.3, 0.4], slack_bus=1, base_kv=11.0
        ),
        customers=Customers(
            id=["hospital", "shop", "homes"],
            bus=[2, 3, 4],
            tier=["critical", "high", "low"],
            weight=[1.0, 0.1, 0.02],
            power_factor=[0.95, 0.9, 0.98],
        ),
        pv=PVSystems(
            id=["roof", "field"],
            customer=["hospital", "homes"],
            p_max_kw=[30.0, 20.0],
            s_max_kva=[40.0, 30.0],
        ),
        batteries=_tiny_batteries(),
        load_kw=np.array(
            [
                [60.0, 40.0, 50.0],
                [62.0, 41.0, 48.0],
                [64.0, 42.0, 47.0],
                [65.0, 45.0, 46.0],
                [66.0, 44.0, 49.0],
                [63.0, 38.0, 55.0],
            ]
        ),
        pv_kw=np.array(
            [[20.0, 15.0], [28.0, 19.0], [30.0, 20.0], [29.0, 18.5], [24.0, 16.0], [18.0, 11.0]]
        ),
        price_gbp_per_kwh=np.array([0.30, 0.28, 0.32, 0.35, 0.40, 0.45]),
        temperature_c=np.array([28.0, 30.0, 32.0, 34.0, 34.5, 33.0]),
        grid_limit_kw=np.array([np.inf, np.inf, np.inf, 0.0, 0.0, np.inf]),
    )


def _tiny_batteries() -> Batteries:
    """Two batteries with the default thermal constants."""
    each = {**USUAL_BATTERY, "t_initial_c": np.nan}
    return Batteries(
        id=["big", "small"],
        bus=[2, 4],
        energy_kwh=[100.0, 60.0],
        p_max_kw=[50.0, 30.0],
        s_max_kva=[60.0, 35.0],
        soc_initial=[0.15, 0.5],
        **{name: [value] * 2 for name, value in each.items()},
    )
