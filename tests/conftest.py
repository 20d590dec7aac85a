"""Options and fixtures of all tests."""

from __future__ import annotations

import gc
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

from tests.support.durations import Durations
from tests.support.tiny_day import tiny_scenario
from vppres.io import find_scenario, read_scenario, write_scenario
from vppres.scenario.scenario import Scenario

if TYPE_CHECKING:
    from tests.support.live_service import Live

TESTS = Path(__file__).parent
pytest_plugins = ["pytester"]

# The same cases in each run, and no limit of time for one: the machine may be busy.
settings.register_profile("vppres", deadline=None, derandomize=True)
settings.load_profile("vppres")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of these tests: the size of one, and which of them run."""
    parser.addoption(
        "--fuzz",
        type=int,
        default=20,
        metavar="N",
        help="random mutations of a valid scenario folder (default: 20)",
    )
    parser.addoption(
        "--quick",
        action="store_true",
        help="the first case of each function of short cases, as measured",
    )
    parser.addoption(
        "--nightly",
        action="store_true",
        help="everything: all cases, and tests marked nightly",
    )
    parser.addoption(
        "--measure",
        action="store_true",
        help="measure the functions that tests/durations.csv lacks",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Measure tests, and choose them by what was measured."""
    config.pluginmanager.register(Durations(config), "durations-of-tests")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out the tests of studies and benchmarks, which are there for the night."""
    whole = config.getoption("nightly") or config.getoption("measure")
    return None if whole or collection_path != TESTS / "nightly" else True


SITES_KEPT = 16
"""Sites whose compiled problems stay: tests go from one to another, where a study has one."""


def pytest_collection_finish() -> None:
    """What was imported stays: the collector need not walk through it, nor so often."""
    if "pandapower" in sys.modules:
        from tests.support.small_nets import empty_tables_are_copied

        empty_tables_are_copied()
    if cache := sys.modules.get("vppres.solve.cache"):
        cache.SITES_KEPT = SITES_KEPT  # type: ignore[attr-defined]
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)


@pytest.fixture(scope="session")
def nightly(pytestconfig: pytest.Config) -> bool:
    """Whether all cases run: tests that loop over seeds take fewer by day."""
    return bool(pytestconfig.getoption("nightly"))


@pytest.fixture(scope="session")
def packaged() -> Scenario:
    """The packaged day."""
    return read_scenario(find_scenario("uk-heatwave-2022"))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A real browser, in which no other loop of events may run."""
    from tests.support.browser import FLAGS, chromium

    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if chromium() is None:
        pytest.skip("no chromium or chrome on the path")
    with sync_api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=chromium(), args=list(FLAGS))
        yield found
        found.close()


@pytest.fixture
def tiny() -> Scenario:
    """The tiny day."""
    return tiny_scenario()


@pytest.fixture(scope="session")
def written_tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny day as a scenario folder, of which each test has a copy."""
    folder = tmp_path_factory.mktemp("written") / "tiny"
    write_scenario(tiny_scenario(), folder)
    return folder


@pytest.fixture
def tiny_folder(written_tiny: Path, tmp_path: Path) -> Path:
    """The tiny day as a scenario folder."""
    return shutil.copytree(written_tiny, tmp_path / "tiny")


@pytest.fixture
def live(tiny: Scenario, tmp_path: Path) -> Iterator[Live]:
    """A service of the tiny feeder at noon, years after its scenario's day."""
    from tests.support.live_service import at_noon

    with at_noon(tiny, tmp_path / "state") as found:
        yield found
