"""Files of strangers: how much of one is read, and what is never opened."""

from __future__ import annotations

from pathlib import Path

from vppres.core.errors import InputError

LARGEST_BYTES = 50 * 2**20
"""A pandapower net of 10,000 buses has some 10 MB."""

MOST_PROBLEMS = 20


def read_bytes(path: Path, limit: int = LARGEST_BYTES, shown: str = "") -> bytes:
    """The content of a regular file of limited size."""
    name = shown or path.name
    if not path.is_file():  # the end of a pipe or a device is not known
        raise InputError.of(name, "is not a regular file", "Give a file.")
    with path.open("rb") as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise InputError.of(
            name,
            f"has more than {limit / 2**20:.3g} MB, or its folder has",
            "Give the feeder alone, without time series.",
        )
    return content


def read_text(path: Path, limit: int = LARGEST_BYTES, shown: str = "") -> str:
    """Text of a file; bytes that are no UTF-8 are replaced, and refused where they matter."""
    return read_bytes(path, limit, shown).decode("utf-8-sig", errors="replace")
