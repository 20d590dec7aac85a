"""Elements of an OpenDSS circuit as a feeder by phase has them, or why it cannot have them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from vppres.core.arrays import Complexes
from vppres.core.units import US_PER_S
from vppres.feeders.dss.nodes import without

PHASES = "abc"
NEXT, PREVIOUS = ("ab", "bc", "ca"), ("ac", "ba", "cb")
"""Coils of a delta, from each phase to the one behind it or before it."""

SECOND = 2  # winding whose taps a regulator moves
SAME = 1e-9
"""Share of an entry by which the two ends of a line may differ and still have the same charging."""

Row = Mapping[str, Any]
Table = list[dict[str, Any]]
Refused = list[tuple[str, str]]


def complexes(parts: Mapping[str, Any]) -> Complexes:
    """Complex numbers of the engine's answer."""
    return np.array(parts["re"]) + 1j * np.array(parts["im"])


def words_of(nodes: list[int]) -> str:
    """Phases of some nodes; ground and other conductors are none."""
    return "".join(PHASES[node - 1] for node in nodes if 1 <= node <= len(PHASES))


class CircuitByPhase:
    """Lines, shunts, transformers and powers by phase of the engine's tables.

    ``refused`` says what of the circuit has no place in them, each with a cure. ``users`` has what
    is connected to each neutral.
    """

    def __init__(self, found: Row) -> None:
        self.found = found
        self.refused: Refused = []
        self.lines: Table = []
        self.at_bus: dict[tuple[str, bool], dict[tuple[int, int], complex]] = {}
        self.users: dict[tuple[str, int], set[str]] = {}
        if not found["source"]["sequence"].lower().startswith("pos"):
            self._refuse(
                f"vsource.source has sequence={found['source']['sequence']}: its phases turn the "
                "other way",
                "Leave 'sequence' out and swap two phases everywhere, or import with --balance.",
            )
        for branch in found["branches"]:
            self._add(branch)
        for row in found["neutrals"]:
            self._take(row["element"], row["nodes"])
        self.taken = {node for node in self.users if not self._own(node)}
        closed = [row for row in found["transformers"] if row["closed"]]
        self.transformers = [*map(self._transformer, closed)]
        self.buses = [self._bus(row) for row in found["buses"]]
        self.powers = [self._power(row) for row in found["powers"]]

    def _refuse(self, message: str, cure: str) -> None:
        self.refused.append((message, cure))

    def _add(self, branch: Row) -> None:
        """One branch: a line between two buses, or what it draws at one."""
        element, joined = branch["element"], {bus for bus, _ in branch["nodes"]}
        if len(joined) > 2:
            self._refuse(f"{element} joins more than two buses", f"Write 'disable {element}'.")
        if len(joined) == 2:
            self._take(element, branch["nodes"])
        if any(first != second for first, second in branch["pairs"]):
            self._refuse(
                f"{element} connects a phase with another one",
                "Name the same nodes at both ends, or import the feeder with --balance.",
            )
        rest = [(bus, nodes, complexes(y)) for bus, nodes, y in branch["rest"]]
        if branch["pairs"]:
            rest = self._line(branch, rest)
        for bus, nodes, y in rest:
            sums = self.at_bus.setdefault((bus, not element.startswith("line.")), {})
            for i, first in enumerate(nodes):
                for j, second in enumerate(nodes):
                    sums[first, second] = sums.get((first, second), 0j) + complex(y[i, j])

    def _line(self, branch: Row, rest: list[Any]) -> list[Any]:
        """Add a line; what of its ends they do not share as charging is left beside it."""
        phases = [first - 1 for first, _ in branch["pairs"]]
        n = len(phases)
        half, other = (y for _, _, y in rest)
        capacitive = (
            len(half) == len(other) == n
            and np.abs(other - half).max() <= SAME * np.abs(half).max()
            and np.abs(half.real).max() <= SAME * np.abs(half).max()
        )
        shared = half.imag if capacitive else np.zeros((n, n))
        self.lines.append(
            {
                "name": branch["element"],
                "from_bus": branch["from_bus"],
                "to_bus": branch["to_bus"],
                "phases": phases,
                "z": complexes(branch["z"]),
                "b_us": 2.0 * shared * US_PER_S,
                "i_max_a": np.nan if branch["amps"] is None else branch["amps"],
            }
        )
        return [] if capacitive else rest

    def _take(self, element: str, nodes: list[Any]) -> None:
        for bus, node in nodes:
            if node > len(PHASES):
                self.users.setdefault((bus, node), set()).add(element)

    def _own(self, node: tuple[str, int]) -> bool:
        """Whether a neutral is that of one transformer, and only shunts ground it."""
        one = [each for each in self.users[node] if each.startswith("transformer.")]
        return len(one) == len(self.users[node]) == 1 and self.grounding(node) is not None

    def grounding(self, node: tuple[str, int]) -> complex | None:
        """Admittance of a neutral to ground, in siemens; None where it joins more than ground."""
        bus, own = node
        nodes, y = _sum([sums for (at, _), sums in self.at_bus.items() if at == bus])
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

    def shunts(self) -> Iterator[tuple[str, list[int], Complexes]]:
        """The matrix of each bus to ground and between its phases, without its own neutrals."""
        for (bus, _), sums in self.at_bus.items():
            nodes, y = _sum([sums])
            gone = [i for i, node in enumerate(nodes) if node > len(PHASES)]
            if gone:
                y = without(y, gone)
            yield bus, [node - 1 for node in nodes if node <= len(PHASES)], y

    def _bus(self, row: Row) -> dict[str, Any]:
        """Phases and nominal voltage between lines of a bus."""
        bus = row["name"]
        beside = [n for n in row["nodes"] if n > len(PHASES) and (bus, n) in self.taken]
        if beside:
            self._refuse(
                f"bus {bus} has node {max(beside)}: conductors beside the phases are not held",
                "Ground the neutral (node 0), or import the feeder with --balance.",
            )
        return {"bus": bus, "kv": row["kv"], "phases": [*words_of(row["nodes"])]}

    def _transformer(self, one: Row) -> dict[str, Any]:
        """A transformer with the coils that each end may have, and its own matrix.

        It has one row for its two windings, or one for each of three and their star.
        """
        windings, count = one["windings"], one["phases"]
        coils = [_windings(each, count) for each in windings]
        if one["star"]:
            star_kv = next(row["kv"] for row in self.found["buses"] if row["name"] == one["star"])
            center = {"bus": one["star"], "kv": star_kv / np.sqrt(3), "tap": 1.0}
            rows = [
                _row(f"{one['name']} winding {number}", (each, center), count, each["r_percent"])
                for number, each in enumerate(windings, start=1)
            ]
            coils.append([" ".join(words_of(one["on_star"]))])
        else:
            r_percent = sum(each["r_percent"] for each in windings)
            rows = [_row(one["name"], windings, count, r_percent)]
            rows[0]["ppm"] = one["ppm"]
            if one["regulated"] == SECOND:
                rows[0]["island_tap"] = 1.0
        live, y, neutrals = [(bus, node) for bus, node in one["live"]], complexes(one["y"]), []
        for node in [node for node in live if node[1] > len(PHASES) and node not in self.taken]:
            i = live.index(node)
            y[i, i] += self.grounding(node) or 0j
            ground = y[i, [bus == node[0] for bus, _ in live]].sum()
            neutrals.append({"bus": node[0], "z": 1.0 / ground})
            y = without(y, [i])
            live.remove(node)
            for row in rows:
                row["ppm"] = 0.0  # it is in the matrix, that of the neutral too
        nodes = [(bus, node - 1) for bus, node in live]
        return {"rows": rows, "coils": coils, "nodes": nodes, "y": y, "neutrals": neutrals}

    def _power(self, row: Row) -> dict[str, Any]:
        """A load, generator or battery with its coils and load model."""
        if row["exponents"] is None:
            self._refuse(
                f"load.{row['name']} has load model {row['model']}",
                "Use model 1, 2, 3, 4 or 5, or import the feeder with --balance.",
            )
        p_kw, q_kvar = row["at_nominal"]
        coils = [*map(words_of, row["coils"])]
        return {**row, "coils": coils, "p_kw": p_kw, "q_kvar": q_kvar}


