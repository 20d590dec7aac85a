"""Plays a scenario against a service over its own HTTP interface, the plant being the world.

Demonstration, tutorial and soak test in one: what devices measure is posted, what is announced is
put, and the set-points that come back are obeyed until they end. The clock of the service is set
step by step, so that a week takes as long as its steps take to decide.
"""

from __future__ import annotations

import random
import time as machine
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, spans_of
from vppres.day.outages import BELIEF, LOOKAHEAD_H
from vppres.outlook.outlook import Announced, length_of, said_so_far
from vppres.scenario.outage_warnings import OutageWarning
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written
from vppres.service.events.announced import SAID_OF_END
from vppres.service.http.client import Client
from vppres.service.http.started import started
from vppres.service.operation.site import Service
from vppres.service.payloads import read_moment
from vppres.service.plans.world import Series, World, critical_off, energy_allowed

Progress = Callable[[int, int], None]


class Announcement(NamedTuple):
    """When, of which event, and what; nothing takes it back."""

    time: pd.Timestamp
    event: str
    body: dict[str, Any]


MOST_ONSETS = 1_000
"""Steps among which an onset is looked for."""

HOUR = pd.Timedelta(hours=1)

LOOKS = 8
"""How often the size of its own service is looked at."""

LATEST_STEPS = 3
"""By how many steps a delayed reading is late at most."""


@dataclass(frozen=True)
class TelemetryFaults:
    """Faults of readings on their way."""

    #: Share that never arrives, and that arrives one to three steps late.
    lost: float = 0.0
    delayed: float = 0.0
    #: By how much clocks are off: half of the sources are ahead, the others behind.
    skew_s: float = 0.0
    repeats: bool = False  #: whether everything is sent twice
    seed: int = 0  #: of the draws


class Way:
    """The way of readings from the devices to the service."""

    def __init__(self, faults: TelemetryFaults) -> None:
        self.faults = faults
        self._random = random.Random(faults.seed)
        self._late: dict[int, list[Series]] = {}
        self._sources: list[str] = []

    def arriving(self, t: int, sent: list[Series]) -> list[Series]:
        """Readings that arrive before a step, of those that are sent at its beginning."""
        now = self._late.pop(t, [])
        for one in sent:
            reading = self._by_its_clock(one)
            drawn = self._random.random()
            if drawn < self.faults.lost:
                continue
            if drawn < self.faults.lost + self.faults.delayed:
                late = t + self._random.randint(1, LATEST_STEPS)
                self._late.setdefault(late, []).append(reading)
            else:
                now.append(reading)
        return now * 2 if self.faults.repeats else now

    def _by_its_clock(self, reading: Series) -> Series:
        """A reading with the time that its source believes."""
        if not self.faults.skew_s:
            return reading
        if reading["source"] not in self._sources:
            self._sources.append(reading["source"])
        sign = 1 if self._sources.index(reading["source"]) % 2 == 0 else -1
        off = pd.Timedelta(seconds=sign * self.faults.skew_s)
        return {**reading, "start": written(read_moment(reading["start"]) + off)}


@dataclass(frozen=True)
class Play:
    """How a scenario is played."""

    speed: float = 0.0  #: simulated over real time; 0 is as fast as steps are decided
    notice_h: float = 24.0  #: how long before it begins an outage is announced, in h
    #: Whether outages are announced at all: in a rehearsal the service knows them.
    announced: bool = True
    faults: TelemetryFaults = field(default_factory=TelemetryFaults)  #: what happens to readings
    #: Whether a scenario's own warnings are announced, as they are issued, instead of what comes.
    beliefs: bool = False


