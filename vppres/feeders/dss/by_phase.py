"""An OpenDSS circuit with all of its phases, as tables; runs in the process of the reader.

Regulators and switched capacitors stand where the circuit's own controls leave them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import opendssdirect as dss

PHASES = "abc"
NEXT, PREVIOUS = ("ab", "bc", "ca"), ("ac", "ba", "cb")
"""Coils of a delta, from each phase to the one behind it or before it."""

EXPONENTS = {1: (0.0, 0.0), 2: (2.0, 2.0), 3: (0.0, 2.0), 5: (1.0, 1.0)}
"""How active and reactive power of OpenDSS's load models follow the voltage."""

US_PER_S = 1e6

Refused = list[dict[str, Any]]


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """The tables of the job's circuit, or what of it has none.

    The job has the ``commands`` of the circuit, and ``disabled``: elements that are out of service.
    """
    engine: Any = sys.modules["dss/engine"]
    problems = engine.build({**job, "open_deltas": True})
    if problems:
        return {"problems": problems}
    engine.settled()
    for element in job["disabled"]:
        dss.Circuit.Disable(element)
    engine._elements.cache_clear()
    refused: Refused = []
    tables = {
        "buses": [_bus(bus, refused) for bus in dss.Circuit.AllBusNames()],
        "source": _source(),
        "lines": [_line(name, engine) for name in engine._of("line") if engine._closed()],
        "transformers": [
            _transformer(name) for name in engine._of("transformer") if engine._closed()
        ],
        "capacitors": [_capacitor(name, refused) for name in engine._of("capacitor")],
        "powers": list(_powers(engine, refused)),
    }
    return {"problems": refused, **tables, "v_pu": {} if refused else _voltages(engine)}


def _voltages(engine: Any) -> dict[str, float]:
    """Voltage to ground of each node with the powers of the file, at any voltage; {} without."""
    for name in engine._of("load"):
        dss.Text.Command(f"edit load.{name} vminpu=0.05 vmaxpu=2")
    for kind in ("generator", "pvsystem"):
        for name in engine._of(kind):
            dss.Circuit.Disable(f"{kind}.{name}")
    if not engine.solved_by_phase():
        return {}
    names = [name.lower() for name in dss.Circuit.AllNodeNames()]
    return dict(zip(names, map(float, dss.Circuit.AllBusMagPu()), strict=True))


def _refuse(refused: Refused, element: str, what: str, cure: str) -> None:
    refused.append({"message": f"{element} {what}", "cure": cure, "command": None})


def _bus(bus: str, refused: Refused) -> dict[str, Any]:
    """Phases and nominal voltage between lines of a bus."""
    dss.Circuit.SetActiveBus(bus)
    nodes = sorted(dss.Bus.Nodes())
    if any(node > len(PHASES) for node in nodes):
        _refuse(
            refused,
            f"bus {bus}",
            f"has node {max(nodes)}: conductors beside the phases are not held",
            "Ground the neutral (node 0), or import the feeder with --balance.",
        )
    words = [PHASES[node - 1] for node in nodes if node <= len(PHASES)]
    return {"bus": bus, "kv": float(dss.Bus.kVBase() * np.sqrt(3)), "phases": words}


