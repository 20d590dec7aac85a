"""Seeded random feeders, small enough to be solved in a fraction of a second."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.random import Generator

from benchmarks.frame.usual_battery import USUAL_BATTERY
from vppres.core.arrays import Flags, Floats, Names
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import Owed, SwitchingState
from vppres.model.data import WindowData
from vppres.model.parts import Parts
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.scenario.timegrid import TimeGrid

BASE_KV = 11.0
WEIGHT = {"critical": 1.0, "high": 0.1, "low": 0.02}
V_FULL_LOAD = {False: (0.935, 0.995), True: (0.88, 0.945)}
"""Range of the lowest voltage with everybody served and no devices; the limit is 0.947."""


class Window(NamedTuple):
    """A scenario and the data of one window over all of its steps."""

    scenario: Scenario
    data: WindowData


def random_scenario(seed: int, stressed: bool = False, n_steps: int | None = None) -> Scenario:
    """A random day of 1 to 4 steps, or as many as are asked for.

    4 to 12 buses in a random tree, 3 to 10 customers, some with PV, batteries that differ;
    sometimes no PV, no battery, equal prices, no outage or nothing but outage, a limited import,
    weights that are multiples of nothing; steps of 15, 30 or 60 min.
    ``stressed`` feeders are too weak for their load, have more sun than anybody can use, or
    inverters below the devices' power.
    """
    rng = np.random.default_rng([seed, int(stressed)])
    steps = int(rng.integers(1, 5)) if n_steps is None else n_steps
    n_buses = int(rng.integers(4, 13))
    customers = _customers(rng, n_buses)
    base_kw = rng.uniform(20.0, 200.0, len(customers))
    load_kw = base_kw * rng.uniform(0.6, 1.0, (steps, len(customers)))
    sun = (1.0, 3.0) if stressed and rng.random() < 0.5 else (0.1, 1.2)
    pv = _pv(rng, customers, base_kw * rng.uniform(*sun, len(customers)), stressed)
    return Scenario(
        name=f"random-{seed}",
        title="Random feeder",
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(pd.Timestamp("2022-07-19", tz="UTC"), float(rng.choice([15, 30, 60])), steps),
        network=random_network(rng, n_buses, customers, load_kw.max(axis=0), stressed),
        customers=customers,
        pv=pv,
        batteries=_batteries(rng, n_buses, base_kw.sum(), stressed),
        load_kw=load_kw,
        pv_kw=pv.p_max_kw * rng.uniform(0.0, 1.0, (steps, len(pv))),
        price_gbp_per_kwh=_prices(rng, steps),
        temperature_c=rng.uniform(15.0, 38.0, steps),
        grid_limit_kw=np.where(_outage(rng, steps), 0.0, _import_limit(rng, load_kw)),
    )


def random_window(seed: int, stressed: bool = False) -> Window:
    """A random feeder with all of its steps as one window, in a random state."""
    scenario = random_scenario(seed, stressed)
    rng = np.random.default_rng([seed, int(stressed), 1])
    b = scenario.batteries
    steps = scenario.grid.n_steps
    n_lines = scenario.network.n_lines
    offset = rng.choice([0.0, 1.0]) * rng.uniform(-3e-4, 3e-4, n_lines)
    return Window(
        scenario,
        WindowData(
            load_kw=scenario.load_kw,
            pv_kw=scenario.pv_kw,
            price_gbp_per_kwh=scenario.price_gbp_per_kwh,
            grid_limit_kw=scenario.grid_limit_kw,
            soc=b.soc_min + (b.soc_max - b.soc_min) * rng.uniform(0.0, 1.0, len(b)),
            eta_charge=b.eta_charge * rng.uniform(0.9, 1.0, len(b)),
            eta_discharge=b.eta_discharge * rng.uniform(0.9, 1.0, len(b)),
            delta_pu2=np.tile(offset, (steps, 1)),
            owed=Owed.of(scenario.customers, scenario.grid.dt_h),
            parts=Parts.one(scenario.network, len(b), steps),
        ),
    )


def random_rules(seed: int) -> SwitchingRules:
    """Rules of every kind, each in about every third case; sometimes of all kinds at once."""
    rng = np.random.default_rng([seed, 2])
    share = rng.choice([0.35, 1.0], p=[0.9, 0.1])

    def sometimes(value: float) -> float:
        return float(value) if rng.random() < share else 0.0

    most = int(rng.integers(0, 4)) if rng.random() < share else None
    cold = sometimes(rng.uniform(0.2, 1.0))
    return SwitchingRules(
        min_served_h=sometimes(rng.uniform(0.0, 2.5)),
        min_unserved_h=sometimes(rng.uniform(0.0, 2.5)),
        price_per_action=sometimes(rng.choice([0.01, 0.05, rng.uniform(0.0, 0.2)])),
        max_actions_per_customer=most,
        stay_restored=bool(rng.random() < share / 3),
        cold_load_factor=1.0 + cold,
        cold_load_h=rng.uniform(0.0, 2.0) if cold else 0.0,
    )


def random_state(seed: int, scenario: Scenario) -> SwitchingState:
    """Random rules, and customers with a random past."""
    rng = np.random.default_rng([seed, 3])
    return random_past(rng, random_rules(seed), scenario)


def random_past(rng: Generator, rules: SwitchingRules, scenario: Scenario) -> SwitchingState:
    """Who was served before, since when and after how many actions."""
    count, dt_h = len(scenario.customers), scenario.grid.dt_h
    served = rng.random(count) < rng.choice([0.5, 0.9, 1.0])
    untouched = served & (rng.random(count) < 0.5)
    since_h = np.where(untouched, np.inf, dt_h * rng.integers(1, 5, count))
    actions = np.where(untouched, 0, 2 - 1 * ~served + 2 * rng.integers(0, 2, count))
    anytime = np.full(count, np.inf)
    return SwitchingState(rules, dt_h, served, since_h, actions.astype(float), anytime)


def names(letter: str, numbers: Iterable[int]) -> Names:
    """Identifiers: a letter and a number."""
    return np.array([f"{letter}{i}" for i in numbers], dtype=object)


def _customers(rng: Generator, n_buses: int) -> Customers:
    count = int(rng.integers(3, 11))
    tier = rng.choice(list(WEIGHT), count)
    weight = np.array([WEIGHT[t] for t in tier])
    if rng.random() < 0.25:
        weight = weight * rng.uniform(0.8, 1.2, count)
    return Customers(
        id=names("c", range(count)),
        bus=rng.integers(2, n_buses + 1, count).astype(object),
        tier=tier,
        weight=weight,
        power_factor=rng.uniform(0.9, 1.0, count),
    )


def _pv(rng: Generator, customers: Customers, p_max_kw: Floats, stressed: bool) -> PVSystems:
    """At most one system per customer; under stress some inverters are below their panels."""
    owners = np.flatnonzero(
        rng.random(len(customers)) < rng.choice([0.0, 0.4, 0.8], p=[0.2, 0.4, 0.4])
    )
    p = p_max_kw[owners]
    return PVSystems(
        id=names("p", owners),
        customer=customers.id[owners],
        p_max_kw=p,
        s_max_kva=p * rng.uniform(0.8 if stressed else 1.0, 1.3, len(owners)),
    )


def _batteries(rng: Generator, n_buses: int, peak_kw: float, stressed: bool) -> Batteries:
    """Zero to five batteries that differ in everything."""
    count = int(rng.choice([0, 1, 2, 3, 5], p=[0.2, 0.2, 0.2, 0.2, 0.2]))
    p = peak_kw * rng.uniform(0.1, 0.4, count)
    soc_min = rng.uniform(0.05, 0.2, count)
    alike = {**USUAL_BATTERY, "t_initial_c": 22.0}
    drawn = {
        "id": names("b", range(count)),
        "bus": rng.integers(2, n_buses + 1, count).astype(object),
        "energy_kwh": p * rng.uniform(0.5, 3.0, count),
        "p_max_kw": p,
        "s_max_kva": p * rng.uniform(0.8 if stressed else 1.0, 1.3, count),
        "soc_min": soc_min,
        "soc_max": rng.uniform(0.8, 0.95, count),
        "soc_initial": rng.uniform(soc_min, 0.8),
        "eta_charge": rng.uniform(0.85, 0.99, count),
        "eta_discharge": rng.uniform(0.85, 0.99, count),
        "r_theta_c_per_kw": rng.uniform(2.8, 4.4, count),
        "c_theta_kwh_per_c": rng.uniform(0.11, 0.43, count),
    }
    return Batteries(**{name: np.full(count, value) for name, value in alike.items()} | drawn)


def random_network(
    rng: Generator, n_buses: int, customers: Customers, peak_kw: Floats, stressed: bool = False
) -> Network:
    """A random tree; its impedances bring the lowest voltage at full load into the range."""
    above = [int(rng.integers(max(1, n - 3), n)) for n in range(2, n_buses + 1)]
    r = rng.uniform(0.2, 1.0, n_buses - 1)
    x = r * rng.uniform(0.3, 1.0, n_buses - 1)
    drop = most_drop(above, r, x, customers, peak_kw, BASE_KV)
    wanted = (1.0 - rng.uniform(*V_FULL_LOAD[stressed]) ** 2) / drop
    return tree(above, r * wanted, x * wanted, base_kv=BASE_KV)


def most_drop(
    above: list[int], r: Floats, x: Floats, customers: Customers, peak_kw: Floats, base_kv: float
) -> float:
    """Largest drop of squared voltage in a tree without losses, in pu, at the customers' peaks."""
    n_buses = len(above) + 1
    demand = np.zeros((2, n_buses + 1))
    tan_phi = np.sqrt(1 / customers.power_factor**2 - 1)
    for kind, power in enumerate((peak_kw, peak_kw * tan_phi)):
        np.add.at(demand[kind], customers.bus.astype(int), power)
    for n in range(n_buses, 1, -1):
        demand[:, above[n - 2]] += demand[:, n]
    drop = np.zeros(n_buses + 1)
    for n in range(2, n_buses + 1):
        flow = 2 * (r[n - 2] * demand[0, n] + x[n - 2] * demand[1, n]) / (1000 * base_kv**2)
        drop[n] = drop[above[n - 2]] + flow
    return float(drop.max())


