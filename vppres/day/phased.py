"""What runs of phased feeders do not state, refused by name."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vppres.core.errors import InputError, Problem
from vppres.day.options import RunOptions
from vppres.scenario.kinds import KINDS, units_of
from vppres.scenario.scenario import HARD, Scenario

CONTROLLERS = ("mpc",)
DECOMPOSED = "decomposed"
NOT_STATED = "is not stated for feeders with phases"
BALANCED = "remove the folder's phase_*.csv for its balanced equivalent"


def check_phased(scenario: Scenario, options: RunOptions) -> None:
    """Refuse what plans of a phased feeder cannot hold.

    Raises
    ------
    InputError
        With every option, column and kind of asset that has no meaning there.
    """
    if scenario.phases is None:
        return
    problems = [*_options(options.on(scenario)), *_columns(scenario), *_kinds(scenario)]
    if problems:
        raise InputError(problems)


def _options(options: RunOptions) -> Iterator[Problem]:
    """Options that a phased feeder has no plan for."""
    if options.mode != "physical":
        yield _option("mode", options.mode, "Use physical")
    if options.controller not in CONTROLLERS:
        yield _option("controller", options.controller, "Use mpc")
    if options.method != DECOMPOSED:
        yield _option("method", options.method, f"Use {DECOMPOSED}")
    if options.voltage_limits == HARD:
        yield _option("voltage_limits", options.voltage_limits, "Use soft")
    for name in ("rotation", "minimum_on_h"):
        if getattr(options, name):
            yield _option(name, getattr(options, name), "Use 0")
    if options.switching.cold:
        yield _option("cold_load_factor", options.switching.cold_load_factor, "Use 1")


def _option(field: str, value: object, cure: str) -> Problem:
    return Problem("options", NOT_STATED, f"{cure}, or {BALANCED}.", field=field, value=value)


def _columns(scenario: Scenario) -> Iterator[Problem]:
    """Columns of customers that a phased feeder has no plan for, by the first who has a value."""
    customers = scenario.customers
    for name in ("max_off_h", "own_backup_h", "share_min"):
        values = getattr(customers, name)
        given = np.flatnonzero(~np.isnan(values))
        if len(given):
            yield Problem(
                "customers.csv",
                NOT_STATED,
                f"Leave the column out, or {BALANCED}.",
                field=f"{name} of {customers.id[given[0]]}",
                value=values[given[0]],
                more=len(given) - 1,
            )


def _kinds(scenario: Scenario) -> Iterator[Problem]:
    """Assets of kinds that a phased feeder has no plan for, by the first of each kind."""
    for name, units in units_of(scenario).items():
        kind = KINDS[name]
        yield Problem(
            kind.file,
            NOT_STATED,
            f"Remove the file, or {BALANCED}.",
            field="id",
            value=units.id[0],
            more=len(units) - 1,
        )
