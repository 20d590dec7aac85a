"""Random days of a live service: bad telemetry, devices that leave and return, events at any time.

``python -m experiments.studies.random_live_days --days 100`` plays days on random feeders in steps
of a quarter of an hour, while the service decides by the hour and anew whenever something changes.
Readings are lost, late, contradictory, impossible or no numbers, brokers repeat what they retained;
devices reject, leave and return; outages begin and end at any second, announced or not, also two
within a step. Every plan is judged by what was readable when it was made:

- nobody of the first tier is off who need not be, by a solution that puts the first tier before
  everything else (``experiments/studies/shedding.py``);
- while somebody of the first tier is off, no state of charge is taken to be below a reading of this
  quarter less what the battery can have given since, unless the plan says so;
- no battery is to give more than such a reading leaves it;
- what the plan supplies is not shed.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import typer
from paho.mqtt.client import MQTTMessage

from benchmarks.frame.pages import markdown_table
from benchmarks.frame.seeds import (
    PATIENT,
    STUDIES,
    Days,
    FirstSeed,
    Jobs,
    Results,
    Span,
    Study,
    report,
)
from experiments.report import machine
from experiments.studies.random_days import small_day
from experiments.studies.shedding import Judge, seen_by
from experiments.studies.within import Within
from vppres.core.arrays import Floats
from vppres.day.options import RunOptions
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.service.access import Access
from vppres.service.clock import SetClock, written
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.mqtt import Bridge, Topics
from vppres.service.operation.site import Service
from vppres.service.plans.world import Series, World, critical_off
from vppres.studies.side_by_side import Where

OPTIONS = RunOptions(horizon_h=4.0, isolate=False, priority="strict", limits=PATIENT)
START = pd.Timestamp("2026-11-21T00:00Z")
QUARTERS = 96
DAYS_IN_A_ROW = 5
"""Of a feeder: a service compiles its windows once for all of them."""

QUARTER = pd.Timedelta(minutes=15)
LOST, LATE, IMPOSSIBLE, CONTRADICTED, REJECTED = 0.2, 0.1, 0.02, 0.05, 0.02
"""Shares of readings, the last one of set-points of an hour."""

LEAVES, RETURNS, RETAINED, NO_NUMBER, TWICE = 0.01, 0.3, 0.1, 0.03, 0.3
"""Chances in a quarter that a device leaves and that it is back, that a broker repeats what it
retained, that a reading is no number, and that a change of the grid is followed by another."""

WORDS = ("unavailable", "62 %", "NaN", True, [1.0])
"""What is sent in place of a number."""

SOC_APART = 0.02
"""Less is what an hour's rounding of measured power comes to."""

IMPOSSIBLE_VALUES = {"soc": 1.7, "load_kw": -5.0, "pv_kw": 1e6}


@dataclass
class LiveDay:
    """What a day was like, and what is wrong with it."""

    seed: int  #: of its feeder
    day: int = 0  #: which one in a row
    #: Plans, and those of them that were made within a step.
    plans: int = 0
    anew: int = 0
    #: Readings that never arrived and that the service did not take; set-points that devices did
    #: not follow.
    lost: int = 0
    refused: int = 0
    rejected: int = 0
    #: Devices that left, messages that a broker repeated, and changes of the grid that were
    #: followed by another within the step.
    left: int = 0
    retained: int = 0
    twice: int = 0
    outage_h: float = 0.0  #: without grid
    critical_off: int = 0  #: plans times customers of the first tier that they leave off
    served_off: int = 0
    avoidable: list[str] = field(default_factory=list)  #: those that need not have been off
    #: Readings above what a plan took for true while somebody of the first tier was off.
    disbelieved: list[str] = field(default_factory=list)
    #: Set-points of batteries beyond what a reading left them.
    denied: list[str] = field(default_factory=list)
    #: Customers that a plan supplied and its island did not.
    shed: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)  #: plans that were made by rule
    #: CPU time of plans that were made anew, that of the solver included.
    anew_s: list[float] = field(default_factory=list)

    @property
    def wrong(self) -> list[str]:
        """All that must not be."""
        return [*self.avoidable, *self.disbelieved, *self.denied, *self.shed, *self.failed]


def site_of(seed: int) -> Scenario:
    """A random feeder with a day of hours, without outage."""
    day = small_day(np.random.default_rng([seed, 3900]), seed)

    def twice(values: Floats) -> Floats:
        return np.concatenate([values, values])

    return replace(
        day,
        grid=TimeGrid(pd.Timestamp("2025-07-01T00:00Z"), 60.0, 24),
        load_kw=twice(day.load_kw),
        pv_kw=twice(day.pv_kw),
        price_gbp_per_kwh=twice(day.price_gbp_per_kwh),
        temperature_c=twice(day.temperature_c),
        grid_limit_kw=np.full(24, np.inf),
    )


