"""A finished day, explained: a reason for every action, and the worth of one more unit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.day.configured import configurations_of, run_in
from vppres.day.recorder import ROTATED
from vppres.day.simulate import Progress
from vppres.day.trajectory import Trajectory
from vppres.explain.costs import WORTH
from vppres.explain.prices import WORTH_GBP, step_prices
from vppres.explain.reason import Reason
from vppres.explain.reasons import why_battery_moved, why_curtailed
from vppres.explain.step import Step
from vppres.explain.summary import why_step
from vppres.explain.windows import Windows
from vppres.kinds.customer import reasons as customer
from vppres.kinds.kind import MOVE_KW
from vppres.kinds.table import KINDS, parts
from vppres.scenario.phases import PHASES
from vppres.solve.shadow_prices import ShadowPrices

EXPLANATIONS = ("time", "phase", "item", "id", "action", "driver", "binding", "words")
SHADOW_PRICES = ("time", "constraint", "item", "unit", "weighted_h", "gbp")

NEAR = 0.01
"""Share by which power must be worth more at a bus than at the slack bus to be named there."""

Row = dict[str, Any]


def explain_day(trajectory: Trajectory, progress: Progress | None = None) -> Trajectory:
    """The run with a reason for every action and the shadow prices of every step.

    One pricing problem is solved for each step, two where cost matters after service; nothing of
    the run changes. A day of 24 steps on 33 buses takes about a second, one on thousands of buses
    minutes.

    Parameters
    ----------
    trajectory : Trajectory
        A finished run.
    progress : callable, optional
        Called as ``progress(steps done, steps in all)`` after every step.

    Returns
    -------
    Trajectory
        The same run with the tables ``explanations`` and ``shadow_prices``, which
        :func:`vppres.report.run_folder.write_run` writes and ``docs/explanations.md`` defines.
    """
    explanations: list[Row] = []
    prices: list[Row] = []
    for step in steps_of(trajectory, progress):
        time = trajectory.steps["time"].iloc[step.t]
        explanations += [{"time": time, "phase": step.phase, **row} for row in _actions(step)]
        prices += [{"time": time, **row} for row in _prices(step)]
    return replace(
        trajectory,
        explanations=pd.DataFrame(explanations, columns=list(EXPLANATIONS)),
        shadow_prices=pd.DataFrame(prices, columns=list(SHADOW_PRICES)),
    )


def explain_step(trajectory: Trajectory, t: int) -> tuple[list[Row], list[Row]]:
    """The rows of one step: its explanations, and its shadow prices; only they are solved for."""
    [step] = steps_of(trajectory, which=slice(t, t + 1))
    return [{"phase": step.phase, **row} for row in _actions(step)], _prices(step)


def steps_of(
    trajectory: Trajectory, progress: Progress | None = None, which: slice = slice(None)
) -> list[Step]:
    """Steps of a run, all if not given, with their phases and their shadow prices."""
    phases = trajectory.steps["phase"]
    windows = _weighed(trajectory, which)
    found = []
    for t, of_step in zip(range(len(phases))[which], windows, strict=True):
        found.append(Step(of_step, t, phases.iloc[t], step_prices(of_step, t)))
        if progress is not None:
            progress(len(found), len(windows))
    return found


def _weighed(trajectory: Trajectory, steps: slice) -> list[Windows]:
    """The windows for each of some steps, in its configuration and with the weights of its plan.

    Steps with the same share them.
    """
    which = range(len(trajectory.steps))[steps]
    rotated = ROTATED in trajectory.customers
    weights = trajectory.by_step("customers", ROTATED) if rotated else None
    closed = configurations_of(trajectory)
    found: dict[tuple[bytes, ...], Windows] = {}
    windows = []
    for t in which:
        weight = None if weights is None else weights[t]
        now = None if closed is None else closed[t]
        key = tuple(b"" if each is None else each.tobytes() for each in (weight, now))
        if key not in found:
            run = trajectory if now is None else run_in(trajectory, now)
            found[key] = Windows(run, weight)
        windows.append(found[key])
    return windows


def _actions(step: Step) -> list[Row]:
    """One row for the step, and each customer, battery, PV system or vehicle of note."""
    site = step.site
    t = step.t
    rows = [_row("step", "", step.phase, why_step(step))]
    rows += [_row("customer", *each) for each in customer.reasons(step)]
    rows += [
        _row(
            "battery",
            site.batteries.id[b],
            "charge" if step.battery_kw[b] > 0 else "discharge",
            why_battery_moved(step, b),
        )
        for b in np.flatnonzero(np.abs(step.battery_kw) > MOVE_KW).tolist()
    ]
    rows += [
        _row("pv", site.pv.id[p], "curtail", why_curtailed(step, p))
        for p in np.flatnonzero(step.recorded.done.pv_curtailed_kw[t] > MOVE_KW).tolist()
    ]
    words = parts("words")
    rows += [
        _row(KINDS[kind].subject, name, action, Reason(*why))
        for kind in site.kinds
        for name, action, why in words[kind].reasons(step)
    ]
    return rows


def _row(item: str, name: object, action: str, reason: Reason) -> Row:
    return {
        "item": item,
        "id": str(name),
        "action": action,
        "driver": reason.driver,
        "binding": reason.binding,
        "words": reason.words,
    }


def _prices(step: Step) -> list[Row]:
    """Shadow prices of a step that are worth something; those of stored energy always."""
    rows = []
    for name, unit, items in _families(step):
        values = _level(step.service, name, len(items)), _level(step.cost, name, len(items))
        if not step.levels.solved:
            continue
        shown = _items_shown(name, *values)
        rows += [
            {
                "constraint": name,
                "item": str(items[i]),
                "unit": unit,
                "weighted_h": values[0][i],
                "gbp": values[1][i],
            }
            for i in shown
        ]
    return rows


def _families(step: Step) -> list[tuple[str, str, Floats]]:
    """Name, unit and items of each family of shadow prices."""
    site = step.site
    net = step.scenario.network
    buses = net.buses
    ends = zip(net.from_bus, net.to_bus, strict=True)
    lines = np.array([f"{above} to {below}" for above, below in ends], dtype=object)
    if site.phases:
        lines = np.array(step.phased.model.rated, dtype=object)
    supply = step.phased.supply if site.phases else None
    of_former = [*PHASES] if site.phases else []
    if supply is not None and len(supply.fed) > 1:
        sources = [former or "the grid" for _, former in supply.fed]
        of_former = [f"{phase} of {source}" for source in sources for phase in PHASES]
    b = site.batteries.id
    pv = site.pv.id
    return [
        ("stored_energy", "kWh", b),
        ("energy_floor", "kWh", b),
        ("energy_ceiling", "kWh", b),
        ("battery_charging", "kW", b),
        ("battery_discharging", "kW", b),
        ("battery_inverter", "kVA", b),
        ("pv_inverter", "kVA", pv),
        ("former_phase", "kVA", np.array(of_former, dtype=object)),
        ("voltage_floor", "0.001 pu", buses),
        ("voltage_ceiling", "0.001 pu", buses),
        ("line_rating", "kVA", lines),
        ("grid", "kW", np.array(["grid"], dtype=object)),
        ("active", "kW", buses),
        ("reactive", "kvar", buses),
    ]


def _level(prices: ShadowPrices | None, name: str, count: int) -> Floats:
    """Values of a family at one level, NaN where the level was not solved."""
    if prices is None:
        return np.full(count, np.nan)
    values = np.atleast_1d(np.asarray(getattr(prices, name), float))
    return np.where(np.abs(values) > WORTH, values, 0.0)


def _items_shown(name: str, service: Floats, cost: Floats) -> list[int]:
    """Items worth a row; of the powers at buses only the best, which says what could be had."""
    worth = (np.abs(np.nan_to_num(service)) > WORTH) | (np.abs(np.nan_to_num(cost)) > WORTH_GBP)
    if name == "stored_energy":
        return list(range(len(service)))
    if name in ("active", "reactive"):
        values = service if np.nan_to_num(service).any() else cost
        best = int(np.argmax(values))
        # Where the network does not matter the slack bus stands for all.
        best = best if values[best] - values[0] > NEAR * abs(values[best]) else 0
        return [best] if worth[best] else []
    return np.flatnonzero(worth).tolist()
