"""The elements of a built circuit as tables, once for all views; runs in the reader's process.

Each branch has its own matrix, each transformer its windings and its matrix, each load its coils.
What a balanced feeder and what one by phase make of them is the reader's.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import opendssdirect as dss

from vppres.core.units import V_PER_KV
from vppres.feeders.dss.elements import (
    PHASES,
    Circuit,
    Side,
    TwoPort,
    Winding,
    buses,
    buses_of,
    coil_volts,
    matrix,
    middle,
    nodes_of,
    number,
    power_drawn,
    service,
    text_of,
)

POWERS = ("load", "generator", "pvsystem", "storage")
BRANCHES = ("line", "reactor", "capacitor")
CONSTANT_IMPEDANCE, GIVEN_EXPONENTS = 2, 4  # OpenDSS's models of a load
ADMITTANCE = 2  # option of 'set loadmodel': all loads are impedances
VARIABLE = 0  # status of a load that multipliers change
DEFAULT_AMPS = 400.0
THREE_PHASES = 3

EXPONENTS = {1: (0.0, 0.0), 2: (2.0, 2.0), 3: (0.0, 2.0), 5: (1.0, 1.0)}
"""How active and reactive power of OpenDSS's load models follow the voltage."""

FOLLOWING = {
    ("generator", 2): (2.0, 2.0),
    ("generator", 5): (0.0, 2.0),
    ("pvsystem", 2): (2.0, 2.0),
    ("storage", 2): (2.0, 2.0),
}
"""The same of models of generation and batteries; of all others powers are constant."""

Table = list[dict[str, Any]]


def tables(circuit: Circuit, solved: bool) -> dict[str, Any]:
    """All elements that carry power, and the buses that they are at."""
    transformers = list(_transformers(circuit))
    return {
        "name": dss.Circuit.Name(),
        "frequency_hz": dss.Solution.Frequency(),
        "buses": [_bus(bus, circuit) for bus in dss.Circuit.AllBusNames()] + _stars(circuit),
        "source": _source(circuit),
        "branches": [*_branches(circuit), *_with_an_open_end(transformers)],
        "transformers": transformers,
        "powers": list(_powers(circuit, solved)),
        "neutrals": _neutrals(circuit),
    }


def _complex(values: Any) -> dict[str, Any]:
    return {"re": np.real(values).tolist(), "im": np.imag(values).tolist()}


def _bus(bus: str, circuit: Circuit) -> dict[str, Any]:
    """Nominal voltage between lines of a bus, and its nodes; of legs the phase that both are."""
    kv = circuit.base_kv(bus)
    nodes = [circuit.legs[bus][0]] if bus in circuit.legs else sorted(dss.Bus.Nodes())
    return {"name": bus, "kv": kv, "nodes": nodes}


def _stars(circuit: Circuit) -> Table:
    """Buses that are the star of transformers with three windings."""
    at: dict[str, set[int]] = {}
    for star, phases in circuit.stars.values():
        at.setdefault(star, set()).update(phases)
    kv = {circuit.stars[name][0]: _star_kv(circuit, name) for name in circuit.stars}
    return [{"name": star, "kv": kv[star], "nodes": sorted(at[star])} for star in kv]


def _star_kv(circuit: Circuit, name: str) -> float:
    """Nominal voltage between lines of a star: that of the first winding."""
    dss.Circuit.SetActiveElement(f"transformer.{name}")
    dss.Transformers.Name(name)
    own = Winding(1)
    return between_lines(own.rated_kv, circuit.base_kv(own.bus))


def between_lines(rated_kv: float, base_kv: float) -> float:
    """A rated voltage between lines; that of a single phase may be to neutral."""
    return float(min((rated_kv, rated_kv * np.sqrt(3)), key=lambda kv: abs(kv - base_kv)))


