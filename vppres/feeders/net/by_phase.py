"""A pandapower net with loads of single phases as the tables of a phased feeder.

pandapower's own branch models of the positive and of the zero sequence do the work. Both are those
of symmetric lines and transformers, so each has one matrix of phases. Its source is held stiff in
all sequences.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Complexes, Floats
from vppres.core.errors import InputError, Problem, first_line
from vppres.core.units import A_PER_KA, US_PER_S, V_PER_KV, W_PER_KW, mw_to_kw
from vppres.feeders.dss.phases import flow_of_source, kept_phases
from vppres.feeders.feeder import ImportedFeeder, PhasedLoad, PhasedSource
from vppres.feeders.net.balance import CURE, TABLES
from vppres.feeders.net.elements import in_service, label, tiers_of
from vppres.feeders.net.ratings import NO_LIMIT_KA
from vppres.scenario.network import BusId
from vppres.scenario.phases import (
    PHASES,
    PhaseBus,
    PhaseConnection,
    PhaseLine,
    Phases,
    PhaseShunt,
    PhaseTransformer,
)

STIFF = {"s_sc_max_mva": 1e9, "rx_max": 0.1, "x0x_max": 1.0, "r0x0_max": 0.1}
"""What pandapower asks of an external grid: a grid that no unbalance moves."""

WYE, DELTA = "a b c", "ab bc ca"
OF_CLOCK = {1: "ac ba cb", 3: "bc ca ab", 5: "ba cb ac", 7: "ca ab bc", 9: "cb ac ba", 11: DELTA}
"""Coils of a delta that those to ground on phases a, b and c are on one core with, by the number of
the vector group: twelfths of a turn by which the low voltage lags."""

NEEDED = {
    "line": ("r0_ohm_per_km", "x0_ohm_per_km", "c0_nf_per_km"),
    "trafo": (
        "vector_group",
        "vk0_percent",
        "vkr0_percent",
        "mag0_percent",
        "mag0_rx",
        "si0_hv_partial",
    ),
}
NOT_BY_PHASE = ("trafo3w", "impedance", "ward", "xward", "gen", "storage", "motor")
NO_BRANCH = 1e12
"""Impedance in pu from which a sequence has no branch: pandapower writes 1e20."""

LEAST_KW = 1e-9
"""Power below which there is none."""

F_BUS, T_BUS, R, X, B, TAP, SHIFT = 0, 1, 2, 3, 4, 8, 9
BR_G, BR_G_ASYM, BR_B_ASYM = 23, 24, 25
GS, BS, KV = 4, 5, 9


def phased_net(net: Any, name: str, feeder: ImportedFeeder) -> PhasedSource:
    """The three phases of a net whose balanced tree has been imported.

    ``net`` has its loads by phase, and branches opened as in the tree ``feeder``.
    """
    problems = [*_unknown(net, name)]
    if problems:
        raise InputError(problems)
    solved, v_pu = _solved(net, name)
    tables = _Tables(solved, name, feeder)
    source = PhasedSource(
        tables.phases(), tuple(_loads(net, feeder.bus_of)), feeder.network.v_slack_pu
    )
    flow, p_kw, q_kvar = flow_of_source(source)
    ours = np.abs(flow.v_pu(flow.solve(p_kw, q_kvar).v))
    at = {str(own): solved.bus.index.get_loc(bus) for bus, own in feeder.bus_of.items()}
    theirs = np.concatenate([v_pu[at[row.bus]] for row in source.phases.buses])
    notes = (
        kept_phases(source.phases),
        "Loads whose phases differ are a customer for each phase. The grid is held stiff.",
    )
    difference_pu = None if np.isnan(theirs).any() else float(np.abs(ours - theirs).max())
    return PhasedSource(source.phases, source.loads, source.v_pu, difference_pu, notes)


def _unknown(net: Any, name: str) -> Iterator[Problem]:
    """Elements without a table, and those that say nothing of the zero sequence."""
    for table in NOT_BY_PHASE:
        for i in in_service(net, table).index if table in net else ():
            yield Problem(name, f"{label(net, table, i)} is not known by phase", CURE)
    for table, columns in NEEDED.items():
        rows = in_service(net, table)
        lacking = [c for c in columns if len(rows) and (c not in rows or rows[c].isna().any())]
        if lacking:
            words = f"is not balanced, and its table {table} lacks {', '.join(lacking)}"
            yield Problem(name, words, f"Give them, or: {CURE[0].lower()}{CURE[1:]}")


def _solved(net: Any, name: str) -> tuple[Any, Floats]:
    """The net solved by phase, with the grid held stiff."""
    from pandapower.pf.runpp_3ph import runpp_3ph

    net = copy.deepcopy(net)
    for column, value in STIFF.items():
        net.ext_grid[column] = value
    try:
        runpp_3ph(net, numba=False, tolerance_mva=1e-10, max_iteration=100)
    except Exception as error:  # pandapower refuses nets with many kinds of error
        words = f"has no power flow by phase in pandapower ({first_line(error)})"
        raise InputError.of(name, words, CURE) from error
    return net, net.res_bus_3ph[[f"vm_{phase}_pu" for phase in PHASES]].to_numpy()


class _Tables:
    """Tables of a net that was solved by phase."""

    def __init__(self, net: Any, name: str, feeder: ImportedFeeder) -> None:
        self.net = net
        self.name = name
        self.slack = feeder.network.slack_bus
        self.one, self.zero = net._ppc1, net._ppc0
        self.base_mva = float(self.one["baseMVA"])
        at = net._pd2ppc_lookups["bus"]
        self.id_of: dict[int, BusId] = {}
        for bus, own in feeder.bus_of.items():
            self.id_of.setdefault(int(at[bus]), own)
        self.kv = self.one["bus"][:, KV].real
        self.y = {"zero": self._of_buses(self.zero), "one": self._of_buses(self.one)}
        self.lines: list[PhaseLine] = []
        self.units: list[PhaseTransformer] = []

    def _of_buses(self, case: Any) -> Complexes:
        """Admittance to ground of each bus in siemens."""
        bus = case["bus"].real
        pu = (bus[:, GS] + 1j * bus[:, BS]) / self.base_mva
        return np.asarray(pu / self._ohm(bus[:, KV]))

    def _ohm(self, kv: Any) -> Any:
        """Impedance of 1 pu: a phase has the base power by itself."""
        return kv**2 / (3.0 * self.base_mva)

    def phases(self) -> Phases:
        """Buses, lines, transformers, and what goes to ground; no connections."""
        for table, (first, end) in self.net._pd2ppc_lookups["branch"].items():
            for i, row in zip(self.net[table].index, range(first, end), strict=False):
                ends = [int(self.one["branch"][row, end].real) for end in (F_BUS, T_BUS)]
                known = all(each in self.id_of for each in ends)
                if not known or len({self.id_of[each] for each in ends}) < 2:
                    continue
                if table == "line":
                    self._line(i, row, *ends)
                elif table == "trafo":
                    self._transformer(i, row, *ends)
        kv = {own: float(self.kv[row]) for row, own in self.id_of.items()}
        order = [self.slack, *(own for own in kv if own != self.slack)]
        buses = tuple(PhaseBus(str(own), own, kv[own], " ".join(PHASES)) for own in order)
        return Phases(buses, tuple(self.lines), tuple(self.units), tuple(self._shunts()))

    def _branch(self, case: Any, row: int) -> tuple[complex, complex]:
        """Impedance and charging of a branch in pu; no impedance where it does not connect."""
        r, x, b = case["branch"][row, [R, X, B]].real
        return complex(r, x), 1j * b

    def _line(self, i: Any, row: int, start: int, end: int) -> None:
        """A line: matrices of its sequences."""
        ohm = self._ohm(self.kv[start])
        (one, b_one), (zero, b_zero) = (self._branch(c, row) for c in (self.one, self.zero))
        line = self.net.line.loc[i]
        rating = float(line["max_i_ka"]) * float(line["df"]) * float(line["parallel"])
        self.lines.append(
            PhaseLine(
                str(self.id_of[start]),
                str(self.id_of[end]),
                _matrix(one * ohm, zero * ohm),
                _matrix(b_one / ohm, b_zero / ohm).imag * US_PER_S,
                A_PER_KA * rating if 0.0 < rating < NO_LIMIT_KA else np.nan,
            )
        )

    def _transformer(self, i: Any, row: int, high: int, low: int) -> None:
        """A transformer whose high voltage carries no zero sequence."""
        words = label(self.net, "trafo", i)
        clock = round(float(self.one["branch"][row, SHIFT].real) / 30.0) % 12
        zero, _ = self._branch(self.zero, row)
        if clock not in OF_CLOCK or abs(zero) < NO_BRANCH:
            group = self.net.trafo["vector_group"].at[i]
            known = "Dyn and Yzn, with an odd number, are known by phase"
            raise InputError.of(self.name, f"{words} is {group}{clock}: {known}", CURE)
        one, _ = self._branch(self.one, row)
        rated = self.net.trafo.loc[i]
        kva = W_PER_KW * float(rated["sn_mva"]) * float(rated["parallel"]) / len(PHASES)
        pct = 100.0 * one * kva / (W_PER_KW * self.base_mva)
        tap = float(self.one["branch"][row, TAP].real)
        self.units.append(
            PhaseTransformer(
                str(rated["name"] or f"t{i}") if isinstance(rated["name"], str) else f"t{i}",
                str(self.id_of[high]),
                OF_CLOCK[clock],
                float(self.kv[high]),
                str(self.id_of[low]),
                WYE,
                float(self.kv[low] / np.sqrt(3)),
                kva,
                pct.real,
                pct.imag,
                from_tap=tap,
            )
        )
        # Its coils have the impedance of the positive sequence in the zero sequence too.
        self.y["zero"][low] -= 1.0 / (one * self._ohm(self.kv[low]))
        for sequence, case in (("one", self.one), ("zero", self.zero)):
            half = 0.5 * _to_ground(case, row)
            self.y[sequence][high] += half[0] / tap**2 / self._ohm(self.kv[high])
            self.y[sequence][low] += half[1] / self._ohm(self.kv[low])

    def _shunts(self) -> Iterator[PhaseShunt]:
        """What goes to ground at each bus: a wye for the zero sequence, a delta for the rest."""
        found: dict[BusId, Complexes] = {}
        for row, own in self.id_of.items():
            zero, one = self.y["zero"][row], self.y["one"][row]
            wye = np.array([zero, (one - zero) / 3.0])
            found[own] = found.get(own, np.zeros(2, dtype=complex)) + wye
        kv = {own: float(self.kv[row]) for row, own in self.id_of.items()}
        for own, parts in found.items():
            if own == self.slack:
                continue  # the source holds it
            for coils, y, across in (
                (WYE, parts[0], kv[own] / np.sqrt(3)),
                (DELTA, parts[1], kv[own]),
            ):
                va = np.conj(y) * (V_PER_KV * across) ** 2 * len(PHASES) / W_PER_KW
                if abs(va) > LEAST_KW:
                    yield PhaseShunt(str(own), coils, across, va.real, va.imag)


def _to_ground(case: Any, row: int) -> Complexes:
    """What a transformer has to ground at its two ends, in pu, doubled."""
    b, g, g_more, b_more = case["branch"][row, [B, BR_G, BR_G_ASYM, BR_B_ASYM]].real
    return np.array([g + 1j * b, g + g_more + 1j * (b + b_more)])


def _matrix(one: complex, zero: complex) -> Complexes:
    """The matrix of phases of a positive, a negative and a zero sequence."""
    mutual = (zero - one) / 3.0
    return np.asarray(np.full((3, 3), mutual) + one * np.eye(3))


def _loads(net: Any, bus_of: Mapping[int, BusId]) -> Iterator[PhasedLoad]:
    """Loads and generators: of three phases as one, of phases that differ one by one."""
    for by_phase, plain, _ in TABLES:
        for table in (plain, by_phase):
            rows = in_service(net, table) if table in net else pd.DataFrame(columns=["bus"])
            rows = rows[rows["bus"].isin(bus_of)]
            for tier, (i, row) in zip(tiers_of(rows), rows.iterrows(), strict=True):
                own = bus_of[int(row["bus"])]
                delta = table == by_phase and row.get("type") == "delta"
                kv = float(net.bus["vn_kv"].at[row["bus"]]) / (1.0 if delta else np.sqrt(3))
                coils = DELTA if delta else WYE
                if table == plain:
                    parts = [(coils, _kva(row, ""), "")]
                else:
                    parts = _parts(coils, [_kva(row, f"_{phase}") for phase in PHASES])
                for words, power, suffix in parts:
                    connection = PhaseConnection(f"{_id(table, i)}{suffix}", str(own), words, kv)
                    yield PhasedLoad(plain, own, power.real, power.imag, connection, tier)


def _kva(row: pd.Series[Any], phase: str) -> complex:
    """Power of an element, or of one of its phases, in kW and kvar."""
    factor = float(mw_to_kw(float(row["scaling"])))
    return factor * complex(row[f"p{phase}_mw"], row[f"q{phase}_mvar"])


def _parts(coils: str, powers: list[complex]) -> list[tuple[str, complex, str]]:
    """Coils that share a power equally, the power, and what they add to a name."""
    if max(abs(each - powers[0]) for each in powers) < LEAST_KW:
        return [(coils, sum(powers), "")]
    return [(word, power, word) for word, power in zip(coils.split(), powers, strict=True) if power]


def _id(table: str, i: Any) -> str:
    """Name of an element among those of all four tables."""
    return {"load": f"{i}", "asymmetric_load": f"{i}p"}.get(table, f"{table}{i}")
