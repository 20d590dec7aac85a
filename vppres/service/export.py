"""What was, as the run of a scenario: stored plans and readings, replayed on the plant.

Of every step the set-points that were said, the demand, sun and state of charge that were measured
(the profile's where nothing was), and whether there was grid. What they led to is the plant's
answer: not all of it is measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.errors import InputError, Problem
from vppres.day.options import RunOptions
from vppres.day.recorder import ROTATED, Recorder, StepRecord
from vppres.day.trajectory import Trajectory
from vppres.io.times import option_time
from vppres.live.profile import Profile
from vppres.model.site import Site
from vppres.plant.plant import BatteryState
from vppres.scenario.scenario import Scenario
from vppres.service.announced import limits_kw, prices, warnings_ever
from vppres.service.as_told import set_state, vehicles_kwh, with_told
from vppres.service.clock import written
from vppres.service.learned import InSteps
from vppres.service.records import Event, seconds
from vppres.service.runner import Service
from vppres.service.store import Store
from vppres.service.window import Window
from vppres.service.world import World

MOST_STEPS = 40_000
"""At once: more than a year of quarter hours."""

CONNECTED = {"available": True}
"""Of plans without a decision: they do not say."""

OF_SOLVE = {
    "status": "status",
    "gap": "relative_gap",
    "objective": "objective",
    "bound": "bound",
    "solve_s": "seconds",
    "fallback_reason": "fallback_reason",
    "correction_reason": "correction_reason",
}
"""Columns of a run's steps by the names of a stored plan."""


def export(service: Service, place: Path | str, begin: str, end: str) -> Trajectory:
    """The steps from a time up to another one, read beside a service that may run.

    Times are ISO 8601, without an offset by the clocks at the site.

    Raises
    ------
    InputError
        For what is no time, and where nothing is stored.
    """
    grid = service.scenario.grid
    times = [option_time(text, grid.zone) for text in (begin, end)]
    with closing(Store(place, Site.of(service.scenario).key, reading=True)) as store:
        return exported(service, store, *times)


def exported(service: Service, store: Store, start: pd.Timestamp, end: pd.Timestamp) -> Trajectory:
    """The steps that a time touches, as a run.

    Raises
    ------
    InputError
        If no step of that time is stored, or there are too many.
    """
    scenario = site_of(service, start, end)
    plans = {plan["start"]: plan for plan in store.plans(scenario.grid.start, scenario.grid.end)}
    times = scenario.grid.times
    stored = [plans.get(written(time)) for time in times]
    if not any(stored):
        raise InputError(
            Problem(
                "export",
                f"finds no step from {written(times[0])} up to {written(scenario.grid.end)}",
                "Give a time in which the service ran.",
            )
        )
    scenario, soc = as_it_was(scenario, stored, store)
    step = scenario.grid.step
    warnings = [
        one
        for one in warnings_ever(store.events_ever(), scenario.grid.start, step)
        if one.issued_at < scenario.grid.end
    ]
    scenario = replace(scenario, warnings=tuple(warnings))
    recorder = Recorder(scenario)
    for record in replayed(scenario, service.options, stored, soc):
        recorder.add(record)
    return recorder.finish(service.options.on(scenario).as_record())


