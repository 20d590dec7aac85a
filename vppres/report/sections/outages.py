"""Outage forecasts, and the warnings behind them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from vppres.outlook.presets import completed
from vppres.report.clock import Clock
from vppres.report.plots.figures import has_beliefs
from vppres.report.sections.base import Run
from vppres.scenario.outage_warnings import OutageWarning


def outages_of(run: Run) -> dict[str, Any] | None:
    """Beliefs beside what came; nothing where outages were known."""
    if not has_beliefs(run.trajectory):
        return None
    scenario = run.trajectory.scenario
    messages = sorted(map(completed, scenario.warnings), key=lambda message: message.issued_at)
    return {
        "kind": run.trajectory.options["outages"],
        "figure": run.figure("outage_belief"),
        "messages": [_row(message, Clock.of(run.trajectory)) for message in messages],
        "counting": _counting(run, Clock.of(run.trajectory)),
    }


def _counting(run: Run, clock: Clock) -> list[dict[str, str]]:
    """From when on which of several messages about one outage counted."""
    steps = run.trajectory.steps
    if "outage_messages" not in steps:
        return []  # a run of an earlier version
    said = steps["outage_messages"]
    changed = steps[said.ne(said.shift()) & said.ne("")]
    return [
        {"time": clock.words(time), "words": words}
        for time, words in zip(changed["time"], changed["outage_messages"], strict=True)
    ]


def _row(message: OutageWarning, clock: Clock) -> dict[str, str]:
    """A message in the words of the table."""
    onsets = (message.onset_earliest, message.onset_likely, message.onset_latest)
    lengths = (message.duration_p10_h, message.duration_p50_h, message.duration_p90_h)
    chance = message.chance
    return {
        "time": clock.words(message.issued_at),
        "about": " ".join(word for word in (message.outage, message.preset) if word),
        "onset": "all-clear" if message.all_clear else _between(onsets, clock),
        "probability": f"{chance:.0%}" if chance >= 0.01 else f"{chance:.2%}",
        "length": ", ".join(f"{hours:.3g}" for hours in lengths if hours is not None),
        "end": _end(message, clock),
    }


def _end(message: OutageWarning, clock: Clock) -> str:
    """Restoration times in a message."""
    said = {
        "not before": message.restored_not_before,
        "about": message.restored_likely,
        "by": message.restored_by,
    }
    return ", ".join(f"{word} {clock.words(time)}" for word, time in said.items() if time)


def _between(onsets: Sequence[pd.Timestamp | None], clock: Clock) -> str:
    """The onset's times, once where they are one."""
    times = list(dict.fromkeys(clock.words(time) for time in onsets if time is not None))
    return " to ".join(times)
