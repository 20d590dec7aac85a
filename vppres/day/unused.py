"""Options of a run that its other options leave without an effect."""

from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter
from typing import Any

from vppres.day.trajectory import Trajectory
from vppres.scenario.option_table import OPTIONS, Option
from vppres.scenario.scenario import Scenario


def without_effect(run: Trajectory) -> list[str]:
    """Options that were given and do nothing in the run, in sentences."""
    found = []
    for option in OPTIONS:
        value = _of(run.options, option.field)
        if not option.acts_with or value in _not_given(option, run.scenario):
            continue
        needed, *values = option.acts_with.split()
        chosen = _of(run.options, needed)
        if (chosen in values) if values else chosen:
            continue
        given = f"--{option.name} {value}" if option.command_line else f"{option.field} {value}"
        why = f"the {needed} is {chosen}, and it is for {' and '.join(values)}"
        found.append(f"{given} has no effect: {why if values else f'there is no {needed}'}.")
    return found


def _of(record: Mapping[str, Any], field: str) -> Any:
    """A field in the record of a run's options, None if the run is older than it."""
    group, _, name = field.rpartition(".")
    return (record.get(group, {}) if group else record).get(name)


def _not_given(option: Option, scenario: Scenario) -> tuple[Any, ...]:
    """Values of an option that was not given."""
    of_scenario = (option.scenario_key,) if option.scenario_key else ()
    return (None, option.default, *(attrgetter(key)(scenario) for key in of_scenario))
