"""Outage warnings against what came: of ten that say 70 %, seven are to be right."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

from vppres.core.arrays import Floats
from vppres.core.errors import InputError
from vppres.core.plain import json_safe
from vppres.io.find import is_scenario, load_scenario
from vppres.io.outage_log import read_outage_log, read_warning_file
from vppres.outlook.durations import Z90
from vppres.outlook.outlook import Announced, SeenOutage, announced_by, seen_outages
from vppres.outlook.presets import completed
from vppres.scenario.outage_warnings import OutageWarning
from vppres.scenario.scenario import Scenario
from vppres.studies.estimate_scores import EstimateScores

BINS = 5

HOUR_H = 1.0
"""Least error in h that an onset of a file may have."""


@dataclass(frozen=True)
class WarnedOutage:
    """A warning and the outage that came of it, which is over; None if none came."""

    warning: OutageWarning
    came: SeenOutage | None

    @property
    def length_h(self) -> float:
        """Length of the outage, NaN where none came or it lasts."""
        return self.came.hours if self.came else float("nan")


@dataclass(frozen=True, eq=False)
class WarningScores:
    """Warnings of many outages and what came of them."""

    #: One for each announced outage, with the last message before it began or could have begun.
    pairs: tuple[WarnedOutage, ...]
    unannounced: tuple[SeenOutage, ...]  #: outages that no message spoke of before they began
    restoration: EstimateScores  #: what was said while outages lasted
    #: Outages first announced when they had begun or could no longer begin; they score nothing.
    late: int = 0

    @classmethod
    def of(
        cls, warnings: Iterable[OutageWarning], outages: Sequence[SeenOutage], step_h: float
    ) -> WarningScores:
        """Scores of messages by all outages of the time, which are over.

        Messages of the same name of an outage speak of one; onsets may be off by ``step_h`` at
        least.
        """
        step = pd.Timedelta(hours=step_h)
        said = [completed(warning) for warning in warnings]
        named: dict[str, list[OutageWarning]] = {}
        for warning in sorted(said, key=lambda one: one.issued_at):
            named.setdefault(warning.outage, []).append(warning)
        left = sorted(outages, key=lambda one: one.start)
        pairs = []
        late = 0
        for messages in (one for group in named.values() for one in _of_one(group, left, step)):
            came = _came_of(messages, left, step)
            last = _last_before(messages, came)
            if last:
                pairs.append(WarnedOutage(last, came))
            elif not all(message.all_clear for message in messages):
                late += 1
            left = [one for one in left if one is not came]
        return cls(tuple(pairs), tuple(left), EstimateScores.of(said, outages), late)

    @classmethod
    def of_files(cls, warnings: str | Path, outages: str | Path) -> WarningScores:
        """Scores of a file like ``warnings.csv`` by a table of outages, ``start`` and ``end``."""
        messages = read_warning_file(warnings)
        came = [SeenOutage(start, end) for start, end in read_outage_log(outages)]
        return cls.of(messages, came, HOUR_H)

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> WarningScores | None:
        """Scores of a scenario's own messages by its outages; None where it has no message."""
        if not scenario.warnings:
            return None
        seen = seen_outages(scenario.grid.times, scenario.outage.tolist())
        return cls.of(scenario.warnings, seen, scenario.grid.dt_h)

    @property
    def n_came(self) -> int:
        """Announced outages that came."""
        return sum(bool(pair.came) for pair in self.pairs)

    @cached_property
    def reliability(self) -> pd.DataFrame:
        """How often an outage came of warnings of like probability; those without one do not count.

        Returns
        -------
        DataFrame
            One row for each fifth of 0 to 1 that has warnings: their number ``warnings``, the mean
            probability ``said``, the share ``came``, and ``low`` and ``high``, what a right
            forecast stays between in 95 of 100 cases (normal approximation).
        """
        said, came = self._said
        part = np.minimum((said * BINS).astype(int), BINS - 1)
        rows = []
        for value in np.unique(part):
            there = part == value
            mean = float(said[there].mean())
            band = 1.96 * float(np.sqrt((said[there] * (1.0 - said[there])).sum())) / there.sum()
            rows.append(
                {
                    "warnings": int(there.sum()),
                    "said": mean,
                    "came": float(came[there].mean()),
                    "low": max(mean - band, 0.0),
                    "high": min(mean + band, 1.0),
                }
            )
        return pd.DataFrame(rows, columns=["warnings", "said", "came", "low", "high"])

    @cached_property
    def duration_pit(self) -> Floats:
        """Ranks of outages' lengths in their forecasts, evenly spread if these were right.

        The logarithm of the length is normal on either side of the median, such that the quantiles
        are those of the warning. Outages of unknown length, and warnings without a spread, are left
        out.
        """
        found = []
        for pair in self.pairs:
            said = pair.warning
            low, middle, high = said.duration_p10_h, said.duration_p50_h, said.duration_p90_h
            if not (low and middle and high) or np.isnan(pair.length_h):
                continue
            end = high if pair.length_h > middle else low
            spread = abs(np.log(end / middle)) / Z90
            if spread > 0.0:
                found.append(float(ndtr(np.log(pair.length_h / middle) / spread)))
        return np.array(found)

    def summary(self) -> dict[str, Any]:
        """All figures as JSON can hold them."""
        return {
            "announced": len(self.pairs),
            "came": self.n_came,
            "unannounced": len(self.unannounced),
            "late": self.late,
            "brier": json_safe(self.brier),
            "brier_of_share": json_safe(self.brier_of_share),
            "reliability": self.reliability.to_dict("records"),
            "duration_pit": self.duration_pit.tolist(),
            "restoration": self.restoration.summary(),
        }

    @property
    def brier(self) -> float:
        """Mean squared distance of the probability from what came; NaN of no warning."""
        said, came = self._said
        return float(((said - came) ** 2).mean()) if len(said) else float("nan")

    @property
    def brier_of_share(self) -> float:
        """Brier score of the share that came, said each time: what warnings are to beat."""
        _, came = self._said
        return float(came.mean() * (1.0 - came.mean())) if len(came) else float("nan")

    @property
    def _said(self) -> tuple[Floats, Floats]:
        """Probabilities, and 1 where an outage came."""
        given = [pair for pair in self.pairs if pair.warning.probability is not None]
        said = np.array([pair.warning.probability for pair in given], dtype=float)
        return said, np.array([bool(pair.came) for pair in given], dtype=float)


