"""Finished measurements, one file each: a run that was interrupted goes on where it stopped."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.jobs import sources_digest
from vppres.core.plain import json_safe
from vppres.day.metrics import versions
from vppres.io.atomic import atomic_write_text

Row = dict[str, Any]


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
    inputs = {"key": dict(key), "sources": sources_digest(), "versions": versions()}
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
