"""Dispatch of one step by rule in a feeder that faults of lines cut into parts.

Each part is a step of its own in which nothing outside of it is served, gives or takes: that with
the grid's bus, islands that something forms, and dead ones in which nothing is supplied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.control.carried import Carried, dispatch_of
from vppres.control.rules import carry, rule_dispatch
from vppres.control.step_state import StepState
from vppres.core.arrays import Flags, Floats
from vppres.model.linearise import Drawn
from vppres.model.parts import at_items


@dataclass(frozen=True, eq=False)
class PartState:
    """A part of the feeder in the step: the items inside, and its own state."""

    state: StepState  #: the step without what is outside of the part
    dead: bool  #: whether nothing forms it, or its bus is out
    #: What is inside, (C,), (P,) and (B,).
    customers: Flags
    pv: Flags
    batteries: Flags
    units: dict[str, Flags]  #: units of each kind inside, (n,)


Rule = Callable[[PartState], Carried | None]


def parts_of_step(state: StepState) -> Iterator[PartState]:
    """Parts of a step, that with the grid's bus first; the step itself where no line is out."""
    parts = state.parts
    numbers = parts.of_bus[0]
    for number in np.unique(numbers):
        for dead in (False, True):
            buses = (numbers == number) & (parts.dead[0] == dead)
            if buses.any():
                yield _part_at(state, buses, number == 0 and not dead, dead)


def _part_at(state: StepState, buses: Flags, with_grid: bool, dead: bool) -> PartState:
    """The part of some buses."""
    site = state.site

    def inside(place: Any) -> Flags:
        return at_items(buses[np.newaxis], place)

    customers, pv, batteries = (
        inside(place)[0] for place in (site.customer_bus, site.pv_bus, site.battery_bus)
    )
    units = {kind: inside(site.unit_bus[kind]) for kind in site.kinds}
    lit = {kind: flags & (not dead) for kind, flags in units.items()}
    drawn = state.drawn and Drawn(state.drawn.kw[:1] * buses, state.drawn.kvar[:1] * buses)
    own = replace(
        state,
        load_kw=state.load_kw * customers,
        pv_kw=state.pv_kw * pv,
        grid_limit_kw=state.grid_limit_kw if with_grid else 0.0,
        export_limit_kw=state.export_limit_kw if with_grid else 0.0,
        online=state.online & batteries & (not dead),
        drawn=drawn,
        inside=buses,
        ahead=state.ahead.part(slice(1)).in_dead_parts(lit),
        taken_kw={kind: kw * lit[kind][0] for kind, kw in state.taken_kw.items()},
        running={kind: on & lit[kind][0] for kind, on in state.running.items()},
    )
    return PartState(
        own, dead, customers, pv, batteries, {k: flags[0] for k, flags in units.items()}
    )


def by_part(state: StepState, rule: Rule) -> Carried | None:
    """The answer of a rule in each part as that of the whole feeder; None if one has none.

    In dead parts nothing is supplied, whatever the rule says.
    """
    parts = [*parts_of_step(state)]
    found = [no_supply(part.state) if part.dead else rule(part) for part in parts]
    if len(parts) == 1:
        return found[0]
    answers = [answer for answer in found if answer is not None]
    return _joined(state, parts, answers) if len(answers) == len(parts) else None


def rule_by_part(
    state: StepState, tiers: Sequence[str], battery_kw: Floats | None = None
) -> Carried:
    """The dispatch by rule of each part; parameters are those of :func:`rule_dispatch`."""
    found = by_part(state, lambda part: rule_dispatch(part.state, tiers, battery_kw))
    assert found is not None  # a rule always has an answer
    return found


def no_supply(state: StepState) -> Carried:
    """A step that no source can form: no supply, and all PV power curtailed."""
    site = state.site
    without_power = replace(state, pv_kw=0.0 * state.pv_kw, drawn=None)
    served = np.zeros(len(site.customers), dtype=bool)
    found = carry(without_power, served, np.zeros(len(site.batteries)))
    assert found is not None  # with no demand and no power every balance closes
    curtailed = replace(found.dispatch, pv_curtailed_kw=state.pv_kw[np.newaxis])
    return replace(found, dispatch=curtailed)


def _joined(state: StepState, parts: list[PartState], answers: list[Carried]) -> Carried:
    """The step of the whole feeder: each device does what it does in its part.

    A flow is the sum of those of all parts, for each part has its own balance.
    """
    plans = [answer.dispatch for answer in answers]

    def of_devices(name: str, table: str) -> Any:
        return sum(
            np.where(getattr(part, table), getattr(plan, name)[0], 0)
            for part, plan in zip(parts, plans, strict=True)
        )

    def of_units(name: str) -> dict[str, Any]:
        kinds = dict.fromkeys(kind for plan in plans for kind in getattr(plan, name))
        return {
            kind: sum(
                np.where(part.units[kind], getattr(plan, name)[kind][0], 0)
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
    dispatch = dispatch_of(
        acting,
        of_devices("served", "customers") > 0,
        tuple(of_devices(name, "pv") for name in ("pv_self_kw", "pv_export_kw", "pv_q_kvar")),
        of_devices("charge_kw", "batteries") - of_devices("discharge_kw", "batteries"),
        of_devices("batt_q_kvar", "batteries"),
        float(plans[0].p_grid_kw[0]),
        of_units("given_kvar"),
    )
    return Carried(
        dispatch,
        sum(answer.reactive_short_kvar for answer in answers),
        max(answer.voltage_excess_pu for answer in answers),
        sum(answer.surplus_kw for answer in answers),
    )
