"""A site under operation: what its scenario, clock, store and last plan say of a moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import pandas as pd

from vppres.core.arrays import Flags
from vppres.day.options import RunOptions
from vppres.day.outages import KNOWN, LOOKAHEAD_H
from vppres.kinds.kind import EARLY_SHARE
from vppres.live.profile import ClockProfile
from vppres.scenario.configuration import Branches, in_configuration, out_of_branches
from vppres.scenario.faults import LineFault
from vppres.scenario.outage_warnings import OutageWarning
from vppres.scenario.scenario import Scenario
from vppres.service.alarms.conditions import BY_HAND
from vppres.service.as_told import closed_by
from vppres.service.clock import SetClock, TimeSource
from vppres.service.events.announced import warnings
from vppres.service.events.faults import faults_at
from vppres.service.storage.records import DECIDED
from vppres.service.storage.store import Store
from vppres.service.telemetry.changes import Changes
from vppres.service.telemetry.knowledge import check_names, states_of

DEADLINE_SHARE = 0.25
"""Largest share of a step that a window may be searched for."""

FAILED = "failed"
"""The status of a step that only the rule could decide."""

MODE = "mode"
"""The setting of what an operator asked for."""

KEEP_DAYS = 400.0
"""More than a year, so that the same day of the last one is there."""

FULL_HORIZON_H = 24.0


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

    def __post_init__(self) -> None:
        check_names(self.scenario)

    @property
    def profile(self) -> ClockProfile | None:
        """Daily profile of the site; None in a rehearsal."""
        return None if self.rehearsal else ClockProfile.of(self.scenario)


@dataclass(frozen=True)
class Span:
    """A step that is planned, or its rest from a moment on."""

    begin: pd.Timestamp  #: of the step
    since: pd.Timestamp  #: from when on the plan holds
    why: str = ""  #: why the plan before does not go on; empty for a whole step
    before: Mapping[str, Any] = field(default_factory=dict)  #: that plan

    @classmethod
    def whole(cls, begin: pd.Timestamp) -> Span:
        """A step from its beginning on."""
        return cls(begin, begin)


class OperatedSite:
    """A site with its clock, store and last plan, and what they say of a moment.

    Attributes
    ----------
    last : dict of str
        The last plan; empty before the first.
    changes : Changes
        Reasons to decide the present step anew.
    """

    def __init__(
        self, service: Service, store: Store, clock: TimeSource, profile: ClockProfile | None
    ) -> None:
        self.store = store
        self.clock = clock
        self.rehearsal = service.rehearsal
        self.played = service.rehearsal or service.paced
        self.keeps = pd.Timedelta(days=service.keep_days)
        self.scenario = service.scenario
        self.branches = Branches.of(self.scenario)
        self.length = self.scenario.grid.step
        self.profile = profile
        most_s = DEADLINE_SHARE * self.scenario.grid.dt_h * 3600.0
        options = service.options.on(service.scenario)
        limits = replace(options.limits, time_s=min(options.limits.time_s, most_s))
        self.options = replace(options, limits=limits)
        self.last: dict[str, Any] = store.last_step()
        self.changes = Changes()

    def begun(self, time: pd.Timestamp) -> pd.Timestamp:
        """Beginning of the step that covers a time."""
        return self.scenario.grid.begun(time).tz_convert("UTC")

    def step_of(self, time: pd.Timestamp | None) -> pd.Timestamp:
        """Beginning of the step that is asked for, the present one if none is."""
        return time.tz_convert("UTC") if time else self.begun(self.clock.now())

    @property
    def until(self) -> pd.Timestamp:
        """Time up to which readings count as of now: clocks may be a little ahead."""
        return self.clock.now() + EARLY_SHARE * self.length

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

    @property
    def outcomes(self) -> dict[str, int]:
        """How many steps there were of each outcome."""
        return {
            **dict.fromkeys((*DECIDED, *BY_HAND, FAILED, "off", "missed"), 0),
            **self.store.outcomes(),
        }

    @property
    def n_ahead(self) -> int:
        """Steps that are known ahead."""
        o = self.options
        hours = {"mpc": o.horizon_h, "reserve": o.reserve.notice_h, "idle": 0.0}
        horizon_h = hours.get(o.controller, FULL_HORIZON_H)
        if o.outages != KNOWN:
            horizon_h = max(horizon_h, LOOKAHEAD_H)
        return self.scenario.grid.steps_in_horizon(horizon_h) + 1

    def is_of_later(self, plan: Mapping[str, Any]) -> bool:
        """Whether a plan was made later than now, by a clock that has been set back since."""
        if not plan or isinstance(self.clock, SetClock):  # that one never goes back
            return False
        return bool(pd.Timestamp(plan["generated_at"]) > self.until)

    def faults(self, now: pd.Timestamp) -> tuple[LineFault, ...]:
        """Faults of lines and buses that are known and not over."""
        return faults_at(self.store.events().values(), self.scenario, now)

    def warnings(self, time: pd.Timestamp) -> list[OutageWarning]:
        """Messages of outages: those of events, and the scenario's own where it is rehearsed."""
        own = self.scenario.warnings if self.rehearsal else ()
        return [*own, *warnings(self.store.events(), time, self.length)]

    def profile_of(self, time: pd.Timestamp) -> Scenario:
        """Profile of a step in the scenario."""
        if self.profile:
            return self.profile.steps(time, 1)
        row = round((time - self.scenario.grid.start) / self.length)
        return self.scenario.between(row, row + 1)

    def closed(self, now: pd.Timestamp) -> Flags:
        """Lines and ties that are closed: as they were read, or else as in the last plan."""
        before = closed_by(self.last, self.branches)
        if not self.scenario.follows_switches:
            return before
        step = replace(self.profile_of(self.begun(now)), faults=self.faults(now))
        out = out_of_branches(step.out_of_service(range(1)), self.branches.ends)[0]
        read = states_of(self.scenario, self.store, now)
        return self.branches.with_states(read, before, out)[0]

    def in_configuration(self, step: Scenario, now: pd.Timestamp) -> Scenario:
        """A step of the feeder as its switches are."""
        return in_configuration(step, self.branches, self.closed(now)).scenario
