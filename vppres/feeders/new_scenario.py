"""A first scenario for an imported feeder: tiers, PV, batteries, profiles and an outage by rule.

Every rule is a starting point to be edited: the folder that is written is the user's.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names, Wholes
from vppres.core.errors import InputError, Problem
from vppres.feeders.feeder import ImportedFeeder
from vppres.feeders.new_options import NewScenarioOptions, PriceRule, check_options, outages_of
from vppres.io import atomic_folder, schema
from vppres.io.editor import add_editor_schema
from vppres.io.scenario_writer import fill_scenario_folder
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import ControllerDefaults, Scenario
from vppres.scenario.source import Source, SourceDeviation
from vppres.scenario.timegrid import TimeGrid

DECIMALS = 6
NOTES_FILE = "notes.md"

TIER_WEIGHTS = {"critical": 1.0, "high": 0.1, "low": 0.02}
"""Weights of the tiers (paper, Parameter Selection)."""

# Demand and PV power of the packaged day of 19 July 2022, hour by hour, as shares of their peaks.
LOAD_SHAPE = (
    0.790,
    0.791,
    0.795,
    0.803,
    0.812,
    0.834,
    0.880,
    0.937,
    0.945,
    0.930,
    0.933,
    0.916,
    0.899,
    0.874,
    0.882,
    0.909,
    0.973,
    1.000,
    0.979,
    0.940,
    0.928,
    0.895,
    0.810,
    0.794,
)
PV_SHAPE = (
    0.000,
    0.000,
    0.000,
    0.000,
    0.010,
    0.087,
    0.239,
    0.414,
    0.621,
    0.787,
    0.905,
    1.000,
    0.988,
    0.896,
    0.774,
    0.616,
    0.419,
    0.231,
    0.105,
    0.027,
    0.000,
    0.000,
    0.000,
    0.000,
)

# Hours of the day (from, to) and prices; mean, lowest and highest price of the paper.
FLAT_PRICE = 0.36
NIGHT = (0, 6)
NIGHT_PRICE = 0.20
EVENING = (16, 20)
EVENING_PRICE = 0.54
TEMPERATURE_C = 20.0

PV_INVERTER_RATIO = 1.1
BATTERY_INVERTER_RATIO = 1.15
# The paper's fleet: 1.272 MW for 2.542 MWh.
BATTERY_KW_PER_KWH = 0.5


def new_scenario(feeder: ImportedFeeder, options: NewScenarioOptions | None = None) -> Scenario:
    """A scenario on an imported feeder; the feeder's loads are the customers' peaks.

    Parameters
    ----------
    feeder : ImportedFeeder
        One customer for each bus with a load.
    options : NewScenarioOptions, optional
        Rules; the defaults if not given.

    Raises
    ------
    InputError
        If an option is out of its range, or the feeder has no load.
    """
    options = options or NewScenarioOptions()
    problems = check_options(options) + _check_feeder(feeder, options)
    if problems:
        raise InputError(problems)
    grid = TimeGrid(
        options.start, options.step_minutes, round(options.days * 1440 / options.step_minutes)
    )
    draw_tier, draw_pv = (np.random.default_rng([options.seed, i]) for i in range(2))
    loaded = np.flatnonzero(feeder.p_load_kw > 0)
    peak_kw = feeder.p_load_kw[loaded]
    customers = _customers(feeder, loaded, options, draw_tier)
    pv = _pv(feeder, customers, peak_kw, options, draw_pv)
    name = _name(feeder.name)
    return Scenario(
        name=name,
        title=f"{feeder.name}: {len(customers)} customers, {_length(options)}",
        grid=grid,
        network=_network(feeder, options),
        customers=customers,
        pv=pv,
        batteries=_batteries(customers, peak_kw, options),
        load_kw=_written(np.outer(_profile(LOAD_SHAPE, grid), peak_kw)),
        pv_kw=_written(np.outer(_profile(PV_SHAPE, grid), pv.p_max_kw)),
        price_gbp_per_kwh=_price(options.price, grid),
        temperature_c=np.full(grid.n_steps, TEMPERATURE_C),
        grid_limit_kw=_grid_limit(options, grid),
        tiers=tuple(TIER_WEIGHTS),
        controller=ControllerDefaults(mode="physical"),
    )


def write_new_scenario(
    feeder: ImportedFeeder, options: NewScenarioOptions, folder: str | Path
) -> list[str]:
    """Write a new scenario's folder, whole or not at all, with ``notes.md`` on what was chosen.

    ``scenario.schema.json`` lets an editor complete and check ``scenario.toml``.

    Returns
    -------
    list of str
        The notes.

    Raises
    ------
    InputError
        As :func:`new_scenario`, or if the folder holds something.
    """
    scenario = new_scenario(feeder, options)
    notes = assumptions(feeder, scenario, options)
    scenario = replace(scenario, source=_source(feeder, notes))
    text = "\n".join([f"# {scenario.title}", "", *(f"- {note}" for note in notes), ""])
    with atomic_folder(folder) as aside:
        fill_scenario_folder(scenario, aside)
        add_editor_schema(aside)
        (aside / NOTES_FILE).write_text(text, encoding="utf-8", newline="\n")
    return notes


def assumptions(
    feeder: ImportedFeeder, scenario: Scenario, options: NewScenarioOptions
) -> list[str]:
    """What was simplified and what was chosen by rule, in sentences."""
    words = [*feeder.notes]
    words += [f"{feeder.deviation}."] if feeder.deviation else []
    words += _left_out(feeder, scenario)
    count = {tier: int((scenario.customers.tier == tier).sum()) for tier in TIER_WEIGHTS}
    words.append(
        "Customers by tier: "
        + ", ".join(f"{n} {tier}" for tier, n in count.items())
        + (
            " (from the source's column `tier`, others drawn)."
            if feeder.tier.any()
            else f" (drawn, seed {options.seed})."
        )
    )
    words.append(
        f"{len(scenario.pv)} PV systems of {scenario.pv.p_max_kw.sum():.1f} kW and "
        f"{len(scenario.batteries)} batteries of "
        f"{scenario.batteries.energy_kwh.sum():.1f} kWh."
    )
    words.append(
        "Load and PV follow one bundled summer day; the source's loads are the peaks. "
        f"Prices are {options.price}; the temperature is {TEMPERATURE_C:g} °C."
    )
    return words


def _source(feeder: ImportedFeeder, notes: list[str]) -> Source:
    """What the scenario says of where it comes from."""
    as_given_pu = None if feeder.deviation is None else feeder.deviation.v_max_pu
    told = [note for note in notes if note != f"{feeder.deviation}."]  # it has a field of its own
    return Source.of(feeder.name, notes=told, deviation=SourceDeviation(as_given_pu=as_given_pu))


def _check_feeder(feeder: ImportedFeeder, options: NewScenarioOptions) -> list[Problem]:
    """A feeder without load, with unknown tiers, or with a slack voltage out of bounds."""
    problems = []
    if not (feeder.p_load_kw > 0).any():
        problems.append(
            Problem(
                feeder.name,
                "has no load",
                "Add the loads to the source: each bus with a load becomes a customer.",
            )
        )
    problems += [
        Problem(
            feeder.name,
            "is not a tier",
            f"Write {', '.join(TIER_WEIGHTS)} into the loads' column tier, or leave it empty.",
            field="tier",
            value=tier,
        )
        for tier in sorted({*feeder.tier} - {"", *TIER_WEIGHTS})
    ]
    v_pu = feeder.network.v_slack_pu if options.v_slack_pu is None else options.v_slack_pu
    if not Network.v_min_pu <= v_pu <= Network.v_max_pu:
        problems.append(
            Problem(
                feeder.name,
                f"must lie between {Network.v_min_pu:g} and {Network.v_max_pu:g}, the "
                "limits of the voltages",
                "Give another one with --v-slack, or correct the source.",
                field="v_slack_pu",
                value=v_pu,
            )
        )
    return problems


def _network(feeder: ImportedFeeder, options: NewScenarioOptions) -> Network:
    if options.v_slack_pu is None:
        return feeder.network
    return replace(feeder.network, v_slack_pu=options.v_slack_pu)


def _customers(
    feeder: ImportedFeeder, loaded: Wholes, options: NewScenarioOptions, draw: np.random.Generator
) -> Customers:
    """One customer per bus with a load; tiers are drawn for those that the source leaves open."""
    bus = feeder.network.buses[loaded]
    p_kw = feeder.p_load_kw[loaded]
    # The model's power factors lag: a load that feeds reactive power counts as purely active.
    q_kvar = np.maximum(feeder.q_load_kvar[loaded], 0.0)
    tier = feeder.tier[loaded].copy()
    free = np.flatnonzero(tier == "")
    tier[draw.permutation(free)] = _drawn_tiers(len(free), options.tier_shares)
    return Customers(
        id=_ids("c", bus),
        bus=bus,
        tier=tier,
        weight=np.array([TIER_WEIGHTS[t] for t in tier]),
        power_factor=np.round(p_kw / np.hypot(p_kw, q_kvar), 6),
    )


def _drawn_tiers(count: int, shares: tuple[float, float, float]) -> list[str]:
    """Tiers by count: shares rounded, the lowest tier takes what is left."""
    names = list(TIER_WEIGHTS)
    first = round(shares[0] * count)
    second = min(round(shares[1] * count), count - first)
    return [names[0]] * first + [names[1]] * second + [names[2]] * (count - first - second)


def _pv(
    feeder: ImportedFeeder,
    customers: Customers,
    peak_kw: Floats,
    options: NewScenarioOptions,
    draw: np.random.Generator,
) -> PVSystems:
    """PV of the source at its customers' buses, or by the rule."""
    own = _existing_pv_kw(feeder)
    own_kw = np.asarray(own.reindex(customers.bus, fill_value=0.0), dtype=float)
    if options.pv == "existing" or (options.pv == "auto" and own_kw.any()):
        p_kw = own_kw
    else:
        p_kw = np.zeros_like(own_kw)
        if options.pv in ("auto", "sized"):
            count = round(options.pv_share_of_buses * len(customers))
            chosen = draw.permutation(len(customers))[:count]
            p_kw[chosen] = options.pv_share_of_peak * peak_kw[chosen]
    p_kw = _written(p_kw)
    has = np.flatnonzero(p_kw > 0)
    return PVSystems(
        id=_ids("pv", customers.bus[has]),
        customer=customers.id[has],
        p_max_kw=p_kw[has],
        s_max_kva=_written(PV_INVERTER_RATIO * p_kw[has]),
    )


