"""Three-phase power flow on admittances that are made of a feeder's tables.

Every device is a set of coils, each between two nodes or a node and ground. With the currents ``I``
that coils draw, voltages are ``V = w - Z I``: ``w`` without any, and ``Z`` one factorisation of the
admittance matrix for each source. So only the voltages across the coils have to be found, by a
fixed point, and by Newton's method where that does not meet.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from vppres.core.arrays import Complexes, Flags, Floats, Wholes
from vppres.core.units import V_PER_KV, VA_PER_KVA, W_PER_KW
from vppres.physics.powerflow import NoSolutionError
from vppres.scenario.phases import Phases, PhaseTransformer, coils_of

TOLERANCE_PU = 1e-10
"""Largest change of a coil's voltage in the last round, as a share of its rated voltage."""

MAX_ROUNDS = 60
MAX_NEWTON = 20
LEAST_SHARE = 1e-3
"""How sharply the share of a load is located beyond which there is no solution."""

ANGLES = np.exp(-2j * np.pi / 3 * np.arange(3))
"""Turns of phases a, b and c."""

S_PER_US = 1e-6


class NoPhasedSolutionError(NoSolutionError):
    """The flow of three phases has no solution beyond a share of its load.

    Parameters
    ----------
    share : float
        That share.
    """

    def __init__(self, share: float) -> None:
        super().__init__(
            "the three-phase power flow has no solution: voltages collapse at "
            f"{share:.1%} of the load. Serve less, or check the impedances.",
            share,
        )


def incidence(phases: Phases, places: Iterable[tuple[str, str]]) -> Any:
    """Voltages across the coils of buses, one after the other, of voltages at nodes."""
    at = phases.node_index
    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    count = 0
    for bus, words in places:
        for coil in coils_of(words):
            for end, sign in zip(coil, (1.0, -1.0), strict=True):
                if end is not None:
                    rows.append(count)
                    columns.append(at[bus, end])
                    values.append(sign)
            count += 1
    return sp.csr_array((values, (rows, columns)), shape=(count, len(at)))


def each_coil(values: ArrayLike, counts: Wholes) -> Any:
    """Values of devices, repeated for each of their coils."""
    return np.repeat(np.asarray(values), counts)


def n_coils(places: Iterable[tuple[str, str]]) -> Wholes:
    """How many coils there are at each place."""
    return np.array([len(words.split()) for _, words in places], dtype=int)


def admittances(phases: Phases) -> Any:
    """Nodal admittances in siemens, without sources and assets.

    Examples
    --------
    A shunt of 100 kvar to ground at 1 kV is 0.1 S:

    >>> from vppres.scenario.phases import PhaseBus, PhaseShunt
    >>> one = Phases((PhaseBus("x", 1, 1.0, "a b c"),), (),
    ...              shunts=(PhaseShunt("x", "a", 1.0, 0.0, -100.0),))
    >>> complex(admittances(one)[0, 0])
    0.1j
    """
    return sp.csc_array(_of_lines(phases) + _of_transformers(phases) + _of_shunts(phases))


def _of_lines(phases: Phases) -> Any:
    """Admittances of all lines: series impedances, and half of the charging at each end."""
    at = phases.node_index
    y: Any = sp.coo_array((len(at), len(at)), dtype=complex)
    rows, columns, values = [y.row], [y.col], [y.data]
    for line in phases.lines:
        own = np.ix_(line.phases, line.phases)
        series = np.linalg.inv(line.z_ohm[own])
        half = 0.5j * S_PER_US * line.b_us[own]
        whole = np.block([[series + half, -series], [-series, series + half]])
        places = [at[bus, phase] for bus in (line.from_bus, line.to_bus) for phase in line.phases]
        rows.append(np.repeat(places, len(places)))
        columns.append(np.tile(places, len(places)))
        values.append(whole.ravel())
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sp.csr_array(entries, shape=y.shape)