def truth_of(site: Scenario, rng: np.random.Generator) -> Scenario:
    """The days that come, in quarters of an hour."""

    def days(values: Any) -> Any:
        return np.concatenate([values] * DAYS_IN_A_ROW)

    def moved(values: Any) -> Any:
        hourly = days(values)
        return (hourly * rng.uniform(0.85, 1.15, hourly.shape)).repeat(4, axis=0)

    dark = np.zeros((DAYS_IN_A_ROW, QUARTERS), dtype=bool)
    for day in dark:
        for begin in rng.integers(4, QUARTERS - 8, rng.integers(1, 4)).tolist():
            day[begin : begin + int(rng.integers(3, 25))] = True
    return replace(
        site,
        grid=TimeGrid(START, 15.0, dark.size),
        load_kw=moved(site.load_kw),
        pv_kw=np.minimum(moved(site.pv_kw), site.pv.p_max_kw),
        price_gbp_per_kwh=days(site.price_gbp_per_kwh).repeat(4),
        temperature_c=days(site.temperature_c).repeat(4),
        grid_limit_kw=np.where(dark.ravel(), 0.0, np.inf),
    )


class Player:
    """Plays days against a service in this process.

    Parameters
    ----------
    seed : int
        Of the feeder.
    runner : Runner
        The service.
    come : Scenario
        What comes, in quarters of an hour.
    rng : Generator
        For all that goes wrong.
    """

    def __init__(self, seed: int, runner: Any, come: Scenario, rng: np.random.Generator) -> None:
        self.seed = seed
        self.runner = runner
        self.come = come
        self.world = World(come, OPTIONS)
        self.http = Within(make_app(runner, Access()))
        self.rng = rng
        self.judge = Judge(runner)
        self.found: LiveDay
        self._late: dict[int, list[Series]] = {}
        self._fresh: dict[str, float] = {}
        self._away: set[str] = set()
        self.bridge = Bridge(self.http, Topics())

    def play(self) -> list[LiveDay]:
        """The days."""
        with closing(self.http):
            return [self._day(day) for day in range(DAYS_IN_A_ROW)]

    def _day(self, day: int) -> LiveDay:
        found = self.found = LiveDay(self.seed, day)
        dark = self.come.grid_limit_kw <= 0.0
        quarters = range(day * QUARTERS, (day + 1) * QUARTERS)
        found.outage_h = float(dark[quarters].sum()) / 4.0
        for q in quarters:
            begin = START + q * QUARTER
            changed = q > 0 and dark[q] != dark[q - 1]
            self._announce(q, dark)
            self._clock(begin)
            if q % 4 == 0:
                self._hear(q, grid_too=not changed)
                self._look(self.http.wanted("POST", "/v1/steps").body)
                self._devices()
            # What happens within the quarter is seen at any second of its first half.
            now = begin + pd.Timedelta(seconds=int(self.rng.integers(1, 440)))
            self._clock(now)
            if q % 4:
                self._hear(q, grid_too=not changed)
            self._come_and_go(now)
            if changed:
                if self.rng.random() < TWICE:
                    found.twice += 1
                    for on in (not dark[q], dark[q]):
                        self._see_grid(on, now)
                        self._anew()
                        now += pd.Timedelta(seconds=int(self.rng.integers(1, 100)))
                        self._clock(now)
                self._see_grid(not dark[q], now)
            self._anew()
            told = self.http.wanted("GET", "/v1/setpoints").body["setpoints"]
            record = self.world.obey(q, told)
            found.served_off += int(critical_off(self.come, record).sum())
        return found

    def _clock(self, time: pd.Timestamp) -> None:
        self.runner.set_clock(time)

    def _announce(self, q: int, dark: Any) -> None:
        """Of every other outage an hour or more before, with an end that may be wrong."""
        ahead = q + int(self.rng.integers(4, 12))
        if ahead < len(dark) and dark[ahead] and not dark[ahead - 1] and self.rng.random() < 0.5:
            start = START + ahead * QUARTER + pd.Timedelta(seconds=int(self.rng.integers(0, 900)))
            end = start + pd.Timedelta(minutes=int(self.rng.integers(30, 400)))
            body = {"type": "outage", "start": written(start), "end": written(end)}
            self.http.wanted("PUT", f"/v1/events/e{ahead}", body)

    def _hear(self, q: int, grid_too: bool) -> None:
        """Readings of a quarter as they arrive, after all that happens to them on the way."""
        arriving = self._late.pop(q, [])
        sent: list[Series] = []
        for one in self.world.readings(q):
            quantity, drawn = str(one["quantity"]), self.rng.random()
            if quantity == "grid_on" and not grid_too:
                continue  # it changes within the quarter, and is told when it does
            if drawn < LOST:
                self.found.lost += 1
            elif drawn < LOST + LATE and quantity != "grid_on":
                late = q + int(self.rng.integers(1, 4))
                self._late.setdefault(late, []).append(one)
            elif drawn < LOST + LATE + IMPOSSIBLE and quantity in IMPOSSIBLE_VALUES:
                sent.append({**one, "values": [IMPOSSIBLE_VALUES[quantity]]})
            elif drawn > 1.0 - NO_NUMBER:
                sent.append({**one, "values": [WORDS[self.rng.integers(len(WORDS))]]})
            else:
                sent.append(one)
        if self.rng.random() < CONTRADICTED:
            other = dict(next(iter(self.world.readings(q))))
            sent.append(
                {**other, "source": "zz-other", "values": [float(self.rng.uniform(0.2, 0.8))]}
            )
        self._fresh = {
            str(one["asset"]): float(one["values"][0])
            for one in sent
            if one["quantity"] == "soc"
            and isinstance(one["values"][0], float)
            and one["values"][0] <= 1.0
            and one["source"] != "zz-other"
        }
        self._post([*arriving, *sent])

    def _come_and_go(self, now: pd.Timestamp) -> None:
        """Devices that leave and return, and what a broker says again when a client is back."""
        names = [*map(str, self.come.batteries.id), *map(str, self.come.customers.id)]
        for name in names:
            away = name in self._away
            if self.rng.random() >= (RETURNS if away else LEAVES):
                continue
            self._away ^= {name}
            self.found.left += not away
            self._post([self._said(name, "online", float(away), now)])
        if self.rng.random() < RETAINED:
            self.found.retained += 1
            for name in map(str, self.come.batteries.id):
                message = MQTTMessage(topic=f"vppres/telemetry/{name}/soc".encode())
                message.retain, message.payload = True, b"0.5"
                self.bridge.broker.on_message(None, None, message)
            self.bridge.turn()

    def _said(self, asset: str, quantity: str, value: float, now: pd.Timestamp) -> Series:
        return {
            "source": "gateway", "asset": asset, "quantity": quantity, "start": written(now),
            "resolution": "PT6H", "values": [value],
        }  # fmt: skip

    def _see_grid(self, on: bool, now: pd.Timestamp) -> None:
        """The grid's reading when it changes; sometimes a second source says otherwise first."""
        one = {
            "source": "substation", "asset": "grid", "quantity": "grid_on", "start": written(now),
            "resolution": "PT15M", "values": [float(on)],
        }  # fmt: skip
        self._post([one])
        if not on and self.rng.random() < CONTRADICTED:
            self._post([{**one, "source": "zz-other", "values": [1.0]}])

    def _post(self, series: Sequence[Series]) -> None:
        if series:
            answer = self.http.ask("POST", "/v1/telemetry", {"series": list(series)})
            self.found.refused += len(answer.body.get("refused", answer.body.get("problems", [])))

    def _devices(self) -> None:
        """Some do not do what they are told."""
        plan = self.runner.last
        points = [one for one in plan["setpoints"] if one["kind"] == "batteries"]
        for one in points:
            if self.rng.random() < REJECTED:
                self.found.rejected += 1
                self.http.wanted(
                    "POST", f"/v1/setpoints/{one['id']}/status", {"status": "rejected"}
                )

    def _anew(self) -> None:
        """The plan that the loop would make."""
        if not self.runner.changes.reasons:
            return
        begin = time.process_time()
        plan = self.runner.anew()
        if plan is not None:
            self.found.anew += 1
            self.found.anew_s.append(round(time.process_time() - begin, 4))
            self._look(plan)

    def _look(self, plan: Mapping[str, Any]) -> None:
        """Judge a plan by what was readable when it was made."""
        found, when = self.found, str(plan["valid_from"])
        found.plans += 1
        if plan["status"] == "failed":
            found.failed.append(f"{when}: {plan['reason']}")
            return
        found.shed += [f"{when}: {one['asset']} ({one['reason']})" for one in plan.get("shed", ())]
        c = self.come.customers
        first = {str(n) for n, tier in zip(c.id, c.tier, strict=True) if tier == self.come.tiers[0]}
        lost = {one["asset"] for one in plan["lost"]}
        off = [p["asset"] for p in plan["setpoints"] if p.get("served") is False]
        off = [name for name in off if name in first - lost]
        found.critical_off += len(off)
        if off:
            self._judge(plan, when)
        hours = (pd.Timestamp(plan["start"]) + 4 * QUARTER - pd.Timestamp(when)) / pd.Timedelta(
            "1h"
        )
        b = self.come.batteries
        for one in plan["setpoints"]:
            soc = self._fresh.get(one["asset"]) if one["kind"] == "batteries" else None
            if soc is None or any(f"soc {one['asset']} " in words for words in plan["estimated"]):
                continue
            i = [str(name) for name in b.id].index(one["asset"])
            given = max(-one["p_kw"], 0.0) * hours / float(b.eta_discharge[i] * b.energy_kwh[i])
            if given > soc - float(b.soc_min[i]) + SOC_APART:
                found.denied.append(f"{when}: {one['asset']} gives {given:.3f} of {soc:.3f}")

    def _judge(self, plan: Mapping[str, Any], when: str) -> None:
        before = len(self.judge.found)
        self.judge.look(plan)
        for shed in self.judge.found[before:]:
            if shed.avoidable:
                self.found.avoidable.append(f"{when}: {asdict(shed)}")
        known = seen_by(self.runner.deciding.controller)
        b = self.come.batteries
        since_h = (pd.Timestamp(when) - pd.Timestamp(when).floor(QUARTER)) / pd.Timedelta("1h")
        given = SOC_APART + since_h * b.p_max_kw / (b.eta_discharge * b.energy_kwh)
        for i, name in enumerate(map(str, b.id)):
            words = " ".join(plan["estimated"])
            if name not in self._fresh or f"soc {name} " in words or f"battery {name} " in words:
                continue
            read, taken = self._fresh[name], float(known.soc[i])
            if not known.online[i] or taken < read - given[i]:
                found = f"{when}: {name} {read:.3f} read, {taken:.3f} taken"
                self.found.disbelieved.append(found)


