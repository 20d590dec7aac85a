"""A decision as the service says it: set-points with their ends and defaults, and why."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any
from urllib.parse import quote

import numpy as np
import pandas as pd

from vppres.core.plain import number_or_none
from vppres.day.recorder import OFF_BY_FAULT, ROTATED
from vppres.day.trajectory import SWITCHES_OPEN
from vppres.kinds.customer.data import limits_h
from vppres.kinds.live_fields import ForeseenOfKinds
from vppres.kinds.table import parts
from vppres.live.foreseen import Foreseen
from vppres.live.measurement import Measurement
from vppres.live.set_points import SetPoints
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written
from vppres.service.of_kind import every
from vppres.service.storage.records import DECIDED, versions
from vppres.service.telemetry.knowledge import StepInputs

SCHEMA_VERSION = "1.0.0"
"""Of the plan. A sign that changes is a new first number."""

OVERLAP = 0.1
"""Share of a step for which set-points hold beyond its end, while the next ones are made."""

MOST_BEFORE = 20
"""Plans of one step that are kept beside the one that holds."""

PROPOSED = "proposed"
"""What a plan says of switches that an operator is to move."""

STORED_VALUE = "stored_value_gbp_per_kwh"

SOLVED = {
    "relative_gap": "gap",
    "objective": "objective",
    "bound": "bound",
    "seconds": "solve_s",
    STORED_VALUE: STORED_VALUE,
}
"""Numbers of a solved window as a plan names them, and as a run's steps do."""

MOST_AHEAD = 48
"""Steps that a plan tells of beside its own."""

IN_PATHS = "/:@!$&'()*+,;="
"""What stands for itself in the path of an address."""

DEFAULT = "default: "
"""How the reason of a set-point begins that was not let pass."""

CHECKED = (*DECIDED, "hold", "manual")
"""Outcomes of steps whose set-points pass the last check."""

LOST = "cannot be supplied: "
"""How the reason begins of a customer that cannot be switched on."""

DARK = "blacked out: "
"""How the reason begins of a customer in an island, or part of the feeder, that is blacked out."""

SHED = "shed: "
"""How the reason begins of a customer that the plan served and its island cannot hold."""

TOO_LITTLE = "what forms the grid cannot supply it"

Tables = Mapping[str, pd.DataFrame]  # set-points by kind of device, each by identifier


Told = Mapping[tuple[str, str], Mapping[str, Any]]  # set-points by kind and identifier


@dataclass(frozen=True)
class Left:
    """State in which devices are left where no plan comes: the grid, and their last set-points."""

    available: bool = True  #: whether there is grid
    known_by: str = "profile"  #: who says so
    told: Told = field(default_factory=dict)  #: set-points that devices had last

    @property
    def grid(self) -> dict[str, Any]:
        """State of the grid in the words of plans."""
        return {"available": self.available, "known_by": self.known_by}


def told_at(plan: Mapping[str, Any], time: pd.Timestamp) -> Told:
    """Set-points of the last plan, or the defaults once it is over."""
    return {(one["kind"], one["asset"]): at(one, time) for one in plan.get("setpoints", ())}


