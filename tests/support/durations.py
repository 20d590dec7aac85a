"""What each test function costs, as last measured, and the quick choice that follows from it.

``pytest --measure`` writes ``tests/durations.csv``; ``pytest --quick`` reads it and takes of every
test function the first cases that together cost at most a second. What was never measured is run.
"""

from __future__ import annotations

import csv
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

FILE = Path(__file__).parents[1] / "durations.csv"
QUICK_S = 1.0
"""Time of the processor that the quick choice grants a test function."""
LEAST_S = 0.1
"""Tests below this are not listed: they change nothing, and the list would change every time."""
PROPERTY = "processor_s"
START = pytest.StashKey[float]()


def processor_s() -> float:
    """Time of the processor of this process and its children: it hardly hangs on what else runs."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def function_of(nodeid: str) -> str:
    """Name of a test function without the parameters of a case."""
    return nodeid.partition("[")[0]


def read_durations() -> dict[str, float]:
    """Seconds of an average case, by test function."""
    if not FILE.exists():
        return {}
    with FILE.open(encoding="utf-8", newline="") as file:
        return {row["test"]: float(row["seconds_per_case"]) for row in csv.DictReader(file)}


def write_durations(seconds: dict[str, float]) -> None:
    """Write the table, sorted by name; what is far below a second is left out."""
    with FILE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["test", "seconds_per_case"])
        writer.writerows(
            [name, f"{value:.2f}"] for name, value in sorted(seconds.items()) if value >= LEAST_S
        )


def quick_choice(names: list[str], seconds: dict[str, float]) -> list[bool]:
    """Whether each case, given by the name of its function, belongs to the quick choice.

    Of every function the first cases are taken whose durations add up to ``QUICK_S`` at most.
    """
    spent: dict[str, float] = defaultdict(float)
    chosen = []
    for name in names:
        spent[name] += seconds.get(name, 0.0)
        chosen.append(spent[name] <= QUICK_S)
    return chosen


class Durations:
    """Measures every test, and leaves out what the quick choice does not take."""

    def __init__(self, measure: bool, quick: bool) -> None:
        self.measure = measure
        self.quick = quick
        self.found: dict[str, list[float]] = defaultdict(list)

    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        """Deselect what is not quick."""
        if not self.quick:
            return
        chosen = quick_choice([function_of(item.nodeid) for item in items], read_durations())
        left_out = [item for item, takes in zip(items, chosen, strict=True) if not takes]
        items[:] = [item for item, takes in zip(items, chosen, strict=True) if takes]
        config.hook.pytest_deselected(items=left_out)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Note when a test begins, its fixtures included."""
        item.stash[START] = processor_s()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Iterator[None]:
        """Send the duration along with the last report of a test, to the process that writes."""
        report = yield
        if call.when == "teardown":
            report.user_properties.append((PROPERTY, processor_s() - item.stash[START]))
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect durations, those of other processes too."""
        if report.when == "teardown":
            self.found[function_of(report.nodeid)].append(dict(report.user_properties)[PROPERTY])

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Write the durations; a partial or quick run renews those of its own tests alone."""
        if not self.measure or hasattr(session.config, "workerinput"):
            return
        new = {name: sum(values) / len(values) for name, values in self.found.items()}
        old = read_durations()
        if self.quick:
            # A shared day is paid for by whichever test comes first: here by another than before.
            new = {name: max(value, old.get(name, 0.0)) for name, value in new.items()}
        write_durations(old | new)
