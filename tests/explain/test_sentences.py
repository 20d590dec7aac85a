"""Every number in a sentence of an explanation is what solving again with one more unit gains."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_scenario
from tests.support.small_windows import DARK, OPEN, battery, two_buses, with_pv
from vppres.core.arrays import Floats
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.explain.day import explain_day
from vppres.explain.windows import Windows
from vppres.explain.words import figure
from vppres.model.data import WindowData
from vppres.scenario.scenario import Scenario
from vppres.solve.result import Status
from vppres.solve.shadow_prices import (
    FixedDecisions,
    PricedTerms,
    PricedWindow,
    ShadowPriceModel,
    price_window,
)
from vppres.solve.solvers import run_conic

DAYS = [(0, True), (1, False), (2, False), (3, False), (5, True)]
"""Days whose sentences have 12 to 70 numbers each, most of them with PV."""

NUMBER = r"([\d.]+)"
SENTENCES = {
    "others": rf"others would lose {NUMBER} weighted",
    "customer": rf"supplying it would be worth {NUMBER} weighted",
    "stored": rf"one more stored kWh would add {NUMBER} weighted",
    "kept": rf"a kWh kept for later would be worth {NUMBER} weighted",
    "kW of battery": rf"one more kW of battery (\S+) would add {NUMBER} weighted",
    "kVA of battery": rf"one more kVA of battery (\S+) would add {NUMBER} weighted",
    "kW at bus": rf"one more kW at bus (\S+) would add {NUMBER} weighted",
    "kvar at bus": rf"one more kvar at bus (\S+) would add {NUMBER} weighted",
    "voltage": rf"limit 0.001 pu lower at bus (\S+) would add {NUMBER} weighted",
    "grid": rf"one more kW from the grid would add {NUMBER} weighted",
}
RELATIVE = 1e-3
ABSOLUTE = 2e-6
"""Slopes are differences of optima that the solver knows to about 1e-9, over steps of 1e-3."""


@dataclass(frozen=True)
class Priced:
    """A step's pricing problem at the level of service, to be solved again."""

    windows: Windows
    model: ShadowPriceModel
    data: WindowData
    held: FixedDecisions

    @classmethod
    def of(cls, windows: Windows, t: int) -> Priced:
        site = windows.site
        data = windows.seen(t)
        model = ShadowPriceModel(site, data.n_steps, windows.beyond)
        held = windows.held(t, data.n_steps)
        priced = cls(windows, model, data, held)
        if not np.isnan(priced.value()):
            return priced
        free = FixedDecisions(
            np.zeros_like(held.service_min),
            held.service_max,
            np.zeros_like(held.mode_min),
            np.ones_like(held.mode_max),
        )
        return cls(windows, model, data, free)

    @property
    def terms(self) -> PricedTerms:
        return PricedTerms(1.0, 0.0, self.windows.site.weights.lambda_curt)

    def value(self, held: FixedDecisions | None = None, data: WindowData | None = None) -> float:
        found = price_window(self.model, data or self.data, held or self.held, self.terms)
        return np.nan if found is None else found.value

    @cache  # noqa: B019
    def answer(self) -> PricedWindow:
        found = price_window(self.model, self.data, self.held, self.terms)
        assert found is not None
        return found

    def with_row(self, name: str, unit: float, item: int) -> float:
        """The optimum with a row of the first step moved, of an item of one family."""
        family = self.model.family(name)
        moved = np.zeros(family.shape)
        moved[0, item] = unit
        return self._moved(name, moved)

    def with_disc(self, name: str, unit: float, item: int) -> float:
        """The optimum with a rating of the first step moved."""
        moved = np.zeros(self.model.family(name).shape)
        moved[0, item * self.model.n_steps] = unit  # radius and vector of each cone in turn
        return self._moved(name, moved)

    def _moved(self, name: str, moved: Floats) -> float:
        """The optimum with other limits of a family."""
        self.model.price(self.data, self.held, self.terms)
        limits = self.model.limits
        before = np.reshape(limits.get(name, 0.0), moved.shape if name in limits else ())
        self.model.limits = {**limits, name: before + moved}
        outcome = run_conic(self.model, 20.0)
        return outcome.value if outcome.status == Status.OPTIMAL else np.nan


