"""An OpenDSS circuit as the tables of a phased feeder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from vppres.core.arrays import Complexes, Floats
from vppres.core.errors import InputError, Problem, VerificationError
from vppres.core.text import named
from vppres.core.units import V_PER_KV, W_PER_KW
from vppres.feeders.closeness import NO_SOLUTION, NOT_CONVERGED
from vppres.feeders.dss.by_phase import CircuitByPhase, complexes
from vppres.feeders.dss.circuit import OpenDSSFlow
from vppres.feeders.dss.nodes import beside, reached, without
from vppres.feeders.feeder import ImportedFeeder, PhasedLoad, PhasedSource
from vppres.io.messages import folded
from vppres.physics.phases import PhasedFlow, admittances
from vppres.scenario.earthing import with_grid
from vppres.scenario.network import BusId
from vppres.scenario.phases import (
    LINES,
    PHASES,
    PhaseBus,
    PhaseConnection,
    PhaseLine,
    Phases,
    PhaseShunt,
    PhaseTransformer,
    coils_of,
)

MATCH = 1e-9
"""Share of a transformer's largest entry by which its coils may couple its ends differently."""

MATCH_BEHIND = 1e-7
"""The same where a neutral is behind an impedance, next to which the coils' own vanish."""

LEAST = 1e-9
"""Share of a matrix's largest entry below which an admittance of it is none."""

DRAWING = ("load", "storage")
"""Kinds whose power is drawn; of the others it is given."""

BEHIND = "vsource"
"""Bus behind the source's impedance, where no other has that name."""

Node = tuple[str, int]


def phased_source(flow: OpenDSSFlow, feeder: ImportedFeeder) -> PhasedSource:
    """The three phases of a circuit whose balanced tree has been imported.

    ``feeder`` is the tree. What is out of service in it is so by phase, less what the tree alone
    cannot have: elements that join the source to a conductor that nothing else does.
    """
    found = flow.tables(by_phase=True)
    own = CircuitByPhase(found)
    if own.refused:
        raise InputError(folded([Problem(flow.name, *each) for each in own.refused]))
    at: dict[str, BusId] = {
        bus: feeder.bus_of[i] for bus, i in flow.index.items() if i in feeder.bus_of
    }
    tables = _CircuitTables(own, flow.name, at, feeder.network.slack_bus)
    phases = tables.phases()
    loads, left_out = tables.powers()
    source = PhasedSource(with_grid(phases), tuple(loads), found["source"]["v_pu"])
    difference_pu = _difference(source, found["v_pu"])
    notes = (*_notes(source.phases, found["kept"]), *left_out)
    if difference_pu is None:
        notes += (NO_SOLUTION if found["v_pu"] else NOT_CONVERGED,)
    causes = tuple(words for _, words in found["beyond"])
    return replace(source, difference_pu=difference_pu, notes=notes, causes=causes)


def _difference(source: PhasedSource, v_pu: Mapping[str, float]) -> float | None:
    """Largest difference of a node's voltage to ground from the source's, with its own powers."""
    if not v_pu:
        return None
    flow, p_kw, q_kvar = flow_of_source(source)
    try:
        found = flow.solve(p_kw, q_kvar)
    except VerificationError:
        return None
    base_v = {row.bus: row.kv * V_PER_KV / np.sqrt(3) for row in source.phases.buses}
    behind = source.phases.buses[0].bus
    apart = [
        abs(abs(v) / base_v[bus] - v_pu[f"{bus}.{phase + 1}"])
        for (bus, phase), v in zip(source.phases.nodes, found.v, strict=True)
        if bus != behind and f"{bus}.{phase + 1}" in v_pu
    ]
    return float(max(apart))


def kept_phases(phases: Phases) -> str:
    """Sentences on a feeder that keeps its phases."""
    return (
        f"The feeder keeps its phases: {len(phases.nodes)} nodes at {len(phases.buses)} buses. "
        "Plans keep each phase of its lines and transformers within its rating."
    )


