"""A first scenario for an imported feeder: tiers, PV, batteries, profiles and an outage by rule.

Every rule is a starting point to be edited: the folder that is written is the user's.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.errors import InputError, Problem
from vppres.core.tables import packaged_table
from vppres.core.text import counted, named
from vppres.feeders.closeness import (
    NOT_CONVERGED,
    check_deviation,
    source_deviation,
    told_causes,
    told_deviation,
)
from vppres.feeders.dss.phased_recheck import worst_hour_by_phase
from vppres.feeders.feeder import ImportedFeeder, Profile
from vppres.feeders.new.assets import NewAssets, new_assets, written
from vppres.feeders.new.connections import connected, shunts_in_islands, with_former
from vppres.feeders.new.kinds import WIND
from vppres.feeders.new.low_voltage import limits_of
from vppres.feeders.new.options import NewScenarioOptions, check_options, outages_of
from vppres.feeders.new.profiles import Series, place_profiles, timed
from vppres.feeders.series.files import FileDefaults, read_profiles
from vppres.io import atomic_folder
from vppres.io.editor import add_editor_schema
from vppres.io.messages import did_you_mean
from vppres.io.scenario_writer import fill_scenario_folder
from vppres.kinds.customer.data import SwitchingRules
from vppres.scenario.assets import PV, TIER_WEIGHTS, Batteries, PVSystems
from vppres.scenario.capacitors import too_large, too_large_by_phase
from vppres.scenario.network import Network
from vppres.scenario.phases import BALANCED, Phases
from vppres.scenario.priority import STRICT
from vppres.scenario.remarks import darkness, doubtful_units, former_words
from vppres.scenario.scenario import (
    DEFAULT_VOLL_GBP_PER_KWH,
    SOFT,
    ControllerDefaults,
    Priority,
    Scenario,
)
from vppres.scenario.source import Source, SourceDeviation
from vppres.scenario.timegrid import TimeGrid

NOTES_FILE = "notes.md"
NO_TIER = f"Write {', '.join(TIER_WEIGHTS)}, or leave the cell of the load empty."
OWN_PROFILES = "source"
"""What stands for the series of the network itself."""

# Demand and PV power of the packaged day of 19 July 2022, hour by hour, as shares of their peaks.
_DAY = packaged_table(__file__, "bundled_day.csv")
LOAD_SHAPE, PV_SHAPE = (tuple(float(hour[name]) for hour in _DAY) for name in ("load", "pv"))

# Hours of the day (from, to) and prices; mean, lowest and highest price of the paper.
DAY_PRICE = 0.36
NIGHT = (0, 6)
NIGHT_PRICE = 0.20
EVENING = (16, 20)
EVENING_PRICE = 0.54
TEMPERATURE_C = 20.0

LEAST_SERVED_H = 1.0
"""Time on supply of a restored customer: none is switched on for less than an hour."""

TOLD_CHOICES = (
    "Chosen: tiers in strict order (rule in [priority] of scenario.toml), where possible "
    f"{LEAST_SERVED_H:g} h on supply for a customer that is restored (min_served_h in "
    f"[switching]), and the British value of lost load, {DEFAULT_VOLL_GBP_PER_KWH:g} GBP/kWh "
    "(voll_gbp_per_kwh in [reliability])."
)


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
    return _built(feeder, options or NewScenarioOptions())[0]


def _built(feeder: ImportedFeeder, options: NewScenarioOptions) -> tuple[Scenario, list[str]]:
    """The scenario, and what was chosen, drawn or left out."""
    problems = check_options(options) + _check_feeder(feeder, options)
    if problems:
        raise InputError(problems)
    grid = options.grid
    assets = new_assets(feeder, options)
    series = _series(feeder, options, assets, grid)
    phases, batteries = BALANCED, assets.batteries
    if feeder.phased is not None:
        own = (assets.customers, assets.pv, batteries, assets.set_labels)
        phases = connected(feeder.phased, feeder.name, *own)
        batteries = with_former(phases, assets.customers, batteries)
    network, switched = _for_islands(_network(feeder, options), batteries, phases)
    if phases:
        phases = shunts_in_islands(phases, network)
        # A loading that is stated would be that of three equal phases, and so would a fixed power.
        none = np.zeros(network.n_buses)
        unlimited = np.full(network.n_lines, np.inf)
        network = replace(network, i_max_a=unlimited, p_fixed_kw=none, q_fixed_kvar=none)
    title = feeder.title or feeder.name
    constant_c = np.full(grid.n_steps, TEMPERATURE_C)
    scenario = Scenario(
        name=_name(feeder.name),
        title=f"{title}: {counted(options.days, 'day')}",
        grid=grid,
        network=network,
        customers=assets.customers,
        pv=assets.pv,
        batteries=batteries,
        gensets=assets.gensets,
        load_kw=written(series.load_kw),
        pv_kw=written(series.pv_kw),
        price_gbp_per_kwh=series.system.get("price_gbp_per_kwh", _price(grid)),
        temperature_c=series.system.get("temperature_c", constant_c),
        grid_limit_kw=_grid_limit(options, grid),
        tiers=tuple(assets.tiers),
        export_limit_kw=np.array(options.export_limit_kw),
        export_price_gbp_per_kwh=np.array(options.export_price_gbp_per_kwh),
        controller=ControllerDefaults(mode="physical", ratings=SOFT),
        priority=Priority(STRICT),
        switching=SwitchingRules(min_served_h=LEAST_SERVED_H),
        phases=phases,
        switches=feeder.switches,
    )
    notes = (*assets.notes, *switched, *series.notes, *_told_constants(series), TOLD_CHOICES)
    return scenario, [*notes, *_told_limits(network, options)]


def _for_islands(
    network: Network, batteries: Batteries, phases: Phases
) -> tuple[Network, list[str]]:
    """The network without the capacitors in islands that no battery can hold there, and which."""
    forming = batteries.formers
    if not forming.any():
        return network, []
    rating_kva = float(batteries.s_max_kva[forming].sum())
    words = f"the {rating_kva:,.0f} kVA"
    off = too_large(network, rating_kva)
    if phases:
        words = f"a third of the {rating_kva:,.0f} kVA on one phase"
        off = too_large_by_phase(network, phases, rating_kva)
    if not off.any():
        return network, []
    note = (
        f"The capacitors at bus {named(network.buses[off])} are switched off in islands: with them "
        f"there is more reactive power than {words} of the grid-forming "
        f"battery {named(batteries.id[forming])}."
    )
    return replace(network, island=network.island & ~off), [note]


def _series(
    feeder: ImportedFeeder, options: NewScenarioOptions, assets: NewAssets, grid: TimeGrid
) -> Series:
    """Load and available power: those that were given, and the bundled day for the rest."""
    shape = _profile(LOAD_SHAPE, grid)
    available_kw = _available(assets.pv, grid)
    if options.profiles is None:
        load_kw = np.outer(shape, assets.peak_kw)
        return Series(load_kw, available_kw, notes=tuple(_told_bundled(assets.pv)))
    profiles = timed(
        _given_profiles(feeder, options), grid, options.time_zone, options.profile_step_minutes
    )
    return place_profiles(
        profiles, feeder, assets, (shape, available_kw), grid, options.max_gap_minutes
    )


def _given_profiles(feeder: ImportedFeeder, options: NewScenarioOptions) -> list[Profile]:
    """Series of the network itself, or of files."""
    if str(options.profiles) != OWN_PROFILES:
        reading = FileDefaults(
            options.time_zone, options.profile_unit, options.profile_step_minutes
        )
        return read_profiles(str(options.profiles), reading)
    if feeder.profiles:
        return [*feeder.profiles]
    raise InputError.of(
        feeder.name,
        "has no series of its own",
        "Give a folder with --profiles, or leave it out for the bundled day.",
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
        As :func:`new_scenario`, if the folder holds something, or if the voltages are further
        from the source's than the options accept.
    """
    scenario, chosen = _built(feeder, options)
    causes: list[str] = []
    if feeder.phased is None:
        deviation = checked = source_deviation(feeder, scenario)
        closeness = told_deviation(feeder, deviation)
        causes += told_causes(feeder, deviation)
    else:
        given_pu = feeder.phased.difference_pu
        worst_pu = None if given_pu is None else worst_hour_by_phase(feeder, scenario)
        opened_pu = feeder.opened_pu
        deviation = SourceDeviation(None, given_pu, worst_pu, opened_pu)
        # Taps stay as given, so that hours of less demand leave the range of the loads' models.
        checked = SourceDeviation(as_given_pu=given_pu, opened_pu=opened_pu)
        closeness = str(deviation)
    check_deviation(feeder, checked, options.accept_deviation)
    told = [*causes, *feeder.notes, *chosen]
    source = Source.of(feeder.name, "", told, deviation, feeder.unbalanced)
    scenario = replace(scenario, source=source)
    said = [former_words(scenario), darkness(scenario), closeness]
    # A source that does not converge is asked for its units itself.
    first = causes if NOT_CONVERGED in causes else [*causes, *doubtful_units(scenario)]
    notes = list(dict.fromkeys([*first, *told, *filter(None, said)]))
    text = "\n".join([f"# {scenario.title}", "", *(f"- {note}" for note in notes), ""])
    with atomic_folder(folder) as aside:
        fill_scenario_folder(scenario, aside)
        add_editor_schema(aside)
        (aside / NOTES_FILE).write_text(text, encoding="utf-8", newline="\n")
    return notes