def _source(circuit: Circuit) -> dict[str, Any]:
    """Bus of the source, what it holds, and the impedance behind which it does."""
    sequence = text_of("vsource.source", "sequence")
    r_ohm, x_ohm = number("vsource.source", "r1"), number("vsource.source", "x1")
    dss.Circuit.SetActiveElement("vsource.source")
    bus = buses()[0]
    phases = [node - 1 for _, node in nodes_of()[:THREE_PHASES]]
    z = np.linalg.inv(matrix()[:THREE_PHASES, :THREE_PHASES])
    dss.Vsources.Name("source")
    base_kv = circuit.base_kv(bus)
    return {
        "bus": bus,
        "kv": base_kv,
        "v_pu": dss.Vsources.PU() * dss.Vsources.BasekV() / base_kv,
        "phases": phases,
        "sequence": sequence,
        "z": _complex(z),
        "r_ohm": r_ohm,
        "x_ohm": x_ohm,
    }


def _branches(circuit: Circuit) -> Iterator[dict[str, Any]]:
    """Lines, reactors and capacitors.

    ``pairs`` has the nodes, from 1, that conductors join, ``z`` their impedance in ohm, ``rest``
    the bus, nodes and admittances of what is beside them. Open lines have ``z`` and no pairs.
    """
    switches = _switches(circuit)
    for kind in BRANCHES:
        for name in circuit.of(kind):
            ends = buses()
            nodes, y = circuit.admittance()
            joined = buses_of(nodes)
            amps = float(dss.CktElement.NormalAmps())
            row: dict[str, Any] = {
                "element": f"{kind}.{name}",
                "name": name if kind == "line" else f"{kind}.{name}",
                "nodes": nodes,
                "amps": None if kind != "line" or amps == DEFAULT_AMPS else amps,
                "carried_a": _carried_a(),
                "switch": kind == "line" and name in switches,
                "locked": kind == "line" and switches.get(name, False),
                "from_bus": ends[0],
                "to_bus": ends[-1],
                "pairs": [],
                "z": None,
            }
            port = TwoPort(circuit, nodes, y) if len(joined) == 2 else None
            if port is not None and port.phases:
                sides = zip((port.start, port.end), port.nodes, port.rest, strict=True)
                row |= {"from_bus": port.start, "to_bus": port.end, "pairs": port.phases}
                row |= {"z": _complex(port.z), "rest": [[b, n, _complex(r)] for b, n, r in sides]}
                yield row
                continue
            at = {bus: [i for i, node in enumerate(nodes) if node[0] == bus] for bus in joined}
            row["rest"] = [
                [bus, [nodes[i][1] for i in own], _complex(y[np.ix_(own, own)])]
                for bus, own in at.items()
            ]
            if kind == "line" and len(set(ends)) == 2:  # open, but there
                row |= {"z": _own_impedance(name), "switch": True}
            yield row


def _switches(circuit: Circuit) -> dict[str, bool]:
    """Lines that are switches, or have a control of one, and whether this is locked."""
    found = {
        name: False
        for name in circuit.of("line")
        if dss.Lines.Name(name) is None and dss.Lines.IsSwitch()
    }
    for name in circuit.of("swtcontrol"):
        dss.SwtControls.Name(name)
        kind, _, line = dss.SwtControls.SwitchedObj().lower().partition(".")
        if kind == "line":
            found[line] = bool(dss.SwtControls.IsLocked())
    return found


def _own_impedance(line: str) -> dict[str, Any]:
    """Series impedance of an open line as if it were closed, whose admittances are of no line."""
    dss.Lines.Name(line)
    n, length = dss.Lines.Phases(), dss.Lines.Length()
    r, x = (np.reshape(each, (n, n)) for each in (dss.Lines.RMatrix(), dss.Lines.XMatrix()))
    return _complex((r + 1j * x) * length)


def _carried_a() -> float:
    """Current into the active element in the last solution, all phases."""
    flat = np.asarray(dss.CktElement.CurrentsMagAng()[::2])
    return float(flat[: dss.CktElement.NumPhases()].sum())


