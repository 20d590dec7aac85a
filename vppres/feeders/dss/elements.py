"""Elements of a finished circuit by their own admittances; runs in the process of the reader.

What a line, reactor or capacitor is, its matrix says: which conductors are open, steps that are
out, reactances in series and conductors that are grounded are in it.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import opendssdirect as dss

PHASES = (1, 2, 3)
ANGLES = np.exp(-2j * np.pi / 3 * np.arange(3))
"""Turns of phases a, b and c."""

V_PER_KV, VA_PER_KVA = 1000.0, 1000.0

LEAST_PCT = 1e-6
"""Reactance of a leg of a star that has no impedance."""

Node = tuple[str, int]

LEGS: dict[str, tuple[int, dict[int, float]]] = {}
"""Buses behind the middle of a winding: the phase that they count as, and the sign of each leg.

Both legs are one node there, with the voltage from leg to leg: half of it, and its opposite, is
that of either leg to ground.
"""

STARS: dict[str, tuple[str, tuple[int, ...]]] = {}
"""Transformers with three windings at three buses: the bus of their star, and its phases."""


def nodes() -> Any:
    """The module of what is joined: child.py loads it by its file."""
    return sys.modules["dss/nodes"]


def nodes_of() -> list[Node]:
    """Bus and node of each conductor of the active element, terminal by terminal."""
    buses = [bus.partition(".")[0].lower() for bus in dss.CktElement.BusNames()]
    each = dss.CktElement.NumConductors()
    order = dss.CktElement.NodeOrder()
    return [(buses[i // each], int(node)) for i, node in enumerate(order)]


def matrix() -> Any:
    """Admittances of the active element in siemens, conductor by conductor."""
    flat = np.asarray(dss.CktElement.YPrim())
    size = round((len(flat) / 2) ** 0.5)
    return (flat[::2] + 1j * flat[1::2]).reshape(size, size).T


def _shut() -> list[list[bool]]:
    """Whether each conductor of each terminal of the active element is closed."""
    conductors = range(1, dss.CktElement.NumConductors() + 1)
    terminals = range(1, dss.CktElement.NumTerminals() + 1)
    return [[not dss.CktElement.IsOpen(end, one) for one in conductors] for end in terminals]


def held_by(end: Node) -> tuple[Node, float]:
    """The node whose voltage a conductor has, and its share of it; ground has none."""
    bus, node = end
    if bus not in LEGS:
        return end, 1.0 if node > 0 else 0.0
    phase, signs = LEGS[bus]
    return (bus, phase), signs.get(node, 0.0) / 2.0


def admittance() -> tuple[list[Node], Any]:
    """Nodes that the active element connects, in the order of its conductors, and their matrix.

    Ground is no node, two conductors at one node are one, and one that is open is not there.
    """
    ends, y = [held_by(end) for end in nodes_of()], matrix()
    shut = [each for terminal in _shut() for each in terminal]
    shares = [share if closed else 0.0 for (_, share), closed in zip(ends, shut, strict=True)]
    known = list(dict.fromkeys(end for (end, _), one in zip(ends, shares, strict=True) if one))
    at = np.zeros((len(known), len(ends)))
    for i, ((end, _), share) in enumerate(zip(ends, shares, strict=True)):
        if share:
            at[known.index(end), i] = share
    return known, at @ y @ at.T


def joined() -> list[tuple[Node, Node]]:
    """Nodes that the conductors of the active element join, those that are closed at both ends."""
    ends, n = [held_by(end) for end in nodes_of()], dss.CktElement.NumConductors()
    first, second = _shut()[:2]
    kept = [
        (ends[k][0], ends[n + k][0])
        for k in range(n)
        if first[k] and second[k] and ends[k][1] and ends[n + k][1]
    ]
    return list(dict.fromkeys(pair for pair in kept if all(node in PHASES for _, node in pair)))


def buses_of(nodes: list[Node]) -> list[str]:
    """Buses of some nodes, in their order."""
    return list(dict.fromkeys(bus for bus, _ in nodes))


class TwoPort:
    """The active element between two buses: conductors in series, and the rest at both ends.

    ``start`` and ``end`` are its buses, ``phases`` the pairs of phases that it joins; ``z`` has
    their impedance in ohm and ``rest`` the admittances of each end beside it, with ``nodes``.
    """

    def __init__(self, nodes: list[Node], y: Any) -> None:
        self.start, self.end = buses_of(nodes)
        pairs = [pair for pair in joined() if pair[0][0] != pair[1][0]]
        self.phases = [(first, second) for (_, first), (_, second) in pairs]
        ends = [[nodes.index(pair[end]) for pair in pairs] for end in (0, 1)]
        series = -y[np.ix_(*ends)]
        self.z = np.linalg.inv(series)
        kept = [[i for i, (b, n) in enumerate(nodes) if b == bus and n in PHASES]
                for bus in (self.start, self.end)]  # fmt: skip
        self.nodes = [[nodes[i][1] for i in own] for own in kept]
        self.rest = []
        for own, places, through in zip(kept, ends, (series, series.T), strict=True):
            rest = y[np.ix_(own, own)].copy()
            at = [own.index(place) for place in places]
            rest[np.ix_(at, at)] -= through
            self.rest.append(rest)

    @property
    def crossed(self) -> bool:
        """Whether a phase becomes another one."""
        return any(first != second for first, second in self.phases)


def power_at_nominal(nodes: list[Node], y: Any, base_kv: float) -> complex:
    """Power of a matrix at the nominal voltages of its bus, in kW and kvar; neutrals have 0 V."""
    phases = [i for i, (_, node) in enumerate(nodes) if node in PHASES]
    v = base_kv * V_PER_KV / np.sqrt(3) * ANGLES[[nodes[i][1] - 1 for i in phases]]
    return complex((v * np.conj(y[np.ix_(phases, phases)] @ v)).sum()) / VA_PER_KVA


def power_drawn() -> complex:
    """Power of the active element in the last solution at all terminals, in kW and kvar."""
    flat = np.asarray(dss.CktElement.Powers())
    return complex(flat[::2].sum(), flat[1::2].sum())


def middle() -> tuple[int, str, dict[int, float]] | None:
    """Phase, bus and legs of the active transformer if its secondary has its middle at ground.

    One phase, and two windings alike at one bus, each between a leg and ground.
    """
    name = dss.CktElement.Name().partition(".")[2]
    dss.Transformers.Name(name)
    if dss.Transformers.NumWindings() != 3 or dss.CktElement.NumPhases() != 1:
        return None
    ends = nodes_of()
    kv = []
    for winding in (2, 3):
        dss.Transformers.Wdg(winding)
        kv.append(float(dss.Transformers.kV()))
    (bus, first), (_, back), (other, forth), (_, second) = ends[2:6]
    phases = [node for _, node in ends[:2] if node in PHASES]
    if bus != other or kv[0] != kv[1] or not phases:
        return None
    if back == 0 and forth == 0 and first != second and 0 not in (first, second):
        return phases[0], bus, {first: 1.0, second: -1.0}
    return None


def beside(lines: list[str]) -> dict[str, list[str]]:
    """Buses that lines join to each bus."""
    ends = []
    for element in lines:
        dss.Circuit.SetActiveElement(element)
        ends.append(buses_of(nodes_of()))
    found: dict[str, list[str]] = nodes().beside(ends)
    return found


def find_legs(transformers: list[str], lines: list[str]) -> None:
    """Find the buses that only hang behind the middle of a winding, along lines."""
    LEGS.clear()
    known = beside(lines)
    for element in transformers:
        dss.Circuit.SetActiveElement(element)
        found = middle()
        if found is not None:
            phase, bus, signs = found
            for each in nodes().reached(bus, known):
                LEGS.setdefault(each, (phase, signs))


def find_stars(transformers: list[str]) -> None:
    """Name the star of each transformer with three windings at three buses.

    Units of single phases between the same buses share one, each with a phase of its own there.
    """
    STARS.clear()
    known = set(dss.Circuit.AllBusNames())
    banks: dict[tuple[str, ...], list[tuple[str, set[int]]]] = {}
    for element in transformers:
        dss.Circuit.SetActiveElement(element)
        name = dss.CktElement.Name().partition(".")[2]
        dss.Transformers.Name(name)
        ends = nodes_of()
        buses = tuple(buses_of(ends))
        if dss.Transformers.NumWindings() != 3 or len(buses) != 3:
            continue
        at = [node for _, node in ends if node in PHASES]
        own = PHASES if dss.CktElement.NumPhases() > 1 else tuple(at[:1])
        bank = banks.setdefault(buses, [])
        free = next((each for each in bank if not each[1] & {*own}), None)
        if free is None:
            star = f"star_{name}"
            while star in known:
                star += "_"
            free = (star, set())
            bank.append(free)
            known.add(star)
        free[1].update(own)
        STARS[name] = (free[0], own)


class Winding:
    """A winding of the active transformer: its bus and coil, and its leg of the star in percent.

    ``kv`` is across a coil; impedances are on the rating of the first winding.
    """

    def __init__(self, number: int) -> None:
        n = dss.CktElement.NumConductors()
        phases = dss.CktElement.NumPhases()
        self.ends = nodes_of()[(number - 1) * n : number * n]
        self.bus = self.ends[0][0]
        dss.Transformers.Wdg(number)
        self.delta = bool(dss.Transformers.IsDelta())
        self.rated_kv = float(dss.Transformers.kV())
        self.kv = self.rated_kv / (np.sqrt(3) if phases > 1 and not self.delta else 1.0)
        self.tap = float(dss.Transformers.Tap())
        self.r_pct = float(dss.Transformers.R())
        if dss.Transformers.NumWindings() > 2:
            x_pct = _of_star(number)
            self.x_pct = x_pct if abs(x_pct) + self.r_pct > LEAST_PCT else LEAST_PCT
        dss.Transformers.Wdg(1)
        self.kva = float(dss.Transformers.kVA())


def _of_star(number: int) -> float:
    """Reactance of a leg of the active transformer's star in percent."""
    xhl, xht, xlt = (dss.Transformers.Xhl(), dss.Transformers.Xht(), dss.Transformers.Xlt())
    twice = {1: xhl + xht - xlt, 2: xhl + xlt - xht, 3: xht + xlt - xhl}[number]
    return float(twice) / 2.0