def _existing_pv_kw(feeder: ImportedFeeder) -> pd.Series[float]:
    """PV power of the source by bus."""
    own = feeder.generators
    is_pv = np.array([str(kind).upper().startswith("PV") for kind in own.kind], dtype=bool)
    return pd.Series(own.p_kw[is_pv], own.bus[is_pv]).groupby(level=0).sum()


def _left_out(feeder: ImportedFeeder, scenario: Scenario) -> Iterator[str]:
    """Loads and generators of the feeder that the scenario does not have."""
    own = feeder.generators
    taken = set(scenario.customers.bus[scenario.pv.owner(scenario.customers)])
    pv_buses = taken & set(_existing_pv_kw(feeder).index)
    lost = [
        g
        for g, bus, kind in zip(own.id, own.bus, own.kind, strict=True)
        if bus not in pv_buses or not str(kind).upper().startswith("PV")
    ]
    if lost:
        yield f"Generators that the scenario does not have: {', '.join(lost)}."
    buses = feeder.network.buses
    reactive = buses[(feeder.p_load_kw <= 0) & (feeder.q_load_kvar != 0)]
    if len(reactive):
        yield f"Loads without active power are left out: bus {', '.join(map(str, reactive))}."
    leading = buses[(feeder.p_load_kw > 0) & (feeder.q_load_kvar < 0)]
    if len(leading):
        yield (
            "Loads that feed reactive power count as purely active: bus "
            f"{', '.join(map(str, leading))}."
        )


