"""Scenarios by name: those that come with the package, or a folder."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from vppres.core.errors import InputError
from vppres.io.messages import did_you_mean
from vppres.io.settings import SCENARIO_FILE

if TYPE_CHECKING:
    from vppres.scenario.scenario import Scenario


def load_scenario(name_or_folder: str | Path) -> Scenario:
    """A packaged scenario, or one from a folder, read and checked.

    Parameters
    ----------
    name_or_folder : str or Path
        As for :func:`find_scenario`.

    Raises
    ------
    InputError
        If there is none, or with every problem of its files.

    Examples
    --------
    >>> load_scenario("uk-heatwave-2022").grid.n_steps
    24
    """
    from vppres.io.scenario_folder import read_scenario

    return read_scenario(find_scenario(name_or_folder))


def packaged_scenarios() -> list[str]:
    """Names of the scenarios that come with the package, sorted."""
    home = _home()
    return sorted(
        entry.name
        for entry in (home.iterdir() if home.is_dir() else [])
        if (entry / SCENARIO_FILE).is_file()
    )


def is_scenario(name_or_folder: str | Path) -> bool:
    """Whether it is the name of a packaged scenario, or a scenario's folder."""
    return (
        str(name_or_folder) in packaged_scenarios()
        or (Path(name_or_folder) / SCENARIO_FILE).is_file()
    )


def find_scenario(name_or_folder: str | Path) -> Path:
    """Folder of a scenario.

    Parameters
    ----------
    name_or_folder : str or Path
        Name of a packaged scenario, or a folder. A packaged name comes first; write ``./name``
        for a folder of the same name.

    Raises
    ------
    InputError
        If it is neither.
    """
    names = packaged_scenarios()
    if str(name_or_folder) in names and isinstance(name_or_folder, str):
        return _home() / name_or_folder
    folder = Path(name_or_folder)
    if os.path.isdir(folder):  # False for a name that no file system takes
        return folder
    raise InputError.of(
        f"scenario {name_or_folder}",
        "is neither a packaged scenario nor a folder",
        did_you_mean(str(name_or_folder), names, "Give the path of a scenario folder."),
    )


def _home() -> Path:
    return Path(str(resources.files("vppres").joinpath("scenarios")))
