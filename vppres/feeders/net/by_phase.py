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
from vppres.core.errors import InputError, Problem, VerificationError, first_line
from vppres.core.text import named
from vppres.core.units import A_PER_KA, US_PER_S, V_PER_KV, W_PER_KW, mw_to_kw
from vppres.feeders.dss.phases import flow_of_source, kept_phases
from vppres.feeders.feeder import ImportedFeeder, PhasedLoad, PhasedSource
from vppres.feeders.net.balance import CURE, TABLES
from vppres.feeders.net.branches import split_stubs, two_ports
from vppres.feeders.net.elements import in_service, label, tiers_of
from vppres.feeders.net.ratings import rating_mva
from vppres.feeders.net.reduce import BS, GS, KV, with_branch
from vppres.feeders.net.switches import ENDS
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

STATUS = 10
LEAKAGE = slice(23, 26)
"""Columns of the branches of pandapower's case that :func:`two_ports` asks for."""


def phased_net(net: Any, name: str, feeder: ImportedFeeder) -> PhasedSource:
    """The three phases of a net whose balanced tree has been imported.

    ``net`` has its loads by phase, and branches opened as in the tree ``feeder``.
    """
    problems = [*_unknown(net, name)]
    if problems:
        raise InputError(problems)
    net = copy.deepcopy(net)
    notes = [*_connected_to_ground(net)]
    _end_before_buses_out_of_service(net)
    solved, v_pu = _solved(net, name)
    tables = _NetTables(solved, name, feeder)
    source = PhasedSource(
        tables.phases(), tuple(_loads(net, feeder.bus_of)), feeder.network.v_slack_pu
    )
    flow, p_kw, q_kvar = flow_of_source(source)
    try:
        ours = np.abs(flow.v_pu(flow.solve(p_kw, q_kvar).v))
    except VerificationError:
        raise InputError.of(
            name,
            "has no solution of its own power flow by phase with its loads, while pandapower's has",
            "Check the size of its loads, or: " + CURE[0].lower() + CURE[1:],
        ) from None
    at = {str(own): solved.bus.index.get_loc(bus) for bus, own in feeder.bus_of.items()}
    theirs = np.concatenate([v_pu[at[row.bus]] for row in source.phases.buses])
    difference_pu = None if np.isnan(theirs).any() else float(np.abs(ours - theirs).max())
    told = (
        kept_phases(source.phases),
        "Loads whose phases differ are a customer for each phase.",
        _told_stiff(net, v_pu),
        *notes,
        *_told_switches(solved),
    )
    return PhasedSource(source.phases, source.loads, source.v_pu, difference_pu, told)


def _connected_to_ground(net: Any) -> Iterator[str]:
    """Connect in wye in place what pandapower leaves out, as it is neither in wye nor in delta."""
    left = []
    for table in (table for pair in TABLES for table in pair[:2] if table in net):
        rows = in_service(net, table)
        odd = rows.index[~rows["type"].isin(("wye", "delta"))]
        left += [label(net, table, i) for i in odd if table != "load"]
        net[table].loc[odd, "type"] = "wye"
    if left:
        yield (
            "Connected in wye here, and left out by pandapower's power flow by phase, which asks "
            f"for the type wye or delta: {named(left)}."
        )


def _end_before_buses_out_of_service(net: Any) -> None:
    """End lines and transformers in place at a bus of their own where theirs is out of service.

    pandapower's power flow by phase has no solution with them.
    """
    import pandapower as pp

    out = net.bus.index[~net.bus["in_service"].astype(bool)]
    for table in ("line", "trafo"):
        for end in ENDS[table]:
            for i, bus in in_service(net, table)[end].items():
                if bus in out:
                    net[table].loc[i, end] = pp.create_bus(net, net.bus.at[bus, "vn_kv"])


def _told_stiff(net: Any, v_pu: Floats) -> str:
    """Note that the grid is held stiff, with the effect of its own strength."""
    grids = in_service(net, "ext_grid")
    given = grids.reindex(columns=[*STIFF])
    if given.isna().any(axis=None):
        return "The grid is held stiff."
    net = copy.deepcopy(net)
    try:
        _solve(net)
    except Exception:  # its numbers may be of no grid
        return "The grid is held stiff."
    theirs = net.res_bus_3ph[[f"vm_{phase}_pu" for phase in PHASES]].to_numpy()
    apart = float(np.nanmax(np.abs(theirs - v_pu)))
    return (
        "The grid is held stiff. With the short-circuit power of the source voltages move by up to "
        f"{apart:.2g} pu."
    )


def _told_switches(net: Any) -> Iterator[str]:
    """Switches with an impedance."""
    found = [label(net, "switch", i) for i in with_branch(net, "switch")]
    if found:
        yield (
            "Switches have a third of their z_ohm, as in pandapower's power flow by phase: "
            f"{named(found)}."
        )


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
    net = copy.deepcopy(net)
    for column, value in STIFF.items():
        net.ext_grid[column] = value
    try:
        _solve(net)
    except Exception as error:  # pandapower refuses nets with many kinds of error
        words = f"has no power flow by phase in pandapower ({first_line(error)})"
        raise InputError.of(name, words, CURE) from error
    return net, net.res_bus_3ph[[f"vm_{phase}_pu" for phase in PHASES]].to_numpy()


