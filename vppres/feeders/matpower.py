"""MATPOWER cases as pandapower nets: of a file only the tables of a network are read."""

from __future__ import annotations

import base64
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from vppres.core.errors import InputError, Problem
from vppres.feeders.confined import confined
from vppres.feeders.strangers import read_bytes, read_text

LARGEST_BYTES = 10 * 2**20
"""The largest case that comes with MATPOWER, of 82,000 buses, has some 20 MB; a feeder has 1."""

_TABLES = ("bus", "gen", "branch")
# A MATPOWER case that computes its own tables: only MATPOWER itself can run that.
_COMPUTES = re.compile(r"^[ \t]*mpc\.(bus|branch|gen)[ \t]*\(", re.MULTILINE)
_HEAD = "function mpc = case\n"


def read_m(path: Path) -> Any:
    """A case written as a MATLAB function; nothing of it is run.

    Raises
    ------
    InputError
        If it is too large, or computes its tables.
    Exception
        Whatever the reader stumbles over.
    """
    text = read_text(path, LARGEST_BYTES)
    found = _COMPUTES.search(text)
    if found:
        raise InputError(
            Problem(
                path.name,
                f"computes mpc.{found[1]} in code, which only MATPOWER can run",
                "Load the case in MATPOWER, write it with savecase, and import that file.",
            )
        )
    parts = [_assigned(text, name, "", ";") for name in ("version", "baseMVA")]
    parts += [_assigned(text, name, "[", "];") for name in _TABLES]
    return _converted("case.m", (_HEAD + "\n".join(parts) + "\n").encode())


def _assigned(text: str, name: str, opening: str, closing: str) -> str:
    """The text of one assignment, found in one pass."""
    start = re.search(rf"mpc\.{name}[ \t]*=[ \t]*{re.escape(opening)}", text)
    end = text.find(closing, start.end()) if start else -1
    if start is None or end < 0:
        raise ValueError(f"mpc.{name} is missing")
    return text[start.start() : end + len(closing)]


def read_mat(path: Path) -> Any:
    """A case in MATLAB's binary format, unpacked in a process of its own.

    Raises
    ------
    InputError
        If it is too large, or takes more time or memory than a case.
    Exception
        Whatever the reader stumbles over.
    """
    content = base64.b64encode(read_bytes(path, LARGEST_BYTES)).decode("ascii")
    found = confined("mat_engine", {"content": content}, path.name)
    if "error" in found:
        raise ValueError(found["error"])
    import scipy.io

    tables = {name: np.asarray(value, dtype=float) for name, value in found["tables"].items()}
    with tempfile.TemporaryDirectory(prefix="vppres-") as folder:
        file = Path(folder, "case.mat")
        scipy.io.savemat(file, {"mpc": {"version": found["version"], **tables}})
        return _from_mpc(file)


def _converted(name: str, content: bytes) -> Any:
    """The net of a case that holds the tables and nothing else."""
    with tempfile.TemporaryDirectory(prefix="vppres-") as folder:
        file = Path(folder, name)
        file.write_bytes(content)
        return _from_mpc(file)


def _from_mpc(file: Path) -> Any:
    from pandapower.converter.matpower import from_mpc

    return from_mpc(str(file))