@dataclass
class Tally:
    """Counts of the simulation so far."""

    #: Steps by what became of them; ``missed`` where the machine was too slow for the speed.
    statuses: Counter[str] = field(default_factory=Counter)
    answers_s: list[float] = field(default_factory=list)  #: how long each step's answer took, and
    overheads_s: list[float] = field(default_factory=list)  #: how much of it no solver took
    #: Words of estimates in plans, and readings that the service did not take.
    estimated: int = 0
    refused: int = 0
    #: Customers of the first tier times steps that were off, and those of them that the step's
    #: energy allowed.
    off: int = 0
    off_needlessly: int = 0
    gate: int = 0  #: set-points that the service held back

    def heard(self, plan: dict[str, Any], seconds: float) -> None:
        """An answer to a step."""
        self.statuses[plan["status"]] += 1
        self.answers_s.append(seconds)
        solver_s = (plan["solve"] or {}).get("seconds") or 0.0
        self.overheads_s.append(seconds - solver_s)
        self.estimated += len(plan["estimated"])
        if plan["solve"]:
            self.gate += sum(one["reason"].startswith("default: ") for one in plan["setpoints"])

    def summary(self) -> dict[str, Any]:
        """In numbers."""
        found: dict[str, Any] = {"steps": self.statuses}
        for name, values in (("answer_s", self.answers_s), ("overhead_s", self.overheads_s)):
            if values:
                p50, p95 = np.percentile(values, [50, 95])
                found[name] = {"median": round(float(p50), 4), "p95": round(float(p95), 4)}
        return {
            **found,
            "estimates": self.estimated,
            "readings_refused": self.refused,
            "set_points_held_back": self.gate,
            "critical_off": self.off,
            "critical_off_though_energy_allowed": self.off_needlessly,
            "slowest_answer_s": round(max(self.answers_s, default=0.0), 3),
        }


class Player:
    """Plays a scenario against a service."""

    def __init__(self, world: World, client: Client, play: Play) -> None:
        self.world = world
        self.client = client
        self.how = play
        self.tally = Tally()
        self._way = Way(play.faults)
        self._told: list[dict[str, Any]] = []
        scenario = world.scenario
        self._announcements: list[Announcement] = [
            *(
                warned(scenario)
                if play.beliefs and scenario.warnings
                else announcements(scenario, play.notice_h)
            ),
            *reports(scenario, play.notice_h),
        ]

    def play(self, progress: Progress | None = None) -> Tally:
        """From the scenario's first step to its last."""
        scenario = self.world.scenario
        begin = machine.monotonic()
        for t in range(scenario.grid.n_steps):
            if self._present(begin) > t:
                self.tally.statuses["missed"] += 1
            else:
                if self.how.speed:
                    machine.sleep(max(begin + self._real_s(t) - machine.monotonic(), 0.0))
                self._step(t)
            record = self.world.obey(t, self._told)
            off = int(critical_off(scenario, record).sum())
            self.tally.off += off
            self.tally.off_needlessly += off if energy_allowed(scenario, record) else 0
            if progress:
                progress(t + 1, scenario.grid.n_steps)
        return self.tally

    def _step(self, t: int) -> None:
        """Send readings and events of a step, and ask for its set-points."""
        now = self.world.scenario.grid.times[t]
        self.client.wanted("PUT", "/v1/clock", {"now": written(now)})
        if self.how.announced:
            due = [one for one in self._announcements if one.time <= now]
            self._announcements = [one for one in self._announcements if one.time > now]
            for _, name, body in due:
                if body:
                    self.client.wanted("PUT", f"/v1/events/{name}", body)
                else:
                    self.client.wanted("DELETE", f"/v1/events/{name}")
        arriving = self._way.arriving(t, self.world.readings(t))
        if arriving:
            answer = self.client.wanted("POST", "/v1/telemetry", {"series": arriving})
            self.tally.refused += len(answer.body["refused"])
        answer = self.client.wanted("POST", "/v1/steps")
        self.tally.heard(answer.body, answer.seconds)
        self._told = self.client.wanted("GET", "/v1/setpoints").body["setpoints"]

    def _real_s(self, t: int) -> float:
        """When a step begins, in real time since the beginning."""
        return t * self.world.scenario.grid.dt_h * 3600.0 / self.how.speed

    def _present(self, begin: float) -> int:
        """The step that the clock is in; the first one where steps wait for us."""
        if not self.how.speed:
            return 0
        return int((machine.monotonic() - begin) / self._real_s(1))


@dataclass(frozen=True)
class Place:
    """Service that the simulation runs against: a running one, else one of its own.

    Its own one has a free port and a folder that is dropped in the end, if none are given.
    """

    url: str | None = None
    token: str | None = None
    port: int | None = None
    state: Path | None = None