class Star:
    """The star of three windings, as a winding."""

    tap = 1.0

    def __init__(self, bus: str, kv: float) -> None:
        self.bus = bus
        self.kv = kv


class ServiceTransformer:
    """The active transformer with its middle at ground, as one with two windings.

    ``y`` is its matrix between its primary and both legs, from which its impedance follows.
    """

    def __init__(self) -> None:
        name = dss.CktElement.Name().partition(".")[2]
        self.nodes, self.y = admittance()
        self.ends = [held_by(end)[0] for end in nodes_of()[:3]]
        dss.Transformers.Name(name)
        self.kv, self.tap = [], []
        for winding in (1, 2):
            dss.Transformers.Wdg(winding)
            self.kv.append(float(dss.Transformers.kV()) * winding)
            self.tap.append(float(dss.Transformers.Tap()))
        dss.Transformers.Wdg(1)
        self.kva = float(dss.Transformers.kVA())
        first = self.nodes.index(next(node for node in self.nodes if node[0] not in LEGS))
        last = next(i for i, node in enumerate(self.nodes) if node[0] in LEGS)
        volts = V_PER_KV**2 * self.kv[0] * self.kv[1] * self.tap[0] * self.tap[1]
        z = complex(100.0 * self.kva * VA_PER_KVA / (-self.y[first, last] * volts))
        self.percent = z if z.imag > 0.0 else -z  # turned round, its voltage is the opposite