def _transformers(circuit: Circuit) -> Iterator[dict[str, Any]]:
    """Transformers by their windings, with the matrix between their nodes.

    One with its middle at ground has two windings; one with three has their ``star``.
    """
    regulators = regulated(circuit)
    for name in circuit.of("transformer"):
        in_halves = middle() is not None
        dss.Circuit.SetActiveElement(f"transformer.{name}")
        dss.Transformers.Name(name)
        nodes, y = circuit.admittance()
        phases, carried_a, at = dss.CktElement.NumPhases(), _carried_a(), circuit.phases()
        numbers = range(1, 1 + dss.Transformers.NumWindings())
        windings = [*map(_winding, map(Winding, numbers))]
        if in_halves and len(buses_of(nodes)) == 2:
            sides, percent = service(circuit, nodes, y)
            windings = [*map(_side, sides, (percent, 0j))]
        star, on_star = circuit.stars.get(name, ("", ()))
        element = f"transformer.{name}"
        yield {
            "name": name,
            "element": element,
            "phases": phases,
            "nodes": at,
            "carried_a": carried_a,
            "windings": windings,
            "closed": bool(star) or len(buses_of(nodes)) == 2,
            "star": star,
            "on_star": on_star,
            "live": nodes,
            "y": _complex(y),
            "regulated": regulators.get(name),
            "ppm": 0.0 if star or in_halves else number(element, "ppm_antifloat"),
            "no_load_percent": number(element, "%noloadloss"),
            "magnetising_percent": number(element, "%imag"),
        }


def _with_an_open_end(transformers: Table) -> Iterator[dict[str, Any]]:
    """Transformers that join no buses: their cores, at the bus that they are still at."""
    for one in transformers:
        if not one["closed"]:
            nodes = one["live"]
            rest = [[bus, [node for _, node in nodes], one["y"]] for bus in buses_of(nodes)]
            at = {"element": one["element"], "name": one["name"], "nodes": nodes}
            yield at | {"pairs": [], "z": None, "rest": rest}


def _winding(own: Winding) -> dict[str, Any]:
    """A winding; of two, the first has all of the reactance."""
    row = _side(own, own.percent)
    return row | {"rated_kv": own.rated_kv, "r_percent": own.r_pct, "delta": own.delta}


def _side(side: Side, percent: complex) -> dict[str, Any]:
    return {
        "bus": side.bus,
        "kv": side.kv,
        "rated_kv": side.kv,
        "tap": side.tap,
        "kva": side.kva,
        "ends": [node for _, node in side.ends],
        "delta": False,
        "r_percent": percent.real,
        "x_percent": percent.imag,
    }


def regulated(circuit: Circuit) -> dict[str, int]:
    """Transformers with a regulator, and the winding whose taps it moves."""
    found = {}
    for name in circuit.of("regcontrol"):
        dss.RegControls.Name(name)
        found[dss.RegControls.Transformer().lower()] = int(dss.RegControls.TapWinding())
    return found


def _neutrals(circuit: Circuit) -> Table:
    """Conductors beside the phases that transformers, loads and generation are connected to."""
    return [
        {"element": f"{kind}.{name}", "nodes": own}
        for kind in ("transformer", *POWERS)
        for name in circuit.of(kind)
        if (own := beside_phases(nodes_of(), circuit))
    ]


def beside_phases(nodes: list[tuple[str, int]], circuit: Circuit) -> list[tuple[str, int]]:
    """Conductors beside the phases among some nodes."""
    return [each for each in nodes if each[1] > max(PHASES) and each[0] not in circuit.legs]


def _powers(circuit: Circuit, solved: bool) -> Iterator[dict[str, Any]]:
    """Loads, generators and batteries with their coils, load models and powers.

    ``exponents`` are None for a load model without; ``at_nominal`` is the power at nominal voltage
    of what follows it.
    """
    for kind in POWERS:
        for name in circuit.of(kind):
            element = f"{kind}.{name}"
            n = dss.CktElement.NumPhases()
            ends, nodes = nodes_of(), circuit.phases()
            bus = ends[0][0]
            delta = text_of(element, "conn").lower() in ("delta", "ll")
            rated_kv = number(element, "kv")
            kv = rated_kv if n == 1 or delta else rated_kv / np.sqrt(3)
            row: dict[str, Any] = {
                "kind": kind,
                "name": name,
                "bus": bus,
                "nodes": nodes,
                "coils": _coils([node for _, node in ends], delta, n),
                "model": int(number(element, "model")),
                **nominal(kind, name, solved),
            }
            row["exponents"] = _exponents(row)
            row["at_nominal"] = row["p_kw"], row["q_kvar"]
            if kind != "load" and any(row["exponents"]) and solved:
                dss.Circuit.SetActiveElement(element)
                square = n * (kv * V_PER_KV) ** 2 / sum(v**2 for v in coil_volts(delta))
                row["at_nominal"] = [
                    power * square ** (exponent / 2)
                    for power, exponent in zip(row["at_nominal"], row["exponents"], strict=True)
                ]
            if bus in circuit.legs:
                kv *= 2.0 if max(map(len, row["coils"])) == 1 else 1.0
                row["coils"] = [[circuit.legs[bus][0]]]
            yield {**row, "kv": kv}


