"""One step, from the clock to the stored plan, and what is to be said between two of them."""

from __future__ import annotations

import json
import logging
import re
import threading
import time as machine
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags
from vppres.core.errors import InputError, StorageError
from vppres.day.forecasting import FORECASTERS
from vppres.day.options import RunOptions
from vppres.day.outages import KNOWN, LOOKAHEAD_H
from vppres.day.trajectory import SWITCHES_OPEN
from vppres.kinds.kind import EARLY_SHARE
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.live.past import REMEMBERED_DAYS
from vppres.live.profile import ClockProfile
from vppres.scenario.configuration import Branches, in_configuration, out_of_branches
from vppres.scenario.faults import LineFault
from vppres.scenario.outage_warnings import OutageWarning
from vppres.scenario.scenario import Scenario
from vppres.service.alarms.conditions import BY_HAND, Situation, conditions, situation
from vppres.service.alarms.notify import Notifier
from vppres.service.alarms.state import Alarms
from vppres.service.as_told import closed_by, expected_by
from vppres.service.clock import SetClock, TimeSource, written
from vppres.service.events.announced import certain_interval, warnings
from vppres.service.events.faults import FAULTS, faults_at, told
from vppres.service.of_kind import told_by_plans
from vppres.service.operation.by_hand import ByHand
from vppres.service.operation.switching import SWITCHING, Switchgear
from vppres.service.plans.document import (
    PROPOSED,
    Left,
    defaults_of,
    made_anew,
    ordered,
    ordered_plan,
    plan_of,
    points_at,
    tables_of,
    told_at,
)
from vppres.service.plans.gate import refusals
from vppres.service.plans.ruled import ruled
from vppres.service.storage.records import DECIDED, After, Asked, Reading, Written, seconds
from vppres.service.storage.store import Store
from vppres.service.telemetry.changes import Changes
from vppres.service.telemetry.grid_readings import (
    GRID_ON,
    IMPORT,
    contradiction,
    lost_now,
    stands_alone,
)
from vppres.service.telemetry.knowledge import (
    CLOSED,
    INSTANT,
    Grid,
    Latest,
    StepInputs,
    grid_at,
    known_at,
    states_of,
)
from vppres.service.telemetry.learned import InSteps, learned
from vppres.service.telemetry.news import AGAINST_PLANS, News, is_said_lost, newest, unknown_to
from vppres.service.telemetry.refused import RefusedReadings

DEADLINE_SHARE = 0.25
"""Largest share of a step that a window may be searched for."""

FAILED = "failed"
"""The status of a step that only the rule could decide."""

LAST_PLAN = "last plan"
"""Who says whether there is grid where nothing else does."""

MODE = "mode"
"""The setting of what an operator asked for."""

MOST_JOBS = 100
"""Steps that were asked for and are remembered, beside those that are stored."""

LONGEST_GAP = pd.Timedelta(days=7)
"""Since the last step: over a longer time it was the clock that was set, and no step is missed."""

KEEP_DAYS = 400.0
"""More than a year, so that the same day of the last one is there."""

MOST_KNOWN = 24
"""Steps of which it is remembered what was expected when they were decided."""

FULL_HORIZON_H = 24.0

