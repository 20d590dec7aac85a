"""Export of the past as the run of a scenario: stored plans and readings, replayed on the plant.

Of every step the set-points that were said, the demand, sun and state of charge that were measured
(the profile's where nothing was), and whether there was grid. What they led to is the plant's
answer: not all of it is measured. Of a step that was decided anew powers are those of its last
plan; who was off, and for how long, counts by its parts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InputError
from vppres.core.units import h_to_minutes
from vppres.day.options import RunOptions
from vppres.day.recorder import ROTATED, Recorder, StepRecord
from vppres.day.trajectory import LOSSES, SHARE, TIME_ON, Trajectory
from vppres.io.times import option_time
from vppres.live.profile import ClockProfile
from vppres.model.site import Site
from vppres.scenario.configuration import Branches
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import Plan, closed_by, expected_by
from vppres.service.clock import written
from vppres.service.events.announced import limits_kw, prices, warnings_ever
from vppres.service.events.faults import faults_told
from vppres.service.of_kind import told_by_plans
from vppres.service.operation.site import Service
from vppres.service.plans.document import SOLVED, STORED_VALUE
from vppres.service.plans.world import World
from vppres.service.replay.within import StepPart, off_in, parts_of
from vppres.service.storage.records import Event, seconds
from vppres.service.storage.store import Store
from vppres.service.telemetry.learned import InSteps
from vppres.service.window import Window

MOST_STEPS = 40_000
"""At once: more than a year of quarter hours."""


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
    times = scenario.grid.times
    plans = store.plans(times[0], scenario.grid.end)
    if not plans:
        message = f"finds no step from {written(times[0])} up to {written(scenario.grid.end)}"
        raise InputError.of("export", message, "Give a time in which the service ran.")
    replay = Replay.of(scenario, service.options, plans, store)
    said = warnings_ever(store.events_ever(), times[0], scenario.grid.step)
    warnings = tuple(one for one in said if one.issued_at < scenario.grid.end)
    replay = replace(replay, scenario=replace(replay.scenario, warnings=warnings))
    recorder = replay.recorder()
    for record in counted(replay, store):
        recorder.add(record)
    return recorder.finish(service.options.on(replay.scenario).as_record())


def site_of(service: Service, start: pd.Timestamp, end: pd.Timestamp) -> Scenario:
    """The site with the steps of a time, as its profile or its own days have them."""
    profile = ClockProfile.of(service.scenario)
    first = service.scenario.grid.begun(start.tz_convert("UTC"))
    step = service.scenario.grid.step
    n_steps = -((first - end) // step)
    if n_steps <= 0:
        cure = f"Give an end after {written(first)}, the beginning of its first step."
        raise InputError.of("export", "does not end after it begins", cure, value=written(end))
    if n_steps > MOST_STEPS:
        cure = f"Give {MOST_STEPS} steps at most, and export the others apart."
        raise InputError.of("export", "is too long", cure, value=f"{n_steps} steps")
    return replace(profile.steps(first, n_steps), warnings=(), faults=())


@dataclass(frozen=True, eq=False)
class Replay:
    """Stored steps, as they were: what was said of them is played again on the plant."""

    #: The steps as they were measured and announced; without grid where plans say so.
    scenario: Scenario
    options: RunOptions  #: how they were decided
    #: Their plans, empty for a step without; none of steps that were not replayed yet.
    stored: list[Plan]
    parts: list[list[StepPart]]  #: parts of each step; none of a step without a plan
    soc: Floats  #: states of charge that were read, NaN where none was, (T, B)

    @classmethod
    def of(
        cls, scenario: Scenario, options: RunOptions, plans: Iterable[Plan], store: Store
    ) -> Replay:
        """The steps of a scenario, with what is stored of them."""
        by_start = {plan["start"]: plan for plan in plans}
        stored = [by_start.get(written(time), {}) for time in scenario.grid.times]
        measured = InSteps(store, scenario.grid)
        step = scenario.grid.step
        parts = [parts_of(plan, step, store) if plan else [] for plan in stored]
        dark = [bool(each) and each[-1].island for each in parts]
        price, limit_kw = _announced(scenario, stored, store)
        b, pv = scenario.batteries, scenario.pv
        soc = measured.laid("soc", b.id, np.full((len(stored), len(b)), np.nan))
        first = np.where(np.isfinite(soc[0]), soc[0], b.soc_initial)
        known = replace(
            scenario,
            load_kw=measured.laid("load_kw", scenario.customers.id, scenario.load_kw),
            pv_kw=np.minimum(measured.laid("pv_kw", pv.id, scenario.pv_kw), pv.p_max_kw),
            price_gbp_per_kwh=price,
            grid_limit_kw=np.where(dark, 0.0, limit_kw),
            faults=faults_told([plan for plan in stored if plan], scenario.network, step),
            batteries=replace(b, soc_initial=np.clip(first, b.soc_min, b.soc_max)),
        )
        return cls(told_by_plans(known, stored), options, stored, parts, soc)

    def records(self) -> Iterator[StepRecord]:
        """The plant's answer to every step that is stored.

        Batteries and the units of each kind begin it with what was measured. Of a step that was
        decided anew it answers the last plan, as if that had held all along; supply counts by the
        parts of the step.
        """
        scenario = self.scenario
        world = World(scenario, self.options)
        day, b = world.day, scenario.batteries
        shared = self.options.on(scenario).shares_supply
        told: list[dict[str, Any]] = []
        closed = self.closed
        for t, plan in enumerate(self.stored):
            read = np.isfinite(self.soc[t])
            held = np.where(read, np.clip(self.soc[t], b.soc_min, b.soc_max), day.state.soc)
            day.state = replace(day.state, soc=held)
            world.begin_as(plan, t)
            if plan:
                told = [{**one, "valid_from": plan["start"]} for one in plan["setpoints"]]
            record = _noted(world.obey(t, told, closed[t]), plan)
            yield _weighed(record, scenario, plan) if shared else record

    @cached_property
    def closed(self) -> list[Flags | None]:
        """Lines and ties that were closed in each step, (E,); None where no switch was moved."""
        branches = Branches.of(self.scenario)
        found, last = [], dict[str, Any]()
        for plan in self.stored:
            last = dict(plan) or last
            found.append(closed_by(last, branches))
        moved = any((closed != branches.closed).any() for closed in found)
        return [closed if moved else None for closed in found]

    def recorder(self) -> Recorder:
        """Recorder of the steps."""
        moved = any(closed is not None for closed in self.closed)
        return Recorder(self.scenario, Branches.of(self.scenario) if moved else None)

    def alone(self, t: int) -> Scenario:
        """A step by itself, with the states of charge that were read at its beginning."""
        alone = self.scenario.between(t, t + 1)
        b = alone.batteries
        soc = np.where(np.isfinite(self.soc[t]), self.soc[t], b.soc_initial)
        held = np.clip(soc, b.soc_min, b.soc_max)
        return replace(alone, batteries=replace(b, soc_initial=held))


def counted(replay: Replay, store: Store) -> Iterator[StepRecord]:
    """The steps of a replay, in which supply counts by the parts of those decided anew.

    The share of a customer is its mean while it was on.
    """
    parts = replay.parts
    if all(len(each) < 2 for each in parts):
        yield from replay.records()
        return
    before = np.ones(len(replay.scenario.customers), dtype=bool)
    for record in replay.records():
        t, ends_on = record.t, record.customers["served"]
        earlier = parts[t][:-1]
        hours = np.array([one.hours for one in parts[t]] or [1.0])
        on = np.array([*(_on_in(one, t, replay, store) for one in earlier), ends_on], dtype=bool)
        losses = (np.vstack([before, on[:-1]]) & ~on).sum(axis=0)
        columns = {**record.customers, TIME_ON: hours @ on / hours.sum(), LOSSES: losses}
        if SHARE in columns:
            shares = [*(_shares_in(one, replay) for one in earlier), columns[SHARE]]
            got, in_full = hours @ (on * shares), hours @ on
            columns[SHARE] = np.divide(got, in_full, out=np.zeros_like(got), where=in_full > 0.0)
        yield replace(record, customers=columns)
        before = ends_on


def off_minutes(
    service: Service, store: Store, plan: Plan, until: pd.Timestamp
) -> tuple[dict[str, float], float]:
    """For how many minutes of a step, up to a time in it, customers were off; and of how many."""
    length = service.scenario.grid.step
    begun = until > pd.Timestamp(plan["start"])
    parts = parts_of(plan, length, store, until if begun else None)
    minutes = [h_to_minutes(part.hours) for part in parts]

    @cache
    def alone() -> Scenario:
        begin = pd.Timestamp(plan["start"])
        site = site_of(service, begin, begin + length)
        return Replay.of(site, service.options, [plan], store).alone(0)

    found: dict[str, float] = {}
    for part, each in zip(parts, minutes, strict=True):
        for name in sorted(off_in(part, plan, alone, service.options, store)):
            found[name] = found.get(name, 0.0) + each
    return found, sum(minutes)


def _on_in(part: StepPart, t: int, replay: Replay, store: Store) -> Flags:
    """Customers that were on in a part of a step, (C,)."""
    off = off_in(part, replay.stored[t], partial(replay.alone, t), replay.options, store)
    return np.array([str(name) not in off for name in replay.scenario.customers.id], dtype=bool)


def _shares_in(part: StepPart, replay: Replay) -> Floats:
    """Shares of their demand that customers were to get while they were on, (C,)."""
    points = (one for one in part.setpoints if one["kind"] == "customers")
    told = {str(one["asset"]): one.get("share", 1.0) for one in points}
    return np.array([told.get(str(name), 1.0) for name in replay.scenario.customers.id])


def _announced(scenario: Scenario, stored: Sequence[Plan], store: Store) -> tuple[Floats, Floats]:
    """Import price and limit of each step, (T,), as they were known when it was decided.

    They are what its plan says; without one, what events said by then.
    """
    price = scenario.price_gbp_per_kwh.copy()
    limit_kw = scenario.grid_limit_kw.copy()
    versions = list(store.events_ever().values())
    step = scenario.grid.step
    for t, (time, plan) in enumerate(zip(scenario.grid.times, stored, strict=True)):
        expected = expected_by(plan)
        if "price_gbp_per_kwh" in expected:
            known_kw = expected["grid_limit_kw"]
            price[t] = expected["price_gbp_per_kwh"]
            limit_kw[t] = np.inf if known_kw is None else known_kw
        elif versions:
            row = slice(t, t + 1)
            series = {name: values[row] for name, values in scenario.series.items()}
            alone = Window(scenario.grid.times[row], step, series)
            said = _known_by(versions, plan.get("generated_at", time))
            price[t] = prices(said, alone)[0]
            limit_kw[t] = limits_kw(said, alone)[0]
    return price, limit_kw


def _known_by(versions: Sequence[Sequence[Event]], time: Any) -> list[Event]:
    """Of each event what was said last by a time, those left out that were withdrawn."""
    at = seconds(pd.Timestamp(time))
    said = ([one for one in each if one.made_at <= at][-1:] for each in versions)
    return [one for (one,) in filter(None, said) if one.body]


def _weighed(record: StepRecord, scenario: Scenario, plan: Plan) -> StepRecord:
    """A step with the weights of its plan; a step without a plan has those of the site."""
    rotated = (plan.get("solve") or {}).get(ROTATED) or {}
    c = scenario.customers
    own = dict(zip(map(str, c.id), c.weight, strict=True))
    weight = np.array([rotated.get(name, own[name]) for name in own], dtype=float)
    return replace(record, customers={**record.customers, ROTATED: weight})


def _noted(record: StepRecord, plan: Plan) -> StepRecord:
    """A step with what its plan says of how it was found."""
    # No model's answer is stored: that of the AC power flow stands in its place.
    buses = {**record.buses, "v_model_pu": record.buses["v_ac_pu"]}
    lines = {
        **record.lines,
        "p_model_kw": record.lines["p_ac_kw"],
        "q_model_kvar": record.lines["q_ac_kvar"],
    }
    found = {"status": plan.get("status", "missed"), "v_error_pu": 0.0}
    if solve := plan.get("solve"):
        numbers = {own: solve.get(name) for name, own in SOLVED.items()}
        if numbers[STORED_VALUE] is None:
            del numbers[STORED_VALUE]
        found |= {own: np.nan if value is None else value for own, value in numbers.items()}
        found |= {name: solve[name] or "" for name in ("fallback_reason", "correction_reason")}
        found["status"] = solve["status"]
        found["fallback"] = solve["fallback"] or "none"
        if "outage_messages" in record.steps:
            found["outage_messages"] = solve.get("outage_messages") or ""
        found["corrected"] = solve["correction_reason"] is not None
        found["estimated"] = "; ".join(plan["estimated"])
    return replace(record, steps={**record.steps, **found}, buses=buses, lines=lines)
