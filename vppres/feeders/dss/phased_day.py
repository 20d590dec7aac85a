"""The steps of a phased run in OpenDSS, asset by asset; runs in the process of the reader.

The circuit's own loads and generation are off. Every asset of the run stands on its own coils, with
its own load model, and takes what it took in the step.
"""

from __future__ import annotations

import sys
from typing import Any

import opendssdirect as dss

OFF = ("load", "pvsystem", "generator", "storage")
MODELS = {(0.0, 0.0): "model=1", (1.0, 1.0): "model=5", (2.0, 2.0): "model=2"}
ISLAND = "vppres_island"
NOTHING_FOUND = {"v": None, "import_kw": None}
"""Of a step without a solution."""

ANY_VOLTAGE = "vminpu=0.05 vmaxpu=2"


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """Complex voltages in V of all nodes in every step, or what is wrong with the circuit.

    The job has the ``commands`` of the circuit; ``assets``, each with ``bus``, ``phases`` from 1,
    ``delta``, ``kv`` and ``exponents``; and ``steps``, each with ``p_kw`` and ``q_kvar`` that the
    assets draw and, in an island, the volts to ground that ``held_v`` has at ``island_bus``.
    Capacitors at the buses of ``open`` are off there.
    """
    engine: Any = sys.modules["dss/engine"]
    problems = engine.build(job["commands"], open_deltas=True)
    if problems:
        return {"problems": problems}
    engine.settled()
    off = tuple(f"{kind}." for kind in OFF)
    for element in dss.Circuit.AllElementNames():
        if element.lower().startswith(off):
            dss.Circuit.Disable(element)
    names = [_new_asset(i, asset) for i, asset in enumerate(job["assets"])]
    if job["island_bus"] is not None:
        dss.Text.Command(
            f"new vsource.{ISLAND} bus1={job['island_bus']}.1.2.3 phases=3 basekv=1 pu=1 "
            "z1=[0,1e-9] z0=[0,1e-9] enabled=no"
        )
    nodes = _nodes()
    steps = []
    for step in job["steps"]:
        _set(job, step, names)
        steps.append(_found(nodes) if engine.solved_by_phase() else NOTHING_FOUND)
    return {"problems": [], "nodes": nodes, "steps": steps}


def _nodes() -> list[str]:
    return [name.lower() for name in dss.Circuit.AllNodeNames()]


def _found(nodes: list[str]) -> dict[str, Any]:
    """Real and imaginary part of each node's voltage, and what the source gives."""
    return {"v": _volts(nodes), "import_kw": -dss.Circuit.TotalPower()[0]}


def _volts(nodes: list[str]) -> list[float]:
    """Real and imaginary parts by node: OpenDSS orders buses anew with its sources."""
    flat = dss.Circuit.AllBusVolts()
    place = {name: i for i, name in enumerate(_nodes())}
    return [float(flat[2 * place[node] + part]) for node in nodes for part in (0, 1)]


def _new_asset(i: int, asset: dict[str, Any]) -> str:
    """A load for an asset: one for all of its coils."""
    phases = asset["phases"]
    nodes = ".".join([asset["bus"], *map(str, phases)])
    count = 1 if asset["delta"] and len(phases) == 2 else len(phases)
    between = asset["delta"] or count == 1
    kv = asset["kv"] if between else asset["kv"] * 3**0.5
    exponents = tuple(asset["exponents"])
    model = MODELS.get(exponents, f"model=4 cvrwatts={exponents[0]} cvrvars={exponents[1]}")
    conn = "delta" if asset["delta"] else "wye"
    name = f"vppres_{i}"
    dss.Text.Command(
        f"new load.{name} bus1={nodes} phases={count} conn={conn} kv={kv:.17g} {model} "
        f"kw=0 kvar=0 {ANY_VOLTAGE}"
    )
    return name


def _set(job: dict[str, Any], step: dict[str, Any], names: list[str]) -> None:
    """Source, capacitors and powers of a step."""
    island = step["held_v"] is not None
    for name in dss.Vsources.AllNames():
        on = (name == ISLAND) == island
        dss.Text.Command(f"vsource.{name}.enabled={'yes' if on else 'no'}")
    if island:
        dss.Text.Command(f"vsource.{ISLAND}.basekv={step['held_v'] * 3**0.5 / 1000.0:.17g}")
    for name in dss.Capacitors.AllNames():
        dss.Circuit.SetActiveElement(f"capacitor.{name}")
        bus = dss.CktElement.BusNames()[0].partition(".")[0].lower()
        if bus in job["open"]:
            dss.Text.Command(f"capacitor.{name}.enabled={'no' if island else 'yes'}")
    for name, p_kw, q_kvar in zip(names, step["p_kw"], step["q_kvar"], strict=True):
        dss.Loads.Name(name)
        dss.Loads.kW(p_kw)
        dss.Loads.kvar(q_kvar)
