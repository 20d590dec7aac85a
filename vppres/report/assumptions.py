"""Assumptions of a run: every option in words, the data, and simplifications of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from vppres.core.plain import flattened
from vppres.day.options import RULES
from vppres.day.trajectory import Trajectory
from vppres.kinds.customer import record as customer
from vppres.kinds.table import parts, units_of
from vppres.scenario.option_table import OPTIONS, Option
from vppres.scenario.priority import STRICT
from vppres.scenario.scenario import LIMIT, SOFT


@dataclass(frozen=True)
class OptionWords:
    """One option of the run in words; the default is empty where it is the value."""

    name: str
    value: str
    meaning: str
    default: str


def option_words(options: Mapping[str, Any]) -> list[OptionWords]:
    """Every option of a run with its meaning and its default."""
    known = {option.field: option for option in OPTIONS}
    rows = []
    for name, value in flattened(options).items():
        words = value_words(value)
        option = known.get(name)
        default = value_words(option.default) if option else words
        rows.append(
            OptionWords(
                name.replace("_", " ").replace(".", ", "),
                words,
                _meaning(option) if option else "",
                "" if words == default else default,
            )
        )
    return rows


def _meaning(option: Option) -> str:
    """Meaning of an option in a sentence."""
    unit = f", in {option.unit}" if option.unit not in ("", "share") else ""
    words = f": {option.words}" if option.words else ""
    return f"{option.meaning[0].upper()}{option.meaning[1:]}{unit}{words}."


def simplifications(run: Trajectory) -> list[str]:
    """Simplifications of the model that matter to this run."""
    options = run.options
    day = run.scenario
    errors = options.get("errors", {})
    exact = not any(errors.values()) if isinstance(errors, Mapping) else True
    sentences = [
        "One phase stands for three: loads, PV and lines are balanced, and lines are series "
        "impedances without charging.",
        "Values are constant within a step: faster changes of load, PV power or voltage are "
        "ignored.",
        "The optimisation uses a linearised network; voltages, currents and losses in this "
        "report are from the AC power flow of the actual step.",
        _ratings(options)
        if day.network.has_ratings
        else "No line has a rating: the report has currents, but no overloads.",
        "Forecasts are the actual load and PV power: no forecast errors."
        if exact
        else "Forecasts have errors; the current step, prices, the grid's availability and "
        "temperatures are known.",
    ]
    if len(day.tiers) > 1:
        sentences.append(_order(options))
    sentences += customer.assumptions(run)
    records = parts("words")
    sentences += [records[kind].assumption(run) for kind in units_of(day)]
    if options.get("thermal") == "off":
        sentences.append("Battery efficiencies are constant: heating is not simulated.")
    if options.get("mode", "paper") == "paper" and day.outage.any():
        sentences.append(
            "In an outage the optimisation's island has no losses; the AC power flow "
            "takes them, and any mismatch, from the grid's bus."
        )
    if options.get("mode") == "physical" and day.outage.any():
        sentences.append(
            "In an outage the batteries that form the grid share losses and "
            "mismatch; frequency and transients are not simulated."
        )
    return [*sentences, *day.batteries.notes]


def _order(options: Mapping[str, Any]) -> str:
    """Meaning of tiers in the plans."""
    if options.get("priority") == STRICT:
        return (
            "Tiers are in strict order: a window supplies as many customers and steps of the first "
            "as it can, then of the second, and so on."
        )
    return "Customers are weighed against each other: many small ones may outweigh a larger one."


def _ratings(options: Mapping[str, Any]) -> str:
    """Meaning of line ratings in the plans."""
    ratings = options.get("ratings")
    if ratings in (LIMIT, SOFT) and options.get("controller") not in RULES:
        own = ", or what they are without control," if ratings == SOFT else ""
        return f"Plans keep the currents of lines within their ratings{own} where a dispatch does."
    return "Line ratings are reported, not enforced."


def data_words(run: Trajectory) -> list[tuple[str, str]]:
    """Size and limits of the scenario, each with its name."""
    day = run.scenario
    net = run.scenario.network
    grid = run.scenario.grid
    weights = ", ".join(_tier_words(run, tier) for tier in day.tiers)
    rated = int(np.isfinite(net.i_max_a).sum())
    return [
        ("scenario", f"{day.name}: {day.title}"),
        ("time", f"{grid.n_steps} steps of {grid.step_minutes:g} min from {grid.start}"),
        (
            "network",
            f"{net.n_buses} buses, {net.n_lines} lines ({rated} with a rating), "
            f"{net.base_kv:g} kV, grid at bus {net.slack_bus} held at {net.v_slack_pu:g} pu",
        ),
        (
            "voltage limits",
            f"{net.v_min_pu:g} to {net.v_max_pu:g} pu in the optimisation, "
            f"{net.v_min_ac_pu:g} to {net.v_max_ac_pu:g} pu in the AC power flow",
        ),
        (
            "customers",
            f"{len(day.customers)}, {day.load_kw.sum(axis=1).max():,.0f} kW at the "
            f"highest; weights: {weights}",
        ),
        ("generators", f"{day.pv.counted()}, {day.pv.p_max_kw.sum():,.0f} kW"),
        (
            "batteries",
            f"{len(day.batteries)}, {day.batteries.energy_kwh.sum():,.0f} kWh, "
            f"{day.batteries.p_max_kw.sum():,.0f} kW",
        ),
        (
            "objective",
            ", ".join(
                f"{f.name} {getattr(day.objective, f.name):g}" for f in fields(day.objective)
            ),
        ),
    ]


def _tier_words(run: Trajectory, tier: str) -> str:
    """Weights that occur in a tier, and how many customers it has."""
    customers = run.scenario.customers
    weights = np.unique(customers.weight[customers.tier == tier])
    text = f"{weights[0]:g}" if len(weights) == 1 else "several" if len(weights) else "none"
    return f"{tier} {text} ({int(np.sum(customers.tier == tier))})"


def value_words(value: Any) -> str:
    """The value of an option.

    >>> value_words(None), value_words(True), value_words([0.5, 2.0])
    ('none', 'yes', '0.5, 2')
    """
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(value_words, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