class Turns(NamedTuple):
    """Coils of transformers, one unit after the other, as a matrix for each side."""

    sides: tuple[Any, Any]  #: voltages across the coils of voltages at nodes, (coils, nodes) each
    volts: tuple[Floats, Floats]  #: their nominal voltages in V, (coils,) each
    taps: tuple[Floats, Floats]  #: their taps, (coils,) each
    counts: Wholes  #: how many pairs of coils each unit has

    @classmethod
    def of(cls, phases: Phases) -> Turns:
        """Turns of all transformers of a feeder."""
        units = phases.transformers
        of_from = [(unit.from_bus, unit.from_coils) for unit in units]
        of_to = [(unit.to_bus, unit.to_coils) for unit in units]
        counts = n_coils(of_from)
        volts = ([unit.from_kv * V_PER_KV for unit in units], [u.to_kv * V_PER_KV for u in units])
        taps = ([unit.from_tap for unit in units], [unit.to_tap for unit in units])
        return cls(
            (incidence(phases, of_from), incidence(phases, of_to)),
            (each_coil(volts[0], counts), each_coil(volts[1], counts)),
            (each_coil(taps[0], counts), each_coil(taps[1], counts)),
            counts,
        )

    def per_unit(self, phases: Phases, of: Callable[[PhaseTransformer], complex]) -> Any:
        """Values of units, repeated for each of their pairs of coils."""
        return each_coil([of(unit) for unit in phases.transformers], self.counts)

    @property
    def through(self) -> Any:
        """Matrix from voltages at nodes to those that drive current through pairs of coils."""
        first, second = (
            sp.diags_array(1.0 / (volts * tap)) @ coils
            for coils, volts, tap in zip(self.sides, self.volts, self.taps, strict=True)
        )
        return first - second


def _of_transformers(phases: Phases) -> Any:
    """Admittances of all transformers: their short circuits, and what goes to ground."""
    turns = Turns.of(phases)
    va = turns.per_unit(phases, lambda unit: unit.kva * VA_PER_KVA)
    z_pct = turns.per_unit(phases, lambda unit: unit.r_pct + 1j * unit.x_pct)
    through = turns.through
    y = through.T @ sp.diags_array(va * 100.0 / z_pct) @ through
    to_ground = -0.5j * va * turns.per_unit(phases, lambda unit: unit.ppm * 1e-6)
    for coils, volts in zip(turns.sides, turns.volts, strict=True):
        y = y + sp.diags_array(abs(coils).T @ (to_ground / volts**2))
    return y


def _of_shunts(phases: Phases) -> Any:
    """Admittances of shunts, whose power is that of all their coils."""
    shunts = phases.shunts
    places = [(shunt.bus, shunt.coils) for shunt in shunts]
    counts = n_coils(places)
    powers = [(s.p_kw - 1j * s.q_kvar) * W_PER_KW / (s.kv * V_PER_KV) ** 2 for s in shunts]
    coils = incidence(phases, places)
    siemens = each_coil(powers, counts) / each_coil(counts, counts)
    return coils.T @ sp.diags_array(siemens) @ coils


def measures(phases: Phases) -> Any:
    """Voltages in pu as their limits count them of those of the nodes in V, (m, nodes)."""
    volts = [
        V_PER_KV * phases.by_bus[bus].kv / (np.sqrt(3) if len(word) == 1 else 1.0)
        for bus, word in phases.measured
    ]
    return sp.csr_array(sp.diags_array(1.0 / np.array(volts)) @ incidence(phases, phases.measured))


@dataclass(frozen=True, eq=False)
class PhasedResult:
    """One flow: complex voltages of the nodes in V, coil voltages, the sources' kVA by phase."""

    v: Complexes
    coil_v: Complexes
    source_kva: Complexes
    drawn_kva: Complexes
    rounds: int

    @property
    def losses_kw(self) -> float:
        """Losses: power of the source beyond that of all coils."""
        return float(self.source_kva.sum().real - self.drawn_kva.sum().real)


