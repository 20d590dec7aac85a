"""A phased run's set-points on the original circuit: node by node, each asset on its own phases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import VerificationError
from vppres.core.units import V_PER_KV
from vppres.feeders.closeness import extreme_steps_by_phase
from vppres.feeders.dss.circuit import OWN_SOURCES, OpenDSSFlow, solved_job
from vppres.feeders.dss.recheck import (
    Recheck,
    Tables,
    drawn,
    held_v,
    side_by_side,
    solved_steps,
    step_jobs,
    step_table,
)
from vppres.feeders.feeder import ImportedFeeder
from vppres.feeders.new.connections import customer_of
from vppres.physics.phased_sources import assets_of, flow_of_grid
from vppres.physics.phases import measures
from vppres.scenario.earthing import in_island
from vppres.scenario.phases import PhaseConnection, Phases, coils_of
from vppres.scenario.scenario import Scenario


def recheck_phased(run: Tables, phases: Phases, source: Path, former: str | None) -> Recheck:
    """Solve the steps of a phased run on the circuit of an OpenDSS script.

    As :func:`vppres.feeders.dss.recheck.recheck_opendss`; ``former`` is the device that holds
    islands, None without any.
    """
    assets = [str(name) for name in pd.unique(drawn(run)["id"])]
    rows = [phases.connection(name) for name in assets]
    job = {
        "off": ("load", *OWN_SOURCES),
        "open_deltas": True,
        "assets": [_asset(row) for row in rows],
        "steps": _steps(run, phases, assets, former),
        "island_bus": None if former is None else phases.connection(former).bus,
        "open": [row.bus for row in phases.shunts if row.island == "no"],
        "taps": {
            unit.id: (unit.to_tap, unit.island_tap)
            for unit in phases.transformers
            if unit.island_tap is not None
        },
    }
    found = solved_steps(job, source)
    voltages = _voltages(run, phases, found, former)
    apart_pu = float(voltages["difference_pu"].abs().max())
    cause = (
        f"Every asset is on its own phases: voltages, also of islands, differ by {apart_pu:.1g} pu."
    )
    notes = ["Regulators are as in the scenario; loads and generation of the script are off."]
    if former is not None:
        notes.append(f"In islands a source stands at {former}, at the voltage that it holds.")
    return Recheck(voltages, step_table(run, found, voltages), cause, tuple(notes))


def worst_hour_by_phase(feeder: ImportedFeeder, scenario: Scenario) -> float | None:
    """Largest difference of a node's voltage in the hours of most and least demand.

    OpenDSS has its own loads there, with their models and limits of voltage, and what the scenario
    has besides. None where a power flow has no solution.
    """
    source, phases, flow = feeder.phased, scenario.phases, feeder.source_flow
    assert source is not None
    if not isinstance(flow, OpenDSSFlow):
        return None
    names = assets_of(scenario)
    loads = {customer_of(load.connection.id): load.connection.id for load in source.loads}
    own = [str(each) for each in scenario.customers.id]
    assets = [
        {"load": loads[each]} if each in own else _asset(phases.connection(each)) for each in names
    ]
    powers = [(p_kw, q_kvar) for _, p_kw, q_kvar in extreme_steps_by_phase(scenario)]
    steps = [{"p_kw": p.tolist(), "q_kvar": q.tolist(), "held_v": None} for p, q in powers]
    job = {"off": OWN_SOURCES, "open_deltas": True, "assets": assets, "steps": steps}
    job |= {"disabled": flow.disabled, **flow.job}
    found = solved_job(job, feeder.name)
    own_flow = flow_of_grid(phases, names, scenario.network.v_slack_pu)
    base_v = np.array([V_PER_KV * phases.by_bus[bus].kv / np.sqrt(3) for bus, _ in phases.nodes])
    at = {node: i for i, node in enumerate(found["nodes"])}
    places = [(i, at.get(f"{bus}.{phase + 1}")) for i, (bus, phase) in enumerate(phases.nodes)]
    both = np.array([(i, other) for i, other in places if other is not None])
    apart = []
    for (p_kw, q_kvar), theirs in zip(powers, found["v"], strict=True):
        try:
            v = own_flow.solve(p_kw, q_kvar).v
        except VerificationError:
            return None
        off = np.abs(np.abs(v[both[:, 0]]) - np.abs(theirs[both[:, 1]])) / base_v[both[:, 0]]
        apart.append(float(off.max()))
    return None if np.isnan(apart).any() else max(apart)


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
    """Power of each asset in every step, and the voltage that is held in islands."""
    wide = drawn(run).pivot(index="time", columns="id", values=["p", "q"])
    p_kw, q_kvar = (wide[each][assets] for each in ("p", "q"))
    bus = None if former is None else phases.by_bus[phases.connection(former).bus]
    base_v = np.nan if bus is None else V_PER_KV * bus.kv / np.sqrt(3)
    held = held_v(run, "nodes", None if bus is None else bus.bus, base_v)
    if former is not None:
        island = held.dropna().index
        p_kw.loc[island, former] = q_kvar.loc[island, former] = 0.0  # the source stands for it
    return step_jobs(run["steps"]["time"], p_kw, q_kvar, held)


def _voltages(
    run: Tables, phases: Phases, found: dict[str, Any], former: str | None
) -> pd.DataFrame:
    """Voltages of both, step by step and as limits count them; none where the plan blacks out."""
    names = [f"{bus}.{phase + 1}" for bus, phase in phases.nodes]
    # The source's own bus is not there.
    at_nodes = pd.DataFrame(found["v"].T, index=found["nodes"]).reindex(names)
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
