"""Random days of the kinds that hurt: weak feeders, nothing to store, more sun than use.

A day is known by its kind and its seed. Every kind has one trait in every day and each of the
others now and then, so that what only hurts together is found too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator

from benchmarks.frame.random_feeders import most_drop, names, random_past, random_rules, tree
from benchmarks.frame.usual_battery import USUAL_BATTERY
from vppres.contract.forecast import Forecaster, ForecastErrors
from vppres.contract.observation import Observation
from vppres.control.converged import dark_steps, physics_of, without_power
from vppres.core.arrays import Flags, Floats
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import Owed, SwitchingState
from vppres.model.beyond_paper.losses import lossless
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.scenario.timegrid import TimeGrid

TRAITS = {
    "no_batteries": "nothing can be stored: steps do not meet",
    "no_power": "batteries of 1 W: nothing can be stored, but steps meet",
    "five_tiers": "five tiers, weights with a fine grid or none",
    "grid_limit": "the grid gives a part of the demand, the same all day",
    "varying_limit": "the grid gives a part of the demand, another in each step",
    "quarters": "steps of 15 min over two days",
    "export": "the grid takes and pays, sometimes more than import costs",
    "surplus": "three to five times as much sun as anybody can use",
    "low_voltage": "400 V with lines of high resistance",
    "tight": "voltages from 0.97 to 1.03 pu",
    "giant": "one customer larger than all others together",
    "small_former": "physical mode with one small battery to form the island",
    "rules": "rules on switching customers, a price of actions, cold load",
}
"""What may hurt in a day, and why."""

KINDS = tuple(TRAITS)
"""A kind is named after the trait that all of its days have."""

COMMON = 0.12
"""Share of the days that have a trait which is not their kind's."""

WEIGHTS = {"critical": 1.0, "high": 0.1, "low": 0.02}
FIVE_WEIGHTS = {"hospital": 1.0, "critical": 0.45, "high": 0.15, "low": 0.05, "spare": 0.01}
BUSES = (10, 120)
LONGEST_OUTAGE_H = 8
SITE_KW = {True: (2.0, 12.0), False: (20.0, 200.0)}
"""Range of a customer's peak at low voltage and else, in kW."""


@dataclass(frozen=True, eq=False)
class HardDay:
    """A day to run."""

    kind: str  #: the trait that all days of the kind have
    seed: int  #: makes the same day again
    traits: frozenset[str]  #: all that it has
    scenario: Scenario  #: the actual day; mode and switching rules are the scenario's own
    errors: ForecastErrors  #: sizes of its forecast errors, zero in every other day

    @property
    def rules(self) -> SwitchingRules:
        """Rules on switching customers."""
        return self.scenario.switching


def hard_day(kind: str, seed: int) -> HardDay:
    """The day of a kind and a seed.

    Examples
    --------
    >>> day = hard_day("no_batteries", 1)
    >>> len(day.scenario.batteries), day.scenario.grid.n_steps
    (0, 24)
    """
    rng = np.random.default_rng([seed, KINDS.index(kind), 1407])
    traits = _traits(rng, kind)
    scenario = _scenario(rng, f"{kind}-{seed}", traits)
    if "rules" in traits:
        rules = replace(random_rules(int(rng.integers(1_000_000))), move_weight=0.0)
        scenario = replace(scenario, switching=rules)
    wrong = rng.random() < 0.5
    sizes = (
        rng.uniform(-0.2, 0.2),
        rng.uniform(0.0, 0.03),
        rng.uniform(-0.2, 0.2),
        rng.uniform(0.0, 0.03),
    )
    errors = ForecastErrors(*(float(size) for size in sizes)) if wrong else ForecastErrors()
    return HardDay(kind, seed, traits, scenario, errors)


def _traits(rng: Generator, kind: str) -> frozenset[str]:
    """The kind's own trait and some of the others."""
    drawn = {name for name in KINDS if rng.random() < COMMON} | {kind}
    rivals = (("no_batteries", "no_power", "small_former"), ("grid_limit", "varying_limit"))
    for group in rivals:
        kept = kind if kind in group else next((name for name in group if name in drawn), None)
        drawn -= set(group) - {kept}
    return frozenset(drawn)