def assumptions(feeder: ImportedFeeder, options: NewScenarioOptions) -> list[str]:
    """Sentences on simplifications and on choices by rule."""
    return [*feeder.notes, *_built(feeder, options)[1]]


def _told_bundled(pv: PVSystems) -> Iterator[str]:
    """Sentence that load and generation are the bundled day's."""
    kinds = dict.fromkeys(pv.kind)
    shaped = "load and PV follow" if PV in kinds else "load follows"
    yield f"Invented: {shaped} one bundled summer day; the source's loads are the peaks."
    still = [str(name) for name in pv.id[pv.kind == WIND]]
    if still:
        yield (
            f"Wind without a series gives nothing: {named(still)}. Give its series with --profiles."
        )
    constant = [str(name) for name in pv.id[(pv.kind != PV) & (pv.kind != WIND)]]
    if constant:
        yield f"Without a series, at their largest power in every step: {named(constant)}."


def _told_constants(series: Series) -> Iterator[str]:
    """Prices and temperature that no series gives."""
    words = []
    if "price_gbp_per_kwh" not in series.system:
        words.append("prices (time-of-use)")
    if "temperature_c" not in series.system:
        words.append(f"the temperature, {TEMPERATURE_C:g} °C")
    if words:
        yield f"Invented: {' and '.join(words)}."


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
            f"is not a tier ({named(feeder.loads.id[feeder.loads.tier == tier])})",
            did_you_mean(tier, TIER_WEIGHTS, NO_TIER),
            field="tier",
            value=tier,
        )
        for tier in sorted({*feeder.loads.tier} - {"", *TIER_WEIGHTS})
    ]
    v_pu = feeder.network.v_slack_pu if options.v_slack_pu is None else options.v_slack_pu
    limits = limits_of(feeder.network, options.time_zone)
    if not limits.v_min_pu <= v_pu <= limits.v_max_pu:
        problems.append(
            Problem(
                feeder.name,
                f"must lie between {limits.v_min_pu:g} and {limits.v_max_pu:g}, the "
                "limits of the voltages",
                "Give another one with --v-slack, or correct the source.",
                field="v_slack_pu",
                value=v_pu,
            )
        )
    return problems