def plan_of(
    decision: SetPoints,
    scenario: Scenario,
    known: StepInputs,
    refused: Mapping[tuple[str, str], str],
    left: Left,
) -> dict[str, Any]:
    """The plan of a step that was decided."""
    solve = decision.solve
    fallback = None if solve["fallback"] == "none" else solve["fallback"]
    reason = fallback or ("corrected" if solve["corrected"] else "plan")
    shed = shed_in(decision)
    own = {("customers", name): f"{SHED}{why}" for name, why in shed.items()}
    own |= {("customers", name): f"{DARK}{why}" for name, why in off_by_fault(decision).items()}
    own |= {("customers", name): f"{LOST}{why}" for name, why in known.lost.items()}
    return {
        **_head(decision.time, scenario, "ok" if fallback is None else "fallback"),
        "inputs_digest": f"sha256:{inputs_digest(known.measurement)}",
        "solve": _solved(decision, fallback),
        "grid": left.grid,
        "estimated": [
            *(words for words in str(solve["estimated"]).split("; ") if words),
            *known.estimated,
        ],
        **({"asked_again": [known.again]} if known.again else {}),
        "late": [one for one in known.latest.heard if one["state"] != "ok"],
        "lost": [{"asset": name, "reason": why} for name, why in known.lost.items()],
        "shed": [{"asset": name, "reason": why} for name, why in shed.items()],
        "setpoints": _set_points(
            decision.time, scenario, left, tables_of(decision, scenario), refused, reason, own
        ),
        "expected": {
            "import_kw": number_or_none(decision.import_kw),
            "soc_start": _by_name(decision.batteries["soc"]),
            "soc": _by_name(decision.batteries["soc_end"]),
            **_extremes(decision),
            "grid_limit_kw": number_or_none(known.limits_kw.iloc[0]),
            "price_gbp_per_kwh": _price(known.measurement),
            **_devices_expected(decision),
            **_by_phase(decision),
        },
        "ahead": _ahead(decision.foreseen, known),
        "off_h": _off_h(decision, scenario),
        **_switching(decision, scenario),
    }


def _solved(decision: SetPoints, fallback: str | None) -> dict[str, Any]:
    """How the window was solved, and what decided in its place."""
    solve, customers = decision.solve, decision.customers
    return {
        "status": str(solve["status"]),
        **{name: number_or_none(solve.get(own, math.nan)) for name, own in SOLVED.items()},
        "outage_messages": str(solve.get("outage_messages", "")) or None,
        ROTATED: _by_name(customers[ROTATED]) if ROTATED in customers else None,
        **{name: solve.get(name) for name in ("levels", "inverted", "shorter")},
        "dark_reason": solve.get("dark_reason") or None,
        "fallback": fallback,
        "fallback_reason": solve["fallback_reason"] or None,
        "correction_reason": solve["reason"] or None,
    }


def _switching(decision: SetPoints, scenario: Scenario) -> dict[str, Any]:
    """Lines and ties that are open, and switches that an operator is to move.

    Empty where plans do not follow switches.
    """
    if not scenario.follows_switches:
        return {}
    proposal = decision.proposal
    told = {PROPOSED: asdict(proposal)} if proposal.operations else {}
    return {SWITCHES_OPEN: [*decision.switches_open], **told}


def shed_in(decision: SetPoints) -> dict[str, str]:
    """Customers that the plan served and that its island cannot hold, and why."""
    solve, c = decision.solve, decision.customers
    if solve.get("dark_reason"):
        return {}
    why = str(solve.get("ac_failed") or "") or TOO_LITTLE
    return {str(name): why for name in c.index[c["shed"].astype(bool)]}


def off_by_fault(decision: SetPoints) -> dict[str, str]:
    """Customers in parts of the feeder that a fault blacks out, and why."""
    c = decision.customers
    if OFF_BY_FAULT not in c:
        return {}
    return {str(name): str(why) for name, why in c[OFF_BY_FAULT].items() if why}


def tables_of(decision: SetPoints, scenario: Scenario) -> Tables:
    """Tables of a decision, by kind of device."""
    return {kind: getattr(decision, kind) for kind in _defaults(scenario)}


def defaults_of(
    time: pd.Timestamp, scenario: Scenario, status: str, reason: str, left: Left
) -> dict[str, Any]:
    """The plan of a step in which nothing was decided: every device does its default."""
    return {
        **_head(time, scenario, status),
        "inputs_digest": None,
        "solve": None,
        "reason": reason,
        "grid": left.grid,
        "estimated": [],
        "late": [],
        "lost": [],
        "setpoints": _set_points(time, scenario, left, {}, {}, reason),
        "expected": None,
        "ahead": None,
    }


