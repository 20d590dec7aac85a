"""Synthetic days and runs for the tests of the record, the figures and the report.

Nothing here is optimised: the dispatch is written down, so that figures can be checked by hand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from benchmarks.frame.usual_battery import USUAL_BATTERY
from vppres.day.recorder import Recorder, StepRecord, voltage_figures
from vppres.day.trajectory import Trajectory
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.scenario.timegrid import TimeGrid

OPTIONS = {
    "controller": "mpc", "horizon_h": 5.0, "solver": "highs", "method": "decomposed", "seed": 7,
    "errors": {"load_bias": 0.1}, "thermal": "off",
}  # fmt: skip

SECTIONS_OF_A_DAY = [
    "overview", "timeline", "service", "feeder", "energy", "network", "figures", "solver",
    "assumptions",
]  # fmt: skip
"""Of a report of one day without explanations, in order."""


def batteries(bus: list[int], energy_kwh: float) -> Batteries:
    """Equal batteries, one at each bus, with the paper's constants."""
    each = {
        "energy_kwh": energy_kwh,
        "p_max_kw": energy_kwh / 2,
        "s_max_kva": energy_kwh,
        "soc_initial": 0.15,
        **USUAL_BATTERY,
        "r_theta_c_per_kw": 3.0,
    }
    return Batteries(
        id=[f"b{n}" for n in bus],
        bus=bus,
        **{name: np.full(len(bus), value) for name, value in each.items()},
    )


def small_scenario(outage: bool = True, step_minutes: float = 30.0) -> Scenario:
    """Four half-hour steps, three customers, one PV system and one battery; outage in steps 1, 2.

    Loads are 10, 20 and 40 kW, prices 0.1, 0.2, 0.3 and 0.4 GBP/kWh.
    """
    return Scenario(
        name="small",
        title="Small day",
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(pd.Timestamp("2022-07-19", tz="UTC"), step_minutes, 4),
        network=Network([1, 2, 3], [2, 3, 4], [0.1] * 3, [0.1] * 3, slack_bus=1, base_kv=11.0),
        customers=Customers(
            id=["a", "b", "c"],
            bus=[2, 3, 4],
            tier=["critical", "low", "low"],
            weight=[1.0, 0.1, 0.2],
            power_factor=[0.95] * 3,
        ),
        pv=PVSystems(id=["pv1"], customer=["b"], p_max_kw=[30.0], s_max_kva=[40.0]),
        batteries=batteries([4], 100.0),
        load_kw=np.tile([10.0, 20.0, 40.0], (4, 1)),
        pv_kw=np.full((4, 1), 12.0),
        price_gbp_per_kwh=[0.1, 0.2, 0.3, 0.4],
        temperature_c=[25.0] * 4,
        grid_limit_kw=[np.inf, 0.0, 0.0, np.inf] if outage else [np.inf] * 4,
    )


def without_devices(scenario: Scenario) -> Scenario:
    """Copy of a day without PV and batteries."""
    return replace(
        scenario,
        pv=PVSystems(id=[], customer=[], p_max_kw=[], s_max_kva=[]),
        batteries=batteries([], 1.0),
        pv_kw=np.zeros((scenario.grid.n_steps, 0)),
    )


def record(scenario: Scenario, t: int, served: list[bool]) -> StepRecord:
    """Step ``t``: batteries idle, 1 kW of every PV system curtailed, flat voltages.

    The import is ``100 + t`` kW, reactive import ``-t`` kvar, the solve takes ``t`` s and has a gap
    of ``t / 1000``; bus 1 of the arrays is at 0.99 pu in the model and at ``0.98 - t / 100`` pu in
    the AC power flow.
    """
    net, devices, pv = scenario.network, np.zeros(len(scenario.batteries)), scenario.pv_kw[t]
    v_model, v_ac, flows = np.ones(net.n_buses), np.ones(net.n_buses), np.zeros(net.n_lines)
    v_model[1], v_ac[1] = 0.99, 0.98 - t / 100
    load_kw = scenario.load_kw[t]
    return StepRecord(
        t=t,
        steps={
            "p_grid_kw": 100.0 + t,
            "q_grid_kvar": -float(t),
            "losses_kw": 1.0,
            **voltage_figures(v_model, v_ac),
            "objective": 1.0,
            "bound": 1.0,
            "gap": t / 1000,
            "status": "optimal",
            "solve_s": float(t),
            "corrected": False,
            "correction_reason": "",
            "fallback": "none",
            "fallback_reason": "",
            "estimated": "",
            "ac_failed": "",
        },
        customers={
            "p_load_kw": load_kw,
            "q_load_kvar": scenario.load_kvar[t],
            "served": np.array(served),
            "shed": np.zeros(len(load_kw), dtype=bool),
        },
        pv={
            "available_kw": pv,
            "self_kw": pv - 1.0,
            "export_kw": 0 * pv,
            "curtailed_kw": 0 * pv + 1.0,
            "q_kvar": 0 * pv,
        },
        batteries={
            "charge_kw": devices,
            "discharge_kw": devices,
            "q_kvar": devices,
            "soc_start": devices + 0.15,
            "soc_end": devices + 0.15,
            "eta_charge": devices + 0.95,
            "eta_discharge": devices + 0.95,
            "temperature_c": devices + 25.0,
            "mismatch_kw": devices,
        },
        buses={"v_model_pu": v_model, "v_ac_pu": v_ac},
        lines={"p_model_kw": flows, "q_model_kvar": flows, "p_ac_kw": flows, "q_ac_kvar": flows},
    )


