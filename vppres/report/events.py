"""A run in words: sentences about the day, and events with their time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from vppres.core.text import counted, named
from vppres.day.kind_tables import kind_events
from vppres.day.series import energy_limits_kwh, outage_spans, stored_energy_kwh
from vppres.day.trajectory import LINES_OUT, SWITCHED, SWITCHING_WHY, Trajectory
from vppres.kinds.customer import record as customer
from vppres.report.clock import Clock
from vppres.report.key_figures import number

NAMES_SHOWN = 6
EMPTY_SHARE = 0.01  # of the usable energy


@dataclass(frozen=True)
class DayEvent:
    """Event at the beginning of a step ``t``, and its time; ``T`` is the end of the day."""

    t: int
    time: str
    words: str


def events_of(run: Trajectory) -> list[DayEvent]:
    """Outages, faults and operations, what befalls customers, batteries, machines and sets."""
    found = sorted(
        [
            *_outage_events(run),
            *_fault_events(run),
            *_switching_events(run),
            *_service_events(run),
            *_within_events(run),
            *customer.events(run),
            *_battery_events(run),
            *kind_events(run),
        ],
        key=lambda entry: entry[0],
    )
    clock = Clock.of(run)
    return [DayEvent(t, clock.at(t), words) for t, words in found]


def opening_of(run: Trajectory, summary: Mapping[str, Any]) -> list[str]:
    """The length of the day, and its outage."""
    clock = Clock.of(run)
    n_steps = len(run.steps)
    return [
        f"{counted(n_steps, 'step')} of {clock.grid.step_minutes:g} min from {clock.at(0)} to "
        f"{clock.full(clock.grid.end)}.",
        *_outage(run, summary),
    ]


def _outage_events(run: Trajectory) -> Iterator[tuple[int, str]]:
    energy = stored_energy_kwh(run)
    for first, last in outage_spans(run):
        held = f", {energy[first]:,.0f} kWh stored" if len(run.batteries) else ""
        yield first, f"Outage begins{held}."
        left = f", {energy[last]:,.0f} kWh stored" if len(run.batteries) else ""
        yield last, f"Outage ends{left}."


def _fault_events(run: Trajectory) -> Iterator[tuple[int, str]]:
    """Lines and buses that went out of service, and came back."""
    if LINES_OUT not in run.steps:
        return
    # Where switches move, a repaired line may stay open until a plan closes it.
    again = "repaired" if SWITCHED in run.steps else "in service again"
    steps = range(len(run.steps))
    found = run.scenario.out_of_service(steps)
    out = [found.names(run.scenario.network, t) for t in steps]
    for t, (before, now) in enumerate(pairwise([[], *out, []])):
        for names, words in (
            ([n for n in now if n not in before], "out of service"),
            ([n for n in before if n not in now], again),
        ):
            if names and t < len(out):
                listed = named(names, NAMES_SHOWN)
                yield t, f"{listed[:1].upper()}{listed[1:]} {words}."


def _switching_events(run: Trajectory) -> Iterator[tuple[int, str]]:
    """Operations of switches, and what they are good for."""
    if SWITCHED not in run.steps:
        return
    rows = zip(run.steps[SWITCHED], run.steps[SWITCHING_WHY], strict=True)
    for t, (moved, why) in enumerate(rows):
        if moved:
            yield t, f"{moved[:1].upper()}{moved[1:]}: {why}."


def _service_events(run: Trajectory) -> Iterator[tuple[int, str]]:
    """Customers that lost supply and were restored, relative to the step before."""
    c = run.scenario.customers
    served, changes = run.by_step("customers", "served"), customer.switched(run)
    for t in range(len(served)):
        for changed, words in (
            (changes[t] & ~served[t], "off supply"),
            (changes[t] & served[t], "restored"),
        ):
            if changed.any():
                order = np.argsort(-c.weight[changed], kind="stable")
                names = [
                    f"{name} ({tier})"
                    for name, tier in zip(c.id[changed][order], c.tier[changed][order], strict=True)
                ]
                who = named(names, NAMES_SHOWN)
                yield t, f"{counted(len(names), 'customer')} {words}: {who}."


def _within_events(run: Trajectory) -> Iterator[tuple[int, str]]:
    """Customers that were off for a part of a step, the most important first."""
    c, off = run.scenario.customers, run.time_off
    within = (off > 0.0) & (off < 1.0)
    minutes = off * run.scenario.grid.step_minutes
    for t in np.flatnonzero(within.any(axis=1)).tolist():
        order = [i for i in np.argsort(-c.weight, kind="stable") if within[t, i]]
        names = [f"{c.id[i]} ({c.tier[i]}) {minutes[t, i]:.3g} min" for i in order]
        words = f"{counted(len(names), 'customer')} off supply for a part of the step"
        yield t, f"{words}: {named(names, NAMES_SHOWN)}."


def _battery_events(run: Trajectory) -> Iterator[tuple[int, str]]:
    """When the batteries reach the end of their usable energy in an outage."""
    energy = stored_energy_kwh(run)
    (low, high) = energy_limits_kwh(run)
    for first, last in outage_spans(run):
        empty = np.flatnonzero(energy[first + 1 : last + 1] <= low + EMPTY_SHARE * (high - low))
        if len(empty) and len(run.scenario.batteries):
            yield first + 1 + int(empty[0]), "Batteries are at their lower limit."


def _outage(run: Trajectory, summary: Mapping[str, Any]) -> list[str]:
    spans = outage_spans(run)
    if not spans:
        return ["No grid outage."]
    clock = Clock.of(run)
    when = " and ".join(clock.span(a, b) for a, b in spans)
    hours = sum(b - a for a, b in spans) * run.scenario.grid.dt_h
    shares = ", ".join(
        f"{tier} {number(share, '.0%')}"
        for tier, share in summary["served_share"].items()
        if share is not None
    )
    return [
        f"Grid outage {when}, {hours:g} h in total.",
        f"Supplied in the outage, of all customer-steps: {shares}; weighted by priority "
        f"{number(summary['resilience'], '.1%')}.",
    ]