def ordered(
    scenario: Scenario, before: Mapping[str, Any], asked: Iterable[Mapping[str, Any]]
) -> Tables:
    """The last plan's set-points, the operator's over them, defaults where there are none."""
    told = {(one["kind"], one["asset"]): one for one in before.get("setpoints", ())}
    over = {(one["kind"], one["asset"]): _asked(one) for one in asked}
    tables = {}
    for kind, defaults in _defaults(scenario).items():
        rows = {}
        for name, default in defaults.items():
            now = {**default, **over.get((kind, name), told.get((kind, name), {}))}
            rows[name] = {field: now[field] for field in default}
        tables[kind] = pd.DataFrame.from_dict(rows, orient="index")
    # The available PV power is not known here; a system feeds what it has.
    tables["pv"]["available_kw"] = scenario.pv.p_max_kw
    return tables


def _asked(one: Mapping[str, Any]) -> dict[str, Any]:
    """Operator's set-point of a device, and its consequences."""
    said = {name: value for name, value in one.items() if value is not None}
    kind = every().get(one["kind"])
    return said | kind.asked(said) if kind else said


def ordered_plan(
    time: pd.Timestamp,
    scenario: Scenario,
    mode: Mapping[str, Any],
    tables: Tables,
    refused: Mapping[tuple[str, str], str],
    left: Left,
) -> dict[str, Any]:
    """The plan of a step that an operator decided."""
    reason = mode["reason"] or mode["mode"]
    plan = defaults_of(time, scenario, mode["mode"], reason, left)
    return {**plan, "setpoints": _set_points(time, scenario, left, tables, refused, reason)}


def made_anew(
    plan: Mapping[str, Any], at: pd.Timestamp, why: str, before: Mapping[str, Any]
) -> dict[str, Any]:
    """A plan of the rest of a step, instead of one that did not know why; it is kept beside."""
    begin = written(at)
    points = [
        {**one, "id": _id(begin, one["kind"], one["asset"]), "valid_from": begin, "anew": why}
        for one in plan["setpoints"]
    ]
    kept = ("id", "valid_from", "status", "setpoints", "grid", SWITCHES_OPEN)
    said = {name: before[name] for name in kept if name in before}
    return {
        **plan,
        "id": f"p-{begin}",
        "valid_from": begin,
        "anew": why,
        "setpoints": points,
        "before": [*before.get("before", []), said][-MOST_BEFORE:],
    }


def points_at(plan: Mapping[str, Any], time: pd.Timestamp) -> list[dict[str, Any]]:
    """Set-points of a step as they hold at a time; none without a plan."""
    if not plan:
        return []
    said = versions(plan)
    begun = [one for one in said if pd.Timestamp(one.get("valid_from", plan["start"])) <= time]
    return [at(one, time) for one in (begun or said[:1])[-1]["setpoints"]]


def refused_of(plan: Mapping[str, Any]) -> list[dict[str, str]]:
    """Set-points of a plan that the last check did not let pass, and why."""
    if plan.get("status") not in CHECKED:
        return []
    return [
        {"asset": one["asset"], "reason": one["reason"].removeprefix(DEFAULT)}
        for one in plan["setpoints"]
        if one["reason"].startswith(DEFAULT)
    ]


def etag(plan: Mapping[str, Any]) -> str:
    """Name of the content."""
    text = json.dumps(plan, sort_keys=True)
    return f'"{hashlib.sha256(text.encode()).hexdigest()[:32]}"'


def _ahead(foreseen: Foreseen, known: StepInputs) -> dict[str, Any]:
    """Outlook on the steps after this one, which are decided anew when they begin."""
    times = foreseen.import_kw.index[:MOST_AHEAD]
    limits_kw = dict(zip(known.limits_kw.index, known.limits_kw.to_numpy(float), strict=True))
    of_kinds = {f.name: getattr(foreseen, f.name) for f in fields(ForeseenOfKinds)}
    tables = {"soc": foreseen.soc_end} | {
        name: table for name, table in of_kinds.items() if table is not None
    }
    return {
        "times": [written(time) for time in times],
        "grid_limit_kw": _numbers(limits_kw.get(time, math.nan) for time in times),
        "import_kw": _numbers(foreseen.import_kw[:MOST_AHEAD]),
        "served": {name: on.tolist() for name, on in foreseen.served[:MOST_AHEAD].items()},
        **{quantity: _table(table) for quantity, table in tables.items()},
    }


