"""Elements of a finished circuit by their own admittances; runs in the process of the reader.

What a line, reactor or capacitor is, its matrix says: which conductors are open, steps that are
out, reactances in series and conductors that are grounded are in it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import opendssdirect as dss

from vppres.core.units import V_PER_KV, VA_PER_KVA
from vppres.feeders.dss.nodes import beside, reached

PHASES = (1, 2, 3)
LEAST_PCT = 1e-6
"""Reactance of a leg of a star that has no impedance."""

Node = tuple[str, int]


@dataclass
class Circuit:
    """The engine's circuit: its elements, and those that are something else here."""

    ends_solved: bool = False  #: whether the script's last command has solved it
    said: str = ""  #: what OpenDSS said when it did not solve the script's circuit
    at_rest: bool = False  #: whether what storage draws at rest is left out of its solution
    #: Options of ``set`` that the script has and OpenDSS did not get.
    left_out: tuple[str, ...] = ()
    #: Controls that OpenDSS refuses, and why: without them the circuit is what it is.
    refused: dict[str, str] = field(default_factory=dict)
    #: Enabled elements of each class, in lower case.
    names: dict[str, list[str]] = field(default_factory=dict)
    #: Buses behind the middle of a winding: the phase that they count as, and the sign of each leg.
    #: Both legs are one node there, with the voltage from leg to leg: half of it, and its opposite,
    #: is that of either leg to ground.
    legs: dict[str, tuple[int, dict[int, float]]] = field(default_factory=dict)
    #: Transformers with three windings at three buses: the bus of their star, and its phases.
    stars: dict[str, tuple[str, tuple[int, ...]]] = field(default_factory=dict)
    #: Buses whose level is not the one that OpenDSS took, and theirs in kV.
    moved: dict[str, float] = field(default_factory=dict)

    def find(self) -> None:
        """Find the enabled elements, the legs and the stars of the finished circuit."""
        self.find_elements()
        self._find_legs()
        self._find_stars()

    def find_elements(self) -> None:
        """Find the elements that are enabled."""
        self.names = {}
        for element in dss.Circuit.AllElementNames():
            dss.Circuit.SetActiveElement(element)
            if dss.CktElement.Enabled():
                kind, _, name = element.lower().partition(".")
                self.names.setdefault(kind, []).append(name)

    def of(self, kind: str) -> Iterator[str]:
        """Names of the enabled elements of a class; each is active while it is yielded."""
        for name in self.names.get(kind, ()):
            dss.Circuit.SetActiveElement(f"{kind}.{name}")
            yield name

    @property
    def elements(self) -> list[str]:
        """Enabled elements, as ``class.name``."""
        return [f"{kind}.{name}" for kind, names in self.names.items() for name in names]

    def held_by(self, end: Node) -> tuple[Node, float]:
        """The node whose voltage a conductor has, and its share of it; ground has none."""
        bus, node = end
        if bus not in self.legs:
            return end, 1.0 if node > 0 else 0.0
        phase, signs = self.legs[bus]
        return (bus, phase), signs.get(node, 0.0) / 2.0

    def base_kv(self, bus: str) -> float:
        """Nominal line-to-line voltage of a bus; from leg to leg it is that of a phase."""
        dss.Circuit.SetActiveBus(bus)
        legs = 2.0 if bus in self.legs else 1.0
        return float(legs * dss.Bus.kVBase() * np.sqrt(3))

    def from_leg_to_leg(self, bus: str) -> complex:
        """Voltage between the legs of a bus in the solution, in V; of a leg alone twice its own."""
        _, signs = self.legs[bus]
        dss.Circuit.SetActiveBus(bus)
        nodes, flat = dss.Bus.Nodes(), np.asarray(dss.Bus.Voltages())
        volts = dict(zip(nodes, flat[::2] + 1j * flat[1::2], strict=False))
        here = [sign * volts[node] for node, sign in signs.items() if node in volts]
        return complex(sum(here) * 2.0 / max(len(here), 1))

    def volts(self) -> dict[str, complex]:
        """Voltage of each node to ground in the solution, of two legs from one to the other."""
        flat = np.asarray(dss.Circuit.AllBusVolts())
        names = [name.lower() for name in dss.Circuit.AllNodeNames()]
        found = dict(zip(names, (flat[::2] + 1j * flat[1::2]).tolist(), strict=True))
        alone = {node: v for node, v in found.items() if node.rpartition(".")[0] not in self.legs}
        legs = self.legs.items()
        return alone | {f"{bus}.{phase}": self.from_leg_to_leg(bus) for bus, (phase, _) in legs}

    def admittance(self) -> tuple[list[Node], Any]:
        """Nodes that the active element connects, in the order of its conductors, and their matrix.

        Ground is no node, two conductors at one node are one, and one that is open is not there.
        """
        ends, y = [self.held_by(end) for end in nodes_of()], matrix()
        closed = [each for terminal in shut() for each in terminal]
        shares = [share if one else 0.0 for (_, share), one in zip(ends, closed, strict=True)]
        known = list(dict.fromkeys(end for (end, _), one in zip(ends, shares, strict=True) if one))
        at = np.zeros((len(known), len(ends)))
        for i, ((end, _), share) in enumerate(zip(ends, shares, strict=True)):
            if share:
                at[known.index(end), i] = share
        return known, at @ y @ at.T

    def joined(self) -> list[tuple[Node, Node]]:
        """Nodes that conductors of the active element join, those that are closed at both ends."""
        if dss.CktElement.NumTerminals() < 2:  # a delta of capacitors
            return []
        ends, n = [self.held_by(end) for end in nodes_of()], dss.CktElement.NumConductors()
        first, second = shut()[:2]
        kept = [
            (ends[k][0], ends[n + k][0])
            for k in range(n)
            if first[k] and second[k] and ends[k][1] and ends[n + k][1]
        ]
        return list(dict.fromkeys(pair for pair in kept if all(node in PHASES for _, node in pair)))

    def phases(self) -> list[int]:
        """Phases that the active element's first terminal is at, from 1 to 3."""
        held = [self.held_by(end) for end in nodes_of()[: dss.CktElement.NumConductors()]]
        return sorted({node for (_, node), share in held if share} & set(PHASES))

    def beside(self) -> dict[str, list[str]]:
        """Buses that lines join to each bus."""
        return beside([buses_of(nodes_of()) for _ in self.of("line")])

    def _find_legs(self) -> None:
        """Find the buses that only hang behind the middle of a winding, along lines."""
        known = self.beside()
        for _ in self.of("transformer"):
            found = middle()
            if found is not None:
                phase, bus, signs = found
                for each in reached(bus, known):
                    self.legs.setdefault(each, (phase, signs))

    def _find_stars(self) -> None:
        """Name the star of each transformer with three windings at three buses.

        Units of single phases between the same buses share one, each with a phase of its own there.
        """
        known = set(dss.Circuit.AllBusNames())
        banks: dict[tuple[str, ...], list[tuple[str, set[int]]]] = {}
        for name in self.of("transformer"):
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
            self.stars[name] = (free[0], own)