def tree(above: list[int], r_ohm: Floats, x_ohm: Floats, **more: Any) -> Network:
    """A network whose buses from 2 on hang below others."""
    below = np.arange(2, len(above) + 2).astype(object)
    return Network(np.array(above, dtype=object), below, r_ohm, x_ohm, slack_bus=1, **more)


def _prices(rng: Generator, steps: int) -> Floats:
    """Equal, in two levels (zero included), or anything."""
    kinds = (np.full(steps, 0.3), rng.choice([0.0, 0.5], steps), rng.uniform(0.05, 0.6, steps))
    return np.asarray(kinds[int(rng.integers(3))])


def _import_limit(rng: Generator, load_kw: Floats) -> Floats | float:
    """No limit, or one around the demand."""
    if rng.random() < 0.7:
        return float("inf")
    return np.asarray(load_kw.sum(axis=1)) * rng.uniform(0.5, 1.3, len(load_kw))


def _outage(rng: Generator, steps: int) -> Flags:
    """None, all, one interval, or scattered steps."""
    begin, end = np.sort(rng.integers(0, steps + 1, 2))
    kinds = (
        np.zeros(steps, bool),
        np.ones(steps, bool),
        (np.arange(steps) >= begin) & (np.arange(steps) < end),
        rng.random(steps) < 0.5,
    )
    return kinds[int(rng.choice(4, p=[0.2, 0.2, 0.4, 0.2]))]