def _notes(phases: Phases, kept: list[str]) -> Iterator[str]:
    """Notes on the phases, and on elements that they have and the tree of buses lacks."""
    yield kept_phases(phases)
    wires = sum(row.limits == LINES for row in phases.buses)
    if wires:
        yield f"Limits are for voltages between phases at {wires} buses that nothing earths."
    if kept:
        yield f"In service by phase, as conductors depend on it: {named(kept)}."


class _CircuitTables:
    """The tables of a circuit: of each bus the phases that the source reaches.

    ``at`` has the feeder's bus of each bus that has supply.
    """

    def __init__(
        self, own: CircuitByPhase, name: str, at: Mapping[str, BusId], slack: BusId
    ) -> None:
        self.source, self.powers_of = own.found["source"], own.powers
        self.name = name
        self.at = dict(at)
        self.slack = slack
        self.kv = {row["bus"]: row["kv"] for row in own.buses}
        self.behind = BEHIND
        while self.behind in self.kv:
            self.behind += "_"
        every = tuple(
            PhaseBus(row["bus"], at[row["bus"]], row["kv"], " ".join(row["phases"]))
            for row in own.buses
            if row["bus"] in at and row["phases"]
        )
        self.rest: list[tuple[str, list[int], Complexes]] = [*own.shunts()]
        self.buses: list[Mapping[str, Any]] = [*own.buses]
        self.lines: list[Mapping[str, Any]] = [*own.lines]
        units = [each for each in own.transformers if each["rows"][0]["from_bus"] in at]
        rows = {row.bus: row for row in every}
        self.units = [unit for each in units for unit in self._transformer(each, rows)]
        self.reached = self._reached()

    def phases(self) -> Phases:
        """The tables without connections; the source is a bus of its own behind its impedance."""
        source = self.source
        rows = [PhaseBus(self.behind, self.slack, source["kv"], " ".join(PHASES))]
        for row in self.buses:
            live = [p for p in row["phases"] if (row["bus"], PHASES.index(p)) in self.reached]
            if row["bus"] in self.at and live:
                rows.append(PhaseBus(row["bus"], self.at[row["bus"]], row["kv"], " ".join(live)))
        z, no_charging = _whole(complexes(source["z"]), source["phases"]), np.zeros((3, 3))
        lines = [PhaseLine(self.behind, source["bus"], z, no_charging)]
        lines += [line for each in self.lines for line in self._line(each)]
        shunts = [row for each in self.rest for row in self._shunts(*each)]
        units = [unit for each in self.units for unit in self._live(each)]
        return Phases(tuple(rows), tuple(lines), tuple(units), tuple(shunts))

    def _reached(self) -> set[Node]:
        """Nodes that lines and pairs of coils join to the source."""
        groups: list[set[Node]] = [{(self.source["bus"], phase) for phase in self.source["phases"]}]
        for line in self.lines:
            ends = (line["from_bus"], line["to_bus"])
            groups += [{(bus, phase) for bus in ends} for phase in line["phases"]]
        groups += [pair for unit in self.units for pair in _pairs(unit)]
        return {*reached(next(iter(groups[0])), beside([[*group] for group in groups]))}

    def _line(self, line: Mapping[str, Any]) -> Iterator[PhaseLine]:
        """A line with the phases that are supplied."""
        kept = [
            i for i, phase in enumerate(line["phases"]) if (line["from_bus"], phase) in self.reached
        ]
        if line["from_bus"] not in self.at or not kept:
            return
        own = np.ix_(kept, kept)
        phases = [line["phases"][i] for i in kept]
        yield PhaseLine(
            line["from_bus"],
            line["to_bus"],
            _whole(line["z"][own], phases),
            _whole(line["b_us"][own], phases).real,
            line["i_max_a"],
        )

    def _transformer(
        self, one: Mapping[str, Any], rows: Mapping[str, PhaseBus]
    ) -> list[PhaseTransformer]:
        """The transformer whose coils couple its ends as OpenDSS's own matrix does.

        Three windings are three transformers to their star. What is left beside them, magnetising
        and core, is at its ends.
        """
        sides = [(row, end) for row in one["rows"] for end in ("from", "to")]
        own = {row[f"{end}_bus"]: rows[row[f"{end}_bus"]] for row, end in sides}
        lines = []
        for neutral in one["neutrals"]:
            row, end = next(side for side in sides if side[0][f"{side[1]}_bus"] == neutral["bus"])
            inner, line = self._behind_neutral(own[neutral["bus"]], row, end, neutral["z"])
            own[inner.bus] = inner
            lines.append(line)
        match = MATCH_BEHIND if lines else MATCH
        first = PhaseBus(self.behind, self.slack, 1.0, " ".join(PHASES))
        known, y = Phases((first, *own.values()), tuple(lines)), one["y"]
        ends = [(bus, phase) for bus, phase in one["nodes"]]
        star = [
            i for i, (bus, _) in enumerate(known.nodes) if bus not in {*dict(ends), self.behind}
        ]
        kept = [node for i, node in enumerate(known.nodes) if i not in star]
        at = [kept.index(node) for node in ends]
        across = np.array([[first[0] != second[0] for second in ends] for first in ends])
        for coils in product(*one["coils"]):
            pairs = [(word, coils[-1]) for word in coils[:-1]]
            words = [word for pair in pairs for each in pair for word in each.split()]
            alike = len({len(each.split()) for each in coils}) == 1 and words
            if not alike or any(len(set(word)) < len(word) for word in words):
                continue  # a coil at ground, or between a phase and itself
            units = [
                PhaseTransformer(**row, from_coils=pair[0], to_coils=pair[1])
                for row, pair in zip(one["rows"], pairs, strict=True)
            ]
            whole = admittances(replace(known, transformers=tuple(units))).toarray()
            rest = y - without(whole, star)[np.ix_(at, at)]
            if across.any() and np.abs(rest[across]).max() <= match * np.abs(y[across]).max():
                for bus in dict.fromkeys(bus for bus, _ in ends):
                    own_at = [i for i, node in enumerate(ends) if node[0] == bus]
                    if np.abs(rest[np.ix_(own_at, own_at)]).max() > MATCH * np.abs(y).max():
                        phases = [ends[i][1] for i in own_at]
                        self.rest.append((bus, phases, rest[np.ix_(own_at, own_at)]))
                return units
        raise InputError.of(
            self.name,
            f"transformer.{one['rows'][0]['id']} does not follow from its coils: a neutral that is "
            "not grounded, an open conductor, or a phase at ground",
            "Connect its neutrals to ground, or import the feeder with --balance.",
        )

    def _behind_neutral(
        self, bus: PhaseBus, row: dict[str, Any], end: str, z_neutral: complex
    ) -> tuple[PhaseBus, PhaseLine]:
        """A bus between a winding in wye and its own, and the line from there.

        What grounds the winding's neutral carries the current of all phases: it is in the line,
        with half of the transformer's impedance, as it alone has no inverse.
        """
        inner = replace(bus, bus=f"{bus.bus} before {row['id']}")
        row["r_pct"], row["x_pct"] = row["r_pct"] / 2.0, row["x_pct"] / 2.0
        row[f"{end}_bus"] = inner.bus
        ohm = (row[f"{end}_kv"] * row[f"{end}_tap"]) ** 2 * V_PER_KV / row["kva"] / 100.0
        phases = [PHASES.index(phase) for phase in bus.phases.split()]
        n = len(phases)
        z = ohm * complex(row["r_pct"], row["x_pct"]) * np.eye(n) + z_neutral * np.ones((n, n))
        line = {
            "from_bus": inner.bus,
            "to_bus": bus.bus,
            "phases": phases,
            "z": z,
            "b_us": np.zeros((n, n)),
            "i_max_a": np.nan,
        }
        self.lines.append(line)
        self.buses.append({"bus": inner.bus, "kv": inner.kv, "phases": bus.phases.split()})
        self.at[inner.bus] = inner.at
        self.kv[inner.bus] = inner.kv
        return inner, PhaseLine(inner.bus, bus.bus, _whole(z, phases), np.zeros((3, 3)))

    def _live(self, unit: PhaseTransformer) -> Iterator[PhaseTransformer]:
        """A transformer with the pairs of coils that are supplied."""
        kept = [i for i, pair in enumerate(_pairs(unit)) if pair <= self.reached]
        first, second = (
            " ".join(coils.split()[i] for i in kept) for coils in (unit.from_coils, unit.to_coils)
        )
        if kept:
            yield replace(unit, from_coils=first, to_coils=second)

    def _shunts(self, bus: str, phases: list[int], y: Complexes) -> Iterator[PhaseShunt]:
        """A matrix at a bus as coils to ground and between phases, at its nominal voltage.

        Those of all three phases that are the same are one.
        """
        live = [i for i, phase in enumerate(phases) if (bus, phase) in self.reached]
        if bus not in self.at or not live:
            return
        y = y[np.ix_(live, live)]
        names = [PHASES[phases[i]] for i in live]
        least = LEAST * float(np.abs(y).max(initial=0.0))
        pairs = [(i, j) for i in range(len(live)) for j in range(i + 1, len(live))]
        to_ground = {name: y[i].sum() for i, name in enumerate(names)}
        between = {names[i] + names[j]: -(y[i, j] + y[j, i]) / 2.0 for i, j in pairs}
        kv = self.kv[bus] / np.sqrt(3)
        for coils, across in ((to_ground, kv), (between, self.kv[bus])):
            values = np.array([*coils.values()])
            one = len(values) == len(PHASES) and np.abs(values - values[0]).max() < least
            rows = [(" ".join(coils), values.sum())] if one else [*coils.items()]
            for words, siemens in rows:
                if abs(siemens) > least:
                    kva = np.conj(siemens) * (across * V_PER_KV) ** 2 / W_PER_KW
                    yield PhaseShunt(bus, words, across, float(kva.real), float(kva.imag))

    def powers(self) -> tuple[list[PhasedLoad], list[str]]:
        """Loads and generators with their connections, and sentences on those not supplied."""
        found: list[PhasedLoad] = []
        dead: list[str] = []
        for row in self.powers_of:
            bus, coils = row["bus"], [coil for coil in row["coils"] if coil]
            live = [
                coil for coil in coils if all((bus, PHASES.index(p)) in self.reached for p in coil)
            ]
            share = len(live) / max(len(row["coils"]), 1)
            if bus not in self.at or len(live) < len(row["coils"]):
                lost_kw = row["p_kw"] * (1.0 if bus not in self.at else 1.0 - share)
                dead.append(f"{row['kind']}.{row['name']} at bus {bus}, {lost_kw:.4g} kW")
            if bus in self.at and live:
                connection = PhaseConnection(
                    row["name"], bus, " ".join(live), row["kv"], *row["exponents"]
                )
                powers = (share * row["p_kw"], share * row["q_kvar"])
                found.append(PhasedLoad(row["kind"], self.at[bus], *powers, connection))
        return found, [f"Without supply, and left out: {named(dead)}."] if dead else []