def changed(step: StepRecord, **tables: dict[str, object]) -> StepRecord:
    """The record with some columns of some tables changed; the voltages' figures follow."""
    new = replace(
        step, **{name: {**getattr(step, name), **columns} for name, columns in tables.items()}
    )
    figures = voltage_figures(new.buses["v_model_pu"], new.buses["v_ac_pu"])
    return replace(new, steps={**new.steps, **figures})


SERVED = [[True, True, True], [True, False, False], [False, True, False], [True, True, True]]


def small_run(
    scenario: Scenario | None = None, planned: dict[str, float] | None = None
) -> Trajectory:
    """The small day: everybody served but ``b, c`` in step 1 and ``a, c`` in step 2."""
    scenario = small_scenario() if scenario is None else scenario
    recorder = Recorder(scenario)
    for t, served in enumerate(SERVED):
        recorder.add(record(scenario, t, served))
    return recorder.finish(OPTIONS, planned)


def day_scenario(n_customers: int = 32) -> Scenario:
    """A day in the manner of the paper's: 24 h, 32 customers, heat, outage from 12 to 18."""
    rng = np.random.default_rng(0)
    hour, bus = np.arange(24), np.arange(2, n_customers + 2)
    shape = (
        0.6 + 0.3 * np.exp(-(((hour - 17) / 4.0) ** 2)) + 0.1 * np.exp(-(((hour - 8) / 2.0) ** 2))
    )
    sun = np.clip(np.sin((hour - 4.5) / 15 * np.pi), 0.0, None)
    rated_kw, panel_kw = rng.uniform(60, 190, n_customers), rng.uniform(25, 92, 28)
    tier = np.array(["critical", "high", "low"], dtype=object)[rng.integers(0, 3, n_customers)]
    weight = pd.Series(tier).map({"critical": 1.0, "high": 0.1, "low": 0.02})
    names = [f"c{b}" for b in bus]
    return Scenario(
        name="day",
        title="Synthetic heatwave day",
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(pd.Timestamp("2022-07-19", tz="UTC"), 60, 24),
        network=Network(
            bus - 1,
            bus,
            np.full(n_customers, 0.3),
            np.full(n_customers, 0.2),
            slack_bus=1,
            base_kv=12.66,
        ),
        customers=Customers(
            id=names,
            bus=bus,
            tier=tier,
            weight=weight.to_numpy(),
            power_factor=np.full(n_customers, 0.95),
        ),
        pv=PVSystems(
            id=[f"p{i}" for i in range(28)],
            customer=names[:28],
            p_max_kw=panel_kw,
            s_max_kva=panel_kw * 1.1,
        ),
        batteries=batteries(list(bus), 79.0),
        load_kw=np.outer(shape, rated_kw),
        pv_kw=np.outer(sun, panel_kw),
        price_gbp_per_kwh=0.36 + 0.12 * np.sin((hour - 11) / 24 * 2 * np.pi),
        temperature_c=28 + 9 * np.sin((hour - 9) / 24 * 2 * np.pi),
        grid_limit_kw=np.where((hour >= 12) & (hour < 18), 0.0, np.inf),
    )


def day_run(scenario: Scenario, supply_kw: float = 2400.0) -> Trajectory:
    """A made-up dispatch: charge in the night and before the outage, then serve by weight."""
    recorder = Recorder(scenario)
    for t in range(scenario.grid.n_steps):
        recorder.add(_day_record(scenario, t, supply_kw))
    return recorder.finish(OPTIONS)


def _day_record(scenario: Scenario, t: int, supply_kw: float) -> StepRecord:
    soc = np.interp(
        np.arange(25), [0, 3, 7, 11, 12, 16, 18, 24], [0.15, 0.6, 0.15, 0.8, 0.85, 0.4, 0.15, 0.15]
    )
    energy = scenario.batteries.energy_kwh
    change_kwh = (soc[t + 1] - soc[t]) * energy
    by_weight = np.argsort(-scenario.customers.weight, kind="stable")
    enough = np.cumsum(scenario.load_kw[t, by_weight]) < supply_kw * (1 + 0.03 * t % 0.2)
    served = np.ones(len(scenario.customers), bool)
    served[by_weight] = enough | ~scenario.outage[t]
    load_kw = float(scenario.load_kw[t] @ served)
    drop = np.arange(scenario.network.n_buses) * load_kw * (3e-7 if scenario.outage[t] else 5e-7)
    error = 0.0015 * np.sin(t) * np.linspace(0, 1, scenario.network.n_buses)
    base = record(scenario, t, served.tolist())
    balance_kw = load_kw - float(scenario.pv_kw[t].sum()) + float(change_kwh.sum())
    return changed(
        base,
        steps={
            "solve_s": 0.1 + 0.02 * t,
            "gap": 1e-5,
            "p_grid_kw": 3.0 if scenario.outage[t] else max(0.0, balance_kw),
        },
        batteries={
            "charge_kw": np.clip(change_kwh, 0, None) / 0.95,
            "discharge_kw": np.clip(-change_kwh, 0, None) * 0.95,
            "soc_start": np.full(len(energy), soc[t]),
            "soc_end": np.full(len(energy), soc[t + 1]),
        },
        buses={"v_ac_pu": 1 - drop, "v_model_pu": 1 - drop + error},
    )
