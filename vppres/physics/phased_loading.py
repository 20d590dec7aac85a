"""Currents of a phased feeder's lines and transformers, as shares of their ratings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Complexes, Floats
from vppres.physics.phases import S_PER_US, Turns
from vppres.scenario.phases import PHASES, PhaseLine, Phases


@dataclass(frozen=True, eq=False)
class Loadings:
    """Shares of ratings that voltages of the nodes lead to."""

    #: Lines by their ends and phase, and transformers by their coils; those that have a rating.
    names: tuple[str, ...]
    per_volt: Any  #: current over rating of each, of the voltages of the nodes in V, (k, nodes)
    kva: Floats  #: what each carries at its rating and nominal voltage, (k,)

    @classmethod
    def of(cls, phases: Phases) -> Loadings:
        """Loadings of all lines and transformers with a rating."""
        rated = [line for line in phases.lines if np.isfinite(line.i_max_a)]
        blocks = [_of_line(phases, line) for line in rated]
        blocks += [_of_transformers(phases)]
        names = [
            f"line from {line.from_bus} to {line.to_bus}, phase {PHASES[phase]}"
            for line in rated
            for phase in line.phases
        ]
        names += [
            f"transformer {unit.id}, {word}"
            for unit in phases.transformers
            for word in unit.to_coils.split()
        ]
        empty = sp.csr_array((0, len(phases.nodes)), dtype=complex)
        kva = [_line_kva(phases, line) for line in rated for _ in line.phases]
        kva += [unit.kva for unit in phases.transformers for _ in unit.to_coils.split()]
        return cls(tuple(names), sp.csr_array(sp.vstack([empty, *blocks])), np.array(kva))

    def in_parts(self, phases: Phases, cut: Phases) -> Loadings:
        """These of the whole feeder, with no current through what its tables in parts lack."""
        lines, units = {id(line) for line in cut.lines}, {unit.id for unit in cut.transformers}
        rated = [line for line in phases.lines if np.isfinite(line.i_max_a)]
        kept = [id(line) in lines for line in rated for _ in line.phases]
        kept += [unit.id in units for unit in phases.transformers for _ in unit.to_coils.split()]
        if not self.names:
            return self
        rows = np.flatnonzero(kept)
        shape = (len(kept), len(rows))
        place = sp.csr_array((np.ones(len(rows)), (rows, np.arange(len(rows)))), shape=shape)
        return replace(self, per_volt=sp.csr_array(place @ Loadings.of(cut).per_volt))

    @classmethod
    def none(cls, phases: Phases) -> Loadings:
        """Loadings of a feeder whose ratings count nothing."""
        nothing = sp.csr_array((0, len(phases.nodes)), dtype=complex)
        return cls((), nothing, np.zeros(0))

    def at(self, v: Complexes) -> Floats:
        """Shares of the ratings, (k,)."""
        return np.abs(self.currents(v))

    def currents(self, v: Complexes) -> Complexes:
        """Currents as shares of the ratings, (k,)."""
        return np.asarray(self.per_volt @ v)


def _line_kva(phases: Phases, line: PhaseLine) -> float:
    """Apparent power of a line's phase at its rating."""
    return float(line.i_max_a * phases.by_bus[line.from_bus].kv / np.sqrt(3))


def _of_line(phases: Phases, line: PhaseLine) -> Any:
    """Current at the sending end of each phase."""
    at = phases.node_index
    own = np.ix_(line.phases, line.phases)
    series = np.linalg.inv(line.z_ohm[own])
    entries = np.hstack([series + 0.5j * S_PER_US * line.b_us[own], -series]) / line.i_max_a
    places = [at[bus, phase] for bus in (line.from_bus, line.to_bus) for phase in line.phases]
    rows = np.repeat(np.arange(len(line.phases)), len(places))
    columns = np.tile(places, len(line.phases))
    return sp.csr_array((entries.ravel(), (rows, columns)), shape=(len(line.phases), len(at)))


def _of_transformers(phases: Phases) -> Any:
    """Current through each pair of coils, without what magnetises them."""
    turns = Turns.of(phases)
    z_pct = turns.per_unit(phases, lambda unit: unit.r_pct + 1j * unit.x_pct)
    return sp.diags_array(100.0 / z_pct) @ turns.through