def buses() -> list[str]:
    """Buses of the active element's terminals, without their phases."""
    return [bus.partition(".")[0].lower() for bus in dss.CktElement.BusNames()]


def nodes_of() -> list[Node]:
    """Bus and node of each conductor of the active element, terminal by terminal."""
    at, each = buses(), dss.CktElement.NumConductors()
    return [(at[i // each], int(node)) for i, node in enumerate(dss.CktElement.NodeOrder())]


def matrix() -> Any:
    """Admittances of the active element in siemens, conductor by conductor."""
    flat = np.asarray(dss.CktElement.YPrim())
    size = round((len(flat) / 2) ** 0.5)
    return (flat[::2] + 1j * flat[1::2]).reshape(size, size).T


def shut() -> list[list[bool]]:
    """Whether each conductor of each terminal of the active element is closed."""
    conductors = range(1, dss.CktElement.NumConductors() + 1)
    terminals = range(1, dss.CktElement.NumTerminals() + 1)
    return [[not dss.CktElement.IsOpen(end, one) for one in conductors] for end in terminals]


def buses_of(nodes: list[Node]) -> list[str]:
    """Buses of some nodes, in their order."""
    return list(dict.fromkeys(bus for bus, _ in nodes))


class TwoPort:
    """The active element between two buses: conductors in series, and the rest at both ends.

    ``start`` and ``end`` are its buses, ``phases`` the pairs of phases that it joins; ``z`` has
    their impedance in ohm and ``rest`` the admittances of each end beside it, with ``nodes``.
    """

    def __init__(self, circuit: Circuit, nodes: list[Node], y: Any) -> None:
        self.start, self.end = buses_of(nodes)
        pairs = [pair for pair in circuit.joined() if pair[0][0] != pair[1][0]]
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


def text_of(element: str, name: str) -> str:
    """Value of an element's property."""
    dss.Circuit.SetActiveElement(element)
    return str(dss.Properties.Value(name)).strip()


def number(element: str, name: str) -> float:
    """A property that OpenDSS only tells as text."""
    return float(text_of(element, name))


def coil_volts(delta: bool) -> list[float]:
    """Voltage across each coil of the active load or generator in the last solution."""
    flat = np.asarray(dss.CktElement.Voltages())
    volts = flat[::2] + 1j * flat[1::2]
    other = [volts[(i + 1) % len(volts)] if delta else volts[-1] for i in range(len(volts))]
    return [float(abs(volts[i] - other[i])) for i in range(dss.CktElement.NumPhases())]


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
    turns = []
    for winding in (2, 3):
        dss.Transformers.Wdg(winding)
        turns.append((float(dss.Transformers.kV()), float(dss.Transformers.Tap())))
    (bus, first), (_, back), (other, forth), (_, second) = ends[2:6]
    phases = [node for _, node in ends[:2] if node in PHASES]
    if bus != other or turns[0] != turns[1] or not phases:
        return None
    if back == 0 and forth == 0 and first != second and 0 not in (first, second):
        return phases[0], bus, {first: 1.0, second: -1.0}
    return None


@dataclass
class Side:
    """One side of a transformer: its bus, the voltage across a coil, its ends, tap and rating."""

    bus: str
    kv: float
    ends: list[Node]
    tap: float = 1.0
    kva: float = 0.0


class Winding(Side):
    """A winding of the active transformer, and its leg of the star of three in percent.

    Impedances are on the rating of the first winding; of two, both have all of the reactance.
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
        x_pct = reactances()[0]
        if dss.Transformers.NumWindings() > 2:
            x_pct = _of_star(number)
            x_pct = x_pct if abs(x_pct) + self.r_pct > LEAST_PCT else LEAST_PCT
        self.percent = complex(self.r_pct, x_pct)
        dss.Transformers.Wdg(1)
        self.kva = float(dss.Transformers.kVA())


def reactances() -> list[float]:
    """Of the active transformer between each two windings, 1-2 first, in percent.

    By ``xscarray``: what is given by it, ``xhl`` and the like do not show.
    """
    return [float(x) for x in str(dss.Properties.Value("xscarray")).strip("[] ").split()]


def _of_star(number: int) -> float:
    """Reactance of a leg of the active transformer's star in percent."""
    xhl, xht, xlt = reactances()
    twice = {1: xhl + xht - xlt, 2: xhl + xlt - xht, 3: xht + xlt - xhl}[number]
    return twice / 2.0


def service(circuit: Circuit, nodes: list[Node], y: Any) -> tuple[list[Side], complex]:
    """Both sides of the active transformer, its middle at ground, and their impedance in percent.

    That follows from its matrix between its primary and both legs.
    """
    ends = [circuit.held_by(end)[0] for end in nodes_of()[:3]]
    dss.Transformers.Name(dss.CktElement.Name().partition(".")[2])
    sides = []
    for winding, own in ((1, ends[:2]), (2, ends[2:])):
        dss.Transformers.Wdg(winding)
        kv, tap = float(dss.Transformers.kV()) * winding, float(dss.Transformers.Tap())
        sides.append(Side(own[0][0], kv, own, tap))
    dss.Transformers.Wdg(1)
    kva = sides[0].kva = float(dss.Transformers.kVA())
    first = nodes.index(next(node for node in nodes if node[0] not in circuit.legs))
    last = next(i for i, node in enumerate(nodes) if node[0] in circuit.legs)
    ohm_pct = 100.0 * kva * VA_PER_KVA / (V_PER_KV**2 * sides[0].kv * sides[1].kv)
    z = complex(ohm_pct / (-y[first, last] * sides[0].tap * sides[1].tap))
    return sides, z if z.imag > 0.0 else -z  # turned round, its voltage is the opposite
