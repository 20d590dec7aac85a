"""A feeder without control: all customers supplied, all PV power, batteries idle.

What it has beyond its limits while the grid is on says what control can be asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import VerificationError
from vppres.core.units import kva_to_a
from vppres.physics.feeder import power_flows
from vppres.physics.places import Places
from vppres.physics.powerflow import ACResult
from vppres.scenario.scenario import LIMIT, SOFT, Scenario

MOST_STEPS = 96
"""Steps that are solved, a day of quarter hours: those with the most and the least net demand."""


def without_control(scenario: Scenario) -> list[str]:
    """Violations of AC limits without control while the grid is on; empty if there are none."""
    steps = _extreme_steps(scenario)
    if not len(steps):
        return []
    found = _solved(scenario, steps)
    nothing = np.full(scenario.network.n_buses, np.nan)
    v_pu = np.array([nothing if one is None else one.v_pu for one in found])
    words = [*_beyond(scenario, steps, v_pu), *_overloaded(scenario, steps, found)]
    failed = sum(one is None for one in found)
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


def _solved(scenario: Scenario, steps: Wholes) -> list[ACResult | None]:
    """The AC power flow of each step, none where it has no solution."""
    flow, _ = power_flows(scenario)
    at = Places.of(scenario)
    usable_kw = np.minimum(scenario.pv_kw, scenario.pv.s_max_kva)
    found: list[ACResult | None] = []
    for t in steps:
        p_kw, q_kvar = np.zeros((2, len(at)))
        np.add.at(p_kw, at.pv, usable_kw[t])
        np.add.at(p_kw, at.customers, -scenario.load_kw[t])
        np.add.at(q_kvar, at.customers, -scenario.load_kvar[t])
        try:
            found.append(flow.solve(p_kw, q_kvar))
        except VerificationError:
            found.append(None)
    return found


def _overloaded(
    scenario: Scenario, steps: Wholes, found: Sequence[ACResult | None]
) -> Iterator[str]:
    """Ratings that are exceeded where plans keep them, with the fullest place and its time."""
    soft = scenario.controller.ratings == SOFT
    if not (soft or scenario.controller.ratings == LIMIT):
        return
    loadings = [(0.0, "") if one is None else _fullest(scenario, one) for one in found]
    most, where = max(loadings)
    if not most > 1.0:
        return
    time = scenario.grid.times[steps[loadings.index((most, where))]].tz_convert(scenario.grid.zone)
    count = sum(share > 1.0 for share, _ in loadings)
    result = (
        "They give way to it where batteries do not help, and no customer is switched off for it"
        if soft
        else "Plans keep them where they can: customers are switched off for it with the grid on "
        "where batteries do not help. Correct the ratings, or let them give way to it, with "
        "ratings = soft"
    )
    yield (
        f"Without control {where} carries {most:.0%} of its rating, {time:%Y-%m-%d %H:%M}: ratings "
        f"are exceeded in {count} of {len(steps)} steps with grid. {result}."
    )


def _fullest(scenario: Scenario, found: ACResult) -> tuple[float, str]:
    """The largest current as a share of its rating, and where it is; 0 without ratings."""
    if found.nodes:
        return (found.loading, found.loading_at) if found.loading > 0.0 else (0.0, "")
    net = scenario.network
    s_kva, v_pu = np.hypot(found.p_from_kw, found.q_from_kvar), found.v_pu[net.parent]
    loading = kva_to_a(s_kva, v_pu * net.base_kv) / net.i_max_a
    line = int(loading.argmax())
    return float(loading[line]), f"line from {net.from_bus[line]} to {net.to_bus[line]}"


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