def sloped(values: list[float], middle: float, step: float) -> tuple[float, float]:
    """What one unit less loses and one more gains, in order; NaN where one of them cannot be."""
    slopes = np.array([(values[0] - middle) / step, (middle - values[1]) / step])
    return float(slopes.min()), float(slopes.max())


def of_customer(priced: Priced, customer: int) -> tuple[float, float]:
    """What it gains to serve a customer, from its share on, or to serve it less than not at all."""
    share = float(priced.answer().served_share[0, customer])
    if share > 0.5:
        least, most = of_row(priced, "service_max", 1.0, customer)
        return least, most
    most, least = (-slope for slope in of_row(priced, "service_min", 1.0, customer))
    return least, most


def of_stored(priced: Priced, battery: int) -> tuple[float, float]:
    """What a kWh in a battery gains."""
    kwh = np.zeros(len(priced.data.soc))
    kwh[battery] = 1e-3 / priced.windows.site.batteries.energy_kwh[battery]
    values = [
        priced.value(data=replace(priced.data, soc=priced.data.soc + sign * kwh))
        for sign in (1.0, -1.0)
    ]
    return sloped(values, priced.answer().value, 1e-3)


def of_row(priced: Priced, name: str, unit: float, item: int) -> tuple[float, float]:
    """What a unit of a row of the first step gains."""
    values = [priced.with_row(name, sign * 1e-3 * unit, item) for sign in (1.0, -1.0)]
    return sloped(values, priced.answer().value, 1e-3)


def of_disc(priced: Priced, item: int) -> tuple[float, float]:
    name = "battery_inverter_capacity"
    values = [priced.with_disc(name, sign * 1e-3, item) for sign in (1.0, -1.0)]
    return sloped(values, priced.answer().value, 1e-3)


def gained(priced: Priced, kind: str, item: str, name: str) -> tuple[float, float]:
    """Least and most that a sentence's unit gains, solved again."""
    site = priced.windows.site
    network = site.network
    if kind in ("others", "customer"):
        customer = list(site.customers.id).index(item)
        low, high = of_customer(priced, customer)
        weight = float(site.customers.weight[customer]) * site.dt_h
        return (low, high) if kind == "customer" else (weight - high, weight - low)
    if kind == "stored":
        each = [of_stored(priced, b) for b in range(len(site.batteries))]
        return max(low for low, _ in each), max(high for _, high in each)
    if kind == "kept":
        battery = list(site.batteries.id).index(item)
        per_kwh = 1.0 / float(site.batteries.energy_kwh[battery])
        return of_row(priced, "battery_soc_dynamics", per_kwh, battery)
    if kind == "kW of battery":
        battery = list(site.batteries.id).index(name)
        row = "charge" if priced.held.mode_min[battery] else "discharge"
        return of_row(priced, f"battery_{row}_mode", 1.0, battery)
    if kind == "kVA of battery":
        return of_disc(priced, list(site.batteries.id).index(name))
    bus = 0 if kind == "grid" else [str(b) for b in network.buses].index(name)
    if kind == "voltage":
        wider = 2 * network.v_min_pu * 1e-3
        return of_row(priced, "voltage_min", wider, bus - 1)
    row = "reactive_power_balance" if kind == "kvar at bus" else "active_power_balance"
    return of_row(priced, row, -1.0, bus)


def numbers(words: str) -> Iterator[tuple[str, str, float]]:
    """Kind, name and number of everything that a sentence says."""
    for kind, pattern in SENTENCES.items():
        for found in re.finditer(pattern, words):
            *name, number = found.groups()
            yield kind, name[0] if name else "", float(number)


