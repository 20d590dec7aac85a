"""Finished measurements, one file each: a run that was interrupted goes on where it stopped."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import vppres
from vppres.core.plain import json_safe
from vppres.day.metrics import versions
from vppres.io.atomic import atomic_write_text

Row = dict[str, Any]
PRESENTATION = ("cli", "explain", "feeders", "io", "live", "report", "studies")
"""Packages that show or read results, and so cannot change them."""


@cache
def package_digest() -> str:
    """SHA-256 of the source files of vppres that compute a result."""
    package = Path(vppres.__file__).parent
    files = sorted(package.rglob("*.py"))
    return digest_of_files(
        file for file in files if file.relative_to(package).parts[0] not in PRESENTATION
    )


def digest_of_files(files: Iterable[Path]) -> str:
    """SHA-256 of the names and contents of files."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


@dataclass(frozen=True)
class Store:
    """Rows by the digest of what they depend on: their key, the sources and the libraries."""

    folder: Path

    def row(self, key: Mapping[str, Any], measure: Callable[[], Row]) -> Row:
        """The row of a key, measured now if it is not there yet."""
        file = self.folder / f"{_digest(key)}.json"
        if not file.is_file():
            self.folder.mkdir(parents=True, exist_ok=True)
            atomic_write_text(file, json.dumps(json_safe({**key, **measure()}), allow_nan=False))
        row: Row = json.loads(file.read_text(encoding="utf-8"))
        return row


def _digest(key: Mapping[str, Any]) -> str:
    inputs = {"key": dict(key), "sources": package_digest(), "versions": versions()}
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
