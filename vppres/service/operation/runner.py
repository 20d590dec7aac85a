"""The steps of a site, one after another: from the clock to the stored plan."""

from __future__ import annotations

import logging
import time as machine
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import pandas as pd

from vppres.core.errors import InputError, StorageError
from vppres.day.trajectory import SWITCHES_OPEN
from vppres.live.past import REMEMBERED_DAYS
from vppres.live.profile import ClockProfile
from vppres.service.clock import SetClock, TimeSource, written
from vppres.service.events.faults import FAULTS, told
from vppres.service.operation.deciding import Deciding
from vppres.service.operation.hearing import Hearing
from vppres.service.operation.site import OperatedSite, Service, Span
from vppres.service.operation.watch import Watch
from vppres.service.plans.document import defaults_of, made_anew
from vppres.service.storage.records import Asked
from vppres.service.storage.store import Store
from vppres.service.telemetry.knowledge import StepInputs

MOST_JOBS = 100
"""Steps that were asked for and are remembered, beside those that are stored."""

LONGEST_GAP = pd.Timedelta(days=7)
"""Since the last step: over a longer time it was the clock that was set, and no step is missed."""

log = logging.getLogger(__name__)


class Runner(OperatedSite):
    """Decides the steps of a site, one after another, and remembers them.

    Attributes
    ----------
    hearing : Hearing
        Readings that come between two steps.
    deciding : Deciding
        The controller, and plans by it.
    watch : Watch
        How the site stands now, and its alarms.
    """

    def __init__(
        self, service: Service, store: Store, clock: TimeSource, profile: ClockProfile | None
    ) -> None:
        super().__init__(service, store, clock, profile)
        self.hearing = Hearing(self)
        self.deciding = Deciding(self)
        self.watch = Watch(self)
        self.on_step: Callable[[float], None] = lambda _: None
        self.on_plan: Callable[[], None] = lambda: None
        self._jobs: OrderedDict[str, Future[dict[str, Any]]] = OrderedDict()
        if isinstance(clock, SetClock) and self.last:
            clock.set(max(clock.now(), pd.Timestamp(self.last["generated_at"])))
        if self.is_of_later(self.last):
            self._come_back()
        else:
            self.deciding.restore()
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
        if not self.deciding.has_decided:  # it begins here
            self.deciding.resume()
        self.hearing.note_turns()
        if self.changes.reasons:  # a plan of the same moment could not be told from the one before
            self.changes.new.set()
        self.watch.check_alarms()

    def _step(self, time: pd.Timestamp | None, actor: str | None) -> dict[str, Any]:
        """Decide a step, in the thread of steps."""
        now = self.clock.now()
        asked = Asked(actor, now) if actor else None
        time = time.tz_convert("UTC") if time else self.begun(now)
        if self.is_of_later(self.last):
            self._come_back()
        stored = self.store.step(time)
        if stored:
            return stored
        self._check(time, now)
        if self.rehearsal and isinstance(self.clock, SetClock):
            self.clock.set(time)
        self._bridge_gap(time)
        return self._planned(Span.whole(time), asked)

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
        return self._planned(Span(time, now, why, before))

    def _planned(self, span: Span, asked: Asked | None = None) -> dict[str, Any]:
        """A plan as the mode has it, kept."""
        begin = machine.monotonic()
        noted = self.changes.noted
        self.hearing.begin_plan()
        plan, known = self.deciding.planned(span, self.mode)
        plan = self._kept(span, plan, asked, known)
        self.on_step(machine.monotonic() - begin)
        self._forget(span.begin)
        self.last = plan
        self.changes.known(noted)
        self.hearing.end_plan()
        self.watch.check_alarms()
        return plan

    def _kept(
        self,
        span: Span,
        plan: dict[str, Any],
        asked: Asked | None = None,
        known: StepInputs | None = None,
    ) -> dict[str, Any]:
        """A plan as it is stored: with its time, and for the rest of the step if decided anew.

        Where the controller decided on what is ``known`` its state is stored too.
        """
        plan = {**plan, "generated_at": written(self.clock.now())}
        if span.why:
            plan = made_anew(plan, span.since, span.why, span.before)
        if faults := self.faults(span.since):
            plan[FAULTS] = told(faults, self.scenario.network, self.length, span.begin)
        if SWITCHES_OPEN not in plan and self.scenario.follows_switches:
            plan[SWITCHES_OPEN] = [*self.branches.open_names(self.closed(span.since))]
        if not known:
            self.store.write_step(span.begin, plan, asked=asked)
            return plan
        after = self.deciding.after()
        try:
            self.store.write_step(span.begin, plan, after, asked)
        except StorageError:
            self.deciding.resume()  # as if it had not decided
            raise
        self.deciding.keep(plan, known, after)
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

    def _forget(self, time: pd.Timestamp) -> None:
        """Once a day drop what is too old."""
        begun = pd.Timestamp(self.last.get("start", time))
        if begun.normalize() != time.normalize() and time - begun <= LONGEST_GAP:
            with suppress(StorageError):  # the step is kept; tomorrow is another day
                self.store.forget(time - self.keeps, time - pd.Timedelta(days=REMEMBERED_DAYS))

    def _bridge_gap(self, time: pd.Timestamp) -> None:
        """Write down the steps since the last one as missed; they are not decided any more."""
        if not self.last:
            return
        missed = pd.Timestamp(self.last["start"]) + self.length
        if time - missed > LONGEST_GAP:
            log.warning("the clock went from %s to %s: no step counts as missed", missed, time)
            self.deciding.resume()
            return
        while missed < time:
            span = Span.whole(missed)
            left = self.deciding.left(span, None)
            reason = "the service did not run"
            plan = defaults_of(missed, self.scenario, "missed", reason, left)
            del plan["grid"]  # not looked at
            self._kept(span, plan)
            missed += self.length

    def _come_back(self) -> None:
        """Take back what was decided ahead of time: it is decided again when its time comes."""
        now = self.clock.now()
        begun = self.begun(now)
        later = begun if self.is_of_later(self.store.step(begun)) else begun + self.length
        reason = f"the clock was set back to {written(now)}"
        log.warning("%s: steps from %s on are decided again", reason, written(later))
        self.store.withdraw(later, now, reason)
        self.last = self.store.last_step()
        self.deciding.restore()