def _of_one(
    messages: Sequence[OutageWarning], outages: Sequence[SeenOutage], step: pd.Timedelta
) -> Iterator[list[OutageWarning]]:
    """Messages of one name outage by outage: what comes after one is over speaks of the next."""
    group: list[OutageWarning] = []
    for message in messages:
        known = announced_before(group, message.issued_at)
        if known:
            came = _came_of(group, outages, step)
            over = came.end if came and came.end else known.latest
            if message.issued_at > over:
                yield group
                group = []
        group.append(message)
    if group:
        yield group


def _came_of(
    messages: Sequence[OutageWarning], outages: Sequence[SeenOutage], step: pd.Timedelta
) -> SeenOutage | None:
    """The first outage that messages explain as they stood when it began, None if there is none.

    An all-clear before it does not undo what was announced: it was wrong.
    """
    for outage in outages:
        known = announced_before(messages, outage.start)
        if known and known.explains(outage, step):
            return outage
    return None


def announced_before(messages: Sequence[OutageWarning], time: pd.Timestamp) -> Announced | None:
    """Outage that messages up to a time had announced, all-clears left out."""
    said = [one for one in messages if one.issued_at <= time and not one.all_clear]
    return announced_by(said) if said else None


def _last_before(
    messages: Sequence[OutageWarning], came: SeenOutage | None
) -> OutageWarning | None:
    """The last message before the outage began, or before it could no longer begin."""
    announced = announced_before(messages, messages[-1].issued_at)
    if not announced:
        return None  # an all-clear of nothing
    until = came.start if came else announced.latest
    before = [one for one in messages if one.issued_at <= until]
    if not before:
        return None
    last = announced_by([one for one in before if not one.all_clear])
    return last.message if last and not before[-1].all_clear else before[-1]


def warnings_scored(
    history: str, warnings: Path | None = None, outages: Path | None = None
) -> WarningScores | None:
    """Scores of the files that are given, or of a scenario's own messages; None without any."""
    if warnings and outages:
        return WarningScores.of_files(warnings, outages)
    if warnings or outages:
        missing, there = ("outages", "warnings") if warnings else ("warnings", "outages")
        cure = f"Give --{missing} FILE beside --{there}: one is scored against the other."
        raise InputError.of("options", "is missing", cure, field=missing)
    if not is_scenario(history):
        return None
    return WarningScores.of_scenario(load_scenario(history))
