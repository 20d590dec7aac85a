"""The kinds of flexible power that a site may have. A new kind is a folder and a line here.

Everywhere else a kind is the name of its field in the scenario, and every layer loops over kinds:
it asks for its part of each by :func:`parts`.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from vppres.kinds.kind import Kind, KindTable, Units

FOLDERS = {"chargers": "vehicles", "thermal_loads": "cooling", "gensets": "gensets"}
"""Folder of each kind, in the order of letters, tables and words."""


@cache
def parts(name: str = "") -> dict[str, Any]:
    """The module of this name of each kind, ``physics`` for example; the folder without a name.

    >>> [folder.KIND.item for folder in parts().values()]
    ['charger', 'thermal_load', 'genset']
    """
    return {
        kind: import_module(f"vppres.kinds.{folder}.{name}".rstrip("."))
        for kind, folder in FOLDERS.items()
    }


KINDS: dict[str, Kind] = {kind: data.KIND for kind, data in parts().items()}

TABLES: dict[str, type[KindTable]] = {
    field: rows for kind in KINDS.values() for field, rows in kind.tables.items()
}
"""Tables of all kinds by field of the scenario."""

SERIES: dict[str, str] = {name: field for field, rows in TABLES.items() for name in rows.series}
"""Field of the table whose rows a series is about, by field of the series."""


def units_of(site: Any) -> dict[str, Units]:
    """Units of each kind that a scenario or site has any of."""
    found: dict[str, Units] = {name: getattr(site, name) for name in KINDS}
    return {name: units for name, units in found.items() if len(units)}
