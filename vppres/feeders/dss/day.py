"""The steps of a run in OpenDSS, on the circuit as it was written: all phases, no balancing.

Runs in the process of :mod:`vppres.feeders.strangers.child`, where the engine that builds circuits
is loaded before it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import opendssdirect as dss

from vppres.feeders.dss import engine
from vppres.feeders.dss.elements import PHASES, Circuit, buses

MODELS = {(0.0, 0.0): "model=1", (1.0, 1.0): "model=5", (2.0, 2.0): "model=2"}
ISLAND = "vppres_island"
NOTHING_FOUND = {"v": None, "import_kw": None}
"""Of a step without a solution."""

# Set-points hold at any voltage; OpenDSS makes impedances of loads beyond these.
ANY_VOLTAGE = "vminpu=0.05 vmaxpu=2"


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """Complex voltages in V of all nodes in every step, or what is wrong with the circuit.

    The job has the ``commands`` of the circuit; the classes that are ``off``; ``assets``, each a
    ``load`` of the circuit, or a new one at ``bus`` with ``phases`` from 1, ``delta``, ``kv`` and
    ``exponents``, or of constant power on all phases of its bus; and ``steps``, each with ``p_kw``
    and ``q_kvar`` that the assets draw and, in an island, the volts to ground that ``held_v`` has
    at ``island_bus``. Capacitors at the buses of ``open`` are off there, and ``taps``
    of second windings are those with the grid and there. With ``constant_power`` the circuit's
    loads keep their power at any voltage, and ``v_slack_pu`` is what its source holds.
    """
    circuit, problems = engine.build(job)
    if problems:
        return {"problems": problems}
    engine.settled(circuit)  # the taps of the plan are those of the state that the file gives
    dss.Text.Command("set loadmult=1 year=0")  # powers of the steps are what is drawn
    if job.get("v_slack_pu") is not None:
        dss.Vsources.Name("source")
        source = buses()[0]
        dss.Vsources.PU(job["v_slack_pu"] * circuit.base_kv(source) / dss.Vsources.BasekV())
    for element in job.get("disabled", ()):
        dss.Circuit.Disable(element)
    switched_off = list(_switch_off(job["off"]))
    names = [
        asset.get("load") or _new_asset(circuit, i, asset) for i, asset in enumerate(job["assets"])
    ]
    if job.get("constant_power"):
        for name in dss.Loads.AllNames():
            dss.Text.Command(f'edit "load.{name}" model=1 {ANY_VOLTAGE}')
    island = _new_source(job.get("island_bus"))
    nodes = [*circuit.volts()]
    steps = []
    for step in job["steps"]:
        _set(job, step, names, island)
        steps.append(_found(circuit, nodes) if engine.solved_by_phase() else NOTHING_FOUND)
    return {
        "problems": [],
        "nodes": nodes,
        "switched_off": switched_off,
        "island": island,
        "steps": steps,
    }


def _switch_off(kinds: list[str]) -> Iterator[str]:
    """Elements of the circuit's own, for which the run has its own."""
    for element in dss.Circuit.AllElementNames():
        if element.lower().startswith(tuple(f"{kind}." for kind in kinds)):
            dss.Circuit.SetActiveElement(element)
            if dss.CktElement.Enabled():
                dss.Circuit.Disable(element)
                yield element.lower()


def _new_asset(circuit: Circuit, i: int, asset: dict[str, Any]) -> str:
    """A load for an asset: one for all of its coils; from leg to leg where there are two."""
    dss.Circuit.SetActiveBus(asset["bus"])
    if asset["bus"] in circuit.legs:
        _, signs = circuit.legs[asset["bus"]]
        legs = [node for node in signs if node in dss.Bus.Nodes()]
        share = len(legs) / len(signs)  # a leg alone has half of the voltage
        kv = asset.get("kv") or 2.0 * dss.Bus.kVBase()
        return _new_load(i, asset, legs, False, 1, share * kv)
    phases = asset.get("phases") or [node for node in dss.Bus.Nodes() if node in PHASES]
    # Where the neutral is a conductor, nothing may hold the phases against ground.
    floats = "phases" not in asset and len(phases) > 2 and max(dss.Bus.Nodes()) > max(PHASES)
    delta = asset.get("delta", floats)
    count = 1 if delta and len(phases) == 2 else len(phases)
    kv = asset.get("kv") or dss.Bus.kVBase()
    if (not delta and count > 1) or floats:
        kv *= 3**0.5
    return _new_load(i, asset, phases, delta, count, kv)


def _new_load(
    i: int, asset: dict[str, Any], phases: list[int], delta: bool, count: int, kv: float
) -> str:
    """A load at some nodes of a bus."""
    exponents = tuple(asset.get("exponents", (0.0, 0.0)))
    model = MODELS.get(exponents, f"model=4 cvrwatts={exponents[0]} cvrvars={exponents[1]}")
    name = f"vppres_{i}"
    dss.Text.Command(
        f"new load.{name} bus1={'.'.join([asset['bus'], *map(str, phases)])} phases={count} "
        f"conn={'delta' if delta else 'wye'} kv={kv:.17g} {model} kw=0 kvar=0 {ANY_VOLTAGE}"
    )
    return name


def _new_source(bus: str | None) -> bool:
    """A stiff source at a bus, off at first; whether the bus has the three phases for it."""
    if bus is None:
        return False
    dss.Circuit.SetActiveBus(bus)
    if not {*PHASES} <= {*dss.Bus.Nodes()}:
        return False
    dss.Text.Command(
        f"new vsource.{ISLAND} bus1={bus}.1.2.3 phases=3 basekv=1 pu=1 z1=[0,1e-9] z0=[0,1e-9] "
        "enabled=no"
    )
    return True


def _set(job: dict[str, Any], step: dict[str, Any], names: list[str], island: bool) -> None:
    """Source, capacitors and powers of a step."""
    held = island and step["held_v"] is not None
    for name in dss.Vsources.AllNames():
        on = (name == ISLAND) == held
        dss.Text.Command(f"vsource.{name}.enabled={'yes' if on else 'no'}")
    if held:
        dss.Text.Command(f"vsource.{ISLAND}.basekv={step['held_v'] * 3**0.5 / 1000.0:.17g}")
    for name in dss.Capacitors.AllNames():
        dss.Circuit.SetActiveElement(f"capacitor.{name}")
        if buses()[0] in job.get("open", ()):
            dss.Text.Command(f"capacitor.{name}.enabled={'no' if held else 'yes'}")
    for name, taps in job.get("taps", {}).items():
        dss.Text.Command(f'edit "transformer.{name}" wdg=2 tap={taps[held]:.17g}')
    for name, p_kw, q_kvar in zip(names, step["p_kw"], step["q_kvar"], strict=True):
        dss.Loads.Name(name)
        dss.Loads.kW(p_kw)
        dss.Loads.kvar(q_kvar)


def _found(circuit: Circuit, nodes: list[str]) -> dict[str, Any]:
    """Real and imaginary part of each node's voltage, and what the source gives."""
    known = circuit.volts()  # of other nodes with each source
    # What only an element was at that is off now is no node any more.
    at = [known.get(node, complex(np.nan, np.nan)) for node in nodes]
    volts = [part for v in at for part in (v.real, v.imag)]
    return {"v": volts, "import_kw": -dss.Circuit.TotalPower()[0]}
