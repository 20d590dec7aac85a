"""A fingerprint of a scenario's content, whatever files it came from."""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.scenario.assets import OPTIONAL, PV, Customers, PVSystems
from vppres.scenario.fairness import Fairness
from vppres.scenario.network import BUS_DRAWS, Network
from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.scenario.phases import Phases
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Headroom, Priority, Scenario

_EXPORT = {"export_limit_kw", "export_price_gbp_per_kwh"}
# What is said of a scenario and changes no result.
_WITHOUT_EFFECT = {"source", "voll_gbp_per_kwh", "zone"}


def scenario_digest(scenario: Scenario) -> str:
    """SHA-256 of everything in a scenario, as 64 hexadecimal digits.

    The file format, the order of the lines and the way a number was written (``60`` or ``60.0``)
    do not matter; every value, identifier and name does. Where the feeder comes from, the zone
    of its clocks and the value of lost load do not: no decision depends on them.
    """
    text = json.dumps(_canonical(scenario), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _canonical(value: Any) -> Any:
    """Nested dictionaries, lists, text and floats."""
    if isinstance(value, Network):
        return _canonical_network(value)
    if isinstance(value, PVSystems):
        return _canonical_pv(value)
    if isinstance(value, Phases):
        return value.key
    if is_dataclass(value):
        left_out = _WITHOUT_EFFECT
        # A connection that imports only keeps the digest from before there was another.
        if isinstance(value, Scenario) and not value.exports:
            left_out = left_out | _EXPORT
        # So does a day of which nothing was measured before.
        if isinstance(value, Scenario) and value.history is None:
            left_out = left_out | {"history"}
        # So does a balanced feeder.
        if isinstance(value, Scenario) and value.phases is None:
            left_out = left_out | {"phases"}
        # So does a run whose batteries may end empty.
        if isinstance(value, ControllerDefaults) and value.soc_end is None:
            left_out = left_out | {"soc_end"}
        # And folders that say nothing of outages ahead.
        if isinstance(value, Scenario):
            left_out = left_out | _unsaid(value)
        if isinstance(value, ControllerDefaults) and value.outages == ControllerDefaults.outages:
            left_out = left_out | {"outages"}
        # So do customers that each stand for one.
        if isinstance(value, Customers) and (value.homes == 1).all():
            left_out = left_out | {"homes"}
        # And customers that may be off for any time, and are not dimmed.
        if isinstance(value, Customers):
            left_out = left_out | {name for name in OPTIONAL if not len(getattr(value, name))}
        # Hard limits are those from before there were others.
        if isinstance(value, ControllerDefaults) and value.voltage_limits == HARD:
            left_out = left_out | {"voltage_limits"}
        # And what says nothing of restoration.
        if isinstance(value, OutageWarning | OutageStatistics):
            left_out = left_out | {
                f.name
                for f in fields(value)
                if f.name.startswith(_OF_RESTORATION) and getattr(value, f.name) is None
            }
        # So are ratings that are reported only.
        if isinstance(value, ControllerDefaults) and value.ratings == REPORT:
            left_out = left_out | {"ratings"}
        names = [f.name for f in fields(value) if f.name not in left_out]
        return {name: _canonical(getattr(value, name)) for name in names}
    if isinstance(value, pd.Timestamp):
        return value.tz_convert("UTC").isoformat()
    if isinstance(value, np.ndarray) and value.ndim == 0:
        return float(value)
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_canonical(item) for item in value]
    return value if value is None or isinstance(value, str) else float(value)


_OF_RESTORATION = ("restored_", "estimate_", "notice_")


def _unsaid(scenario: Scenario) -> set[str]:
    """What says no more than a folder without it."""
    said = {
        "warnings": bool(scenario.warnings),
        "outage_statistics": scenario.outage_statistics != OutageStatistics(),
        "priority": scenario.priority != Priority(),
        "headroom": scenario.headroom != Headroom(),
        "fairness": scenario.fairness != Fairness(),
        "interruptions": bool(scenario.interruptions),
        "chargers": bool(len(scenario.chargers)),
        "sessions": bool(len(scenario.chargers)),
    }
    return {name for name, told in said.items() if not told}


def _canonical_pv(pv: PVSystems) -> dict[str, Any]:
    """Folders whose systems are all PV, or all owned, keep their digest."""
    told = {"kind": not (pv.kind == PV).all(), "bus": pv.alone.any()}
    return {f.name: _canonical(getattr(pv, f.name)) for f in fields(pv) if told.get(f.name, True)}


def _canonical_network(network: Network) -> dict[str, Any]:
    """Limits by name and the lines sorted: their order in a file means nothing."""
    ends = [_canonical(end) for end in (network.from_bus, network.to_bus)]
    columns = [*ends, network.r_ohm.tolist(), network.x_ohm.tolist()]
    if network.has_ratings:  # folders without ratings keep their digest
        columns.append(network.i_max_a.tolist())
    columns += [getattr(network, name).tolist() for name in _own_columns(network)]
    lines = zip(*columns, strict=True)
    scalars = [f.name for f in fields(network) if f.name.endswith(("_pu", "_kv", "slack_bus"))]
    return {
        "lines": sorted((list(line) for line in lines), key=str),
        **{name: _canonical(getattr(network, name)) for name in scalars},
        **({"buses": _canonical_buses(network)} if network.has_draws else {}),
    }


def _own_columns(network: Network) -> list[str]:
    """Ratios and charging where there are any; folders without them keep their digest."""
    ratios = ["ratio"] if network.has_ratios else []
    return ratios + (["b_us", "g_us"] if network.has_charging else [])


def _canonical_buses(network: Network) -> list[list[Any]]:
    """What the buses draw by themselves, sorted."""
    columns = [getattr(network, name).tolist() for name in BUS_DRAWS]
    if not network.island.all():  # folders without such shunts keep their digest
        columns.append(network.island.tolist())
    rows = zip(_canonical(network.buses), *columns, strict=True)
    return sorted((list(row) for row in rows if any(row[1 : 1 + len(BUS_DRAWS)])), key=str)
