"""A phased run's set-points on the original circuit: node by node, each asset on its own phases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Complexes
from vppres.core.units import V_PER_KV
from vppres.feeders.dss import text as dss_text
from vppres.feeders.dss.recheck import Recheck, Tables, side_by_side, solved_steps, step_table
from vppres.physics.phases import measures
from vppres.scenario.earthing import in_island
from vppres.scenario.phases import PhaseConnection, Phases, coils_of


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
    found = solved_steps("dss/phased_day", job, script, source.name)
    voltages = _voltages(run, phases, found, former)
    return Recheck(voltages, step_table(run, found, voltages), _cause(voltages), _notes(former))


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
    served = customers.get("share", customers["served"]).astype(float)
    parts = [
        (customers, customers["p_load_kw"] * served, customers["q_load_kvar"] * served),
        (pv, -(pv["self_kw"] + pv["export_kw"]), -pv["q_kvar"]),
        (batteries, batteries["charge_kw"] - batteries["discharge_kw"], -batteries["q_kvar"]),
    ]
    frames = [
        pd.DataFrame({"time": table["time"], "id": table["id"], "p": p_kw, "q": q_kvar})
        for table, p_kw, q_kvar in parts
        if len(table)
    ]
    wide = pd.concat(frames).pivot(index="time", columns="id").loc[run["steps"]["time"]]
    p_kw, q_kvar = (wide[each][assets].to_numpy(float) for each in ("p", "q"))
    held_v = _held_v(run, phases, former)
    if former is not None:
        island = [i for i, volts in enumerate(held_v) if volts is not None]
        p_kw[island, assets.index(former)] = 0.0  # the source stands for it
        q_kvar[island, assets.index(former)] = 0.0
    return [
        {"p_kw": p, "q_kvar": q, "held_v": volts}
        for p, q, volts in zip(p_kw.tolist(), q_kvar.tolist(), held_v, strict=True)
    ]


def _held_v(run: Tables, phases: Phases, former: str | None) -> list[float | None]:
    """Volts to ground of the former's bus, step by step; None with grid or without any."""
    steps = run["steps"]
    if former is None:
        return [None] * len(steps)
    row = phases.by_bus[phases.connection(former).bus]
    nodes = run["nodes"][run["nodes"]["bus"] == row.bus]
    volts = V_PER_KV * row.kv / np.sqrt(3)
    held = (nodes.groupby("time")["v_ac_pu"].first() * volts).reindex(steps["time"])
    return [
        float(v) if outage and np.isfinite(v) else None
        for v, outage in zip(held, steps["outage"], strict=True)
    ]


def _voltages(
    run: Tables, phases: Phases, found: dict[str, Any], former: str | None
) -> pd.DataFrame:
    """Voltages of both, step by step and as limits count them; none where the plan blacks out."""
    lost = [np.nan] * 2 * len(found["nodes"])
    parts = np.array([lost if step["v"] is None else step["v"] for step in found["steps"]])
    volts: Complexes = parts[:, ::2] + 1j * parts[:, 1::2]
    names = [f"{bus}.{phase + 1}" for bus, phase in phases.nodes]
    # The source's own bus is not there.
    at_nodes = pd.DataFrame(volts.T, index=found["nodes"]).reindex(names)
    outage = run["steps"]["outage"].to_numpy(bool)
    island = phases if former is None else in_island(phases, former)
    measured = measures(phases), measures(island)
    v_pu = np.abs(
        [measured[int(dark)] @ v for dark, v in zip(outage, at_nodes.to_numpy().T, strict=True)]
    )
    v_plan_pu = run["nodes"]["v_ac_pu"].to_numpy(float).reshape(v_pu.shape)
    v_pu = np.where(np.isnan(v_plan_pu), np.nan, v_pu)
    table = side_by_side(run, phases.measured, v_pu, v_plan_pu)
    return table.assign(phase=run["nodes"]["phase"].to_numpy())


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
