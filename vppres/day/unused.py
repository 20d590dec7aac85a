"""Options of a run that its other options, or its devices, leave without an effect."""

from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter
from typing import Any

import numpy as np

from vppres.core.text import counted
from vppres.day.trajectory import Trajectory
from vppres.scenario.assets import Batteries
from vppres.scenario.option_table import OPTIONS, Option, option_of
from vppres.scenario.scenario import Scenario

STATES_OF_CHARGE = ("soc_end", "reserve.soc")
"""Options that ask a state of charge of all batteries, each of which has limits of its own."""


def without_effect(run: Trajectory) -> list[str]:
    """Options that were given and do nothing in the run, or not what they say, in sentences."""
    found = []
    for option in OPTIONS:
        value = _of(run.options, option.field)
        if value is None:
            continue
        why = _why_idle(run.options, option)
        if option.field in STATES_OF_CHARGE and not why:
            found += beyond_limits(f"--{option.name}", value, run.scenario.batteries)
        if why and value not in _not_given(option, run.scenario):
            found.append(f"{_given(option, value)} has no effect{why}.")
    if run.options.get("move_switches") and not run.scenario.switches.movable.any():
        found.append("--move-switches has no effect: the site has no switch that can be moved.")
    return found


def beyond_limits(name: str, soc: float, batteries: Batteries) -> list[str]:
    """Batteries that a state of charge, asked of all, is outside the limits of, in a sentence."""
    beyond = (soc < batteries.soc_min) | (soc > batteries.soc_max)
    if not beyond.any():
        return []
    of = counted(len(batteries), "battery", "batteries")
    held = np.clip(soc, batteries.soc_min, batteries.soc_max)[beyond]
    least, most = f"{held.min():g}", f"{held.max():g}"
    kept = least if least == most else f"{least} to {most}"
    return [
        f"{name} {soc:g} is outside the limits of {int(beyond.sum())} of {of} (soc_min, soc_max): "
        f"the nearest limit counts there, {kept}."
    ]


def _why_idle(options: Mapping[str, Any], option: Option) -> str:
    """Why an option does nothing beside the others; empty if it acts."""
    if not option.acts_with:
        return ""
    needed, *values = option.acts_with.split()
    chosen = _of(options, needed)
    if values:
        fits = chosen in values
        return "" if fits else f": the {needed} is {chosen}, and it is for {' and '.join(values)}"
    other = option_of(needed)
    off = False if other.kind is bool else other.default
    return f" without --{other.name}" if chosen == off else ""


def _given(option: Option, value: Any) -> str:
    """An option as it is given."""
    if not option.command_line:
        return f"{option.field} {value}"
    return f"--{option.name}" if option.kind is bool else f"--{option.name} {value}"


def _of(record: Mapping[str, Any], field: str) -> Any:
    """A field in the record of a run's options, None if the run is older than it."""
    group, _, name = field.rpartition(".")
    return (record.get(group, {}) if group else record).get(name)


def _not_given(option: Option, scenario: Scenario) -> tuple[Any, ...]:
    """Values of an option that was not given."""
    of_scenario = (option.scenario_key,) if option.scenario_key else ()
    return (None, option.default, *(attrgetter(key)(scenario) for key in of_scenario))