def wrong_numbers(seed: int, stressed: bool, options: RunOptions) -> tuple[int, list[str]]:
    """How many numbers the sentences of a random day have, and those that are not true."""
    run = explain_day(run_day(random_scenario(seed, stressed, n_steps=5), options))
    windows = Windows(run)
    times = list(run.steps["time"])
    told = 0
    wrong = []
    priced_at = cache(lambda time: Priced.of(windows, times.index(time)))
    for row in run.explanations.itertuples():
        for kind, name, number in numbers(row.words):
            priced = priced_at(row.time)
            low, high = gained(priced, kind, str(row.id), name)
            if np.isnan(low):
                continue  # what was recorded leaves no room: a price has no end there
            least = float(figure(low - RELATIVE * abs(low) - ABSOLUTE))
            most = float(figure(high + RELATIVE * abs(high) + ABSOLUTE))
            told += 1
            if not least <= number <= most:
                wrong.append(f"{seed} {row.time} {row.id} {kind} {number}: {low} to {high}")
    return told, wrong


@pytest.mark.daily
@pytest.mark.parametrize(("seed", "stressed"), DAYS)
def test_every_number_of_a_random_day_is_true(seed: int, stressed: bool) -> None:
    told, wrong = wrong_numbers(seed, stressed, RunOptions(horizon_h=1.0))
    assert told > 10
    assert not wrong, "\n".join(wrong)


def test_no_sentence_promises_more_where_all_are_supplied() -> None:
    """The plan stores exactly what the outage's hour needs: less is too little, and more is spare."""
    day = two_buses([[20.0], [20.0], [20.0]], [1.0], [OPEN, DARK, OPEN])
    day = replace(day, batteries=battery(soc=0.15))
    run = explain_day(run_day(day, RunOptions(horizon_h=2.0, mode="paper")))
    assert run.customers["served"].all()
    assert not run.explanations["words"].str.contains("would add").any()


@pytest.mark.parametrize("priority", ["weights", "strict"])
def test_an_island_without_batteries_lacks_no_battery_power(priority: str) -> None:
    day = two_buses([[3.0, 4.0]] * 2, [1.0, 1.0], [DARK, DARK])
    day = with_pv(day, [5.0, 5.0])
    run = explain_day(run_day(day, RunOptions(horizon_h=1.0, mode="paper", priority=priority)))
    off = run.explanations[run.explanations["action"] == "not_served"]
    assert len(off) == 2
    assert off["words"].str.contains("power from PV").all()
    assert not run.explanations["words"].str.contains("battery power|stored energy").any()


WEIGHED = RunOptions(mode="physical", priority="weights")


def dark_feeder(seed: int, first: int, until: int) -> Scenario:
    """Eight steps of a random feeder, without a grid from one step until another."""
    day = random_scenario(seed, stressed=True, n_steps=8)
    limits_kw = np.where(day.grid_limit_kw > 0.0, day.grid_limit_kw, np.inf)
    limits_kw[first:until] = 0.0
    return replace(day, grid_limit_kw=limits_kw)


def test_one_more_stored_kwh_is_that_of_the_battery_where_it_gains_most() -> None:
    """Three batteries live on exactly what they need: their prices say nothing of a fourth."""
    run = explain_day(run_day(dark_feeder(38, 3, 7), replace(WEIGHED, horizon_h=5.0)))
    last = run.explanations[run.explanations["time"] == run.steps["time"].iloc[6]]
    assert last["words"].str.contains("stored kWh would add 0.0043 weighted", regex=False).any()


def test_what_a_customer_adds_to_the_losses_counts_among_what_it_needs() -> None:
    """36.2 kW are left beside 36 kW of demand, which lose another 2 kW on the way."""
    run = explain_day(run_day(dark_feeder(18, 1, 3), replace(WEIGHED, horizon_h=1.0)))
    assert run.explanations is not None
    told = run.explanations
    off = told[(told["action"] == "not_served") & (told["id"] == "c5")]
    assert off["words"].str.contains("battery power").all()