def _coils(nodes: list[int], delta: bool, count: int) -> list[list[int]]:
    """Ends of the coils of a device, in the order in which they share its power.

    One that is at ground alone, or between a node and itself, has none.
    """
    if delta:
        ends = [(i, (i + 1) % (count if count > 2 else count + 1)) for i in range(count)]
    else:
        ends = [(i, count) for i in range(count)]
    found = []
    for pair in ends:
        live = [nodes[i] for i in pair if i < len(nodes) and nodes[i] > 0]
        found.append([] if len(set(live)) < len(live) else live)
    return found


def _exponents(row: dict[str, Any]) -> tuple[float, float] | None:
    """How active and reactive power of an element follow the voltage."""
    kind, model = row["kind"], row["model"]
    if kind != "load":
        return FOLLOWING.get((kind, model), (0.0, 0.0))
    if dss.Solution.LoadModel() == ADMITTANCE:
        return EXPONENTS[CONSTANT_IMPEDANCE]
    if model == GIVEN_EXPONENTS:
        dss.Loads.Name(row["name"])
        return float(dss.Loads.CVRwatts()), float(dss.Loads.CVRvars())
    return EXPONENTS.get(model)


def nominal(kind: str, name: str, solved: bool) -> dict[str, float]:
    """Nominal power of a load, and what anything else gives or draws in the solution.

    Generation is positive of generators, drawn power of loads and batteries. ``p_max_kw`` and
    ``s_kva`` are the largest power and the rating, as far as the source says so.
    """
    if kind == "load":
        dss.Loads.Name(name)
        factor = dss.Solution.LoadMult() if int(dss.Loads.Status()) == VARIABLE else 1.0
        factor *= _growth()
        return {"p_kw": float(dss.Loads.kW() * factor), "q_kvar": float(dss.Loads.kvar() * factor)}
    element = f"{kind}.{name}"
    dss.Circuit.SetActiveElement(element)
    drawn = power_drawn() if solved else 0j
    if kind == "generator":
        dss.Generators.Name(name)
        p_kw = float(dss.Generators.kW())
        given = -drawn if solved else complex(p_kw, dss.Generators.kvar())
        return {"p_kw": given.real, "q_kvar": given.imag, "p_max_kw": max(p_kw, given.real)}
    if kind == "pvsystem":
        s_kva = number(element, "kva")
        panel_kw = number(element, "pmpp") * number(element, "%pmpp") / 100.0
        return {
            "p_kw": -drawn.real,
            "q_kvar": -drawn.imag,
            "p_max_kw": min(s_kva, panel_kw),
            "s_kva": s_kva,
            "sunny_kw": number(element, "pmpp") * number(element, "irradiance"),
        }
    return {"p_kw": drawn.real, "q_kvar": drawn.imag, **_battery(element)}


def _growth() -> float:
    """Factor by which loads have grown in the year that the script sets."""
    years = dss.Solution.Year() - 1
    dss.Text.Command("get %growth")
    return float((1.0 + float(dss.Text.Result()) / 100.0) ** years) if years >= 0 else 1.0


def _battery(element: str) -> dict[str, float]:
    """Energy, powers and efficiencies of a battery."""
    rated_kw = number(element, "kwrated")
    share = min(number(element, "%charge"), number(element, "%discharge"), 100.0) / 100.0
    return {
        "energy_kwh": number(element, "kwhrated"),
        "p_max_kw": rated_kw * share,
        "s_kva": number(element, "kva"),
        "soc": number(element, "%stored") / 100.0,
        "soc_min": number(element, "%reserve") / 100.0,
        "eta_charge": number(element, "%effcharge") / 100.0,
        "eta_discharge": number(element, "%effdischarge") / 100.0,
        "idle_kw": rated_kw * number(element, "%idlingkw") / 100.0,
    }
