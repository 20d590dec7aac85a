"""An OpenDSS circuit with all of its phases, as tables; runs in the process of the reader.

Controls stand where the circuit's own solution leaves them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import opendssdirect as dss

from vppres.core.units import US_PER_S
from vppres.feeders.dss import engine
from vppres.feeders.dss.elements import (
    Circuit,
    ServiceTransformer,
    Side,
    TwoPort,
    Winding,
    buses_of,
    matrix,
    middle,
    nodes_of,
)
from vppres.feeders.dss.nodes import beside, reached, without

PHASES = "abc"
NEXT, PREVIOUS = ("ab", "bc", "ca"), ("ac", "ba", "cb")
"""Coils of a delta, from each phase to the one behind it or before it."""

EXPONENTS = {1: (0.0, 0.0), 2: (2.0, 2.0), 3: (0.0, 2.0), 5: (1.0, 1.0)}
"""How active and reactive power of OpenDSS's load models follow the voltage."""

SECOND = 2  # winding whose taps a regulator moves
SAME = 1e-9
"""Share of an entry by which the two ends of a line may differ and still have the same charging."""

Refused = list[dict[str, Any]]
Table = list[dict[str, Any]]


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """The tables of the job's circuit, or what of it has none.

    The job has the commands of the circuit, and ``disabled``: elements that are out of service. Of
    these, ``kept`` are those without which a conductor that the source supplies would have none.
    """
    circuit, problems = engine.build({**job, "open_deltas": True})
    if problems:
        return {"problems": problems}
    engine.settled(circuit)
    kept = _needed(job["disabled"], circuit) if job["disabled"] else []
    for element in job["disabled"]:
        if element not in kept:
            dss.Circuit.Disable(element)
    circuit.find_elements()
    solved = engine.solved_by_phase()
    refused: Refused = []
    own = _Matrices(circuit, refused)
    tables = {
        "kept": kept,
        "source": _source(refused),
        "lines": own.lines,
        "transformers": [_transformer(name, circuit, own) for name in circuit.of("transformer")],
        "shunts": own.shunts(),
        "buses": [
            *(_bus(bus, circuit, own.taken, refused) for bus in dss.Circuit.AllBusNames()),
            *_stars(circuit),
        ],
        "powers": [] if refused else list(_powers(circuit, solved, refused)),
        "causes": [words for _, words in sorted(engine.beyond(circuit))] if solved else [],
    }
    v_pu = _voltages(circuit) if solved and not refused else {}
    return {"problems": refused, **tables, "v_pu": v_pu}


def _needed(disabled: list[str], circuit: Circuit) -> list[str]:
    """Elements that close a loop of buses, but of no conductor."""
    joined: dict[str, list[tuple[Any, ...]]] = {}
    for kind in ("line", "reactor", "capacitor", "transformer"):
        for name in circuit.of(kind):
            nodes = [tuple(circuit.admittance()[0])] if kind == "transformer" else []
            joined[f"{kind}.{name}"] = nodes or circuit.joined()
    groups = [group for element, own in joined.items() if element not in disabled for group in own]
    kept = []
    for element in disabled:
        own = joined.get(element, [])
        known = beside(groups)
        if any({*group} - {*reached(group[0], known)} for group in own):
            kept.append(element)
            groups += own
    return kept


def _voltages(circuit: Circuit) -> dict[str, float]:
    """Voltage to ground of each node in pu in the last solution; of legs, from one to the other."""
    names = [name.lower() for name in dss.Circuit.AllNodeNames()]
    found = dict(zip(names, map(float, dss.Circuit.AllBusMagPu()), strict=True))
    legs = circuit.legs
    found = {name: v for name, v in found.items() if name.rpartition(".")[0] not in legs}
    return found | {f"{bus}.{phase}": circuit.legs_pu(bus) for bus, (phase, _) in legs.items()}


def _refuse(refused: Refused, element: str, what: str, cure: str) -> None:
    refused.append(engine.wrong(f"{element} {what}", cure))


def _bus(
    bus: str, circuit: Circuit, taken: set[tuple[str, int]], refused: Refused
) -> dict[str, Any]:
    """Phases and nominal voltage between lines of a bus."""
    kv = circuit.base_kv(bus)
    if bus in circuit.legs:
        return {"bus": bus, "kv": kv, "phases": [PHASES[circuit.legs[bus][0] - 1]]}
    nodes = sorted(dss.Bus.Nodes())
    beside = [node for node in nodes if node > len(PHASES) and (bus, node) in taken]
    if beside:
        _refuse(
            refused,
            f"bus {bus}",
            f"has node {max(beside)}: conductors beside the phases are not held",
            "Ground the neutral (node 0), or import the feeder with --balance.",
        )
    words = [PHASES[node - 1] for node in nodes if node <= len(PHASES)]
    return {"bus": bus, "kv": kv, "phases": words}


