"""The steps of a day in OpenDSS, on the circuit as it was written: all phases, no balancing.

Runs in the process of :mod:`vppres.feeders.strangers.child`, where the engine that builds circuits
is loaded before it.
"""

from __future__ import annotations

import sys
from typing import Any

import opendssdirect as dss

PHASES = (1, 2, 3)
# Set-points are constant power at any voltage; OpenDSS makes impedances of loads beyond these.
ANY_VOLTAGE = "vminpu=0.05 vmaxpu=2"
OWN_SOURCES = ("pvsystem", "generator", "storage")


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """Voltages of every step of the job, or what is wrong with the circuit.

    The job has the ``commands`` of the circuit; ``group_of``, the scenario's bus for each bus;
    and ``steps``, each with ``load`` and ``feed``: active and reactive power in kW and kvar by the
    scenario's bus, and in ``held_pu`` the voltage at ``island_bus`` where a battery there holds it
    instead of the circuit's source. Capacitors at the scenario's buses in ``open`` are off in an
    island. With ``constant_power`` all loads keep their power at any voltage.
    """
    # Loaded by child.py: a package is not known there.
    engine: Any = sys.modules["dss/engine"]
    problems = engine.build(job["commands"])
    if problems:
        return {"problems": problems}
    engine.settled()  # the taps of the plan are those of the state that the file gives
    loads = _loads(job["group_of"], job["constant_power"])
    feeds = _new_feeds(sorted({bus for step in job["steps"] for bus in step["feed"]}))
    switched_off = list(_switch_off())
    island = _new_source(job["island_bus"])
    dss.Text.Command("set controlmode=off mode=snap tolerance=1e-8 maxiterations=100")
    solved = []
    for step in job["steps"]:
        _hold(step["held_pu"] if island else None)
        _open(job, island and step["held_pu"] is not None)
        solved.append(_solved(step, loads, feeds))
    return {
        "problems": [],
        "nodes": dss.Circuit.AllNodeNames(),
        "nominal_kw": {bus: sum(p for _, p, _ in own) for bus, own in loads.items()},
        "switched_off": switched_off,
        "island": island,
        "steps": solved,
    }


def _loads(
    group_of: dict[str, str], constant_power: bool
) -> dict[str, list[tuple[str, float, float]]]:
    """Name, active and reactive power of the loads at each bus of the scenario."""
    found: dict[str, list[tuple[str, float, float]]] = {}
    for name in dss.Loads.AllNames():
        dss.Loads.Name(name)
        if not dss.CktElement.Enabled():
            continue
        bus = dss.CktElement.BusNames()[0].partition(".")[0].lower()
        own = (name, dss.Loads.kW(), dss.Loads.kvar())
        found.setdefault(group_of.get(bus, ""), []).append(own)
        if constant_power:
            dss.Text.Command(f"load.{name}.model=1")
            dss.Text.Command(f"edit load.{name} {ANY_VOLTAGE}")
    return found


def _new_feeds(buses: list[str]) -> dict[str, str]:
    """A load at each bus, on all its phases, whose negative power is what is fed in there."""
    made = {}
    for number, bus in enumerate(buses):
        dss.Circuit.SetActiveBus(bus)
        nodes = [node for node in dss.Bus.Nodes() if node in PHASES]
        line_to_neutral_kv = dss.Bus.kVBase()
        kv = line_to_neutral_kv * (3**0.5 if len(nodes) > 1 else 1.0)
        name = f"vppres_{number}"
        terminal = ".".join([bus, *map(str, nodes)])
        dss.Text.Command(
            f"new load.{name} bus1={terminal} phases={len(nodes)} kv={kv:.9g} model=1 conn=wye "
            f"kw=0 kvar=0 {ANY_VOLTAGE}"
        )
        made[bus] = name
    return made


def _switch_off() -> Any:
    """Generation of the circuit's own: the run has its own in its place."""
    for element in dss.Circuit.AllElementNames():
        if element.lower().startswith(tuple(f"{kind}." for kind in OWN_SOURCES)):
            dss.Circuit.SetActiveElement(element)
            if dss.CktElement.Enabled():
                dss.Circuit.Disable(element)
                yield element.lower()


def _new_source(bus: str | None) -> bool:
    """A stiff source at a bus, off at first; whether the bus has the three phases for it."""
    if bus is None:
        return False
    dss.Circuit.SetActiveBus(bus)
    if not {*PHASES} <= {*dss.Bus.Nodes()}:
        return False
    kv = dss.Bus.kVBase() * 3**0.5
    dss.Text.Command(
        f"new vsource.vppres_island bus1={bus}.1.2.3 phases=3 basekv={kv:.9g} pu=1 isc3=1e9 "
        "isc1=1e9 enabled=no"
    )
    return True


def _hold(held_pu: float | None) -> None:
    """Let the circuit's source hold the voltage, or that of the island."""
    for name in dss.Vsources.AllNames():
        on = (name == "vppres_island") == (held_pu is not None)
        dss.Text.Command(f"vsource.{name}.enabled={'yes' if on else 'no'}")
    if held_pu is not None:
        dss.Text.Command(f"vsource.vppres_island.pu={held_pu:.9g}")


def _open(job: dict[str, Any], island: bool) -> None:
    """Switch capacitors off in an island that the plan has without them."""
    for name in dss.Capacitors.AllNames():
        dss.Circuit.SetActiveElement(f"capacitor.{name}")
        bus = dss.CktElement.BusNames()[0].partition(".")[0].lower()
        if job["group_of"].get(bus) in job["open"]:
            dss.Text.Command(f"capacitor.{name}.enabled={'no' if island else 'yes'}")


def _solved(
    step: dict[str, Any], loads: dict[str, list[tuple[str, float, float]]], feeds: dict[str, str]
) -> dict[str, Any]:
    """Voltages and what the source delivers in a step; no voltages where there is no solution."""
    for bus, (p_kw, q_kvar) in step["load"].items():
        _set_group(loads.get(bus, []), p_kw, q_kvar)
    for bus, name in feeds.items():
        p_kw, q_kvar = step["feed"].get(bus, (0.0, 0.0))
        _set_load(name, -p_kw, -q_kvar)
    try:
        dss.Solution.Solve()
    except Exception:  # the engine's own class has no public name
        return {"v_pu": None, "import_kw": None, "import_kvar": None}
    if not dss.Solution.Converged():
        return {"v_pu": None, "import_kw": None, "import_kvar": None}
    delivered = dss.Circuit.TotalPower()
    return {
        "v_pu": list(dss.Circuit.AllBusMagPu()),
        "import_kw": -delivered[0],
        "import_kvar": -delivered[1],
    }


def _set_group(own: list[tuple[str, float, float]], p_kw: float, q_kvar: float) -> None:
    """Share a demand among the loads of a bus as they share its nominal power."""
    nominal_kw = sum(p for _, p, _ in own)
    nominal_kvar = sum(q for _, _, q in own)
    for name, p, q in own:
        share_kw = p / nominal_kw if nominal_kw else 0.0
        share_kvar = q / nominal_kvar if nominal_kvar else share_kw
        _set_load(name, p_kw * share_kw, q_kvar * share_kvar)


def _set_load(name: str, p_kw: float, q_kvar: float) -> None:
    dss.Loads.Name(name)
    dss.Loads.kW(p_kw)
    dss.Loads.kvar(q_kvar)