def _sum(parts: list[dict[tuple[int, int], complex]]) -> tuple[list[int], Complexes]:
    """Nodes of some parts of a bus, and the sum of their matrices."""
    nodes = sorted({node for sums in parts for pair in sums for node in pair})
    entries = [[sum(sums.get((i, j), 0j) for sums in parts) for j in nodes] for i in nodes]
    return nodes, np.array(entries).reshape(len(nodes), len(nodes))


def _row(name: str, sides: Any, phases: int, r_percent: float) -> dict[str, Any]:
    """Two windings without their coils, with the impedance between them in percent."""
    first, second = sides
    return {
        "id": name,
        "from_bus": first["bus"],
        "from_kv": first["kv"],
        "from_tap": first["tap"],
        "to_bus": second["bus"],
        "to_kv": second["kv"],
        "to_tap": second["tap"],
        "kva": first["kva"] / phases,
        "r_pct": r_percent,
        "x_pct": first["x_percent"],
        "ppm": 0.0,
    }


def _windings(own: Row, count: int) -> list[str]:
    """Coils that a winding may be, in words; a conductor at ground is no end of one."""
    if count == 1:  # from one phase to another in either turn, or to ground
        words = words_of(own["ends"][:2])
        return [words, words[::-1]]
    if not own["delta"]:
        return [" ".join(words_of(own["ends"][:count]))]
    names = [words_of([node]) for node in own["ends"][:3]]
    return [_delta(names, NEXT), _delta(names, PREVIOUS)]


def _delta(names: list[str], pairs: tuple[str, ...]) -> str:
    """The coils of a delta whose conductors are these phases."""
    turn = dict(zip(PHASES, names, strict=True))
    return " ".join(turn[pair[0]] + turn[pair[1]] for pair in pairs)