def simulate(
    service: Service,
    scenario: Scenario,
    play: Play,
    place: Place,
    told: Callable[[str], None] = lambda _: None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Play a scenario against a service, and say in numbers what happened.

    The service is one of its own where the place has no address.

    Returns
    -------
    dict
        Figures that JSON can hold.
    """
    world = World(scenario, service.options)
    play = replace(play, beliefs=service.options.on(service.scenario).outages == BELIEF)
    if place.url is not None:
        with closing(Client(place.url, place.token)) as client:
            return Player(world, client, play).play(progress).summary()
    with ExitStack() as stack:
        folder = place.state or Path(stack.enter_context(TemporaryDirectory(prefix="vppres-")))
        own = stack.enter_context(started(service, folder, place.port))
        client = stack.enter_context(closing(Client(own.url)))
        told(f"Watch it at {own.url}")
        player = Player(world, client, play)
        sizes = []

        def look(done: int, total: int) -> None:
            if done % max(total // LOOKS, 1) == 0:
                sizes.append({"step": done, **own.size()})
            if progress:
                progress(done, total)

        return {**player.play(look).summary(), "size": sizes}


def warned(scenario: Scenario) -> Iterator[Announcement]:
    """When which belief is announced, or taken back, of the warnings of a scenario."""
    grid = scenario.grid
    step = grid.step
    so_far: dict[str, list[OutageWarning]] = {}
    standing = set()
    for one in sorted(scenario.warnings, key=lambda one: one.issued_at):
        messages = so_far.setdefault(one.outage, [])
        messages.append(one)
        name = f"warned-{list(so_far).index(one.outage) + 1}"
        # It may have been due before it was said.
        first = grid.begun(one.issued_at - LOOKAHEAD_H * HOUR)
        if crew := _of_crew(one):
            yield Announcement(one.issued_at, f"{name}-crew", crew)
        said = said_so_far(messages, pd.date_range(first, periods=MOST_ONSETS, freq=step))
        if said and said[1].any():
            standing.add(name)
            yield Announcement(one.issued_at, name, _belief(*said, first, step))
        elif name in standing:
            standing.remove(name)
            yield Announcement(one.issued_at, name, {})


def _belief(
    known: Announced, onset: Floats, first: pd.Timestamp, step: pd.Timedelta
) -> dict[str, Any]:
    """A warning as an event of the service."""
    message = known.message
    begin, end = np.flatnonzero(onset)[[0, -1]].tolist()
    resolution = f"PT{round(step.total_seconds())}S"
    body: dict[str, Any] = {
        "type": "outage_belief",
        "source": "simulation",
        "issued_at": written(message.issued_at),
        "probability": message.chance,
        "onset": {
            "start": written(first + begin * step),
            "resolution": resolution,
            "probabilities": (onset[begin : end + 1] / onset.sum()).tolist(),
        },
    }
    lengths = length_of(message, step / HOUR, round(LOOKAHEAD_H * HOUR / step))
    if lengths is None:
        return body
    if known.estimate and np.count_nonzero(lengths) == 1:
        alone = {"family": "lognormal", "median_h": message.duration_p50_h}
        return {**body, "duration": alone}
    likely = np.flatnonzero(lengths)
    hours = ((likely + 1) * (step / HOUR)).tolist()
    shares = (lengths[likely] / lengths.sum()).tolist()
    return {**body, "duration": {"family": "discrete", "hours": hours, "probabilities": shares}}


def _of_crew(message: OutageWarning) -> dict[str, Any]:
    """End of the outage in a warning, as an event of the service; empty if it names none."""
    said = {key: getattr(message, field) for key, field in SAID_OF_END.items()}
    times = {key: written(time) for key, time in said.items() if time}
    return {"type": "restoration", "source": "simulation", **times} if times else {}


def announcements(scenario: Scenario, notice_h: float) -> Iterator[Announcement]:
    """When which event is announced, for each outage of a scenario."""
    times = scenario.grid.times
    step = scenario.grid.step
    for number, (start, end) in enumerate(spans_of(scenario.outage), start=1):
        body = {
            "type": "outage",
            "source": "simulation",
            "start": written(times[start]),
            "end": written(times[end - 1] + step),
        }
        told = times[start] - pd.Timedelta(hours=notice_h)
        yield Announcement(told, f"outage-{number}", body)


def reports(scenario: Scenario, notice_h: float) -> Iterator[Announcement]:
    """When which fault of a line or bus is reported: as it begins, or before if it is known."""
    for number, fault in enumerate(scenario.faults, start=1):
        place = {"bus": fault.bus} if fault.line is None else {"line": fault.line}
        body = {
            "type": "fault",
            "source": "simulation",
            **{name: str(bus) for name, bus in place.items()},
            "start": written(fault.start),
            "end": written(fault.end),
        }
        begun = scenario.grid.begun(fault.start)
        told = begun - pd.Timedelta(hours=notice_h) if fault.known else begun
        yield Announcement(told, f"fault-{number}", body)
