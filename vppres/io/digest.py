"""A fingerprint of a scenario's content, whatever files it came from."""

from __future__ import annotations

import hashlib
import json
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.scenario.network import BUS_DRAWS, LINE_DEFAULTS, Network
from vppres.scenario.phases import Phases
from vppres.scenario.scenario import Scenario

_WITHOUT_EFFECT = {"source", "voll_gbp_per_kwh", "zone"}
"""Fields that change no result."""


def scenario_digest(scenario: Scenario) -> str:
    """SHA-256 of everything in a scenario, as 64 hexadecimal digits.

    The file format, the order of the lines and the way a number was written (``60`` or ``60.0``)
    do not matter, nor whether a default was written at all; every other value, identifier and name
    does. Where the feeder comes from, the zone of its clocks and the value of lost load do not: no
    decision depends on them.
    """
    return hashlib.sha256(_text(_canonical(scenario)).encode()).hexdigest()


def _text(canonical: Any) -> str:
    return json.dumps(canonical, sort_keys=True)


def _canonical(value: Any) -> Any:
    """Nested dictionaries, lists, text and floats."""
    if isinstance(value, Phases):
        return value.key
    if isinstance(value, Network):
        return _canonical_network(value)
    if is_dataclass(value):
        return {name: _canonical(getattr(value, name)) for name in _stated(value)}
    if isinstance(value, pd.Timestamp):
        return value.tz_convert("UTC").isoformat()
    if isinstance(value, np.ndarray) and value.ndim == 0:
        return float(value)
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_canonical(item) for item in value]
    return value if value is None or isinstance(value, str) else float(value)


def _stated(value: Any) -> list[str]:
    """Fields that are required, or say more than their default.

    So a scenario keeps its digest when vppres learns of something that the scenario has not.
    """
    given = [f for f in fields(value) if f.init and f.name not in _WITHOUT_EFFECT]
    required = [f.name for f in given if f.default is MISSING and f.default_factory is MISSING]
    # A column has its default for each item of its table.
    required += [f.name for f in given if f.name == "id" and len(value) and "id" not in required]
    without = type(value)(**{name: getattr(value, name) for name in required})

    def text_of(name: str) -> list[str]:
        return [_text(_canonical(getattr(each, name))) for each in (value, without)]

    return [f.name for f in given if f.name in required or len(set(text_of(f.name))) > 1]


def _canonical_network(network: Network) -> dict[str, Any]:
    """Limits by name, and lines and buses sorted: their order in a file means nothing."""
    stated = _stated(network)
    of_lines = [name for name in stated if name in ("r_ohm", "x_ohm", *LINE_DEFAULTS)]
    of_buses = [name for name in stated if name in (*BUS_DRAWS, "island")]
    scalars = [name for name in stated if np.ndim(getattr(network, name)) == 0]
    return {
        "lines": _rows(network, ["from_bus", "to_bus", *of_lines]),
        "buses": _rows(network, ["buses", *of_buses]) if of_buses else [],
        **{name: _canonical(getattr(network, name)) for name in scalars},
    }


def _rows(network: Network, names: list[str]) -> list[list[Any]]:
    """Columns as sorted rows."""
    columns = (_canonical(getattr(network, name)) for name in names)
    return sorted((list(row) for row in zip(*columns, strict=True)), key=str)
