"""Remarks on a scenario: its source, doubtful units, islands without a voltage source."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from vppres.core.text import counted, named
from vppres.kinds.customer import data as customer
from vppres.kinds.export import data as export
from vppres.kinds.table import KINDS, TABLES
from vppres.scenario.capacitors import too_large, too_large_by_phase
from vppres.scenario.earthing import floating
from vppres.scenario.formers import forming_batteries, island_former, named_units
from vppres.scenario.line_heat import hot_lines
from vppres.scenario.network import LOW_VOLTAGE_KV

if TYPE_CHECKING:
    from vppres.scenario.scenario import Scenario

NAMES_SHOWN = 5
"""Assets named in one sentence."""

LOW_VOLTAGE_KW = (0.1, 1e3)
MEDIUM_VOLTAGE_KW = (1.0, 1e4)
"""Least and largest plausible peak of the median customer: of homes, and of substations."""

BATTERY_H = (0.1, 200.0)
"""Least and most hours at full power that a battery plausibly holds."""


def doubtful_units(scenario: Scenario) -> list[str]:
    """Demand, lines and batteries of a size that suggests another unit, in sentences.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from vppres.io.find import load_scenario
    >>> day = load_scenario("uk-heatwave-2022")
    >>> doubtful_units(day)
    []
    >>> print(*doubtful_units(replace(day, load_kw=day.load_kw / 1000.0)))
    load_kw.csv, c18: the median customer's largest demand is 0.098552 kW at 12.66 kV. Is the file \
in MW? Its numbers are kW.
    """
    said = [_doubtful_demand(scenario) or hot_lines(scenario)]
    b = scenario.batteries
    hours = np.divide(b.energy_kwh, b.p_max_kw, out=np.ones(len(b)), where=b.p_max_kw > 0.0)
    least_h, most_h = BATTERY_H
    for wrong, question in (
        (hours < least_h, "Is the energy in MWh, or the power in W?"),
        (hours > most_h, "Is the energy in Wh, or the power in MW?"),
    ):
        for i in np.flatnonzero(wrong)[:1]:
            others = f" (and {wrong.sum() - 1} more)" if wrong.sum() > 1 else ""
            said.append(
                f"batteries.csv, {b.id[i]}{others}: energy_kwh = {b.energy_kwh[i]:.4g} holds "
                f"p_max_kw = {b.p_max_kw[i]:.4g} for {hours[i]:,.6g} h. {question}"
            )
    return [*filter(None, said)]


def _doubtful_demand(scenario: Scenario) -> str:
    """Whether the median customer's peak is that of another unit."""
    peak_kw = scenario.load_kw.max(axis=0)
    median = int(np.argsort(peak_kw, kind="stable")[(len(peak_kw) - 1) // 2])
    base_kv = scenario.network.base_kv
    least_kw, most_kw = LOW_VOLTAGE_KW if base_kv <= LOW_VOLTAGE_KV else MEDIUM_VOLTAGE_KW
    if peak_kw[median] == 0.0 or least_kw <= peak_kw[median] <= most_kw:
        return ""
    return (
        f"load_kw.csv, {scenario.customers.id[median]}: the median customer's largest demand is "
        f"{peak_kw[median]:,.6g} kW at {base_kv:g} kV. Is the file in "
        f"{'MW' if peak_kw[median] < least_kw else 'W'}? Its numbers are kW."
    )


def darkness(scenario: Scenario, mode: str | None = None) -> str:
    """Why every island of a scenario blacks out, or would; empty if something can form the grid.

    ``mode`` is that of its islands; the scenario's own if not given.
    """
    named_of = named_units(scenario)
    able = [(each & getattr(scenario, kind).fuelled(scenario)) for kind, each in named_of.items()]
    if not scenario.outage.any() or scenario.formers.any() or any(each.any() for each in able):
        return ""
    count = int(scenario.outage.sum())
    steps = "the only step" if count == 1 else f"the {count} steps"
    cause = "No battery can form a grid"
    if scenario.batteries.formers.any():
        cause = (
            "No battery that is to form a grid has three phases (coils of phase_connections.csv)"
        )
    elif len(scenario.batteries):
        cause = "No battery has the power to form a grid"
    if named_of:
        cause = (
            "No battery can form a grid, and no generating set with this duty has fuel for a step"
        )
    if (mode or scenario.controller.mode) == "physical":
        return f"{cause}: the island is blacked out, with no supply in {steps} without grid."
    return (
        f"{cause}: a real island would be blacked out in {steps} without grid. Paper mode assumes "
        "its voltage and counts customers supplied by PV as served; physical mode does not."
    )


def unknown_phases(scenario: Scenario) -> list[str]:
    """Warnings that no run knows the phases, as the source is unbalanced; empty if it is not.

    Examples
    --------
    >>> from vppres.io.find import load_scenario
    >>> unknown_phases(load_scenario("uk-heatwave-2022"))
    []
    """
    unbalanced = scenario.source.unbalanced
    if not unbalanced:
        return []
    words = [
        f"Phases are not known here: the source is unbalanced ({unbalanced}) and was spread over "
        "three phases. A single phase may exceed voltage limits or ratings that these figures keep."
    ]
    formers = scenario.batteries.id[forming_batteries(scenario)]
    if scenario.outage.any() and len(formers):
        words.append(
            f"Not checked: the phases of what forms the island ({', '.join(map(str, formers))}). "
            "One phase may be beyond its rating, and the island may trip."
        )
    return words


def held_capacitors(scenario: Scenario) -> str:
    """Which capacitors the batteries of an island cannot hold; empty if they can hold all."""
    network = scenario.network.islanded
    batteries = scenario.batteries
    formers_kva = float(batteries.s_max_kva[forming_batteries(scenario)].sum())
    if not scenario.outage.any() or not formers_kva:
        return ""
    size, table = f"the {formers_kva:,.0f} kVA of its grid-forming batteries", "buses.csv"
    off = too_large(network, formers_kva)
    if scenario.phases:
        size, table = f"a third of {size} on one phase", "buses.csv and phase_shunts.csv"
        off = too_large_by_phase(network, scenario.phases, formers_kva)
    buses = network.buses[off]
    if not len(buses):
        return ""
    return (
        f"The capacitors that stay connected in an island have more reactive power than {size}, "
        f"and may black it out. Give those of bus {', '.join(map(str, buses[:12]))} the value no "
        f"in the column island of {table}."
    )


NO_FORMER = (
    "Nothing can form the grid of an island: without grid no customer is supplied. Mark a battery "
    f"in batteries.csv{''.join(f' or a {k.sign} in {k.file}' for k in KINDS.values() if k.forms)} "
    "with grid_forming."
)
ONE_FORMER = "Nothing else forms it: if it fails or has no energy left, no customer is supplied."


def former_words(scenario: Scenario, mode: str | None = None, always: bool = False) -> str:
    """Description of the devices that form an island's grid; empty where no island needs it.

    ``mode`` is that of its islands, the scenario's own if not given; with ``always`` an outage may
    come that is not in the scenario, as it may for a service.
    """
    b = scenario.batteries
    physical = (mode or scenario.controller.mode) == "physical"
    outage = always or scenario.outage.any()
    if not physical or not outage:
        return ""
    forming = [
        f"{KINDS[kind].sign} {units.id[i]} at bus {units.bus[i]} ({units.largest_kw[i]:,.4g} kW)"
        for kind, forms in named_units(scenario).items()
        for units in [getattr(scenario, kind)]
        for i in np.flatnonzero(forms)
    ]
    names = [
        f"{b.id[i]} at bus {b.bus[i]} ({b.s_max_kva[i]:,.4g} kVA)"
        for i in np.flatnonzero(scenario.formers)
    ]
    if not names and not forming:
        return NO_FORMER if always else ""  # of the outages of a scenario, :func:`darkness` says it
    alone = f" {ONE_FORMER}" if len(names) + len(forming) == 1 else ""
    if scenario.faults and not (b.grid_forming.any() or forming):
        alone = " Behind a line that is out it is the one with the largest inverter there."
    if not names:
        fuel = "it has fuel" if len(forming) == 1 else "they have fuel"
        return f"{_form(forming)}, as long as {fuel}.{alone}{_unearthed(scenario)}"
    if b.grid_forming.any():
        then = f" Without their energy, it is {named(forming, NAMES_SHOWN)}." if forming else ""
        return f"{_form(names)}.{then}{alone}{_unearthed(scenario)}"
    demand_kva = np.hypot(scenario.load_kw.sum(axis=1), scenario.load_kvar.sum(axis=1))
    return (
        f"{_form(names)}: no battery is marked grid_forming in batteries.csv, and its inverter is "
        f"the largest. Mark those that can form it. The largest demand is {demand_kva.max():,.1f} "
        f"kVA.{alone}"
    )


def _form(names: list[str]) -> str:
    """Devices that form the grid of an island, as the beginning of a sentence."""
    form = "forms" if len(names) == 1 else "form"
    return f"In an island {named(names, NAMES_SHOWN)} {form} the grid"


def _unearthed(scenario: Scenario) -> str:
    """Warning that customers in an island have no earthed source; empty if they have one."""
    former = island_former(scenario)
    if not scenario.phases or former is None:
        return ""
    names = floating(scenario.phases, former, [str(name) for name in scenario.customers.id])
    if not names:
        return ""
    return (
        f" With {former} as source nothing earths the buses of {named(names, NAMES_SHOWN)}, whose "
        "coils are to ground: nothing holds their voltages there, and no plan is sure. Mark a "
        "battery or generating set whose coils or transformer earth them as grid_forming."
    )


def rising_weights(scenario: Scenario) -> str:
    """Which tier outweighs customers of one that is named before it; empty if none does."""
    customers = scenario.customers
    present = [tier for tier in scenario.tiers if (customers.tier == tier).any()]
    for before, after in pairwise(present):
        more = float(customers.weight[customers.tier == after].max())
        above = customers.tier == before
        lighter = above & (customers.weight < more)
        if lighter.any():
            less = float(customers.weight[lighter].max())
            who = "any" if (lighter == above).all() else named(customers.id[lighter], NAMES_SHOWN)
            return (
                f"A customer of tier {after!r} weighs {more:g}, more than {who} of tier {before!r} "
                f"({less:g}), though tiers are named from the most important one: check [tiers] "
                "and the column weight, if that is not meant."
            )
    return ""


def source_words(scenario: Scenario) -> list[str]:
    """Description of a scenario's source, its exactness and the place of the import's notes.

    Examples
    --------
    >>> from vppres.io.find import load_scenario
    >>> source_words(load_scenario("uk-heatwave-2022"))
    []
    """
    source = scenario.source
    if not source:
        return []
    notes = len(source.notes)
    kept = (
        f" [source] in scenario.toml has {counted(notes, 'note')} on the import." if notes else ""
    )
    return [f"{source}{kept}"]


def remarks(scenario: Scenario, mode: str | None = None) -> list[str]:
    """Doubtful units, dark islands, dear export and tiers, each in a sentence.

    Examples
    --------
    >>> from vppres.io.find import load_scenario
    >>> remarks(load_scenario("uk-heatwave-2022"))
    []
    """
    said = [
        *doubtful_units(scenario),
        darkness(scenario, mode),
        former_words(scenario, mode),
        held_capacitors(scenario),
        export.remark(scenario),
        rising_weights(scenario),
        customer.remark(scenario),
        *(getattr(scenario, name).remark(scenario) for name in TABLES),
    ]
    return [*filter(None, said)]