def _scenario(rng: Generator, name: str, traits: frozenset[str]) -> Scenario:
    """A feeder with these traits, and its day."""
    n_buses = round(float(np.exp(rng.uniform(*np.log(BUSES)))))
    per_hour = 4 if "quarters" in traits else 1
    hours = 48 if "quarters" in traits else 24
    hour = np.arange(hours * per_hour) / per_hour
    customers = _customers(rng, n_buses, traits)
    peak_kw = _peaks(rng, len(customers), traits)
    load_kw = _loads(rng, hour, peak_kw)
    pv, pv_kw = _pv(rng, hour, customers, peak_kw, traits)
    out = _outage(rng, hour)
    mode = "physical" if "small_former" in traits else "paper"
    return Scenario(
        name=name,
        title=f"Random day: {', '.join(sorted(traits))}",
        controller=ControllerDefaults(mode=mode, voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(pd.Timestamp("2022-07-18", tz="UTC"), 60.0 / per_hour, len(hour)),
        network=_network(rng, n_buses, customers, load_kw, traits),
        customers=customers,
        pv=pv,
        batteries=_batteries(rng, n_buses, float(load_kw.sum(axis=1).max()), traits),
        load_kw=load_kw,
        pv_kw=pv_kw,
        price_gbp_per_kwh=_prices(rng, hour),
        temperature_c=np.full(len(hour), 25.0),
        grid_limit_kw=_grid_limit(rng, load_kw.sum(axis=1), out, traits),
        tiers=tuple(_weights(traits)),
        **_export(rng, load_kw, hour, traits),
    )


def _weights(traits: frozenset[str]) -> dict[str, float]:
    return FIVE_WEIGHTS if "five_tiers" in traits else WEIGHTS


def _customers(rng: Generator, n_buses: int, traits: frozenset[str]) -> Customers:
    """One customer at most buses, few of them in the first tiers."""
    bus = 2 + np.flatnonzero(rng.random(n_buses - 1) < rng.uniform(0.6, 1.0))
    bus = bus if len(bus) else np.array([2])
    weights = _weights(traits)
    share = np.arange(1, len(weights) + 1) ** 1.3
    tier = rng.choice(list(weights), len(bus), p=share / share.sum())
    weight = np.array([weights[name] for name in tier])
    if "five_tiers" in traits and rng.random() < 0.5:
        weight = weight * rng.uniform(0.8, 1.2, len(bus))
    return Customers(
        id=names("c", bus),
        bus=bus.astype(object),
        tier=tier,
        weight=weight,
        power_factor=rng.uniform(0.88, 0.99, len(bus)),
    )


def _peaks(rng: Generator, count: int, traits: frozenset[str]) -> Floats:
    """Largest demand of each customer in kW."""
    low, high = SITE_KW["low_voltage" in traits]
    peak = np.exp(rng.uniform(np.log(low), np.log(high), count))
    if "giant" in traits:
        who = int(rng.integers(count))
        peak[who] = rng.uniform(1.1, 2.0) * (peak.sum() - peak[who] + low)
    return np.asarray(peak)


def _loads(rng: Generator, hour: Floats, peak_kw: Floats) -> Floats:
    """Demand with a peak at noon or in the evening, and noise of a tenth."""
    late = rng.uniform(10.0, 20.0, len(peak_kw))
    base = rng.uniform(0.25, 0.6, len(peak_kw))
    away = (hour[:, None] - late + 12.0) % 24.0 - 12.0
    shape = base + (1.0 - base) * np.exp(-((away / 4.0) ** 2))
    noise = rng.uniform(0.9, 1.0, shape.shape)
    return np.asarray(peak_kw * shape * noise)


def _pv(
    rng: Generator, hour: Floats, customers: Customers, peak_kw: Floats, traits: frozenset[str]
) -> tuple[PVSystems, Floats]:
    """Panels of some customers and what the sun gives them, (T, P)."""
    owners = np.flatnonzero(rng.random(len(customers)) < rng.uniform(0.2, 0.7))
    size = rng.uniform(3.0, 5.0) if "surplus" in traits else rng.uniform(0.2, 1.0)
    panel_kw = peak_kw[owners] * size * rng.uniform(0.5, 1.0, len(owners))
    sun = np.clip(np.sin((hour % 24.0 - 4.5) / 16.0 * np.pi), 0.0, None)
    cloud = rng.uniform(rng.uniform(0.3, 1.0), 1.0, (len(hour), 1))
    pv = PVSystems(
        id=names("p", owners),
        customer=customers.id[owners],
        p_max_kw=panel_kw,
        s_max_kva=panel_kw * rng.uniform(1.0, 1.2, len(owners)),
    )
    return pv, np.asarray(panel_kw * sun[:, None] * cloud)


def _outage(rng: Generator, hour: Floats) -> Flags:
    """Steps without grid: one outage, in every fifth day two."""
    out = np.zeros(len(hour), dtype=bool)
    for _ in range(2 if rng.random() < 0.2 else 1):
        begin = rng.integers(4, int(hour[-1]) - 3)
        out |= (hour >= begin) & (hour < begin + rng.integers(2, LONGEST_OUTAGE_H + 1))
    return out


def _grid_limit(rng: Generator, load_kw: Floats, out: Flags, traits: frozenset[str]) -> Floats:
    """Largest import of each step; a limited grid seldom goes out too."""
    if "grid_limit" in traits:
        limit = np.full(len(load_kw), rng.uniform(0.3, 0.9) * load_kw.max())
    elif "varying_limit" in traits:
        limit = load_kw * rng.uniform(0.2, 1.1, len(load_kw))
    else:
        return np.where(out, 0.0, np.inf)
    return np.where(out & bool(rng.random() < 0.3), 0.0, limit)


def _prices(rng: Generator, hour: Floats) -> Floats:
    """Equal, in two levels, or anything, some of it below zero."""
    evening = (hour % 24.0 >= 16.0) & (hour % 24.0 < 20.0)
    kinds = (
        np.full(len(hour), 0.3),
        np.where(evening, 0.45, 0.15),
        rng.uniform(-0.05, 0.6, len(hour)),
    )
    return np.asarray(kinds[int(rng.integers(3))])


def _export(
    rng: Generator, load_kw: Floats, hour: Floats, traits: frozenset[str]
) -> dict[str, Any]:
    """What the grid takes and pays."""
    if "export" not in traits:
        return {}
    limit_kw = load_kw.sum(axis=1).max() * rng.choice([0.1, 0.5, np.inf])
    price = rng.uniform(0.0, 0.5, len(hour)) if rng.random() < 0.5 else np.full(len(hour), 0.1)
    return {
        "export_limit_kw": np.full(len(hour), limit_kw),
        "export_price_gbp_per_kwh": price,
    }


def _batteries(rng: Generator, n_buses: int, peak_kw: float, traits: frozenset[str]) -> Batteries:
    """Some batteries with 5 to 60 % of the peak, alike in efficiency or not."""
    count = 0 if "no_batteries" in traits else int(rng.integers(1, 9))
    part = rng.dirichlet(np.full(max(count, 1), 2.0))[:count]
    p = np.maximum(peak_kw * rng.uniform(0.05, 0.6) * part, 1e-3)
    if "no_power" in traits:
        p = np.full(count, 1e-3)
    energy = p * rng.uniform(1.0, 5.0, count)
    forming = np.zeros(count, dtype=bool)
    if "small_former" in traits:
        forming[np.argmin(p)] = True
    alike = rng.random() < 0.6
    eta = np.full((2, count), 0.95) if alike else rng.uniform(0.85, 0.98, (2, count))
    constants = {**USUAL_BATTERY, "eta_charge": eta[0], "eta_discharge": eta[1]}
    return Batteries(
        id=names("b", np.arange(count)),
        bus=rng.integers(2, n_buses + 1, count).astype(object),
        energy_kwh=np.maximum(energy, 1e-3),
        p_max_kw=p,
        s_max_kva=np.maximum(p * rng.uniform(0.9, 1.3, count), 1e-3),
        soc_initial=rng.uniform(0.15, 0.85, count),
        grid_forming=forming,
        **{name: np.broadcast_to(value, count) for name, value in constants.items()},
    )


def _network(
    rng: Generator,
    n_buses: int,
    customers: Customers,
    load_kw: Floats,
    traits: frozenset[str],
) -> Network:
    """A random tree, long or bushy; its impedances set the lowest voltage at the peak."""
    reach = int(rng.integers(1, 11))
    above = [int(rng.integers(max(1, n - reach), n)) for n in range(2, n_buses + 1)]
    low = "low_voltage" in traits
    r = rng.uniform(0.2, 1.0, n_buses - 1)
    x = r / rng.uniform(*((2.0, 8.0) if low else (0.8, 2.5)), n_buses - 1)
    base_kv = 0.4 if low else 11.0
    peak = load_kw[int(load_kw.sum(axis=1).argmax())]
    drop = most_drop(above, r, x, customers, peak, base_kv)
    v_min_pu, v_max_pu = (0.97, 1.03) if "tight" in traits else (0.947, 1.053)
    v_lowest = v_min_pu + rng.uniform(-0.03, 0.02)
    wanted = (1.0 - v_lowest**2) / drop
    limits = {"v_min_pu": v_min_pu, "v_max_pu": v_max_pu}
    return tree(above, r * wanted, x * wanted, base_kv=base_kv, **limits)


@dataclass(frozen=True, eq=False)
class HardWindow:
    """A window of a day of a kind, in a random state."""

    day: HardDay  #: the day
    #: First step and number of steps.
    t0: int
    steps: int
    site: Site  #: fixed data
    data: WindowData  #: the window, as its controller would see it


HORIZONS_H = (5, 5, 5, 11)
"""Horizons of hourly windows; a window has the present step too."""
QUARTER_STEPS = (20, 20, 40)
"""Steps of windows in quarter hours."""
HEADROOM = 0.1
"""Share of the inverters that physical windows keep free, the default of a run."""


def hard_window(kind: str, seed: int) -> HardWindow:
    """A window that meets the outage of the day of a kind and a seed.

    Examples
    --------
    >>> window = hard_window("tight", 2)
    >>> window.data.n_steps == window.steps
    True
    """
    day = hard_day(kind, seed)
    scenario = day.scenario
    rng = np.random.default_rng([seed, 99])
    steps = 1 + int(rng.choice(HORIZONS_H))
    if "quarters" in day.traits:
        steps = int(rng.choice(QUARTER_STEPS))
    last = scenario.grid.n_steps - steps
    out = np.flatnonzero(scenario.outage)
    first = max(0, out[0] - steps + 1) if len(out) else 0
    latest = min(last, out[-1]) if len(out) else last
    t0 = min(int(rng.integers(first, max(first, latest) + 1)), last)
    b = scenario.batteries
    soc = b.soc_min + (b.soc_max - b.soc_min) * rng.uniform(0.0, 1.0, len(b))
    forecast = Forecaster(scenario, day.errors, seed).at(t0, range(t0, t0 + steps))
    past, owed = _past(rng, scenario), Owed.of(scenario.customers, scenario.grid.dt_h)
    able = np.ones(len(b), dtype=bool)
    seen = Observation(t0, forecast, soc, b.eta_charge, b.eta_discharge, past, owed, able)
    site = Site.of(scenario)
    data = WindowData.of(seen, site, "lossless")
    if scenario.controller.mode == "physical":
        lit = without_power(data, dark_steps(site, data))
        data = lossless(lit, physics_of(site, lit, HEADROOM))
    return HardWindow(day, t0, steps, site, data)


def _past(rng: Generator, scenario: Scenario) -> SwitchingState:
    """Random past of the customers, where there are rules."""
    if scenario.switching.active:
        return random_past(rng, scenario.switching, scenario)
    return SwitchingState.start(scenario.switching, scenario.grid.dt_h, len(scenario.customers))
