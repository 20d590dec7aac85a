"""Dispatch of one step by rule in a feeder that faults of lines cut into parts.

Each part is a step of its own in which nothing outside of it is served, gives or takes: that with
the grid's bus, islands that something forms, and dead ones in which nothing is supplied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vppres.control.carried import Carried, dispatch_of
from vppres.control.rules import carry, rule_dispatch
from vppres.control.step_state import StepState
from vppres.core.arrays import Flags, Floats
from vppres.kinds.export.physics import Export
from vppres.model.linearise import Drawn

Rule = Callable[[StepState], Carried | None]


def parts_of_step(state: StepState) -> Iterator[StepState]:
    """Parts of a step, that with the grid's bus first; the step itself where no line is out."""
    parts = state.now.parts
    numbers = parts.of_bus[0]
    for number in np.unique(numbers):
        for dead in (False, True):
            buses = (numbers == number) & (parts.dead[0] == dead)
            if buses.any():
                yield _part_at(state, buses, number == 0 and not dead, dead)


def _part_at(state: StepState, buses: Flags, with_grid: bool, dead: bool) -> StepState:
    """The part of some buses: a step in which there is nothing outside of it."""
    site, part = state.site, replace(state, inside=buses, dead=dead)
    lit = {kind: part.items(place) & (not dead) for kind, place in site.unit_bus.items()}
    now = state.now
    inside = replace(
        now,
        load_kw=now.load_kw * part.items(site.customer_bus),
        pv_kw=now.pv_kw * part.items(site.pv_bus),
        grid_limit_kw=now.grid_limit_kw if with_grid else np.zeros(1),
        export=now.export if with_grid else Export.absent(),
        drawn=now.drawn and Drawn(now.drawn.kw * buses, now.drawn.kvar * buses),
        ahead=now.ahead.in_dead_parts({kind: on[np.newaxis] for kind, on in lit.items()}),
    )
    return replace(
        part,
        now=inside,
        online=state.online & part.items(site.battery_bus) & (not dead),
        taken_kw={kind: kw * lit[kind] for kind, kw in state.taken_kw.items()},
        running={kind: on & lit[kind] for kind, on in state.running.items()},
    )


def by_part(state: StepState, rule: Rule) -> Carried | None:
    """The answer of a rule in each part as that of the whole feeder; None if one has none.

    In dead parts nothing is supplied, whatever the rule says.
    """
    parts = [*parts_of_step(state)]
    found = [no_supply(part) if part.dead else rule(part) for part in parts]
    if len(parts) == 1:
        return found[0]
    answers = [answer for answer in found if answer is not None]
    return _joined(state, parts, answers) if len(answers) == len(parts) else None


def rule_by_part(
    state: StepState, tiers: Sequence[str], battery_kw: Floats | None = None
) -> Carried:
    """The dispatch by rule of each part; parameters are those of :func:`rule_dispatch`."""
    found = by_part(state, lambda part: rule_dispatch(part, tiers, battery_kw))
    assert found is not None  # a rule always has an answer
    return found


def no_supply(state: StepState) -> Carried:
    """A step that no source can form: no supply, and all PV power curtailed."""
    site = state.site
    now = replace(state.now, pv_kw=0.0 * state.now.pv_kw, drawn=Drawn.absent())
    without_power = replace(state, now=now)
    served = np.zeros(len(site.customers), dtype=bool)
    found = carry(without_power, served, np.zeros(len(site.batteries)))
    assert found is not None  # with no demand and no power every balance closes
    return replace(found, pv_curtailed_kw=state.pv_kw[np.newaxis])


def _joined(state: StepState, parts: list[StepState], plans: list[Carried]) -> Carried:
    """The step of the whole feeder: each device does what it does in its part.

    A flow is the sum of those of all parts, for each part has its own balance.
    """
    site = state.site

    def of_devices(name: str, place: Any) -> Any:
        return sum(
            np.where(part.items(place), getattr(plan, name)[0], 0)
            for part, plan in zip(parts, plans, strict=True)
        )

    def of_units(name: str) -> dict[str, Any]:
        kinds = dict.fromkeys(kind for plan in plans for kind in getattr(plan, name))
        return {
            kind: sum(
                np.where(part.items(site.unit_bus[kind]), getattr(plan, name)[kind][0], 0)
                for part, plan in zip(parts, plans, strict=True)
                if kind in getattr(plan, name)
            )
            for kind in kinds
        }

    acting = replace(
        state,
        taken_kw=of_units("taken_kw"),
        running={kind: on > 0 for kind, on in of_units("running").items()},
    )
    joined = dispatch_of(
        acting,
        of_devices("served", site.customer_bus) > 0,
        tuple(
            of_devices(name, site.pv_bus) for name in ("pv_self_kw", "pv_export_kw", "pv_q_kvar")
        ),
        of_devices("charge_kw", site.battery_bus) - of_devices("discharge_kw", site.battery_bus),
        of_devices("batt_q_kvar", site.battery_bus),
        float(plans[0].p_grid_kw[0]),
        of_units("given_kvar"),
    )
    return replace(
        joined,
        reactive_short_kvar=sum(plan.reactive_short_kvar for plan in plans),
        voltage_excess_pu=max(plan.voltage_excess_pu for plan in plans),
        surplus_kw=sum(plan.surplus_kw for plan in plans),
    )