def _batteries(customers: Customers, peak_kw: Floats, options: NewScenarioOptions) -> Batteries:
    """A battery at every customer, sized by its peak load; the format's defaults elsewhere."""
    energy_kwh = _written(options.battery_kwh_per_peak_kw * peak_kw)
    has = np.flatnonzero(energy_kwh > 0)
    p_kw = _written(BATTERY_KW_PER_KWH * energy_kwh[has])
    defaults: dict[str, Any] = {
        name: np.full(len(has), np.nan if field.default is None else field.default)
        for name, field in schema.BatteryRow.model_fields.items()
        if not field.is_required()
    }
    defaults["soc_initial"] = defaults["soc_min"]
    defaults["grid_forming"] = np.zeros(len(has), dtype=bool)
    return Batteries(
        id=_ids("b", customers.bus[has]),
        bus=customers.bus[has],
        energy_kwh=energy_kwh[has],
        p_max_kw=p_kw,
        s_max_kva=_written(BATTERY_INVERTER_RATIO * p_kw),
        **defaults,
    )


def _written(values: Floats) -> Floats:
    """Numbers without the noise of their arithmetic, so that a person can read the files."""
    return np.round(values, DECIMALS)


def _ids(prefix: str, buses: Names) -> Names:
    """Identifiers of assets, after their bus."""
    return np.array([f"{prefix}{bus}" for bus in buses], dtype=object)


def _hours(grid: TimeGrid) -> Floats:
    """Hour of the day at the middle of every step, shape (T,)."""
    middle = grid.times + pd.Timedelta(minutes=grid.step_minutes / 2)
    return np.asarray(middle.hour + middle.minute / 60 + middle.second / 3600, dtype=float)


def _profile(shape: tuple[float, ...], grid: TimeGrid) -> Floats:
    """An hourly shape at every step, linear between the middles of the hours."""
    return np.interp(_hours(grid), np.arange(24) + 0.5, shape, period=24)


def _price(rule: PriceRule, grid: TimeGrid) -> Floats:
    """Import price of every step in GBP/kWh, shape (T,)."""
    price = np.full(grid.n_steps, FLAT_PRICE)
    if rule == "time-of-use":
        hours = _hours(grid)
        for (start, end), value in ((NIGHT, NIGHT_PRICE), (EVENING, EVENING_PRICE)):
            price[(hours >= start) & (hours < end)] = value
    return price


def _grid_limit(options: NewScenarioOptions, grid: TimeGrid) -> Floats:
    """No limit but in the outages, shape (T,)."""
    times = grid.times
    dark = np.logical_or.reduce(
        [(times >= first) & (times < last) for first, last in outages_of(options)]
    )
    return np.where(dark, 0.0, np.inf)


def _name(source: str) -> str:
    """A name that a scenario may have."""
    stem = source.rpartition(".")[0] or source
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", stem).strip("-._") or "feeder"


def _length(options: NewScenarioOptions) -> str:
    return "1 day" if options.days == 1 else f"{options.days} days"
