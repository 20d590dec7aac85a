"""An OpenDSS circuit as the tables of a phased feeder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from vppres.core.arrays import Complexes, Floats
from vppres.core.errors import InputError, Problem
from vppres.core.units import V_PER_KV
from vppres.feeders.feeder import ImportedFeeder, PhasedLoad, PhasedSource
from vppres.feeders.strangers.confined import TIME_LIMIT_S, confined
from vppres.physics.phases import PhasedFlow, of_transformer
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
"""Share of its largest entry by which a transformer's matrix may differ from that of its coils."""


def phased_source(
    job: Mapping[str, Any], name: str, feeder: ImportedFeeder, disabled: list[str]
) -> PhasedSource:
    """The three phases of a circuit whose balanced tree has been imported.

    ``job`` has the commands that build it; ``feeder`` is the tree, with the name of each bus of the
    circuit in ``source_flow``. Elements in ``disabled`` are out of service.
    """
    found = confined("dss/by_phase", {**job, "disabled": disabled}, name, TIME_LIMIT_S)
    problems = [Problem(name, each["message"], each["cure"]) for each in found["problems"]]
    problems += _crossed(found, name)
    if problems:
        raise InputError(problems)
    flow: Any = feeder.source_flow
    at: dict[str, BusId] = {
        bus: feeder.bus_of[i] for bus, i in flow.index.items() if i in feeder.bus_of
    }
    phases = _phases(found, name, at, feeder.network.slack_bus)
    loads = tuple(_loads(found, at))
    source = PhasedSource(with_grid(phases), loads, found["source"]["v_pu"])
    difference_pu = _difference(source, found["v_pu"])
    return replace(source, difference_pu=difference_pu, notes=tuple(_notes(source.phases)))


def _difference(source: PhasedSource, v_pu: Mapping[str, float]) -> float | None:
    """Largest difference of a node's voltage to ground from OpenDSS's, without generators."""
    if not v_pu:
        return None
    flow, p_kw, q_kvar = flow_of_source(source)
    drawn = np.array([load.kind == "load" for load in source.loads])
    found = flow.solve(p_kw * drawn, q_kvar * drawn)
    base_v = {row.bus: row.kv * V_PER_KV / np.sqrt(3) for row in source.phases.buses}
    apart = [
        abs(abs(v) / base_v[bus] - v_pu[f"{bus}.{phase + 1}"])
        for (bus, phase), v in zip(source.phases.nodes, found.v, strict=True)
        if f"{bus}.{phase + 1}" in v_pu
    ]
    return float(max(apart))


def kept_phases(phases: Phases) -> str:
    """That a feeder is by phase, in sentences."""
    return (
        f"The feeder keeps its phases: {len(phases.nodes)} nodes at {len(phases.buses)} buses. "
        "Plans keep each phase of its lines and transformers within its rating."
    )


def _notes(phases: Phases) -> Iterator[str]:
    """What is known of the phases."""
    yield kept_phases(phases)
    wires = sum(row.limits == LINES for row in phases.buses)
    if wires:
        yield f"Limits are for voltages between phases at {wires} buses that nothing earths."


def _crossed(found: Mapping[str, Any], name: str) -> list[Problem]:
    """Lines that connect a phase with another one."""
    return [
        Problem(
            name,
            f"line.{line['name']} connects a phase with another one",
            "Name the same nodes at both ends, or import the feeder with --balance.",
        )
        for line in found["lines"]
        if line["from_phases"] != line["to_phases"]
    ]


def _phases(found: Mapping[str, Any], name: str, at: Mapping[str, BusId], slack: BusId) -> Phases:
    """The tables without connections; the source is a bus of its own behind its impedance."""
    source = found["source"]
    behind = str(slack)
    rows = [PhaseBus(behind, slack, source["kv"], " ".join(PHASES))]
    rows += [
        PhaseBus(row["bus"], at[row["bus"]], row["kv"], " ".join(row["phases"]))
        for row in found["buses"]
        if row["bus"] in at
    ]
    z, no_charging = _whole(_of(source["z"]), source["phases"]), np.zeros((3, 3))
    lines = [PhaseLine(behind, source["bus"], z, no_charging)]
    lines += [
        PhaseLine(
            line["from_bus"],
            line["to_bus"],
            _whole(_of(line["z"]), line["from_phases"]),
            _whole(np.array(line["b_us"]), line["from_phases"]).real,
            np.nan if line["i_max_a"] is None else line["i_max_a"],
        )
        for line in found["lines"]
        if line["from_bus"] in at
    ]
    units = [
        _transformer(one, name, rows)
        for one in found["transformers"]
        if one["row"]["from_bus"] in at
    ]
    shunts = [
        PhaseShunt(row["bus"], row["coils"], row["kv"], 0.0, -row["kvar"])
        for row in found["capacitors"]
        if row["bus"] in at and row["kvar"]
    ]
    return Phases(tuple(rows), tuple(lines), tuple(units), tuple(shunts))


def _transformer(one: Mapping[str, Any], name: str, rows: list[PhaseBus]) -> PhaseTransformer:
    """The transformer with the coils that give OpenDSS's own matrix."""
    known, y = Phases(tuple(rows), ()), _of(one["y"])
    at = [known.node_index[bus, phase] for bus, phase in one["nodes"]]
    for first, second in product(*one["coils"]):
        unit = PhaseTransformer(**one["row"], from_coils=first, to_coils=second)
        if len(coils_of(first)) == len(coils_of(second)):
            own = of_transformer(known, unit).tocsr()[at][:, at].toarray()
            if np.abs(own - y).max() <= MATCH * np.abs(y).max():
                return unit
    raise InputError(
        [
            Problem(
                name,
                f"transformer.{one['row']['id']} does not follow from its coils: a neutral that is "
                "not grounded, or a core",
                "Leave out neutral impedances, %imag and %noloadloss, or import with --balance.",
            )
        ]
    )


def _of(parts: Mapping[str, Any]) -> Complexes:
    return np.array(parts["re"]) + 1j * np.array(parts["im"])


def _whole(values: Complexes | Floats, phases: list[int]) -> Complexes:
    """A matrix of some phases as one of all three, NaN elsewhere."""
    found = np.full((3, 3), np.nan, dtype=complex)
    found[np.ix_(phases, phases)] = values
    return found


def _loads(found: Mapping[str, Any], at: Mapping[str, BusId]) -> list[PhasedLoad]:
    """Loads and generators that are supplied, with their connections."""
    return [
        PhasedLoad(
            row["kind"],
            at[row["bus"]],
            row["p_kw"],
            row["q_kvar"],
            PhaseConnection(row["name"], row["bus"], row["coils"], row["kv"], *row["exponents"]),
        )
        for row in found["powers"]
        if row["bus"] in at
    ]


def flow_of_source(source: PhasedSource) -> tuple[PhasedFlow, Floats, Floats]:
    """The own power flow of a source as it is given: with its powers, drawn positive."""
    phases = replace(source.phases, connections=tuple(load.connection for load in source.loads))
    names = [load.connection.id for load in source.loads]
    flow = PhasedFlow(phases, names, phases.buses[0].bus, source.v_pu)
    signs = np.array([1.0 if load.kind == "load" else -1.0 for load in source.loads])
    p_kw = signs * np.array([load.p_kw for load in source.loads])
    q_kvar = signs * np.array([load.q_kvar for load in source.loads])
    return flow, p_kw, q_kvar
