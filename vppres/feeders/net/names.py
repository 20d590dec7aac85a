"""Names of a source as identifiers: such that each names one thing, and can be shown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from vppres.core.text import flaw_of_name, visible
from vppres.io.series import TIME
from vppres.scenario.network import BusId

LONGEST = 80
"""Characters of a name: identifiers have at most 100, and a number may follow."""


def bus_names(net: Any) -> dict[int, BusId]:
    """Names of the buses of a pandapower net; those without one keep their number."""
    given = net.bus["name"] if "name" in net.bus else [None] * len(net.bus)
    found = identifiers([name if isinstance(name, str) else "" for name in given], net.bus.index)
    return dict(zip(map(int, net.bus.index), found, strict=True))


def identifiers(names: Sequence[str], numbers: Sequence[object]) -> list[str]:
    """Names as identifiers: one that is missing is its number, one that others have gets it.

    The column of times is one of the others.

    >>> identifiers(["School", "Mill", "Mill", "", "time"], [3, 4, 5, 6, 7])
    ['School', 'Mill (4)', 'Mill (5)', '6', 'time (7)']
    >>> identifiers(["Mill", "Mill", "Mill (4)"], [4, 5, 6])
    ['Mill (4)', 'Mill (5)', 'Mill (4) (6)']
    """
    clean = [_clean(name) for name in names]
    numbered = [f"{name} ({number})" for name, number in zip(clean, numbers, strict=True)]
    count = Counter([*clean, *map(str, numbers), *numbered, TIME])
    return [
        str(number) if not name else name if count[name] == 1 else longer
        for name, number, longer in zip(clean, numbers, numbered, strict=True)
    ]


def _clean(name: str) -> str:
    """A name that can be shown, without what a spreadsheet would run.

    >>> _clean("=1+1"), _clean("-5"), _clean("- @Mill  ")
    ('1+1', '-5', 'Mill')
    """
    clean = visible(" ".join(name.split()))[:LONGEST].strip()
    while flaw_of_name(clean, LONGEST):
        clean = clean[1:].strip()
    return clean


def name_in(label: str) -> str:
    """The name in a label.

    >>> name_in("sgen 8 (WKA 7)")
    'WKA 7'
    """
    return label.partition("(")[2].removesuffix(")")