def _table(table: pd.DataFrame) -> dict[str, Any]:
    """Numbers of each asset by time; of a table that is not by time the row of each asset."""
    if isinstance(table.index, pd.DatetimeIndex):
        return {str(name): _numbers(values) for name, values in table[:MOST_AHEAD].items()}
    rows = table.to_dict(orient="index").items()
    return {
        str(name): {
            field: written(value) if isinstance(value, pd.Timestamp) else value
            for field, value in row.items()
        }
        for name, row in rows
    }


def _devices_expected(decision: SetPoints) -> dict[str, Any]:
    """Expected values of the units of each kind; empty without any."""
    found: dict[str, Any] = {}
    for kind, live in parts("live").items():
        rows = getattr(decision, kind)
        found |= {} if rows is None else live.expected(rows)
    return found


def _off_h(decision: SetPoints, scenario: Scenario) -> dict[str, float]:
    """How long customers with a longest time off are off by the end of the step, if they are."""
    if "off_h" not in decision.customers:
        return {}
    off_h = decision.customers["off_h"].loc[[*limits_h(scenario)]]
    return {str(name): float(hours) for name, hours in off_h.items() if hours > 0.0}


def inputs_digest(measured: Measurement) -> str:
    """SHA-256 of a measurement."""
    digest = hashlib.sha256()
    for f in fields(measured):
        value = getattr(measured, f.name)
        if isinstance(value, (pd.DataFrame, pd.Series)):
            digest.update(np.ascontiguousarray(value.to_numpy(float)).tobytes())
        else:
            text = sorted(value.items()) if isinstance(value, dict) else str(value)
            digest.update(f"{f.name} {text}".encode())
    return digest.hexdigest()


def at(setpoint: Mapping[str, Any], time: pd.Timestamp) -> dict[str, Any]:
    """A set-point as it holds at a time: itself, or its default when it is over."""
    begun = pd.Timestamp(setpoint["valid_from"]) <= time
    active = begun and time < pd.Timestamp(setpoint["valid_until"])
    return {**setpoint, **({} if active else setpoint["default"]), "active": active}


def _head(time: pd.Timestamp, scenario: Scenario, status: str) -> dict[str, Any]:
    minutes = scenario.grid.step_minutes
    return {
        "schema_version": SCHEMA_VERSION,
        "id": f"p-{written(time)}",
        "status": status,
        "start": written(time),
        "valid_from": written(time),
        "resolution": f"PT{minutes:g}M" if minutes % 60 else f"PT{minutes / 60:g}H",
        "site_time_zone": scenario.grid.zone,
    }


def _set_points(
    time: pd.Timestamp,
    scenario: Scenario,
    left: Left,
    tables: Tables,
    refused: Mapping[tuple[str, str], str],
    reason: str,
    reasons: Mapping[tuple[str, str], str] | None = None,
) -> list[dict[str, Any]]:
    """Set-point of each device, its end, and the default that follows.

    A few devices have ``reasons`` of their own; what is ``refused``, and why, is not said. Without
    tables every device does its default.
    """
    begin, end = written(time), written(time + (1.0 + OVERLAP) * scenario.grid.step)
    phases = scenario.phases
    points = []
    for kind, defaults in _defaults(scenario).items():
        rows = tables[kind].to_dict(orient="index") if tables and kind in tables else {}
        for name, default in defaults.items():
            by_default = not tables or (kind, name) in refused
            row: Mapping[Any, Any] = {} if by_default else rows[name]
            if by_default and not (kind == "batteries" and tables):
                row = left.told.get((kind, name), {})
            if not left.available:
                default = _kept(kind, default, row)
            why = (reasons or {}).get((kind, name), reason)
            if by_default:
                why = f"{DEFAULT}{refused.get((kind, name), reason)}"
            points.append(
                {
                    "id": _id(begin, kind, name),
                    "asset": name,
                    "kind": kind,
                    **({"phases": phases.connection(name).coils} if phases else {}),
                    **(default if by_default else _like(default, row)),
                    **({"sign": _SIGNS[kind]} if kind in _SIGNS else {}),
                    "valid_from": begin,
                    "valid_until": end,
                    "default": default,
                    "reason": why,
                }
            )
    return points


