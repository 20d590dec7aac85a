"""CPU time of each test function, as last measured, and the cases that run by that.

``tests/durations.csv`` lists every test function and every fixture that tests share. Three sizes of
run follow from it:

- ``pytest --quick``: functions of short cases on short fixtures, and of each the first case. It is
  an allow list: what was never measured does not run.
- ``pytest``: all functions but those that are marked nightly. Of one with random cases (a parameter
  ``seed``) the first cases that together cost at most ``USUAL_S``.
- ``pytest --nightly``: everything.

``pytest --measure`` adds the functions and fixtures that the list lacks. What is not listed fails
``test_every_test_is_measured``, so the list cannot go stale. A function whose cases take longer than
``LONG_S`` has a mark, daily or nightly, which ``test_every_long_test_says_when_it_runs`` wants. One
that has grown since it was measured fails once it takes ``GROWN_S``.
"""

from __future__ import annotations

import csv
import os
from collections import defaultdict
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import pytest

FILE = Path(__file__).parents[1] / "durations.csv"
QUICK_CASE_S = 0.1
"""CPU time of a case and its shared fixtures up to which a function is quick."""
LONG_S = 1.5
"""CPU time of a case above which a function says when it runs: it is marked daily or nightly."""
GROWN_S = 10.0
"""CPU time at which a case without such a mark fails: far above ``LONG_S``, for slow machines."""
USUAL_S = 1.0
"""CPU time that a usual run grants the random cases of one function; the first always runs."""
PROPERTY = "processor_s"
COLLECTED = pytest.StashKey[set[str]]()
UNMARKED = pytest.StashKey[set[str]]()
"""Functions with neither mark."""