NUMBERS = re.compile(r" [-+.\d]+")
"""What changes from step to step in words about the same."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Service:
    """Service of one site: its controller, store and clock."""

    scenario: Scenario  #: the site
    options: RunOptions  #: how it decides
    #: Whether the scenario's own steps are played, at the pace of the requests.
    rehearsal: bool = False
    #: Whether the clock is set over HTTP, instead of the machine's; that of a rehearsal is.
    paced: bool = False
    keep_days: float = KEEP_DAYS  #: how long readings and plans are kept, in days

    @property
    def profile(self) -> ClockProfile | None:
        """Daily profile of the site; None in a rehearsal."""
        return None if self.rehearsal else ClockProfile.of(self.scenario)


@dataclass(frozen=True)
class Within:
    """A moment within a step that is decided anew from then on, and why the plan before is not."""

    at: pd.Timestamp
    why: str
    before: dict[str, Any]


class Runner:
    """Decides the steps of a site, one after another, and remembers them."""

    def __init__(
        self, service: Service, store: Store, clock: TimeSource, profile: ClockProfile | None
    ) -> None:
        self.store = store
        self.clock = clock
        self.rehearsal = service.rehearsal
        self.notifier: Notifier | None = None
        self.keeps = pd.Timedelta(days=service.keep_days)
        self.played = service.rehearsal or service.paced
        self.scenario = service.scenario
        self.branches = Branches.of(self.scenario)
        self.length = self.scenario.grid.step
        self.profile = profile
        most_s = DEADLINE_SHARE * self.scenario.grid.dt_h * 3600.0
        options = service.options.on(service.scenario)
        limits = replace(options.limits, time_s=min(options.limits.time_s, most_s))
        self.options = replace(options, limits=limits)
        self.heard: list[dict[str, Any]] = []
        self.expected: OrderedDict[str, Measurement] = OrderedDict()
        self.last: dict[str, Any] = store.last_step()
        self.on_step: Callable[[float], None] = lambda _: None
        self.on_plan: Callable[[], None] = lambda: None
        self._jobs: OrderedDict[str, Future[dict[str, Any]]] = OrderedDict()
        self.changes = Changes()
        self.refused = RefusedReadings(self.length)
        self.news = News(store)
        self._fresh: dict[tuple[str, str], Reading] = {}
        self._hearing = threading.Lock()
        self.alarms = Alarms(store)
        self._within: Within | None = None
        self._odd = set[str]()
        if isinstance(clock, SetClock) and self.last:
            clock.set(max(clock.now(), pd.Timestamp(self.last["generated_at"])))
        self._state = self._last_state()
        if self._made_later(self.last, clock.now()):
            self._come_back(clock.now())
        else:
            self._controller = self._restored()
        # One thread decides all steps, so that there is one process that solves.
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="vppres-step")

    def close(self) -> None:
        """End the thread, after the step that it is in."""
        self._thread.shutdown()

    def step(self, time: pd.Timestamp | None = None, actor: str | None = None) -> dict[str, Any]:
        """The plan of a step, the present one if not given: the stored one, or a new one.

        Raises
        ------
        InputError
            If no step begins then, if it is over, or not yet there.
        StorageError
            If it could not be kept: then nothing was decided.
        """
        return self._thread.submit(self._step, time, actor).result()

    def anew(self) -> dict[str, Any] | None:
        """Decide the rest of the present step, if its plan does not know something; else None."""
        return self._thread.submit(self._anew).result()

    def hear(self, readings: list[Reading], now: pd.Timestamp, actor: str) -> Written:
        """Keep readings, and note what the present plan does not know of them."""
        until = now + EARLY_SHARE * self.length
        new = self.news.of(readings, until, self.last or {})
        kept = self.store.write_readings(readings, now, actor)
        told = newest(readings)
        with self._hearing:
            self._fresh |= told
        if self.last:
            self._compare(told.values(), until)
            imports = any(one.quantity == IMPORT and abs(one.value) > 0.0 for one in readings)
            if imports and is_said_lost(self.last) and self._fed():
                new.append("import although the grid was said to be lost")
            for words in new:
                self.changes.note(words)
        return kept

    def _compare(self, told: Iterable[Reading], until: pd.Timestamp) -> None:
        """Note what readings say against the plan, as far as they are the last ones."""
        said = [one for one in told if one.quantity in AGAINST_PLANS]
        kinds = {one.quantity for one in said}
        last = self.store.latest(until, kinds) if kinds else []
        for words in unknown_to(self.last, (one for one in last if one in said), self._fed):
            self.changes.note(words)

    def _fed(self) -> bool:
        """Whether something contradicts the last reading of the grid, that it is lost."""
        now = self.clock.now()
        zero = lost_now(now, self.length, self.store)
        demand_kw = float(self._profile_of(self.begun(now)).load_kw.sum())
        return contradiction(zero, now, self.length, self.store, demand_kw) != ""

    def asked_again(self, readings: Iterable[Reading]) -> list[str]:
        """Requests to send a reading again: a lost grid that no other reading confirms."""
        if not any(one.quantity == GRID_ON and one.value == 0.0 for one in readings):
            return []
        now = self.clock.now()
        words = stands_alone(lost_now(now, self.length, self.store), now, self.length, self.store)
        return [words] if words else []

    def look(self) -> None:
        """Note what has changed while the service did not run."""
        if not self.last:
            return
        until = self.clock.now() + EARLY_SHARE * self.length
        latest = self.store.latest(until, INSTANT)
        self._compare(latest, until)
        since = seconds(pd.Timestamp(self.last["generated_at"]))
        if any(one.time > since for one in latest):
            self.changes.note("the service has started again")
        for name, event in self.store.events().items():
            if event.made_at > since:
                self.changes.note(f"event {name}")

    def note_turns(self) -> None:
        """Note what has begun or ended since the plan of the present step was made."""
        if not self.last or self.rehearsal:
            return
        since, now = pd.Timestamp(self.last["generated_at"]), self.clock.now()
        for what, time in self._turns():
            if since < time <= now:
                self.changes.note(what)

    def to_next_turn_s(self) -> float:
        """How long until something begins or ends otherwise than in the present plan, in s."""
        now = self.clock.now()
        left = [(time - now).total_seconds() for _, time in self._turns() if time > now]
        return float(min(left, default=np.inf))

    def _turns(self) -> list[tuple[str, pd.Timestamp]]:
        """When the mode and events end, and outages begin in a step that is planned with grid."""
        asked, _ = self.store.setting(MODE)
        events = self.store.events()
        times = {f"event {name} ended": one.body.get("end") for name, one in events.items()}
        if asked:
            times[f"mode {asked['mode']} ended"] = asked["until"]
        if (self.last.get("grid") or {}).get("available"):
            certain = {name: certain_interval(one.said) for name, one in events.items()}
            times |= {f"event {name} began": one[0] for name, one in certain.items() if one}
        return [(what, pd.Timestamp(time)) for what, time in times.items() if time]

    def checked(self, asked: Mapping[str, Any]) -> list[str]:
        """Consequences of an operator's set-points now, by balance and AC power flow.

        Raises
        ------
        InputError
            If they would black out an island that is lit.
        """
        now = self.clock.now()
        found = self.situation(now)
        step = self._in_configuration(self._measured(now, found.is_dark), now)
        step = told_by_plans(step, [found.plan])
        return ByHand(asked, step, found, self.options).words()

    @property
    def is_switching(self) -> bool:
        """Whether states of switches are asked for or proposed, or an operation was confirmed."""
        asked = self.store.setting(SWITCHING)[0]
        return bool(asked.get("closed") or asked.get("issued") or self.last.get(PROPOSED))

    def switchgear(self, asked: Mapping[str, Any] | None = None) -> Switchgear:
        """Switches as they were read last, and as an operator asked for them, or asks now."""
        now = self.clock.now()
        until = now + EARLY_SHARE * self.length
        read = states_of(self.scenario, self.store, now)
        given = self.store.setting(SWITCHING)[0] if asked is None else asked
        found = self.situation(now)
        step = self._measured(now, found.is_dark)
        seen = self._carried_out(given.get("issued"), until)
        closed, proposed = closed_by(self.last, self.branches), self.last.get(PROPOSED, {})
        has_grid = not found.is_dark
        return Switchgear(
            step=step,
            read=read,
            of_plan=closed,
            proposed=proposed,
            soc=found.known_soc,
            asked=given,
            carried_out=seen,
            set_points=points_at(self.last, now),
            has_grid=has_grid,
            source=has_grid or found.formers is None,
            is_lit=not found.why_dark,
            now=now,
        )

    def _carried_out(self, issued: Mapping[str, Any] | None, until: pd.Timestamp) -> bool:
        """Whether an operation was seen in a reading after it was confirmed."""
        if issued is None:
            return False
        since = self.store.between(pd.Timestamp(issued["confirmed_at"]), until, [CLOSED])
        told = (one for one in since if one.asset == issued["switch"])
        return any(one.value == float(issued["closed"]) for one in told)

    def _measured(self, now: pd.Timestamp, is_dark: bool) -> Scenario:
        """The present step, with its readings and what is known to be out."""
        last = self.last
        step = self._profile_of(self.begun(now))
        measured = InSteps(self.store, step.grid)
        limit_kw = expected_by(last).get("grid_limit_kw")
        known_kw = np.inf if limit_kw in (None, 0.0) else limit_kw
        return replace(
            step,
            load_kw=measured.laid("load_kw", step.customers.id, step.load_kw),
            pv_kw=np.minimum(measured.laid("pv_kw", step.pv.id, step.pv_kw), step.pv.p_max_kw),
            grid_limit_kw=np.array([0.0 if is_dark else known_kw]),
            faults=self.faults(now),
        )

    def situation(self, now: pd.Timestamp) -> Situation:
        """How the site is, with the last plan and what that does not know."""
        return situation(
            now,
            self.scenario,
            self.store,
            self.last,
            self.ahead_s,
            self.changes.reasons,
            self.options.mode,
        )

    def check_alarms(self) -> None:
        """Raise, change and clear alarms by what is wrong now."""
        now = self.clock.now()
        with suppress(StorageError):  # /readyz says so, and the next look comes soon
            found = self.situation(now)
            unreached = self.notifier.unreached() if self.notifier else ()
            stopped = self.switchgear().stopped if self.is_switching else ""
            found = replace(found, unreached=unreached, switching_stopped=stopped)
            self.alarms.look(conditions(found), now)

    def begin(self, time: pd.Timestamp | None = None, actor: str | None = None) -> str:
        """Let a step be decided, and do not wait; the name of the job, that of its step."""
        time = self.step_of(time)
        name = written(time)
        if name not in self._jobs or self._jobs[name].done():
            self._jobs[name] = self._thread.submit(self._step, time, actor)
            while len(self._jobs) > MOST_JOBS:
                self._jobs.popitem(last=False)
        return name

    def job(self, name: str) -> dict[str, Any] | None:
        """How a step that was asked for stands, with its plan; None if it was not."""
        future = self._jobs.get(name)
        if future and not future.done():
            return {"id": name, "status": "started" if future.running() else "queued"}
        try:
            plan = self.store.step(pd.Timestamp(name))
        except ValueError:
            plan = {}
        if plan:
            return {"id": name, "status": "finished", "plan": plan}
        if not future:
            return None
        return {"id": name, "status": "failed", "reason": str(future.exception()).splitlines()[0]}

    def set_clock(self, time: pd.Timestamp) -> None:
        """Let it be a later time.

        Raises
        ------
        InputError
            If it is the machine's clock that counts, or the time is over.
        """
        problem = None
        if not isinstance(self.clock, SetClock):
            problem = ("is the machine's", "Start the service with --paced or --rehearse.")
        elif time < self.clock.now():
            problem = ("does not go back", f"It is {written(self.clock.now())}.")
        if problem:
            raise InputError.of("clock", *problem, field="now", value=written(time))
        self._thread.submit(self._set_clock, time).result()

    def _set_clock(self, time: pd.Timestamp) -> None:
        assert isinstance(self.clock, SetClock)
        self.clock.set(time)
        if not self._state:  # nothing was decided yet: it begins here
            self._controller = self._restored()
        self.note_turns()
        if self.changes.reasons:  # a plan of the same moment could not be told from the one before
            self.changes.new.set()
        self.check_alarms()

    def begun(self, time: pd.Timestamp) -> pd.Timestamp:
        """Beginning of the step that covers a time."""
        return self.scenario.grid.begun(time).tz_convert("UTC")

    def step_of(self, time: pd.Timestamp | None) -> pd.Timestamp:
        """Beginning of the step that is asked for, the present one if none is."""
        return time.tz_convert("UTC") if time else self.begun(self.clock.now())

    @property
    def mode(self) -> dict[str, Any]:
        """Mode that an operator set, as long as it holds."""
        asked, _ = self.store.setting(MODE)
        if not asked or (asked["until"] and pd.Timestamp(asked["until"]) <= self.clock.now()):
            return {"mode": "auto", "until": None, "reason": "", "setpoints": []}
        found: dict[str, Any] = asked
        return found

    @property
    def why_none(self) -> str:
        """Why there is no plan yet."""
        if self.played:
            return "No step was decided yet. Ask for one with POST /v1/steps."
        return "The first step is being decided."

    @property
    def ahead_s(self) -> float:
        """How long the last plan still holds, in s; negative when it is over, or not yet there."""
        if not self.last:
            return -float("inf")
        start, now = pd.Timestamp(self.last["start"]), self.clock.now()
        left = start + self.length - now if start <= now else now - start
        return float(left.total_seconds())

    def _step(self, time: pd.Timestamp | None, actor: str | None) -> dict[str, Any]:
        """Decide a step, in the thread of steps."""
        now = self.clock.now()
        asked = Asked(actor, now) if actor else None
        time = time.tz_convert("UTC") if time else self.begun(now)
        if self._made_later(self.last, now):
            self._come_back(now)
        stored = self.store.step(time)
        if stored:
            return stored
        self._check(time, now)
        if self.rehearsal and isinstance(self.clock, SetClock):
            self.clock.set(time)
        self._bridge_gap(time)
        return self._planned(time, asked)

    def _anew(self) -> dict[str, Any] | None:
        """Decide the rest of the present step anew, instead of its plan."""
        self.changes.new.clear()
        why = "; ".join(self.changes.reasons)
        now = self.clock.now()
        before = self.last
        time = self.begun(now)
        # Where the step is not decided yet its own plan will know; a rehearsal stands still.
        if not why or self.rehearsal or before.get("start") != written(time):
            return None
        if now <= pd.Timestamp(before["valid_from"]):
            return None
        self._within = Within(now, why, before)
        try:
            return self._planned(time, None)
        finally:
            self._within = None

    def _planned(self, time: pd.Timestamp, asked: Asked | None) -> dict[str, Any]:
        """A plan as the mode has it, kept."""
        begin = machine.monotonic()
        noted = self.changes.noted
        with self._hearing:
            self._fresh = {}
        mode = self.mode
        known: StepInputs | None = None
        if mode["mode"] == "off":
            reason, left = mode["reason"] or "switched off", self._left(time, self._grid(time))
            plan = defaults_of(time, self.scenario, "off", reason, left)
        elif mode["mode"] in BY_HAND:
            plan = self._by_hand(time, mode)
        else:
            plan, known = self._decided(time)
        plan = self._kept(time, plan, asked, known)
        self.on_step(machine.monotonic() - begin)
        self._forget(time)
        self.last = plan
        self.changes.known(noted)
        with self._hearing:
            told = [*self._fresh.values()]
        self._compare(told, self.clock.now() + EARLY_SHARE * self.length)
        self.check_alarms()
        return plan

    def _kept(
        self,
        time: pd.Timestamp,
        plan: dict[str, Any],
        asked: Asked | None = None,
        known: StepInputs | None = None,
    ) -> dict[str, Any]:
        """A plan as it is stored: with its time, and for the rest of the step if decided anew.

        Where the controller decided on what is ``known`` its state is stored too.
        """
        plan = {**plan, "generated_at": written(self.clock.now())}
        if self._within:
            plan = made_anew(plan, self._within.at, self._within.why, self._within.before)
        if faults := self.faults(self._moment(time)):
            plan[FAULTS] = told(faults, self.scenario.network, self.length, time)
        if SWITCHES_OPEN not in plan and self.scenario.follows_switches:
            closed = self._closed(self._moment(time))
            plan[SWITCHES_OPEN] = [*self.branches.open_names(closed)]
        if not known:
            self.store.write_step(time, plan, asked=asked)
            return plan
        after = After(self._controller.saved(), self._controller.measured)
        try:
            self.store.write_step(time, plan, after, asked)
        except StorageError:
            self._controller = self._restored()  # as if it had not decided
            raise
        self._log_odd(plan)
        self._state = after.state
        self.expected[plan["id"]] = known.measurement
        while len(self.expected) > MOST_KNOWN:
            self.expected.popitem(last=False)
        return plan

    def _check(self, time: pd.Timestamp, now: pd.Timestamp) -> None:
        """Whether a step may be decided now."""
        problem = None
        if self.begun(time) != time:
            problem = (
                "is not the beginning of a step",
                f"One begins at {written(self.begun(time))}.",
            )
        elif self.last and time < pd.Timestamp(self.last["start"]):
            problem = ("is over, and was not decided", f"The last step is {self.last['start']}.")
        elif self.rehearsal and not self.scenario.grid.start <= time < self.scenario.grid.end:
            problem = (
                "is no step of the scenario that is rehearsed",
                f"Its steps are those from {written(self.scenario.grid.start)} up to "
                f"{written(self.scenario.grid.end)}.",
            )
        elif not self.rehearsal and time != self.begun(now):
            problem = ("is not the present step", f"That one began at {written(self.begun(now))}.")
        if problem:
            raise InputError.of("step", *problem, field="time", value=written(time))

    def _decided(self, time: pd.Timestamp) -> tuple[dict[str, Any], StepInputs | None]:
        """The controller's plan, and on what; by rule on nothing, whatever it is that fails."""
        known: StepInputs | None = None
        try:
            self._feed(time)
            now = self._within.at if self._within else None
            known = known_at(time, self._controller, self.store, self.rehearsal, now)
            self.heard = known.latest.heard
            decision = self._controller.step(known.measurement)
            # What was decided on, not what was read: the gate checks this decision.
            tables = tables_of(decision, self.scenario)
            refused = refusals(tables, self.scenario, dict(decision.batteries["soc"]))
        except StorageError:
            raise
        except Exception as error:
            # A step without an answer is worse than any of it.
            log.exception("step")
            return self._ruled(time, known, error), None
        plan = plan_of(decision, self.scenario, known, refused, self._left(time, known.grid))
        return {**plan, "outage_probability": self._believed(known)}, known

    def _grid(self, time: pd.Timestamp) -> Grid | None:
        """Whether there is grid in a step that the controller does not decide; None if unknown."""
        try:
            self._feed(time)
            return grid_at(time, self._controller, self.store, self._moment(time))
        except StorageError:
            raise
        except Exception:
            log.exception("whether there is grid at %s", written(time))
            return None

    def _left(self, time: pd.Timestamp, grid: Grid | None) -> Left:
        """Last set-points of devices and state of the grid, which is as before if it is unknown."""
        told = told_at(self.last, self._moment(time))
        if grid:
            return Left(grid.available, grid.known_by, told)
        before = self.last.get("grid") or {"available": True}
        return Left(before["available"], LAST_PLAN, told)

    def _moment(self, time: pd.Timestamp) -> pd.Timestamp:
        """From when on a plan of a step holds."""
        return self._within.at if self._within else time

    def _log_odd(self, plan: dict[str, Any]) -> None:
        """A line for what is odd, when it begins; readings that are only missing are late.

        Several messages speak of one outage, or a device is not as its readings or sessions say.
        """
        said = [plan["solve"]["outage_messages"] or "", *plan["estimated"]]
        odd = {NUMBERS.sub("", words): words for words in said if not words.endswith("(missing)")}
        for key, words in odd.items():
            if key and key not in self._odd:
                log.warning("%s: %s", plan["start"], words)
        self._odd = set(odd)

    def _ruled(
        self, time: pd.Timestamp, known: StepInputs | None, error: Exception
    ) -> dict[str, Any]:
        """The plan of a rule that needs no solver, for a step in which everything else failed."""
        moment = self._moment(time)
        now = replace(self._profile_of(time), faults=self.faults(moment))
        now = self._in_configuration(now, moment)
        left = self._left(time, known.grid if known else None)
        latest = known.latest if known else Latest.at(time, self.scenario, self.store)
        if not left.available:
            now = replace(now, grid_limit_kw=np.zeros(1))
        lost = known.lost if known else {}
        words = str(error).splitlines()[:1] or [type(error).__name__]
        mode = {"mode": FAILED, "reason": f"by rule: {words[0]}"}
        physical = self.options.mode == "physical"
        tables = ruled(now, latest.soc, lost, ordered(self.scenario, self.last, []), physical)
        return ordered_plan(time, self.scenario, mode, tables, {}, left)

    def _closed(self, now: pd.Timestamp) -> Flags:
        """Lines and ties that are closed: as they were read, or else as in the last plan."""
        before = closed_by(self.last, self.branches)
        if not self.scenario.follows_switches:
            return before
        step = replace(self._profile_of(self.begun(now)), faults=self.faults(now))
        out = out_of_branches(step.out_of_service(range(1)), self.branches.ends)[0]
        read = states_of(self.scenario, self.store, now)
        return self.branches.with_states(read, before, out)[0]

    def _in_configuration(self, step: Scenario, now: pd.Timestamp) -> Scenario:
        """A step of the feeder as its switches are."""
        return in_configuration(step, self.branches, self._closed(now)).scenario

    def _profile_of(self, time: pd.Timestamp) -> Scenario:
        """Profile of a step in the scenario."""
        if self.profile:
            return self.profile.steps(time, 1)
        row = round((time - self.scenario.grid.start) / self.length)
        return self.scenario.between(row, row + 1)

    def _forget(self, time: pd.Timestamp) -> None:
        """Once a day drop what is too old."""
        begun = pd.Timestamp(self.last.get("start", time))
        if begun.normalize() != time.normalize() and time - begun <= LONGEST_GAP:
            with suppress(StorageError):  # the step is kept; tomorrow is another day
                self.store.forget(time - self.keeps, time - pd.Timedelta(days=REMEMBERED_DAYS))

    def _by_hand(self, time: pd.Timestamp, mode: dict[str, Any]) -> dict[str, Any]:
        """The plan of an operator, through the gate as any other."""
        tables = ordered(self.scenario, self.last, mode.get("setpoints", []))
        refused = refusals(tables, self.scenario, Latest.at(time, self.scenario, self.store).soc)
        left = self._left(time, self._grid(time))
        return ordered_plan(time, self.scenario, mode, tables, refused, left)

    def _bridge_gap(self, time: pd.Timestamp) -> None:
        """Write down the steps since the last one as missed; they are not decided any more."""
        if not self.last:
            return
        missed = pd.Timestamp(self.last["start"]) + self.length
        if time - missed > LONGEST_GAP:
            log.warning("the clock went from %s to %s: no step counts as missed", missed, time)
            self._controller = self._restored()
            return
        while missed < time:
            reason, left = "the service did not run", self._left(missed, None)
            plan = defaults_of(missed, self.scenario, "missed", reason, left)
            del plan["grid"]  # not looked at
            self._kept(missed, plan)
            missed += self.length

    def _made_later(self, plan: dict[str, Any], now: pd.Timestamp) -> bool:
        """Whether a plan was made later than now, by a clock that has been set back since."""
        if not plan or isinstance(self.clock, SetClock):  # that one never goes back
            return False
        return bool(pd.Timestamp(plan["generated_at"]) > now + EARLY_SHARE * self.length)

    def _come_back(self, now: pd.Timestamp) -> None:
        """Take back what was decided ahead of time: it is decided again when its time comes."""
        begun = self.begun(now)
        later = begun if self._made_later(self.store.step(begun), now) else begun + self.length
        reason = f"the clock was set back to {written(now)}"
        log.warning("%s: steps from %s on are decided again", reason, written(later))
        self.store.withdraw(later, now, reason)
        self.last = self.store.last_step()
        self._state = self._last_state()
        self._controller = self._restored()

    def _restored(self) -> Controller:
        """The controller where the last stored state left it."""
        known = self.scenario
        if self.profile:
            known = self.profile.steps(self.begun(self.clock.now()), self.n_ahead)
        state = json.loads(self._state) if self._state else None
        history = None
        if self.options.forecaster in FORECASTERS:
            history = learned(self.store, self.scenario, self.begun(self.clock.now()))
        return Controller.of(known, self.options, state=state, history=history)

    def _last_state(self) -> str:
        """The last state that is whole; empty where nothing was decided yet."""
        states = self.store.states()
        for text in states:
            try:
                json.loads(text)
                return text
            except ValueError:
                log.error("the last state of the controller is cut: the one before it is taken")
        if states:
            cure = "Put a copy of the database in its place, or remove it."
            raise InputError.of(self.store.place, "has no whole state of the controller", cure)
        return ""

    def _feed(self, time: pd.Timestamp) -> None:
        """Let the controller know the steps up to the horizon's end and one more, and messages."""
        if self.profile:
            end = self._controller.scenario.grid.end
            missing = round((time - end) / self.length) + self.n_ahead
            if missing > 0:
                self._controller.extend(self.profile.steps(end, missing))
        self._controller.warn(*self.warnings(time), replacing=True)
        self._controller.report(*self.faults(self._moment(time)), replacing=True)

    def faults(self, now: pd.Timestamp) -> tuple[LineFault, ...]:
        """Faults of lines and buses that are known and not over."""
        return faults_at(self.store.events().values(), self.scenario, now)

    def warnings(self, time: pd.Timestamp) -> list[OutageWarning]:
        """Messages of outages: those of events, and the scenario's own where it is rehearsed."""
        own = self.scenario.warnings if self.rehearsal else ()
        return [*own, *warnings(self.store.events(), time, self.length)]

    def _believed(self, known: StepInputs) -> list[float]:
        """Probability of an outage in the present step and those behind it."""
        if self.options.outages == KNOWN:
            return [float(limit_kw <= 0.0) for limit_kw in known.grid.limits_kw]
        found = self._controller.out_probability(known.measurement.time)
        return [round(float(each), 6) for each in found]

    @property
    def n_ahead(self) -> int:
        """Steps that are known ahead."""
        o = self.options
        hours = {"mpc": o.horizon_h, "reserve": o.reserve.notice_h, "idle": 0.0}
        horizon_h = hours.get(o.controller, FULL_HORIZON_H)
        if o.outages != KNOWN:
            horizon_h = max(horizon_h, LOOKAHEAD_H)
        return self.scenario.grid.steps_in_horizon(horizon_h) + 1

    @property
    def outcomes(self) -> dict[str, int]:
        """How many steps there were of each outcome."""
        return {
            **dict.fromkeys((*DECIDED, *BY_HAND, FAILED, "off", "missed"), 0),
            **self.store.outcomes(),
        }