def _id(begin: str, kind: str, name: str) -> str:
    """Identifier of a set-point, which can be written in an address as it is."""
    return f"{begin}/{kind}/{quote(name, safe=IN_PATHS)}"


def _kept(kind: str, default: Mapping[str, Any], told: Mapping[Any, Any]) -> dict[str, Any]:
    """The default of a device in an island: its last set-point, so that nothing is switched.

    A PV system that was not curtailed goes on feeding what it has.
    """
    free = kind == "pv" and not told.get("curtailed_kw")
    return {**default, **({} if free else _like(default, told))}


def _like(default: Mapping[str, Any], row: Mapping[Any, Any]) -> dict[str, Any]:
    """Fields of a row that a default also has."""
    return {field: type(value)(row[field]) for field, value in default.items() if field in row}


_SIGNS = {
    "batteries": "charging_positive",
    "pv": "injection_positive",
    **{name: kind.direction for name, kind in every().items() if kind.direction},
}


def _defaults(scenario: Scenario) -> dict[str, dict[str, dict[str, Any]]]:
    """Defaults of devices: batteries and sets rest, PV systems feed, rooms are in band.

    By kind and identifier; of kinds that are no part of every site only those that there are.
    """
    pv, customers = scenario.pv, scenario.customers
    found: dict[str, dict[str, dict[str, Any]]] = {
        "batteries": {str(name): {"p_kw": 0.0, "q_kvar": 0.0} for name in scenario.batteries.id},
        "pv": {
            str(name): {"p_kw": float(p_kw), "q_kvar": 0.0, "curtailed_kw": 0.0}
            for name, p_kw in zip(pv.id, pv.p_max_kw, strict=True)
        },
        "customers": {
            str(name): {"served": True} | ({"share": 1.0} if dimmable else {})
            for name, dimmable in zip(customers.id, customers.dimmable, strict=True)
        },
    }
    further = {kind: live.defaults(scenario) for kind, live in parts("live").items()}
    return found | {kind: each for kind, each in further.items() if each}


def _price(measured: Measurement) -> float | None:
    """Import price of the step."""
    prices = measured.price_gbp_per_kwh
    return number_or_none(prices.iloc[0]) if isinstance(prices, pd.Series) else None


def _by_phase(decision: SetPoints) -> dict[str, Any]:
    """Expected values of each phase; empty without phases and without power."""
    found = decision.by_phase
    if not found:
        return {}
    return {
        "phases": {
            "source": found.source,
            "source_kva": {str(phase): float(kva) for phase, kva in found.source_kva.items()},
            "rating_kva": found.rating_kva,
            "v_pu": {phase: list(ends) for phase, ends in found.v_pu.items()},
            "unbalance_max": number_or_none(found.unbalance_max),
            "nearest": vars(found.nearest),
        }
    }


def _extremes(decision: SetPoints) -> dict[str, Any]:
    """Lowest and highest voltage of any bus, or node of a phased feeder; no bus in a blackout."""
    low = high = decision.buses["v_ac_pu"]
    if decision.by_phase:
        at_bus = decision.by_phase.nodes.groupby(level="bus")
        low, high = at_bus.min(), at_bus.max()
    return {
        "v_min_pu": number_or_none(low.min()),
        "v_max_pu": number_or_none(high.max()),
        "v_min_bus": None if low.isna().all() else str(low.idxmin()),
    }


def _by_name(column: pd.Series[float]) -> dict[str, float | None]:
    """Numbers by asset."""
    return {str(name): number_or_none(value) for name, value in column.items()}


def _numbers(values: Iterable[Any]) -> list[float | None]:
    return [number_or_none(value) for value in values]