def _pairs(unit: PhaseTransformer) -> list[set[Node]]:
    """Nodes of each pair of coils."""
    sides = [
        [{(bus, end) for end in coil if end is not None} for coil in coils_of(words)]
        for bus, words in ((unit.from_bus, unit.from_coils), (unit.to_bus, unit.to_coils))
    ]
    return [first | second for first, second in zip(*sides, strict=True)]


def _whole(values: Complexes | Floats, phases: list[int]) -> Complexes:
    """A matrix of some phases as one of all three, NaN elsewhere."""
    found = np.full((3, 3), np.nan, dtype=complex)
    found[np.ix_(phases, phases)] = values
    return found


def flow_of_source(source: PhasedSource) -> tuple[PhasedFlow, Floats, Floats]:
    """The own power flow of a source as it is given: with its powers, drawn positive."""
    phases = replace(source.phases, connections=tuple(load.connection for load in source.loads))
    names = [load.connection.id for load in source.loads]
    flow = PhasedFlow(phases, names, [(phases.buses[0].bus, source.v_pu)])
    signs = np.array([1.0 if load.kind in DRAWING else -1.0 for load in source.loads])
    p_kw = signs * np.array([load.p_kw for load in source.loads])
    q_kvar = signs * np.array([load.q_kvar for load in source.loads])
    return flow, p_kw, q_kvar