def _stars(circuit: Circuit) -> Iterator[dict[str, Any]]:
    """Buses that are the star of transformers with three windings."""
    at: dict[str, set[int]] = {}
    for star, phases in circuit.stars.values():
        at.setdefault(star, set()).update(phases)
    for star, kv in engine.stars_kv(circuit).items():
        yield {"bus": star, "kv": kv, "phases": [PHASES[node - 1] for node in sorted(at[star])]}


def _nodes() -> list[tuple[str, int]]:
    """Bus and phase of each conductor of the active element; phase -1 is ground."""
    return [(bus, node - 1) for bus, node in nodes_of()]


def _complex(matrix: Any) -> dict[str, Any]:
    return {"re": np.real(matrix).tolist(), "im": np.imag(matrix).tolist()}


class _Matrices:
    """Lines, reactors and capacitors by their own matrices.

    ``users`` has what else is connected to each neutral.
    """

    def __init__(self, circuit: Circuit, refused: Refused) -> None:
        self.circuit = circuit
        self.lines: Table = []
        self.at_bus: dict[tuple[str, bool], dict[tuple[int, int], complex]] = {}
        self.users: dict[tuple[str, int], set[str]] = {}
        for kind in ("line", "reactor", "capacitor"):
            for name in circuit.of(kind):
                amps = engine.rated_amps(dss.CktElement.NormalAmps()) if kind == "line" else None
                self._add(f"{kind}.{name}", kind != "line", amps, refused)
        for kind in ("transformer", *engine.POWERS):
            for name in circuit.of(kind):
                self._take(f"{kind}.{name}", nodes_of())

    def _take(self, element: str, nodes: list[tuple[str, int]]) -> None:
        for node in nodes:
            if node[1] > len(PHASES) and node[0] not in self.circuit.legs:
                self.users.setdefault(node, set()).add(element)

    @property
    def taken(self) -> set[tuple[str, int]]:
        """Neutrals that are more than that of one transformer, which only shunts ground."""
        return {node for node in self.users if not self._own(node)}

    def _own(self, node: tuple[str, int]) -> bool:
        one = [each for each in self.users[node] if each.startswith("transformer.")]
        return len(one) == len(self.users[node]) == 1 and self.grounding(node) is not None

    def grounding(self, node: tuple[str, int]) -> complex | None:
        """Admittance of a neutral to ground, in siemens; None where it joins more than ground."""
        bus, own = node
        nodes, y = self._sum([sums for (at, _), sums in self.at_bus.items() if at == bus])
        gone = [
            i for i, each in enumerate(nodes)
            if each > len(PHASES) and each != own and (bus, each) not in self.users
        ]  # fmt: skip
        if gone:
            y = without(y, gone)
            nodes = [each for i, each in enumerate(nodes) if i not in gone]
        if own not in nodes:
            return 0j
        at = nodes.index(own)
        return None if np.delete(y[at], at).any() else complex(y[at, at])

    @staticmethod
    def _sum(parts: list[dict[tuple[int, int], complex]]) -> tuple[list[int], Any]:
        """Nodes of some parts of a bus, and the sum of their matrices."""
        nodes = sorted({node for sums in parts for pair in sums for node in pair})
        entries = [[sum(sums.get((i, j), 0j) for sums in parts) for j in nodes] for i in nodes]
        return nodes, np.array(entries).reshape(len(nodes), len(nodes))

    def _add(self, element: str, switched: bool, amps: float | None, refused: Refused) -> None:
        """One element: a line between two buses, or what it draws at one."""
        nodes, y = self.circuit.admittance()
        buses = buses_of(nodes)
        if len(buses) > 2:
            _refuse(refused, element, "joins more than two buses", f"Write 'disable {element}'.")
        if len(buses) == 2:
            self._take(element, nodes)
            port = TwoPort(self.circuit, nodes, y)
            if port.crossed:
                _refuse(
                    refused,
                    element,
                    "connects a phase with another one",
                    "Name the same nodes at both ends, or import the feeder with --balance.",
                )
                return
            if port.phases:
                self._line(element, port, amps)
            else:
                for bus, own, rest in zip(
                    (port.start, port.end), port.nodes, port.rest, strict=True
                ):
                    self._rest(bus, own, rest, switched)
        elif buses:
            self._rest(buses[0], [node for _, node in nodes], y, switched)

    def _line(self, element: str, port: Any, amps: float | None) -> None:
        """A line; charging that its ends do not share is left at them."""
        phases = [first - 1 for first, _ in port.phases]
        n = len(phases)
        whole = [len(rest) == n for rest in port.rest]
        half = port.rest[0] if all(whole) else np.zeros((n, n))
        alike = all(whole) and np.abs(port.rest[1] - half).max() <= SAME * np.abs(half).max()
        capacitive = alike and np.abs(half.real).max() <= SAME * np.abs(half).max()
        shared = half.imag if capacitive else np.zeros((n, n))
        for bus, own, rest in zip((port.start, port.end), port.nodes, port.rest, strict=True):
            if not capacitive:
                self._rest(bus, own, rest, switched=False)
        self.lines.append(
            {
                "name": element,
                "from_bus": port.start,
                "to_bus": port.end,
                "phases": phases,
                "z": _complex(port.z),
                "b_us": (2.0 * shared * US_PER_S).tolist(),
                "i_max_a": amps,
            }
        )

    def _rest(self, bus: str, nodes: list[int], y: Any, switched: bool) -> None:
        """Add a matrix to what there is at a bus."""
        sums = self.at_bus.setdefault((bus, switched), {})
        for i, first in enumerate(nodes):
            for j, second in enumerate(nodes):
                sums[first, second] = sums.get((first, second), 0j) + complex(y[i, j])

    def shunts(self) -> Table:
        """The matrix of each bus to ground and between its phases, without its own neutrals."""
        found: Table = []
        for (bus, _), sums in self.at_bus.items():
            nodes, y = self._sum([sums])
            gone = [i for i, node in enumerate(nodes) if node > len(PHASES)]
            if gone:
                y = without(y, gone)
            phases = [node - 1 for node in nodes if node <= len(PHASES)]
            found.append({"bus": bus, "phases": phases, "y": _complex(y)})
        return found