def _solve(net: Any) -> None:
    from pandapower.pf.runpp_3ph import runpp_3ph

    runpp_3ph(net, numba=False, tolerance_mva=1e-10, max_iteration=100)


class _NetTables:
    """Tables of a net that was solved by phase."""

    def __init__(self, net: Any, name: str, feeder: ImportedFeeder) -> None:
        self.net = net
        self.name = name
        self.slack = feeder.network.slack_bus
        cases = {"one": net._ppc1, "zero": net._ppc0}
        self.base_mva = float(net._ppc1["baseMVA"])
        at = net._pd2ppc_lookups["bus"]
        self.id_of: dict[int, BusId] = {}
        for bus, own in feeder.bus_of.items():
            self.id_of.setdefault(int(at[bus]), own)
        self.kv = net._ppc1["bus"][:, KV].real
        self.y = {sequence: self._of_buses(case) for sequence, case in cases.items()}
        self.branches: dict[str, Any] = {}
        for sequence, case in cases.items():
            branch = case["branch"].real
            table = two_ports(branch, *branch[:, LEAKAGE].T)
            self.branches[sequence] = table
            # What branches that are open at one end draw at the other.
            _, stubs = split_stubs(table.assign(label="")[branch[:, STATUS] > 0], {*self.id_of})
            for stub in stubs:
                self.y[sequence][stub.row] += stub.y / self._ohm(self.kv[stub.row])
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
            for i, row in zip(with_branch(self.net, table), range(first, end), strict=False):
                start, last = (int(self.branches["one"].at[row, at]) for at in ("from", "to"))
                if self.id_of.get(start) in (None, self.id_of.get(last)) or last not in self.id_of:
                    continue
                if table == "trafo":
                    self._transformer(i, row, start, last)
                else:
                    ka = rating_mva(self.net, table, i) / (np.sqrt(3.0) * self.kv[start])
                    self._line(row, start, last, A_PER_KA * ka if np.isfinite(ka) else np.nan)
        kv = {own: float(self.kv[row]) for row, own in self.id_of.items()}
        order = [self.slack, *(own for own in kv if own != self.slack)]
        buses = tuple(PhaseBus(str(own), own, kv[own], " ".join(PHASES)) for own in order)
        return Phases(buses, tuple(self.lines), tuple(self.units), tuple(self._shunts()))

    def _z(self, sequence: str, row: int) -> complex:
        """Impedance of a branch in pu."""
        r, x = self.branches[sequence].loc[row, ["r", "x"]]
        return complex(r, x)

    def _line(self, row: int, start: int, end: int, i_max_a: float) -> None:
        """A line or a switch: matrices of its sequences; its leakage goes to ground at its ends."""
        ohm = self._ohm(self.kv[start])
        one, zero = (self._z(sequence, row) for sequence in ("one", "zero"))
        charging = []
        for sequence in ("one", "zero"):
            half = complex(self.branches[sequence].at[row, "y_from"])
            charging.append(2j * half.imag / ohm)
            for bus in (start, end):
                self.y[sequence][bus] += half.real / ohm
        self.lines.append(
            PhaseLine(
                str(self.id_of[start]),
                str(self.id_of[end]),
                _matrix(one * ohm, zero * ohm),
                _matrix(*charging).imag * US_PER_S,
                i_max_a,
            )
        )

    def _transformer(self, i: Any, row: int, high: int, low: int) -> None:
        """A transformer whose high voltage carries no zero sequence."""
        words = label(self.net, "trafo", i)
        clock = round(self.branches["one"].at[row, "shift"] / 30.0) % 12
        if clock not in OF_CLOCK or abs(self._z("zero", row)) < NO_BRANCH:
            group = self.net.trafo["vector_group"].at[i]
            known = "Dyn and Yzn, with an odd number, are known by phase"
            raise InputError.of(self.name, f"{words} is {group}{clock}: {known}", CURE)
        one = self._z("one", row)
        rated = self.net.trafo.loc[i]
        kva = W_PER_KW * float(rated["sn_mva"]) * float(rated["parallel"]) / len(PHASES)
        pct = 100.0 * one * kva / (W_PER_KW * self.base_mva)
        tap = float(self.branches["one"].at[row, "tap"])
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
        for sequence, table in self.branches.items():
            first, second = table.loc[row, ["y_from", "y_to"]]
            self.y[sequence][high] += first / tap**2 / self._ohm(self.kv[high])
            self.y[sequence][low] += second / self._ohm(self.kv[low])

    def _shunts(self) -> Iterator[PhaseShunt]:
        """Shunts at each bus: a wye for the zero sequence, a delta for the rest."""
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
                delta = row["type"] == "delta"
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
