"""Configurations of the experiments: one TOML file each."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

Config = dict[str, Any]

FOLDER = Path(__file__).with_name("config")


def read_config(name: str, quick: bool = False, folder: Path = FOLDER) -> Config:
    """Configuration of an experiment.

    Parameters
    ----------
    name : str
        Name of the experiment's module.
    quick : bool
        Whether the file's table ``quick`` replaces what it names: fewer levels and seeds.
    folder : Path
        Folder of the file; a study has its own beside it.
    """
    values = tomllib.loads((folder / f"{name}.toml").read_text(encoding="utf-8"))
    fewer = values.pop("quick", {})
    return {**values, **fewer} if quick else values