def _source(refused: Refused) -> dict[str, Any]:
    """Bus of the source, what it holds, and the impedance behind which it does."""
    dss.Text.Command("? vsource.source.sequence")
    if not dss.Text.Result().strip().lower().startswith("pos"):
        _refuse(
            refused,
            "vsource.source",
            f"has sequence={dss.Text.Result().strip()}: its phases turn the other way",
            "Leave 'sequence' out and swap two phases everywhere, or import with --balance.",
        )
    dss.Circuit.SetActiveElement("vsource.source")
    bus = dss.CktElement.BusNames()[0].partition(".")[0].lower()
    phases = [phase for _, phase in _nodes()[:3]]
    z = np.linalg.inv(matrix()[:3, :3])
    dss.Vsources.Name("source")
    dss.Circuit.SetActiveBus(bus)
    base_kv = float(dss.Bus.kVBase() * np.sqrt(3))
    v_pu = dss.Vsources.PU() * dss.Vsources.BasekV() / base_kv
    return {"bus": bus, "kv": base_kv, "v_pu": v_pu, "phases": phases, "z": _complex(z)}


def _transformer(name: str, circuit: Circuit, matrices: _Matrices) -> dict[str, Any]:
    """A transformer with the coils that each end may have, and its own matrix.

    It has one row for its two windings, or one for each of three and their star.
    """
    element = f"transformer.{name}"
    if middle() is not None:
        dss.Circuit.SetActiveElement(element)
        return _service(name, circuit)
    dss.Transformers.Name(name)
    dss.Circuit.SetActiveElement(element)
    phases = dss.CktElement.NumPhases()
    live, y = circuit.admittance()
    numbers = range(1, 1 + dss.Transformers.NumWindings())
    own = [Winding(number) for number in numbers]
    coils = [_windings([node - 1 for _, node in each.ends], each.delta, phases) for each in own]
    if len(own) == 2:
        ppm = engine.number(f"{element}.ppm_antifloat")
        rows = [_row(name, own, phases, own[0].percent + own[1].r_pct, ppm)]
        if engine.regulated(circuit).get(name) == SECOND:
            rows[0]["island_tap"] = 1.0
    else:
        star, at = circuit.stars[name]
        center = Side(star, engine.stars_kv(circuit)[star] / np.sqrt(3))
        rows = [
            _row(f"{name} winding {number}", (each, center), phases, each.percent, 0.0)
            for number, each in zip(numbers, own, strict=True)
        ]
        coils.append([" ".join(PHASES[node - 1] for node in at)])
    neutrals = []
    for node in [node for node in live if node[1] > len(PHASES) and node not in matrices.taken]:
        i = live.index(node)
        y[i, i] += matrices.grounding(node) or 0j
        ground = y[i, [bus == node[0] for bus, _ in live]].sum()
        neutrals.append({"bus": node[0], "z": _complex(1.0 / ground)})
        y = without(y, [i])
        live.remove(node)
        for row in rows:
            row["ppm"] = 0.0  # it is in the matrix, that of the neutral too
    return {
        "rows": rows,
        "coils": coils,
        "nodes": [(bus, node - 1) for bus, node in live],
        "y": _complex(y),
        "neutrals": neutrals,
    }


