"""Series in files: a folder or one file, CSV or Parquet, wide, long, or one file per asset."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.feeders.feeder import Profile
from vppres.feeders.series.clocks import in_utc
from vppres.io.tables import Table, read_table

SUFFIXES = (".csv", ".parquet")
TIMES = ("time", "timestamp", "datetime")
IDS = ("id", "asset", "name", "element")
VALUES = ("value", "p", "power")
_BEFORE = r"(?<!_per)(?:_|\s*\[|\s*\(|\s+)"  # 0.3 GBP/kWh is no energy
_OF_SERIES = r"(kw|mw|pu|p\.u\.|wh|kwh|mwh)"
_UNIT = re.compile(_BEFORE + _OF_SERIES + r"[\])]?$", re.IGNORECASE)
_OTHER_UNIT = re.compile(_BEFORE + r"(w|gw|kva|mva|kvar|mvar)[\])]?$", re.IGNORECASE)
_PLAIN = re.compile(_OF_SERIES, re.IGNORECASE)
UNITS_CURE = "End the column's or the file's name in _kw, _mw, _pu or, for energy, in _kwh"


@dataclass(frozen=True)
class FileDefaults:
    """Zone of times without offset, unit such as ``kw``, and minutes of a row, where not said."""

    zone: str | None = None
    unit: str | None = None
    row_minutes: float | None = None


def read_profiles(path: str | Path, reading: FileDefaults) -> list[Profile]:
    """Series of a file, or of all CSV and Parquet files of a folder.

    A file has a column of times (``time``, ``timestamp`` or ``datetime``), or rows of a given
    length. It is of one of three kinds: long, with the columns ``id`` and a value; of one asset,
    after which the file is named, with a single column named ``value``, ``p`` or after a unit; or
    wide, with a column for each asset. The unit is the end of a column's or file's name, such as
    ``_kw``, or ``reading``'s.
    """
    path = Path(path)
    profiles: list[Profile] = []
    problems: list[Problem] = []
    for file in _files(path):
        table, found = read_table(file)
        problems += found
        if table:
            read, found = _read(table, reading)
            profiles += read
            problems += found
    if problems:
        raise InputError(problems)
    return profiles


def _files(path: Path) -> list[Path]:
    """The file, or the files of the folder by name."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError.of(
            f"profiles {path.name}",
            "there is no such file or folder",
            "Correct the path, or write 'source' for the network's own series.",
        )
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    if not files:
        raise InputError.of(
            f"profiles {path.name}",
            "has neither a CSV nor a Parquet file",
            "Give a folder with series, or one file.",
        )
    return files


def _read(table: Table, reading: FileDefaults) -> tuple[list[Profile], list[Problem]]:
    """All series of a file."""
    frame = table.frame
    names = {str(name).strip().lower(): str(name) for name in frame.columns}
    clock = next((names[word] for word in TIMES if word in names), None)
    if clock is None and reading.row_minutes is None:
        return [], [
            Problem(
                table.file,
                "has no column of times",
                f"Name it {TIMES[0]}; the other columns are assets, or id and value. Without "
                "times say how long a row is with --profile-step.",
            )
        ]
    key = next((names[word] for word in IDS if word in names), None)
    rest = [str(name) for name in frame.columns if name not in (clock, key)]
    if not rest:
        return [], [Problem(table.file, "has no column of values", "Add one for each asset.")]
    if key is not None:
        return _long(table, clock, key, rest, reading)
    return _wide(table, clock, rest, reading)


def _wide(
    table: Table, clock: str | None, columns: list[str], reading: FileDefaults
) -> tuple[list[Profile], list[Problem]]:
    """A column for each asset; a single column of values is that of the file's asset."""
    times, problems = _times(table, clock, slice(None), reading)
    stem, file_unit = _named(Path(table.file).stem)
    of_values = bool(_plain(columns[0])) or _named(columns[0])[0].lower() in VALUES
    single = len(columns) == 1 and of_values  # not named after an asset
    profiles = []
    for column in columns:
        name, unit = _named(column)
        unit = unit or (_plain(column) if single else "") or file_unit or reading.unit or ""
        values, found = _numbers(table, column)
        problems += found
        if len(times) == len(values):
            series = pd.Series(values, times)
            profiles.append(
                Profile(table.file, stem if single else name, series, unit, column=column)
            )
    return profiles, problems