def processor_s() -> float:
    """CPU time of this process and its children: it hardly depends on what else runs."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def function_of(nodeid: str) -> str:
    """Name of a test function without the parameters of a case."""
    return nodeid.partition("[")[0]


def name_of(fixture: pytest.FixtureDef[object]) -> str:
    """Name of a fixture, with the file that offers it."""
    return f"{fixture.baseid}::{fixture.argname}"


def is_shared(fixture: pytest.FixtureDef[object]) -> bool:
    """Whether a fixture of these tests serves several functions."""
    return fixture.scope != "function" and fixture.baseid.startswith("tests")


def shared_fixtures(item: pytest.Item) -> list[str]:
    """Fixtures that a case shares with others."""
    used = [found[-1] for found in item._fixtureinfo.name2fixturedefs.values()]
    return [name_of(fixture) for fixture in used if is_shared(fixture)]


def read_durations() -> dict[str, float]:
    """CPU seconds of an average case, by test function, and of fixtures."""
    if not FILE.exists():
        return {}
    with FILE.open(encoding="utf-8", newline="") as file:
        return {row["test"]: float(row["seconds_per_case"]) for row in csv.DictReader(file)}


def write_durations(seconds: dict[str, float]) -> None:
    """Write the table, sorted by name."""
    with FILE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["test", "seconds_per_case"])
        writer.writerows([name, f"{value:.2f}"] for name, value in sorted(seconds.items()))


def quick_choice(
    names: list[str], fixtures: list[list[str]], seconds: dict[str, float]
) -> list[bool]:
    """Whether each case, given by its function and shared fixtures, belongs to the quick run."""
    seen: set[str] = set()
    chosen = []
    for name, shared in zip(names, fixtures, strict=True):
        cost_s = sum(seconds.get(part, float("inf")) for part in (name, *shared))
        chosen.append(cost_s <= QUICK_CASE_S and name not in seen)
        seen.add(name)
    return chosen


def unmeasured_choice(
    names: list[str], fixtures: list[list[str]], seconds: dict[str, float]
) -> list[bool]:
    """Whether each case is to be measured: of new functions, and of one for each new fixture."""
    known = set(seconds)
    chosen = set()
    for name, shared in zip(names, fixtures, strict=True):
        if not known.issuperset([name, *shared]):
            chosen.add(name)
            known.update([name, *shared])
    return [name in chosen for name in names]


def usual_choice(names: list[str], seconds: dict[str, float], random: list[bool]) -> list[bool]:
    """Whether each case, given by the name of its function, belongs to the usual run."""
    spent: dict[str, float] = defaultdict(float)
    chosen = []
    for name, drawn in zip(names, random, strict=True):
        first = name not in spent
        spent[name] += seconds.get(name, 0.0)
        chosen.append(first or not drawn or spent[name] <= USUAL_S)
    return chosen


def too_long(unmarked: set[str], seconds: dict[str, float]) -> list[str]:
    """Functions whose cases are long, and that do not say when they run."""
    return sorted(name for name in unmarked if seconds.get(name, 0.0) > LONG_S)


def is_random(item: pytest.Item) -> bool:
    """Whether a case is drawn by a seed: one of many that test the same."""
    call = getattr(item, "callspec", None)
    return call is not None and "seed" in call.params


def has_mark(item: pytest.Item) -> bool:
    """Whether a case says when it runs."""
    return any(item.get_closest_marker(marker) for marker in ("daily", "nightly"))


class Durations:
    """Measures tests, and leaves out what a run of its size does not take."""

    def __init__(self, config: pytest.Config) -> None:
        self.measures = bool(config.getoption("measure"))
        self.quick = bool(config.getoption("quick"))
        self.nightly = bool(config.getoption("nightly"))
        self.begun_s = 0.0
        self.fixtures: dict[str, float] = {}
        self.found: dict[str, list[float]] = defaultdict(list)

    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        """Deselect what does not belong to the run."""
        names = [function_of(item.nodeid) for item in items]
        fixtures = [shared_fixtures(item) for item in items]
        config.stash[COLLECTED] = {*names, *chain.from_iterable(fixtures)}
        config.stash[UNMARKED] = {
            name for name, item in zip(names, items, strict=True) if not has_mark(item)
        }
        chosen = self.choice(items, names, fixtures)
        left_out = [item for item, takes in zip(items, chosen, strict=True) if not takes]
        items[:] = [item for item, takes in zip(items, chosen, strict=True) if takes]
        config.hook.pytest_deselected(items=left_out)

    def choice(
        self, items: list[pytest.Item], names: list[str], fixtures: list[list[str]]
    ) -> list[bool]:
        """Whether each case runs, by the size of the run."""
        seconds = read_durations()
        if self.measures:
            return unmeasured_choice(names, fixtures, seconds)
        if self.nightly:
            return [True] * len(items)
        if self.quick:
            chosen = quick_choice(names, fixtures, seconds)
        else:
            chosen = usual_choice(names, seconds, [is_random(item) for item in items])
        return [
            takes and item.get_closest_marker("nightly") is None
            for takes, item in zip(chosen, items, strict=True)
        ]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Note when a test begins."""
        self.begun_s, self.fixtures = processor_s(), {}
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[object]) -> Iterator[object]:
        """Measure a shared fixture apart from the test that happens to need it first."""
        before_s = processor_s()
        try:
            return (yield)
        finally:
            if is_shared(fixturedef):
                self.fixtures[name_of(fixturedef)] = processor_s() - before_s

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Iterator[None]:
        """Send the durations along with the last report of a test, to the process that writes."""
        report = yield
        if call.when == "teardown":
            case_s = processor_s() - self.begun_s - sum(self.fixtures.values())
            measured = {function_of(item.nodeid): case_s, **self.fixtures}
            report.user_properties.append((PROPERTY, measured))
            by_day = not (self.measures or self.nightly)
            if by_day and case_s > GROWN_S and report.passed and not has_mark(item):
                report.outcome = "failed"
                report.longrepr = f"{case_s:.1f} s of CPU time: make it shorter, or mark it nightly"
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect durations, those of other processes too."""
        if report.when == "teardown":
            for name, value in dict(report.user_properties)[PROPERTY].items():
                self.found[name].append(value)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Add what was measured to the table; a run of all tests drops rows without a test."""
        if not self.measures:
            return
        new = {name: sum(values) / len(values) for name, values in self.found.items()}
        seconds = read_durations() | new
        if session.config.args_source is pytest.Config.ArgsSource.TESTPATHS:
            seconds = {name: seconds[name] for name in session.config.stash[COLLECTED]}
        write_durations(seconds)