def site_of(service: Service, start: pd.Timestamp, end: pd.Timestamp) -> Scenario:
    """The site with the steps of a time, as its profile or its own days have them."""
    profile = Profile.of(service.scenario)
    first = service.scenario.grid.begun(start.tz_convert("UTC"))
    step = service.scenario.grid.step
    n_steps = -((first - end) // step)
    if n_steps <= 0:
        cure = f"Give an end after {written(first)}, the beginning of its first step."
        raise InputError(
            Problem("export", "does not end after it begins", cure, value=written(end))
        )
    if n_steps > MOST_STEPS:
        cure = f"Give {MOST_STEPS} steps at most, and export the others apart."
        raise InputError(Problem("export", "is too long", cure, value=f"{n_steps} steps"))
    return replace(profile.steps(first, n_steps), warnings=())


def as_it_was(
    scenario: Scenario, stored: list[dict[str, Any] | None], store: Store
) -> tuple[Scenario, Floats]:
    """What was measured and announced, without grid where plans say so; and SoC, NaN if not so."""
    measured = InSteps(store, scenario.grid)
    dark = [plan is not None and not plan.get("grid", CONNECTED)["available"] for plan in stored]
    price, limit_kw = _announced(scenario, stored, store)
    nothing = np.full((scenario.grid.n_steps, len(scenario.batteries)), np.nan)
    soc = measured.laid("soc", scenario.batteries.id, nothing)
    first = np.where(np.isfinite(soc[0]), soc[0], scenario.batteries.soc_initial)
    b = scenario.batteries
    loads = scenario.thermal_loads
    known = replace(
        scenario,
        load_kw=measured.laid("load_kw", scenario.customers.id, scenario.load_kw),
        pv_kw=np.minimum(
            measured.laid("pv_kw", scenario.pv.id, scenario.pv_kw), scenario.pv.p_max_kw
        ),
        price_gbp_per_kwh=price,
        grid_limit_kw=np.where(dark, 0.0, limit_kw),
        batteries=replace(b, soc_initial=np.clip(first, b.soc_min, b.soc_max)),
        thermal_loads=replace(loads, t_initial_c=_indoor_c(scenario, stored[0], loads.t_initial_c)),
    )
    return with_told(known, stored), soc


def _announced(
    scenario: Scenario, stored: Sequence[Mapping[str, Any] | None], store: Store
) -> tuple[Floats, Floats]:
    """Import price and limit of each step, (T,), as they were known when it was decided.

    They are what its plan says; without one, what events said by then.
    """
    price = scenario.price_gbp_per_kwh.copy()
    limit_kw = scenario.grid_limit_kw.copy()
    versions = list(store.events_ever().values())
    step = scenario.grid.step
    for t, (time, plan) in enumerate(zip(scenario.grid.times, stored, strict=True)):
        expected = (plan or {}).get("expected") or {}
        if "price_gbp_per_kwh" in expected:
            known_kw = expected["grid_limit_kw"]
            price[t] = expected["price_gbp_per_kwh"]
            limit_kw[t] = np.inf if known_kw is None else known_kw
        elif versions:
            row = slice(t, t + 1)
            series = {name: values[row] for name, values in scenario.series.items()}
            alone = Window(scenario.grid.times[row], step, series)
            said = _known_by(versions, time if plan is None else plan["generated_at"])
            price[t] = prices(said, alone)[0]
            limit_kw[t] = limits_kw(said, alone)[0]
    return price, limit_kw


def _known_by(versions: Sequence[Sequence[Event]], time: Any) -> list[Event]:
    """Of each event what was said last by a time, those left out that were withdrawn."""
    at = seconds(pd.Timestamp(time))
    last = [next((one for one in reversed(each) if one.made_at <= at), None) for each in versions]
    return [one for one in last if one is not None and one.body]


def replayed(
    scenario: Scenario, options: RunOptions, stored: list[dict[str, Any] | None], soc: Floats
) -> Iterator[StepRecord]:
    """The plant's answer to every stored step.

    Batteries, rooms, tanks, vehicles and generating sets begin it with what was measured.

    Of a step that was decided anew it answers the last plan, as if that had held all along.
    """
    world = World(scenario, options)
    b = scenario.batteries
    shared = options.on(scenario).shares_supply
    told: list[dict[str, Any]] = []
    for t, plan in enumerate(stored):
        state = world.day.state
        held = np.where(np.isfinite(soc[t]), np.clip(soc[t], b.soc_min, b.soc_max), state.soc)
        world.day.state = BatteryState(held, state.eta_charge, state.eta_discharge, state.t_cell_c)
        climate = world.day.plant.climate
        climate.t_c = _indoor_c(scenario, plan, climate.t_c)
        garage, engines = world.day.plant.garage, world.day.plant.engines
        garage.kwh = vehicles_kwh(scenario, plan, garage.kwh)
        engines.state = set_state(scenario, t, plan, engines.state)
        if plan is not None:
            told = [{**one, "valid_from": plan["start"]} for one in plan["setpoints"]]
        record = _noted(world.obey(t, told), plan)
        yield _weighed(record, scenario, plan) if shared else record


def _indoor_c(scenario: Scenario, plan: Mapping[str, Any] | None, reckoned_c: Floats) -> Floats:
    """Temperatures that a step was decided on, (H,); those that are reckoned without a plan."""
    known = ((plan or {}).get("expected") or {}).get("indoor_c", {})
    pairs = zip(map(str, scenario.thermal_loads.id), reckoned_c.tolist(), strict=True)
    return np.array([known.get(name, t_c) for name, t_c in pairs], dtype=float)


def _weighed(record: StepRecord, scenario: Scenario, plan: dict[str, Any] | None) -> StepRecord:
    """A step with the weights of its plan; a step without a plan has those of the site."""
    rotated = ((plan or {}).get("solve") or {}).get(ROTATED) or {}
    c = scenario.customers
    own = dict(zip(map(str, c.id), c.weight, strict=True))
    weight = np.array([rotated.get(name, own[name]) for name in own], dtype=float)
    return replace(record, customers={**record.customers, ROTATED: weight})


def _noted(record: StepRecord, plan: dict[str, Any] | None) -> StepRecord:
    """A step with what its plan says of how it was found."""
    # No model's answer is stored: that of the AC power flow stands in its place.
    buses = {**record.buses, "v_model_pu": record.buses["v_ac_pu"]}
    lines = {
        **record.lines,
        "p_model_kw": record.lines["p_ac_kw"],
        "q_model_kvar": record.lines["q_ac_kvar"],
    }
    found = {"status": "missed" if plan is None else plan["status"], "v_error_pu": 0.0}
    if plan is not None and plan["solve"] is not None:
        solve = plan["solve"]
        values = {name: solve[stored] for name, stored in OF_SOLVE.items()}
        found |= {
            name: ("" if name.endswith("reason") else np.nan) if value is None else value
            for name, value in values.items()
        }
        found["fallback"] = solve["fallback"] or "none"
        worth = solve.get("stored_value_gbp_per_kwh")
        if worth is not None:
            found["stored_value_gbp_per_kwh"] = worth
        if "outage_messages" in record.steps:
            found["outage_messages"] = solve.get("outage_messages") or ""
        found["corrected"] = solve["correction_reason"] is not None
        found["estimated"] = "; ".join(plan["estimated"])
    return replace(record, steps={**record.steps, **found}, buses=buses, lines=lines)