def run_one(seed: int) -> list[LiveDay]:
    """The days of a feeder."""
    rng = np.random.default_rng([seed, 3901])
    site = site_of(seed)
    come = truth_of(site, rng)
    service = Service(site, OPTIONS, paced=True)
    with TemporaryDirectory() as folder, opened(service, Path(folder), SetClock(START)) as runner:
        return Player(seed, runner, come, rng).play()


def write_report(feeders: Sequence[list[LiveDay]], wall_s: float, folder: Path) -> Path:
    """Write ``random_live_days.json``, ``.md`` and ``.html``; returns the Markdown file."""
    days = [day for feeder in feeders for day in feeder]
    anew_s = [each for day in days for each in day.anew_s]
    rows = [
        ("days", len(days)),
        ("plans", sum(day.plans for day in days)),
        ("of these made anew within a step", sum(day.anew for day in days)),
        ("hours without grid", sum(day.outage_h for day in days)),
        ("readings lost", sum(day.lost for day in days)),
        ("readings refused", sum(day.refused for day in days)),
        ("set-points rejected by devices", sum(day.rejected for day in days)),
        ("devices that left", sum(day.left for day in days)),
        ("messages that were retained", sum(day.retained for day in days)),
        ("grid changed twice in a step", sum(day.twice for day in days)),
        ("first tier off (customers of plans)", sum(day.critical_off for day in days)),
        ("first tier off, avoidably", sum(len(day.avoidable) for day in days)),
        ("readings not believed without a word", sum(len(day.disbelieved) for day in days)),
        ("energy ordered that a reading had denied", sum(len(day.denied) for day in days)),
        ("supplied by the plan and shed", sum(len(day.shed) for day in days)),
        ("plans by rule", sum(len(day.failed) for day in days)),
        ("CPU time of a plan made anew, median (s)", f"{np.median(anew_s or [0.0]):.3f}"),
        ("CPU time of a plan made anew, largest (s)", f"{max(anew_s, default=0.0):.3f}"),
    ]
    wrong = [f"- feeder {day.seed}, day {day.day}: {words}" for day in days for words in day.wrong]
    text = "\n\n".join(
        [
            markdown_table(("quantity", "value"), rows),
            f"{wall_s / 60:.1f} min; {machine()}.",
            *(["\n".join(wrong)] if wrong else []),
        ]
    )
    return report(folder / "random_live_days", "Random days of a live service", text, days, wall_s)


STUDY = Study(
    run_one, write_report, lambda feeder: [wrong for day in feeder for wrong in day.wrong]
)


def main(
    days: Days = 100, seed: FirstSeed = 0, jobs: Jobs = -1, results: Results = STUDIES
) -> None:
    """Play random days against a live service, and judge every plan."""
    feeders = -(-days // DAYS_IN_A_ROW)
    STUDY.play(Span(seed, feeders), Where(jobs), results)


if __name__ == "__main__":
    typer.run(main)