def _nodes() -> list[tuple[str, int]]:
    """Bus and phase of each conductor of the active element; phase -1 is ground."""
    buses = [bus.partition(".")[0].lower() for bus in dss.CktElement.BusNames()]
    order = dss.CktElement.NodeOrder()
    each = dss.CktElement.NumConductors()
    return [(buses[i // each], node - 1) for i, node in enumerate(order)]


def _matrix() -> Any:
    """Admittances of the active element in siemens."""
    flat = np.asarray(dss.CktElement.YPrim())
    size = round((len(flat) / 2) ** 0.5)
    return (flat[::2] + 1j * flat[1::2]).reshape(size, size).T


def _complex(matrix: Any) -> dict[str, Any]:
    return {"re": matrix.real.tolist(), "im": matrix.imag.tolist()}


def _source() -> dict[str, Any]:
    """Bus of the source, what it holds, and the impedance behind which it does."""
    dss.Circuit.SetActiveElement("vsource.source")
    bus = dss.CktElement.BusNames()[0].partition(".")[0].lower()
    phases = [phase for _, phase in _nodes()[:3]]
    z = np.linalg.inv(_matrix()[:3, :3])
    dss.Vsources.Name("source")
    dss.Circuit.SetActiveBus(bus)
    base_kv = float(dss.Bus.kVBase() * np.sqrt(3))
    v_pu = dss.Vsources.PU() * dss.Vsources.BasekV() / base_kv
    return {"bus": bus, "kv": base_kv, "v_pu": v_pu, "phases": phases, "z": _complex(z)}


def _line(name: str, engine: Any) -> dict[str, Any]:
    """Ends, phases, impedance and charging of a line, as OpenDSS's own matrix has them."""
    dss.Circuit.SetActiveElement(f"line.{name}")
    ends = _nodes()
    y = _matrix()
    n = len(ends) // 2
    series = -y[:n, n:]
    charging = 2.0 * (y[:n, :n] - series).imag
    return {
        "name": name,
        "from_bus": ends[0][0],
        "to_bus": ends[n][0],
        "from_phases": [phase for _, phase in ends[:n]],
        "to_phases": [phase for _, phase in ends[n:]],
        "z": _complex(np.linalg.inv(series)),
        "b_us": (charging * US_PER_S).tolist(),
        "i_max_a": engine.rated_amps(dss.CktElement.NormalAmps()),
    }


def _transformer(name: str) -> dict[str, Any]:
    """A transformer with the coils that each end may have, and its own matrix."""
    element = f"transformer.{name}"
    dss.Transformers.Name(name)
    dss.Circuit.SetActiveElement(element)
    phases = dss.CktElement.NumPhases()
    order, y = _nodes(), _matrix()
    dss.Text.Command(f"? {element}.ppm_antifloat")
    ppm = float(dss.Text.Result())
    row: dict[str, Any] = {"id": name, "x_pct": float(dss.Transformers.Xhl()), "r_pct": 0.0}
    ends = []
    n = len(order) // 2
    for winding, (end, nodes) in enumerate((("from", order[:n]), ("to", order[n:])), start=1):
        dss.Transformers.Wdg(winding)
        delta = bool(dss.Transformers.IsDelta())
        kv = float(dss.Transformers.kV())
        if not delta and phases > 1:
            kv /= np.sqrt(3)
        row |= {
            f"{end}_bus": nodes[0][0],
            f"{end}_kv": kv,
            f"{end}_tap": float(dss.Transformers.Tap()),
        }
        row["r_pct"] += float(dss.Transformers.R())
        row["kva"] = float(dss.Transformers.kVA()) / phases
        ends.append(_windings([phase for _, phase in nodes], delta, phases))
    row["ppm"] = ppm
    live = [i for i, (_, phase) in enumerate(order) if phase >= 0]
    return {
        "row": row,
        "coils": ends,
        "nodes": [order[i] for i in live],
        "y": _complex(y[np.ix_(live, live)]),
    }


def _windings(phases: list[int], delta: bool, count: int) -> list[str]:
    """Coils that a winding may be, in words."""
    if not delta:
        return [" ".join(PHASES[phase] for phase in phases[:count] if phase >= 0)]
    if count == 1:
        return ["".join(PHASES[phase] for phase in phases[:2] if phase >= 0)]
    names = [PHASES[phase] for phase in phases[:3]]
    return [_delta(names, NEXT), _delta(names, PREVIOUS)]


def _delta(names: list[str], pairs: tuple[str, ...]) -> str:
    """The coils of a delta whose conductors are these phases."""
    turn = dict(zip(PHASES, names, strict=True))
    return " ".join(turn[pair[0]] + turn[pair[1]] for pair in pairs)


def _capacitor(name: str, refused: Refused) -> dict[str, Any]:
    """Coils of a capacitor that are in, and what they feed at their rated voltage."""
    element = f"capacitor.{name}"
    dss.Capacitors.Name(name)
    dss.Circuit.SetActiveElement(element)
    ends = _nodes()
    n = dss.CktElement.NumPhases()
    delta = bool(dss.Capacitors.IsDelta())
    if not delta and any(phase >= 0 for _, phase in ends[dss.CktElement.NumConductors() :]):
        _refuse(
            refused,
            element,
            "is in series, or its neutral is not grounded",
            "Connect it to ground or in delta, or import the feeder with --balance.",
        )
    states = dss.Capacitors.States()
    kv = float(dss.Capacitors.kV())
    kv = kv if delta or n == 1 else kv / np.sqrt(3)
    kvar = float(dss.Capacitors.kvar()) * sum(states) / max(len(states), 1)
    coils = _load_coils([phase for _, phase in ends[:n]], delta, n)
    return {"bus": ends[0][0], "coils": coils, "kv": kv, "kvar": kvar}


def _load_coils(phases: list[int], delta: bool, count: int) -> str:
    """Coils of a load: to ground, one between two phases, or the three of a delta."""
    live = [PHASES[phase] for phase in phases if phase >= 0]
    if not delta or len(live) == 1:
        # A wye whose neutral is at a phase is between its phases and that one.
        neutral = phases[count] if len(phases) > count else -1
        return " ".join(each + (PHASES[neutral] if neutral >= 0 else "") for each in live[:count])
    return "".join(live) if len(live) == 2 else _delta(live, NEXT)


def _powers(engine: Any, refused: Refused) -> Iterator[dict[str, Any]]:
    """Loads and generators with their coils and load models."""
    for kind in ("load", "generator", "pvsystem"):
        for name in engine._of(kind):
            element = f"{kind}.{name}"
            n = dss.CktElement.NumPhases()
            ends = _nodes()
            dss.Text.Command(f"? {element}.kv")
            kv = float(dss.Text.Result())
            dss.Text.Command(f"? {element}.conn")
            delta = dss.Text.Result().strip().lower() in ("delta", "ll")
            phases = [phase for _, phase in ends]
            live = sum(phase >= 0 for phase in phases)
            # What is called a delta at one node is between that node and ground.
            rated = kv if n == 1 or (delta and live > 1) else kv / np.sqrt(3)
            yield {
                "kind": kind,
                "name": name,
                "bus": ends[0][0],
                "coils": _load_coils(phases, delta, n),
                "kv": rated,
                "exponents": _exponents(name, refused) if kind == "load" else (0.0, 0.0),
                **engine.nominal(kind, name),
            }


def _exponents(name: str, refused: Refused) -> tuple[float, float]:
    """How active and reactive power of a load follow the voltage."""
    dss.Loads.Name(name)
    model = int(dss.Loads.Model())
    if model == 4:
        return float(dss.Loads.CVRwatts()), float(dss.Loads.CVRvars())
    if model not in EXPONENTS:
        _refuse(
            refused,
            f"load.{name}",
            f"has load model {model}",
            "Use model 1, 2, 3, 4 or 5, or import the feeder with --balance.",
        )
    return EXPONENTS.get(model, (0.0, 0.0))
