"""pandapower's JSON, checked before pandapower reads it.

The format names the module and the class of each object, and pandapower imports the module before
it looks whether it may build the class. Here every name is looked at first, in nested texts too.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, TypeGuard

from vppres.core.errors import InputError, Problem
from vppres.feeders.strangers.files import MOST_PROBLEMS, read_text

LARGEST_BYTES = 32 * 2**20
"""A net of 10,000 buses has some 10 MB."""

MOST_BRACKETS = 1_000_000
"""Each is an object or list in memory; a net of 10,000 buses has some 100,000."""

DEEPEST = 30
"""Nets have some six levels: net, table, its text, rows, cells, and objects in cells."""

TABLES = frozenset({("pandas.core.frame", "DataFrame"), ("pandas", "DataFrame")})
BUILT = TABLES | {
    ("pandapower.auxiliary", "pandapowerNet"),
    ("pandas.core.series", "Series"),
    ("pandas", "Series"),
    ("pandas", "Index"),
    ("pandas", "RangeIndex"),
    ("numpy", "array"),
    ("networkx", "MultiGraph"),
    ("builtins", "tuple"),
    ("builtins", "set"),
    ("builtins", "frozenset"),
    ("builtins", "complex"),
    ("geopandas.geodataframe", "GeoDataFrame"),
    ("shapely", "Point"),
    ("shapely", "LineString"),
    ("shapely", "MultiLineString"),
    ("shapely", "Polygon"),
}
"""What pandapower builds of a net: data without behaviour."""

NUMBERS = re.compile(r"(u?int(8|16|32|64)|float(16|32|64)|complex(64|128)|bool_?|str_)")
LEFT_OUT = (
    "pandapower.control.",
    "pandapower.timeseries.",
    "pandapower.protection.",
    "pandapower.shortcircuit.",
    "pandapower.estimation.",
)
"""Controllers and the like: neither imported nor built, as the feeder has none."""

SETTINGS = frozenset(
    {
        "_module",
        "_class",
        "_object",
        "_state",
        "orient",
        "dtype",
        "is_multiindex",
        "is_multicolumn",
        "index_name",
        "index_names",
        "column_name",
        "column_names",
        "crs",
        "columns",
        "typ",
    }
)
"""What may stand beside an object: others go to the readers of pandas as options of their own."""

NOTE = "Controllers and protection of the source do not act."


def read_pandapower(path: Path) -> tuple[Any, tuple[str, ...], list[dict[str, Any]]]:
    """A net from a file, what is left out of it, and the texts of its controllers of constants."""
    text = read_text(path, LARGEST_BYTES)
    if text.count("{") + text.count("[") > MOST_BRACKETS:
        raise InputError.of(
            path.name,
            f"has more than {MOST_BRACKETS} objects and lists",
            "Give the feeder alone, without time series.",
        )
    check = _Check(path.name)
    omitted = check.run(text)
    from pandapower.file_io import from_json_string

    net = from_json_string(text, convert=True, omit_modules=list(LEFT_OUT))
    return net, (NOTE,) if omitted else (), check.constants


class _Check:
    """Looks at every object of a file, and at every text that may be JSON itself."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.problems: dict[str, Problem] = {}
        self.omitted = False
        self.constants: list[dict[str, Any]] = []

    def run(self, text: str) -> bool:
        """Raise what was found; whether anything will be left out."""
        waiting = [(self._parsed(text), 0)]
        while waiting and len(self.problems) < MOST_PROBLEMS:
            value, depth = waiting.pop()
            if depth > DEEPEST:
                self._refuse(f"nests deeper than {DEEPEST} levels", "Save the net alone.")
                break
            if isinstance(value, dict):
                self._object(value)
                waiting += [(inner, depth + 1) for inner in value.values()]
            elif isinstance(value, list):
                waiting += [
                    (inner, depth + 1)
                    for inner in value
                    if isinstance(inner, (dict, list)) or _may_be_json(inner)
                ]
            elif _may_be_json(value):
                waiting.append((self._inner(value), depth + 1))
        if self.problems:
            raise InputError(list(self.problems.values()))
        return self.omitted

    def _parsed(self, text: str) -> Any:
        """JSON whose keys are unambiguous; anything else is no file of pandapower's."""
        try:
            return json.loads(text, object_pairs_hook=self._pairs)
        except (ValueError, RecursionError) as error:
            raise InputError.of(
                self.name,
                f"cannot be read as pandapower JSON ({error})",
                "Correct the file, or choose another format with --from.",
            ) from None

    def _inner(self, text: str) -> Any:
        """A text that is JSON itself; None where it is not and cannot be taken for it."""
        try:
            return json.loads(text, object_pairs_hook=self._pairs)
        except (ValueError, RecursionError):
            # Another reader may be less strict than this one.
            if "_module" in text or "\\u" in text:
                self._refuse("has a text that names a module and is not JSON", "Remove it.")
            return None

    def _pairs(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        """An object; with the same key twice, readers differ on which one counts."""
        found = dict(pairs)
        if len(found) < len(pairs) and ("_module" in found or "_class" in found):
            self._refuse("has an object with the same key twice", "Remove one of them.")
        return found

    def _object(self, value: dict[str, Any]) -> None:
        """The module, the class and the settings of an object."""
        if "_module" not in value and "_class" not in value:
            return
        module = value.get("_module")
        kind = value.get("_class")
        if not (isinstance(module, str) and isinstance(kind, str)):
            self._refuse(
                f"names {_cut(module)}.{_cut(kind)}, which is not an object of a net",
                "Give both names, or none.",
            )
            return
        if module.startswith(LEFT_OUT) and kind != "function":
            self.omitted = True
            if kind == "ConstControl":
                self.constants.append(value)
            return
        if (module, kind) not in BUILT and not (module == "numpy" and NUMBERS.fullmatch(kind)):
            self._refuse(
                f"names {_cut(module)}.{_cut(kind)}, which is not an object of a net",
                "Remove it, or write the net anew with pandapower.to_json.",
            )
            return
        unknown = sorted(set(value) - SETTINGS) if "_object" in value else []
        if unknown:
            self._refuse(f"gives {kind} the setting '{_cut(unknown[0])}'", "Remove it.")
        if (module, kind) in TABLES and not _is_table(value.get("_object")):
            self._refuse(
                "has a table that is not given as JSON",
                "Write the net anew with pandapower.to_json.",
            )

    def _refuse(self, message: str, cure: str) -> None:
        self.problems.setdefault(message, Problem(self.name, message, cure))


def _may_be_json(value: object) -> TypeGuard[str]:
    """Whether a value is a text that may be JSON itself."""
    return isinstance(value, str) and value.lstrip()[:1] in ("{", "[", '"')


def _is_table(content: object) -> bool:
    """Whether a table is there as text; pandas takes another text for a path and opens it."""
    return isinstance(content, str) and content.lstrip()[:1] == "{"


def _cut(name: object) -> str:
    """A name of a stranger as far as it is needed to find it."""
    shown = "".join(c if c.isprintable() else "?" for c in str(name))
    return shown if len(shown) <= 60 else f"{shown[:60]}..."