class PhasedFlow:
    """Power flow of three phases from sources that hold the three voltages of their buses.

    Each source has a part of the feeder of its own. What none of them reaches has no voltage, and
    assets there draw nothing.

    Parameters
    ----------
    phases : Phases
        The feeder.
    assets : sequence of str
        Devices in the order of their powers, each with a connection.
    sources : sequence of (str, float)
        Bus and voltage in pu of each source.
    """

    def __init__(
        self, phases: Phases, assets: Sequence[str], sources: Sequence[tuple[str, float]]
    ) -> None:
        self.phases = phases
        self.assets = list(assets)
        nodes = phases.nodes
        self.held: Wholes = np.array(
            [nodes.index((bus, phase)) for bus, _ in sources for phase in range(3)], dtype=int
        )
        self.v_held: Complexes = np.concatenate(
            [v_pu * V_PER_KV * phases.by_bus[bus].kv / np.sqrt(3) * ANGLES for bus, v_pu in sources]
        )
        self.y = admittances(phases)
        _, joined = connected_components(abs(self.y), directed=False)
        of_sources = joined[self.held].reshape(-1, 3)
        #: Nodes that each source reaches, (sources, nodes).
        self.reached: Flags = np.array([np.isin(joined, own) for own in of_sources], dtype=bool)
        self.lit: Flags = np.asarray(self.reached.any(axis=0), dtype=bool)
        self.free: Wholes = np.setdiff1d(np.flatnonzero(self.lit), self.held)
        self._factors: Any = splu(self.y[self.free][:, self.free].tocsc())
        rows = [phases.connection(name) for name in self.assets]
        places = [(row.bus, row.coils) for row in rows]
        self.coils = incidence(phases, places)
        counts = n_coils(places)
        first = [phases.node_index[bus, coils_of(words)[0][0]] for bus, words in places]
        #: Assets that each source reaches, (sources, assets), and those that any does, (assets,).
        self.supplied: Flags = self.reached[:, np.array(first, dtype=int)]
        self.with_power: Flags = np.asarray(self.supplied.any(axis=0), dtype=bool)
        self.asset: Wholes = np.repeat(np.arange(len(rows)), counts)
        self.share: Floats = each_coil(1.0 / counts, counts)
        self.rated_v: Floats = np.repeat([row.kv * V_PER_KV for row in rows], counts)
        self.p_exponent: Floats = np.repeat([row.p_exponent for row in rows], counts)
        self.q_exponent: Floats = np.repeat([row.q_exponent for row in rows], counts)

    @cached_property
    def no_load_v(self) -> Complexes:
        """Voltages of the nodes while nothing draws power."""
        v = np.zeros(len(self.phases.nodes), dtype=complex)
        v[self.held] = self.v_held
        coupling = self.y[self.free][:, self.held]
        v[self.free] = self._factors.solve(-(coupling @ self.v_held))
        return v

    def taken(self, current: Complexes) -> Complexes:
        """Voltages of the nodes that currents of the coils take away, (nodes, k) of (coils, k)."""
        v = np.zeros((len(self.phases.nodes), *current.shape[1:]), dtype=complex)
        if current.size:
            v[self.free] = self._factors.solve(np.asarray(self._drawn @ current, dtype=complex))
        return v

    def taken_at(self, rows: Any) -> Complexes:
        """Drop of sums of voltages, (R, nodes), by currents of coils, (R, coils)."""
        ends = sp.csr_array(rows)[:, self.free].T.toarray().astype(complex)
        if not ends.size:
            return np.zeros((rows.shape[0], self.coils.shape[0]), dtype=complex)
        return np.asarray((self._drawn.T @ self._factors.solve(ends, "T")).T)

    @cached_property
    def _drawn(self) -> Any:
        """Coils at nodes that nothing holds, (nodes, coils)."""
        return sp.csr_array(self.coils[:, self.free].T)

    @cached_property
    def no_load_u(self) -> Complexes:
        """Voltages across the coils at no load; rated ones of coils that no source reaches."""
        return np.where(self.with_power[self.asset], self.coils @ self.no_load_v, self.rated_v)

    @cached_property
    def _z(self) -> Complexes:
        """Voltage across each coil that a current of another one takes away, in ohm."""
        return self.taken_at(self.coils)

    def drawn_va(self, p_kw: Floats, q_kvar: Floats, u: Complexes) -> Complexes:
        """Power that each coil draws at its voltage, from powers of the assets at rated voltage."""
        ratio = np.abs(u) / self.rated_v
        p = p_kw[self.asset] * self.share * ratio**self.p_exponent
        q = q_kvar[self.asset] * self.share * ratio**self.q_exponent
        return np.asarray((p + 1j * q) * W_PER_KW)

    def solve(self, p_kw: Floats, q_kvar: Floats) -> PhasedResult:
        """The flow of powers that assets draw at rated voltage, (assets,) each.

        Raises
        ------
        NoPhasedSolutionError
            If there is none.
        """
        p, q = (np.where(self.with_power, np.asarray(each, float), 0.0) for each in (p_kw, q_kvar))
        found = self._fixed_point(p, q, self.no_load_u)
        if found is None:
            u, rounds = self._newton(p, q, self.no_load_u), MAX_ROUNDS
        else:
            u, rounds = found
        if u is None:
            raise NoPhasedSolutionError(self._reached(p, q))
        return self._result(p, q, u, rounds)

    def _fixed_point(self, p: Floats, q: Floats, u: Complexes) -> tuple[Complexes, int] | None:
        """Coil voltages, and in how many rounds; None where they do not meet."""
        before = np.inf
        for rounds in range(MAX_ROUNDS):
            current = np.conj(self.drawn_va(p, q, u) / u)
            after = self.no_load_u - self.coils @ self.taken(current)
            change = float((np.abs(after - u) / self.rated_v).max(initial=0.0))
            u = after
            if change <= TOLERANCE_PU:
                return u, rounds + 1
            if not change < 2.0 * before or change > 1.0:
                return None
            before = change
        return None

    def _newton(self, p: Floats, q: Floats, u: Complexes) -> Complexes | None:
        """Voltages by Newton's method in real and imaginary parts; None where it fails."""
        u0, z = self.no_load_u, self._z
        for _ in range(MAX_NEWTON):
            s = self.drawn_va(p, q, u)
            current = np.conj(s / u)
            missed = u - u0 + z @ current
            if float((np.abs(missed) / self.rated_v).max(initial=0.0)) <= TOLERANCE_PU:
                return u
            by_u, by_conj = self.current_slopes(p, q, u)
            own, turned = z * by_u, z * by_conj
            eye = np.eye(len(u))
            jacobian = np.block(
                [
                    [eye + (own + turned).real, (turned - own).imag],
                    [(own + turned).imag, eye + (own - turned).real],
                ]
            )
            step = np.linalg.solve(jacobian, -np.concatenate([missed.real, missed.imag]))
            u = u + step[: len(u)] + 1j * step[len(u) :]
            if not np.isfinite(u).all() or (np.abs(u) < 0.2 * self.rated_v).any():
                return None
        return None

    def current_slopes(self, p: Floats, q: Floats, u: Complexes) -> tuple[Complexes, Complexes]:
        """How a coil's current ``conj(S(|u|) / u)`` follows ``u`` and its conjugate."""
        s = self.drawn_va(p, q, u)
        # d|u| = Re(conj(u) du) / |u|, so S changes by its exponents' share Re(conj(u) du) / |u|².
        per_size: Complexes = self.p_exponent * s.real - 1j * self.q_exponent * s.imag
        per_size /= 2.0 * np.abs(u) ** 2
        turned = u / np.conj(u)
        return per_size, per_size * turned - np.conj(s) / np.conj(u) ** 2

    def _reached(self, p: Floats, q: Floats) -> float:
        """Share of a load up to which there is a solution, from no load on."""
        low, high = 0.0, 1.0
        u = self.no_load_u
        while high - low > LEAST_SHARE:
            share = (low + high) / 2.0
            found = self._newton(share * p, share * q, u)
            if found is None:
                high = share
            else:
                low, u = share, found
        return low

    def _result(self, p: Floats, q: Floats, u: Complexes, rounds: int) -> PhasedResult:
        s = self.drawn_va(p, q, u)
        current = np.conj(s / u)
        v = self.no_load_v - self.taken(current)
        at_source = (self.y @ v + self.coils.T @ current)[self.held]
        source = self.v_held * np.conj(at_source) / W_PER_KW
        return PhasedResult(v, u, source, s / W_PER_KW, rounds)

    # What is measured.

    @cached_property
    def measured(self) -> tuple[tuple[tuple[str, str], ...], Any]:
        """Bus and phase of each voltage that is limited, and these voltages in pu of the nodes'."""
        return self.phases.measured, measures(self.phases)

    def v_pu(self, v: Complexes) -> Floats:
        """Voltages in pu as their limits count them; 1 where no source holds any."""
        found = np.abs(self.measured[1] @ v)
        return np.where(self.measured_lit, found, 1.0)

    @cached_property
    def measured_lit(self) -> Flags:
        """Voltages with limits that a source holds, (m,)."""
        return np.asarray(abs(self.measured[1]) @ self.lit > 0.0)

    @cached_property
    def complete(self) -> tuple[list[str], Wholes]:
        """Buses with three phases that a source holds, and their nodes, (buses, 3)."""
        at = self.phases.node_index
        complete = [row.bus for row in self.phases.buses if len(row.phases.split()) == 3]
        buses = [bus for bus in complete if self.lit[at[bus, 0]]]
        places = [[at[bus, phase] for phase in range(3)] for bus in buses]
        return buses, np.array(places, dtype=int)

    def unbalance(self, v: Complexes) -> Floats:
        """Voltage unbalance factor of each complete bus: negative over positive sequence."""
        three = v[self.complete[1]]
        negative, positive = (np.abs(three @ turns) for turns in (ANGLES, np.conj(ANGLES)))
        return np.asarray(np.minimum(negative, positive) / np.maximum(negative, positive))
