"""A phased run's set-points on the original circuit: node by node, each asset on its own phases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Complexes, Floats
from vppres.core.errors import InputError
from vppres.feeders.dss import text as dss_text
from vppres.feeders.dss.circuit import located
from vppres.feeders.dss.recheck import STEPS_PER_S, Recheck, Tables
from vppres.feeders.strangers.confined import TIME_LIMIT_S, confined
from vppres.scenario.phases import PHASES, PhaseConnection, Phases, coils_of

V_PER_KV = 1000.0


def recheck_phased(run: Tables, phases: Phases, source: Path, former: str | None) -> Recheck:
    """Solve the steps of a phased run on the circuit of an OpenDSS script.

    Parameters
    ----------
    run : mapping of DataFrame
        Tables of a finished run.
    phases : Phases
        The scenario's.
    source : Path
        The script that it was made from.
    former : str, optional
        The battery that holds islands.

    Raises
    ------
    InputError
        If the script cannot be read.
    """
    script = dss_text.read_script(source)
    assets = [*_ids(run, "customers"), *_ids(run, "pv"), *_ids(run, "batteries")]
    rows = [phases.connection(name) for name in assets]
    job = {
        "commands": [command.text for command in script.commands],
        "assets": [_asset(row) for row in rows],
        "steps": _steps(run, phases, assets, former),
        "island_bus": None if former is None else phases.connection(former).bus,
        "open": [row.bus for row in phases.shunts if row.island == "no"],
    }
    limit_s = TIME_LIMIT_S + len(run["steps"]) / STEPS_PER_S
    found = confined("dss/phased_day", job, source.name, limit_s)
    if found["problems"]:
        raise InputError([located(problem, script, source.name) for problem in found["problems"]])
    voltages = _voltages(run, phases, found)
    return Recheck(voltages, _step_table(run, found, voltages), _cause(voltages), _notes(former))


def _ids(run: Tables, table: str) -> list[str]:
    return [str(name) for name in pd.unique(run[table]["id"])]


def _asset(row: PhaseConnection) -> dict[str, Any]:
    """How OpenDSS connects an asset's coils."""
    coils = coils_of(row.coils)
    delta = coils[0][1] is not None
    ends = [first for first, _ in coils]
    if delta and len(coils) == 1:
        ends = [end for end in coils[0] if end is not None]
    exponents = [row.p_exponent, row.q_exponent]
    phases = [end + 1 for end in ends]
    return {"bus": row.bus, "phases": phases, "delta": delta, "kv": row.kv, "exponents": exponents}


def _steps(
    run: Tables, phases: Phases, assets: list[str], former: str | None
) -> list[dict[str, Any]]:
    """What each asset draws in every step, and the voltage that a battery holds in islands."""
    customers, pv, batteries = run["customers"], run["pv"], run["batteries"]
    served = customers["served"].astype(float)
    parts = [
        (customers, customers["p_load_kw"] * served, customers["q_load_kvar"] * served),
        (pv, -(pv["self_kw"] + pv["export_kw"]), -pv["q_kvar"]),
        (batteries, batteries["charge_kw"] - batteries["discharge_kw"], -batteries["q_kvar"]),
    ]
    tables = []
    for column in (1, 2):
        wide = [
            pd.DataFrame({"time": part[0]["time"], "id": part[0]["id"], "x": part[column]})
            for part in parts
            if len(part[0])
        ]
        whole = pd.concat(wide).pivot_table(index="time", columns="id", values="x")
        tables.append(whole[assets])
    held = _held_v(run, phases, former)
    own = None if former is None else assets.index(former)
    steps = []
    for time, outage in run["steps"][["time", "outage"]].itertuples(index=False):
        p, q = (table.loc[time].to_numpy(float).copy() for table in tables)
        island = bool(outage) and time in held
        if island and own is not None:
            p[own] = q[own] = 0.0  # the source stands for it
        steps.append(
            {"p_kw": p.tolist(), "q_kvar": q.tolist(), "held_v": held[time] if island else None}
        )
    return steps


