"""What runs of phased feeders do not state, refused by name."""

from __future__ import annotations

from collections.abc import Iterator

from vppres.core.errors import InputError, Problem
from vppres.day.options import RunOptions
from vppres.scenario.scenario import HARD, Scenario

CONTROLLERS = ("mpc",)
DECOMPOSED = "decomposed"
BALANCED = "remove the folder's phase_*.csv for its balanced equivalent"


def check_phased(scenario: Scenario, options: RunOptions) -> None:
    """Refuse what plans of a phased feeder cannot hold.

    Raises
    ------
    InputError
        With every option that has no meaning there.
    """
    if scenario.phases is None:
        return
    problems = [*_not_stated(options.on(scenario))]
    for name in ("max_off_h", "own_backup_h", "share_min"):
        if len(getattr(scenario.customers, name)):
            problems.append(_wrong(name, "", "Leave the column of customers.csv out"))
    if problems:
        raise InputError(problems)


def _not_stated(options: RunOptions) -> Iterator[Problem]:
    """Options that a phased feeder has no plan for."""
    if options.mode != "physical":
        yield _wrong("mode", options.mode, "Use physical")
    if options.controller not in CONTROLLERS:
        yield _wrong("controller", options.controller, "Use mpc")
    if options.method != DECOMPOSED:
        yield _wrong("method", options.method, f"Use {DECOMPOSED}")
    if options.voltage_limits == HARD:
        yield _wrong("voltage_limits", options.voltage_limits, "Use soft")
    for name in ("rotation", "minimum_on_h"):
        if getattr(options, name):
            yield _wrong(name, getattr(options, name), "Leave it at 0")
    if options.switching.cold:
        yield _wrong("cold_load_factor", options.switching.cold_load_factor, "Use 1")


def _wrong(field: str, value: object, cure: str) -> Problem:
    return Problem(
        "options",
        "is not stated for feeders with phases",
        f"{cure}, or {BALANCED}.",
        field=field,
        value=value,
    )
