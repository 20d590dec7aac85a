"""Checks of a run: options and kinds of assets that its plans do not state."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vppres.core.errors import InputError, Problem
from vppres.day.options import PERFECT, RunOptions
from vppres.day.outages import BELIEF, KNOWN
from vppres.kinds.table import KINDS, parts, units_of
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid

MPC = "mpc"
DECOMPOSED = "decomposed"
NOT_STATED = "is not stated for feeders with phases"
BALANCED = "remove the folder's phase_*.csv for its balanced equivalent"


def check_run(scenario: Scenario, options: RunOptions, grid: TimeGrid) -> None:
    """Refuse what the plans of a run cannot hold.

    Raises
    ------
    InputError
        With every option, column and kind of asset that has no meaning there, and the cure.
    """
    problems = [*_phased(scenario, options)] or [
        *_cold(scenario, options),
        *_controller(scenario, options, grid),
    ]
    if problems:
        raise InputError(problems)
    physics = parts("physics")
    for kind in units_of(scenario):
        physics[kind].check_prices(scenario, options.horizon_h, options.seed)


def _cold(scenario: Scenario, options: RunOptions) -> Iterator[Problem]:
    """A higher demand after restorations, of what is dimmed or has a temperature."""
    field, value = "cold_load_factor", options.rules.cold_load_factor
    if options.rules.cold and scenario.customers.dimmable.any():
        # Which of the two comes first is not said.
        message = "is not stated for customers that may be dimmed"
        cure = "Use 1, or leave the column share_min of customers.csv out."
        yield Problem("options", message, cure, field=field, value=value)
    for kind in map(KINDS.__getitem__, units_of(scenario)):
        if not (options.rules.cold and kind.recovers_by):
            continue
        message = f"counts what {kind.what} draw after an outage twice"
        cure = f"Use 1: what restored customers draw follows from their {kind.recovers_by}."
        yield Problem("options", message, cure, field=field, value=value)


def _controller(scenario: Scenario, options: RunOptions, grid: TimeGrid) -> Iterator[Problem]:
    """Problems of options that only the MPC plans, of the horizon, and of outages without a use."""
    name, outages = options.controller, str(options.outages)
    if name != MPC:
        for kind in map(KINDS.__getitem__, units_of(scenario)):
            cure = f"Use {MPC}, or remove {kind.file}."
            yield Problem("options", f"plans no {kind.what}", cure, field="controller", value=name)
        if options.shares_supply:
            message = "share supply within tiers, which is for the controller mpc"
            cure = "Leave them at 0, or use the controller mpc."
            yield Problem("options", message, cure, field="rotation and minimum_on_h")
        if options.move_switches:
            cure = f"Use {MPC}, or leave the switches as they are."
            yield Problem("options", f"are not moved by {name}", cure, field="move_switches")
    elif 0.0 < options.horizon_h < grid.dt_h:
        message = f"is shorter than a step of {grid.dt_h:g} h"
        cure = f"Give {grid.dt_h:g} or more, or 0 for the present step alone."
        yield Problem("options", message, cure, field="horizon_h", value=options.horizon_h)
    message = f"has no meaning for the controller {name}"
    if name == PERFECT and outages != KNOWN:
        cure = "Use the controller full-horizon, or known outages."
        yield Problem("options", message, cure, field="outages", value=outages)
    elif name != MPC and outages == BELIEF:
        cure = "Use the controller mpc, or likely outages."
        yield Problem("options", message, cure, field="outages", value=outages)


def _phased(scenario: Scenario, options: RunOptions) -> Iterator[Problem]:
    """Options that a phased feeder has no plan for."""
    if not scenario.phases:
        return
    for field, value, wrong, cure in (
        ("mode", options.mode, options.mode != "physical", "physical"),
        ("controller", options.controller, options.controller != MPC, MPC),
        ("method", options.method, options.method != DECOMPOSED, DECOMPOSED),
    ):
        if wrong:
            cure = f"Use {cure}, or {BALANCED}."
            yield Problem("options", NOT_STATED, cure, field=field, value=value)


def check_parts(scenario: Scenario) -> None:
    """Refuse items of a customer that is switched in parts: it is not said with which.

    Raises
    ------
    InputError
        If there is one.
    """
    customers = scenario.customers
    for kind, units in units_of(scenario).items():
        alone = units.connected(customers, np.zeros(len(customers), dtype=bool))
        owner = units.owner(customers)
        for i in np.flatnonzero(~alone & (customers.shed_steps[owner] > 1))[:1]:
            own_bus = f"{KINDS[kind].word} {units.id[i]} a bus instead, or "
            raise InputError.of(
                KINDS[kind].file,
                "is switched in parts (shed_steps)",
                f"Give {own_bus if hasattr(units, 'bus') else ''}the customer a shed_steps of 1.",
                field="customer",
                value=customers.id[owner[i]],
            )
