"""AC voltages of a feeder without control: all customers supplied, all PV power, batteries idle."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import VerificationError
from vppres.physics.phased_sources import (
    assets_of,
    drawn_uncontrolled,
    farthest,
    flow_of_grid,
    measured_at,
)
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.phases import Phases
from vppres.scenario.scenario import SOFT, Scenario

Solved = Callable[[Floats, Floats, Floats], Floats]
"""Voltages of the buses, (N,), from demand (C,), its reactive power, and PV power (P,)."""

MOST_STEPS = 96
"""Steps that are solved, a day of quarter hours: those with the most and the least net demand."""


def without_control(scenario: Scenario) -> list[str]:
    """Violations of AC limits without control while the grid is on; empty if there are none."""
    steps = _extreme_steps(scenario)
    if not len(steps):
        return []
    v_pu, failed = _voltages(scenario, steps)
    words = [*_beyond(scenario, steps, v_pu)]
    if failed:
        most_kw = scenario.load_kw.sum(axis=1).max()
        words.append(
            f"Without control the AC power flow has no solution in {failed} of {len(steps)} steps "
            "with grid: customers will be switched off with the grid on. Check the units: "
            f"load_kw.csv is in kW (at most {most_kw:,.6g} kW in all), lines.csv in ohm of the "
            "whole line."
        )
    return words


def _extreme_steps(scenario: Scenario) -> Wholes:
    """Steps with grid, of many those with the most and the least net demand."""
    connected = np.flatnonzero(~scenario.outage)
    if len(connected) <= MOST_STEPS:
        return connected
    net_kw = scenario.load_kw.sum(axis=1) - scenario.pv_kw.sum(axis=1)
    order = connected[np.argsort(net_kw[connected])]
    return np.sort(np.append(order[: MOST_STEPS // 2], order[-MOST_STEPS // 2 :]))


def _voltages(scenario: Scenario, steps: Wholes) -> tuple[Floats, int]:
    """AC voltages of the steps that have any, NaN in the others, and how many those are."""
    solved = (
        _balanced(scenario) if scenario.phases is None else _by_phase(scenario, scenario.phases)
    )
    usable_kw = np.minimum(scenario.pv_kw, scenario.pv.s_max_kva)
    found = np.full((len(steps), scenario.network.n_buses), np.nan)
    for row, t in enumerate(steps):
        try:
            found[row] = solved(scenario.load_kw[t], scenario.load_kvar[t], usable_kw[t])
        except VerificationError:
            continue
    return found, int(np.isnan(found).any(axis=1).sum())


def _balanced(scenario: Scenario) -> Solved:
    """The flow of a balanced feeder."""
    net = scenario.network
    customer = net.place(scenario.customers.bus)
    pv = net.place(scenario.pv.buses(scenario.customers))
    flow = ACPowerFlow(net)

    def solved(load_kw: Floats, load_kvar: Floats, pv_kw: Floats) -> Floats:
        return flow.solve(pv @ pv_kw - customer @ load_kw, -(customer @ load_kvar)).v_pu

    return solved


def _by_phase(scenario: Scenario, phases: Phases) -> Solved:
    """Solver of a phased feeder: for each bus the voltage that is farthest from 1 pu."""
    net = scenario.network
    flow = flow_of_grid(phases, assets_of(scenario), net.v_slack_pu)
    at_bus = measured_at(phases, net)

    def solved(load_kw: Floats, load_kvar: Floats, pv_kw: Floats) -> Floats:
        drawn = drawn_uncontrolled(load_kw, load_kvar, pv_kw, len(flow.assets))
        return farthest(flow.v_pu(flow.solve(*drawn).v), at_bus, net.n_buses)

    return solved


def _beyond(scenario: Scenario, steps: Wholes, v_pu: Floats) -> Iterator[str]:
    """Limits of the AC voltages that are left, with the farthest bus and its time."""
    net = scenario.network
    soft = scenario.controller.voltage_limits == SOFT
    result = (
        "Limits give way to it where batteries do not help, and no customer is switched off for it"
        if soft
        else "Limits are hard: customers may be switched off for it with the grid on"
    )
    for verb, side, limit, beyond in (
        ("falls", "below", net.v_min_ac_pu, net.v_min_ac_pu - v_pu),
        ("rises", "above", net.v_max_ac_pu, v_pu - net.v_max_ac_pu),
    ):
        beyond = np.nan_to_num(beyond, nan=-np.inf)
        if not (beyond > 0.0).any():
            continue
        row, bus = np.unravel_index(int(beyond.argmax()), beyond.shape)
        time = scenario.grid.times[steps[row]].tz_convert(scenario.grid.zone)
        count = int((beyond > 0.0).any(axis=1).sum())
        yield (
            f"Without control the voltage {verb} to {v_pu[row, bus]:.4f} pu at bus "
            f"{net.buses[bus]}, {time:%Y-%m-%d %H:%M}: {side} the AC limit of {limit:g} pu in "
            f"{count} of {len(steps)} steps with grid. {result}."
        )
