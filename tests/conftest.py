"""Options and fixtures of all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.tiny_day import tiny_scenario
from vppres.io import write_scenario
from vppres.scenario.scenario import Scenario


def pytest_addoption(parser: pytest.Parser) -> None:
    """How many random mutations of a scenario folder are read (tests/test_bad_input.py)."""
    parser.addoption("--fuzz", type=int, default=1000, metavar="N",
                     help="random mutations of a valid scenario folder (default: 1000)")


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
