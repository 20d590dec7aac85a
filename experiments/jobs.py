"""A job is one simulated day: which day, and how it is run."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

import data.uk_heatwave_2022.build as builder
from benchmarks.frame.store import digest_of_files, package_digest
from experiments.weighted import WeightedChoices
from vppres.day.metrics import versions
from vppres.day.options import RunOptions
from vppres.io.digest import scenario_digest
from vppres.scenario.scenario import Scenario

# What makes the short results of whole days.
RESULT_FORMAT = (Path(__file__).with_name("shorten.py"),)
# What solves the days that are solved by one weighted objective.
WEIGHTED = tuple(
    Path(__file__).with_name(name) for name in ("weighted.py", "weighted_model.py", "units.py")
)


@dataclass(frozen=True)
class Day:
    """Arguments of the builder of the paper's day; the defaults are the packaged scenario."""

    seed: int = builder.SEED  #: seed of the per-bus data that the paper does not publish
    #: Share of the load that the critical customers have.
    critical_share: float = builder.CRITICAL_SHARE
    price: str = "B"  #: rebuild of the price
    outage_steps: int = 6  #: hours without grid from 12:00 on
    #: Which thermal capacity goes with which thermal resistance.
    zone_pairing: tuple[int, ...] = builder.ZONE_PAIRING


@dataclass(frozen=True)
class Job:
    """A day and the options of its run."""

    day: Day = field(default_factory=Day)  #: which day
    options: RunOptions = field(default_factory=RunOptions)  #: how it is run
    #: Choices of one weighted solve of each window; as the options say if not given.
    weighted: WeightedChoices | None = None

    def digest(self) -> str:
        """SHA-256 of all that the result depends on: day, options, sources and libraries."""
        inputs = {
            "day": _digest_of_day(self.day),
            "options": self.options.as_record(),
            "weighted": None if self.weighted is None else asdict(self.weighted),
            "sources": sources_digest() if self.weighted is None else weighted_sources_digest(),
            "versions": versions(),
        }
        return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()

    def text(self) -> str:
        """What the job is, in a line."""
        changed = {**_changed(self.day, Day()), **_changed(self.options, RunOptions())}
        if self.weighted is not None:
            changed["weighted"] = self.weighted
        return ", ".join(f"{name} = {value}" for name, value in changed.items()) or "defaults"


@cache
def scenario(day: Day) -> Scenario:
    """The day's data."""
    return builder.build(
        seed=day.seed,
        critical_share=day.critical_share,
        price=day.price,
        outage_steps=day.outage_steps,
        zone_pairing=day.zone_pairing,
    )


@cache
def sources_digest() -> str:
    """SHA-256 of the source files that compute a result and shorten it."""
    return package_digest() + digest_of_files(RESULT_FORMAT)


@cache
def weighted_sources_digest() -> str:
    """The same for days that are solved by one weighted objective."""
    return sources_digest() + digest_of_files(WEIGHTED)


@cache
def _digest_of_day(day: Day) -> str:
    return scenario_digest(scenario(day))


def _changed(value: Day | RunOptions, default: Day | RunOptions) -> dict[str, object]:
    """Fields that differ from the defaults."""
    usual = asdict(default)
    return {name: item for name, item in asdict(value).items() if item != usual[name]}
