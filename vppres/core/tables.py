"""Tables that come with the package."""

from __future__ import annotations

import csv
from pathlib import Path


def packaged_table(module: str, name: str) -> list[dict[str, str]]:
    """The rows of a CSV table beside a module, as text by column.

    ``module`` is its ``__file__``.
    """
    with Path(module).with_name(name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
