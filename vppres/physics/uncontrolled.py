"""AC voltages of a feeder without control: all customers supplied, all PV power, batteries idle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import VerificationError
from vppres.physics.feeder import power_flows
from vppres.physics.places import Places
from vppres.scenario.scenario import SOFT, Scenario

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
    flow, _ = power_flows(scenario)
    at = Places.of(scenario)
    usable_kw = np.minimum(scenario.pv_kw, scenario.pv.s_max_kva)
    found = np.full((len(steps), scenario.network.n_buses), np.nan)
    for row, t in enumerate(steps):
        p_kw, q_kvar = np.zeros((2, len(at)))
        np.add.at(p_kw, at.pv, usable_kw[t])
        np.add.at(p_kw, at.customers, -scenario.load_kw[t])
        np.add.at(q_kvar, at.customers, -scenario.load_kvar[t])
        try:
            found[row] = flow.solve(p_kw, q_kvar).v_pu
        except VerificationError:
            continue
    return found, int(np.isnan(found).any(axis=1).sum())


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