def _held_v(run: Tables, phases: Phases, former: str | None) -> dict[Any, float]:
    """Volts to ground of the former's bus in steps without grid that have any."""
    if former is None:
        return {}
    row = phases.by_bus[phases.connection(former).bus]
    nodes = run["nodes"][run["nodes"]["bus"] == row.bus]
    outages = set(run["steps"].loc[run["steps"]["outage"].astype(bool), "time"])
    volts = V_PER_KV * row.kv / np.sqrt(3)
    first = nodes.groupby("time")["v_ac_pu"].first().dropna()
    return {time: float(v) * volts for time, v in first.items() if time in outages}


def _voltages(run: Tables, phases: Phases, found: dict[str, Any]) -> pd.DataFrame:
    """Voltages of both, step by step and as limits count them."""
    place = {name: i for i, name in enumerate(found["nodes"])}
    plan = run["nodes"].groupby("time")["v_ac_pu"].apply(np.array)
    labels = phases.measured
    tables = []
    for step, (time, outage) in zip(
        found["steps"], run["steps"][["time", "outage"]].itertuples(index=False), strict=True
    ):
        v: Floats = np.full(len(labels), np.nan)
        if step["v"] is not None:
            flat = np.array(step["v"])
            volts: Complexes = flat[::2] + 1j * flat[1::2]
            v = np.array([_measured(phases, place, volts, *label) for label in labels])
        planned = plan.loc[time]
        dark = np.isnan(planned)
        tables.append(
            pd.DataFrame(
                {
                    "time": time,
                    "outage": bool(outage),
                    "bus": [bus for bus, _ in labels],
                    "phase": [phase for _, phase in labels],
                    "v_pu": np.where(dark, np.nan, v),
                    "v_plan_pu": planned,
                }
            )
        )
    voltages = pd.concat(tables, ignore_index=True)
    return voltages.assign(difference_pu=voltages["v_pu"] - voltages["v_plan_pu"])


def _measured(
    phases: Phases, place: dict[str, int], volts: Complexes, bus: str, word: str
) -> float:
    """A voltage in pu as its limits count it; NaN for the source's own bus, which is not there."""
    names = [f"{bus}.{PHASES.index(letter) + 1}" for letter in word]
    if not all(name in place for name in names):
        return np.nan
    v = volts[place[names[0]]]
    if len(names) == 2:
        return float(abs(v - volts[place[names[1]]]) / (V_PER_KV * phases.by_bus[bus].kv))
    return float(abs(v) * np.sqrt(3) / (V_PER_KV * phases.by_bus[bus].kv))


def _step_table(run: Tables, found: dict[str, Any], voltages: pd.DataFrame) -> pd.DataFrame:
    largest = voltages["difference_pu"].abs().groupby(voltages["time"]).max()
    imported = [np.nan if s["import_kw"] is None else s["import_kw"] for s in found["steps"]]
    return pd.DataFrame(
        {
            "time": run["steps"]["time"].to_numpy(),
            "outage": run["steps"]["outage"].to_numpy(bool),
            "import_kw": np.array(imported, dtype=float),
            "import_plan_kw": run["steps"]["p_grid_kw"].to_numpy(float),
            "difference_max_pu": largest.reindex(run["steps"]["time"]).to_numpy(),
        }
    )


def _cause(voltages: pd.DataFrame) -> str:
    """How close the two are, islands too."""
    largest = float(voltages["difference_pu"].abs().max())
    return (
        f"Every asset is on its own phases: voltages, also of islands, differ by {largest:.1g} pu."
    )


def _notes(former: str | None) -> tuple[str, ...]:
    stays = "Regulators stay as in the scenario; loads and generation of the script are off."
    if former is None:
        return (stays,)
    return stays, f"In islands a source stands at battery {former}, at the voltage that it holds."