def _long(
    table: Table, clock: str | None, key: str, columns: list[str], reading: FileDefaults
) -> tuple[list[Profile], list[Problem]]:
    """One row for each time and asset; hours that clocks show twice are distinguished by asset."""
    if len(columns) > 1:
        return [], [
            Problem(
                table.file,
                f"has the column {key} and {len(columns)} columns of values",
                "Keep one column of values.",
            )
        ]
    values, problems = _numbers(table, columns[0])
    unit = _named(columns[0])[1] or _plain(columns[0]) or _named(Path(table.file).stem)[1]
    ids = table.frame[key].astype(str).str.strip().to_numpy()
    profiles = []
    for name in dict.fromkeys(ids):
        rows = np.flatnonzero(ids == name)
        times, found = _times(table, clock, rows, reading)
        problems += found
        if len(times):
            series = pd.Series(values[rows], times)
            profiles.append(Profile(table.file, str(name), series, unit or reading.unit or ""))
    return profiles, problems


def _times(
    table: Table, clock: str | None, rows: Any, reading: FileDefaults
) -> tuple[pd.Index, list[Problem]]:
    """Times of some rows in UTC, or their numbers in a file without times."""
    if clock is None:
        return pd.RangeIndex(len(table.frame.iloc[rows])), []
    return in_utc(pd.Index(table.frame[clock].iloc[rows]), reading.zone, table.file, clock)


def _numbers(table: Table, column: str) -> tuple[np.ndarray, list[Problem]]:
    """Numbers of a column; empty cells are gaps."""
    cells = table.frame[column]
    if cells.dtype.kind in "iuf":
        return cells.to_numpy(dtype=float), []
    texts = table.texts(column)
    values = pd.to_numeric(texts.where(texts != ""), errors="coerce").to_numpy(dtype=float)
    wrong = np.flatnonzero((np.isnan(values) & (texts != "").to_numpy()) | np.isinf(values))
    told = [int(i) for i in wrong if texts.iloc[i].lower() not in ("nan", "null", "na", "none")]
    cure = "Correct it, or leave it empty: a gap is filled, and the notes say so."
    problems = table.problems(told, column, "is not a number", cure)
    return np.where(np.isinf(values), np.nan, values), problems


def _named(text: str) -> tuple[str, str]:
    """A name without its unit, and the unit.

    >>> _named("load 3_mw"), _named("pv18 [kWh]"), _named("price_gbp_per_kwh")
    (('load 3', 'mw'), ('pv18', 'kwh'), ('price_gbp_per_kwh', ''))
    """
    found = _UNIT.search(text)
    if found is None or found.start() == 0:
        return text.strip(), ""
    return text[: found.start()].strip(), found.group(1).lower().replace(".", "")


def other_unit(name: str) -> str:
    """A unit that series cannot have at the end of a name without one that they can.

    >>> other_unit("c18_kvar"), other_unit("c18 [W]"), other_unit("south")
    ('kvar', 'W', '')
    """
    found = _OTHER_UNIT.search(name)
    return found.group(1) if found else ""


def _plain(text: str) -> str:
    """A unit that is all of a name."""
    return text.strip().lower().replace(".", "") if _PLAIN.fullmatch(text.strip()) else ""


def units_missing(profiles: list[Profile]) -> Iterator[Problem]:
    """Series without a unit, one problem a file."""
    files: dict[str, list[str]] = {}
    for profile in profiles:
        if not profile.unit:
            files.setdefault(profile.where, []).append(profile.name)
    for where, names in files.items():
        more = f", and {len(names) - 1} more" if len(names) > 1 else ""
        yield Problem(
            where,
            f"does not say the unit of {names[0]}{more}",
            f"{UNITS_CURE}, or give --profile-unit.",
        )