def _network(feeder: ImportedFeeder, options: NewScenarioOptions) -> Network:
    limits = limits_of(feeder.network, options.time_zone)
    v_slack_pu = feeder.network.v_slack_pu if options.v_slack_pu is None else options.v_slack_pu
    return replace(
        feeder.network,
        v_slack_pu=v_slack_pu,
        v_min_pu=limits.v_min_pu,
        v_max_pu=limits.v_max_pu,
        v_min_ac_pu=limits.v_min_ac_pu,
        v_max_ac_pu=limits.v_max_ac_pu,
    )


def _told_limits(network: Network, options: NewScenarioOptions) -> Iterator[str]:
    """Sentence on the voltage limits of a low-voltage feeder."""
    limits = limits_of(network, options.time_zone)
    if limits.origin:
        yield (
            f"Voltage limits are {limits.v_min_ac_pu:g} to {limits.v_max_ac_pu:g} pu, and "
            f"{limits.v_min_pu:g} to {limits.v_max_pu:g} pu in plans ({limits.origin}). Edit "
            "[network] where the feeder has others."
        )


def _hours(grid: TimeGrid) -> Floats:
    """Hour of the day at the middle of every step, shape (T,)."""
    middle = grid.times + pd.Timedelta(minutes=grid.step_minutes / 2)
    return np.asarray(middle.hour + middle.minute / 60 + middle.second / 3600, dtype=float)


def _profile(shape: tuple[float, ...], grid: TimeGrid) -> Floats:
    """An hourly shape at every step, linear between the middles of the hours."""
    return np.interp(_hours(grid), np.arange(24) + 0.5, shape, period=24)


def _available(pv: PVSystems, grid: TimeGrid) -> Floats:
    """Power of each system, (T, P): the bundled day's for PV, none for wind, else the largest."""
    constant = np.where(pv.kind == WIND, 0.0, 1.0)
    shape = np.where(pv.kind == PV, _profile(PV_SHAPE, grid)[:, None], constant)
    return shape * pv.p_max_kw


def _price(grid: TimeGrid) -> Floats:
    """Import price of every step in GBP/kWh, shape (T,)."""
    price = np.full(grid.n_steps, DAY_PRICE)
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
