"""Options and fixtures of all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.durations import Durations
from tests.support.tiny_day import tiny_scenario
from vppres.io import write_scenario
from vppres.scenario.scenario import Scenario


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of these tests: the size of one, and which of them run."""
    parser.addoption(
        "--fuzz",
        type=int,
        default=1000,
        metavar="N",
        help="random mutations of a valid scenario folder (default: 1000)",
    )
    parser.addoption(
        "--quick",
        action="store_true",
        help="of every test function the cases that fit into a second, as measured",
    )
    parser.addoption(
        "--measure",
        action="store_true",
        help="write the durations that --quick goes by: tests/durations.csv",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Measure tests, and choose them by what was measured."""
    config.pluginmanager.register(
        Durations(config.getoption("measure"), config.getoption("quick")), "durations-of-tests"
    )


@pytest.fixture
def tiny() -> Scenario:
    """The tiny day."""
    return tiny_scenario()


@pytest.fixture
def tiny_folder(tiny: Scenario, tmp_path: Path) -> Path:
    """The tiny day as a scenario folder."""
    folder = tmp_path / "tiny"
    write_scenario(tiny, folder)
    return folder