def _row(
    name: str, sides: Sequence[Side], phases: int, percent: complex, ppm: float
) -> dict[str, Any]:
    """Two windings without their coils, with the impedance between them in percent."""
    first, second = sides
    return {
        "id": name,
        "from_bus": first.bus,
        "from_kv": first.kv,
        "from_tap": first.tap,
        "to_bus": second.bus,
        "to_kv": second.kv,
        "to_tap": second.tap,
        "kva": first.kva / phases,
        "r_pct": percent.real,
        "x_pct": percent.imag,
        "ppm": ppm,
    }


def _service(name: str, circuit: Circuit) -> dict[str, Any]:
    """A transformer with its middle at ground, as one coil on each side."""
    own = ServiceTransformer(circuit)
    words = "".join(PHASES[node - 1] for _, node in own.ends[:2] if node > 0)
    return {
        "rows": [_row(name, own.windings, 1, own.percent, 0.0)],
        "neutrals": [],
        "coils": [[words, words[::-1]], [PHASES[own.ends[2][1] - 1]]],
        "nodes": [(bus, node - 1) for bus, node in own.nodes],
        "y": _complex(own.y),
    }


def _windings(phases: list[int], delta: bool, count: int) -> list[str]:
    """Coils that a winding may be, in words; a conductor at ground is no end of one."""
    if count == 1:  # from one phase to another, or to ground
        return ["".join(PHASES[phase] for phase in phases[:2] if phase in range(3))]
    if not delta:
        return [" ".join(PHASES[phase] for phase in phases[:count] if phase in range(3))]
    names = [PHASES[phase] if phase in range(3) else "" for phase in phases[:3]]
    return [_delta(names, NEXT), _delta(names, PREVIOUS)]


def _delta(names: list[str], pairs: tuple[str, ...]) -> str:
    """The coils of a delta whose conductors are these phases."""
    turn = dict(zip(PHASES, names, strict=True))
    return " ".join(turn[pair[0]] + turn[pair[1]] for pair in pairs)


def _load_coils(phases: list[int], delta: bool, count: int) -> list[str]:
    """Coils of a device, in the order in which they share its power; ground alone is none."""
    if delta:
        ends = [(i, (i + 1) % (count if count > 2 else count + 1)) for i in range(count)]
    else:
        ends = [(i, count) for i in range(count)]
    found = []
    for first, second in ends:
        pair = [phases[i] if i < len(phases) else -1 for i in (first, second)]
        live = [PHASES[phase] for phase in pair if phase >= 0]
        found.append("" if len(set(live)) < len(live) else "".join(live))
    return found


def _powers(circuit: Circuit, solved: bool, refused: Refused) -> Iterator[dict[str, Any]]:
    """Loads, generators and batteries with their coils and load models."""
    for kind in engine.POWERS:
        for name in circuit.of(kind):
            element = f"{kind}.{name}"
            n = dss.CktElement.NumPhases()
            ends = _nodes()
            kv = engine.number(f"{element}.kv")
            delta = engine.text_of(f"{element}.conn") in ("delta", "ll")
            coils = _load_coils([phase for _, phase in ends], delta, n)
            kv = kv if n == 1 or delta else kv / np.sqrt(3)
            legs = circuit.legs.get(ends[0][0])
            if legs is not None:
                kv *= 2.0 if max(map(len, coils)) == 1 else 1.0
                coils = [PHASES[legs[0] - 1]]
            yield {
                "kind": kind,
                "name": name,
                "bus": ends[0][0],
                "coils": coils,
                "kv": kv,
                "exponents": _exponents(name, refused) if kind == "load" else (0.0, 0.0),
                **engine.nominal(kind, name, solved),
                **(_impedance() if kind == "generator" else {}),
            }


def _impedance() -> dict[str, Any]:
    """Power at nominal voltage of the active generator if it is a constant impedance."""
    if int(dss.Generators.Model()) != engine.CONSTANT_IMPEDANCE:
        return {}
    # OpenDSS's multiplier of generators does not change it.
    powers = {"p_kw": float(dss.Generators.kW()), "q_kvar": float(dss.Generators.kvar())}
    return {**powers, "exponents": EXPONENTS[engine.CONSTANT_IMPEDANCE]}


def _exponents(name: str, refused: Refused) -> tuple[float, float]:
    """How active and reactive power of a load follow the voltage."""
    dss.Loads.Name(name)
    model = int(dss.Loads.Model())
    if dss.Solution.LoadModel() == engine.ADMITTANCE:
        return EXPONENTS[engine.CONSTANT_IMPEDANCE]
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
