"""MATPOWER cases as pandapower nets."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.core.errors import InputError, Problem
from vppres.feeders.matpower.text import ALL, CURE, Refused, tables_of, words_of
from vppres.feeders.net.ratings import NO_LIMIT_KA, NO_LIMIT_MVA
from vppres.feeders.strangers.confined import confined
from vppres.feeders.strangers.files import read_bytes, read_text

LARGEST_BYTES = 10 * 2**20
"""The largest case that comes with MATPOWER, of 82,000 buses, has some 20 MB; a feeder has 1."""

TABLES = ("bus", "gen", "branch")
CASE = ("baseMVA", *TABLES)
COLUMNS = {"bus": ALL["VMIN"], "gen": ALL["GEN_STATUS"], "branch": ALL["BR_STATUS"]}
"""Columns that a table has at least."""

# Columns that must be numbers; limits may be infinite.
FINITE = {
    "bus": ("BUS_I", "BUS_TYPE", "PD", "QD", "GS", "BS", "BASE_KV"),
    "gen": ("GEN_BUS", "PG", "QG", "VG", "GEN_STATUS"),
    "branch": ("F_BUS", "T_BUS", "BR_R", "BR_X", "BR_B", "TAP", "SHIFT", "BR_STATUS"),
}
STATUS_OF_DC = 2  # column of mpc.dcline, from 0
LARGEST_BUS = 1_000_000_000  # numbers of buses in published cases have at most eight digits
F_HZ = 50.0  # pandapower has charging as capacitance; any frequency gives it back as it was
Case = dict[str, Floats]
FUELS = "genfuel"
MEANT = {"dfo": "diesel", "rfo": "oil", "ng": "gas", "lng": "gas"}
"""MATPOWER's short words for fuels; its others are plain."""

NO_FUEL = ("unknown", "other", "none", "na", "n/a")


def read_m(path: Path) -> tuple[Any, tuple[str, ...]]:
    """A case written as a MATLAB function; units that it converts are computed, nothing is run."""
    text = read_text(path, LARGEST_BYTES)
    try:
        case = tables_of(text)
    except ExceptionGroup as refused:  # before Python 3.11.4 except* wraps what is raised in it
        raise InputError(
            [
                Problem(path.name, one.message, CURE, row=one.line)
                for one in refused.exceptions
                if isinstance(one, Refused)
            ]
        ) from None
    return net_of(case, path.name, words_of(text, FUELS))


def read_mat(path: Path) -> tuple[Any, tuple[str, ...]]:
    """A case in MATLAB's binary format, unpacked in a process of its own."""
    content = base64.b64encode(read_bytes(path, LARGEST_BYTES)).decode("ascii")
    found = confined("matpower.binary", {"content": content}, path.name)
    if "error" in found:
        raise ValueError(found["error"])
    tables = found["tables"].items()
    case = {name: np.atleast_2d(np.array(value, float)) for name, value in tables}
    return net_of(case, path.name, found["fuels"])


def net_of(case: Case, name: str, fuels: Sequence[str] = ()) -> tuple[Any, tuple[str, ...]]:
    """The net of a case's tables, its buses numbered as in the case, and what was chosen.

    ``fuels`` are those of ``genfuel``, one for each row of ``gen``; they say of what kind a
    generator is, and that its size is its PMAX.

    The tables are ``baseMVA``, ``bus``, ``gen`` and ``branch``, shape (rows, columns) each, in
    MATPOWER's format of version 2. Branches with a ratio, a phase shift or two levels become
    transformers, others lines.
    """
    problems = _check_tables(case, name) or _check_values(case, name)
    if problems:
        raise InputError(problems)
    import pandapower as pp

    from vppres.feeders.net.empty_net import empty_net

    net = empty_net(f_hz=F_HZ, sn_mva=float(case["baseMVA"][0, 0]))
    bus = case["bus"]
    numbers = _whole(bus, "BUS_I")
    isolated = numbers[_of(bus, "BUS_TYPE") == 4]
    pp.create_buses(
        net, len(bus), _of(bus, "BASE_KV"), index=numbers, in_service=_of(bus, "BUS_TYPE") != 4
    )
    _add_powers(net, bus, numbers)
    kind_of = dict(zip(numbers, _whole(bus, "BUS_TYPE"), strict=True))
    notes = _add_generators(net, case["gen"], kind_of, _words_for(fuels, len(case["gen"])))
    branch = case["branch"]
    # MATPOWER leaves out branches at an isolated bus whole, with what they charge.
    at_isolated = np.isin(branch[:, :2], isolated).any(axis=1)
    _add_branches(net, branch[~at_isolated])
    return net, notes


def _of(table: Floats, column: str) -> Floats:
    """A column by MATPOWER's name of it."""
    return table[:, ALL[column] - 1]


def _whole(table: Floats, column: str) -> Wholes:
    return _of(table, column).astype(int)


def _check_tables(case: Case, name: str) -> list[Problem]:
    """Tables that are missing, or have too few columns."""
    cure = "Correct the file, or choose another format with --from."
    what = "cannot be read as a MATPOWER case of version 2"
    missing = [f"mpc.{field} is missing" for field in CASE if field not in case]
    if missing:
        return [Problem(name, f"{what} ({', '.join(missing)})", cure)]
    narrow = [
        f"mpc.{table} has {case[table].shape[1]} columns instead of {COLUMNS[table]} or more"
        for table in TABLES
        if case[table].shape[1] < COLUMNS[table] or not len(case[table])
    ]
    return [Problem(name, f"{what} ({', '.join(narrow)})", cure)] if narrow else []


def _check_values(case: Case, name: str) -> list[Problem]:
    """Values that no network has, one problem for each table and kind."""
    problems = []
    for table, columns in FINITE.items():
        values = np.column_stack([_of(case[table], column) for column in columns])
        wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(wrong):
            what = f"has no number in a column of {', '.join(columns)}"
            problems.append(_in_rows(name, table, wrong, what))
    base = case["baseMVA"]
    if base.size != 1 or not 0 < base[0, 0] < np.inf:
        problems.append(Problem(name, "has no positive number as mpc.baseMVA", "Correct it."))
    if problems:
        return problems
    bus = case["bus"]
    numbers = _of(bus, "BUS_I")
    known, first = np.unique(numbers, return_index=True)
    faults = (
        ("bus", np.setdiff1d(np.arange(len(bus)), first), "has the number of another bus"),
        ("bus", np.flatnonzero(~(_of(bus, "BASE_KV") > 0)), "has no positive BASE_KV"),
        (
            "bus",
            np.flatnonzero((numbers < 0) | (numbers % 1 != 0) | (numbers > LARGEST_BUS)),
            f"has no whole number up to {LARGEST_BUS}",
        ),
        (
            "bus",
            np.flatnonzero(~np.isin(_of(bus, "BUS_TYPE"), (1, 2, 3, 4))),
            "has no BUS_TYPE from 1 to 4",
        ),
        ("gen", _strange(_of(case["gen"], "GEN_BUS"), known), "is at a bus that is not in mpc.bus"),
        *(
            ("branch", _strange(_of(case["branch"], end), known), f"has an unknown {end}")
            for end in ("F_BUS", "T_BUS")
        ),
    )
    found = [_in_rows(name, table, rows, what) for table, rows, what in faults if len(rows)]
    if "dcline" in case and case["dcline"].shape[1] > STATUS_OF_DC:
        running = np.flatnonzero(case["dcline"][:, STATUS_OF_DC] > 0)
        if len(running):
            what = "is a DC line, which the model does not have"
            cure = "Replace it by a load and a generator, or switch it off."
            found.append(replace(_in_rows(name, "dcline", running, what), cure=cure))
    return found


def _strange(values: Floats, known: Floats) -> Wholes:
    """Rows whose bus is not known."""
    return np.flatnonzero(~np.isin(values, known))


def _in_rows(name: str, table: str, rows: Wholes, what: str) -> Problem:
    more = f" and {len(rows) - 1} more" if len(rows) > 1 else ""
    return Problem(name, f"row {rows[0] + 1} of mpc.{table}{more} {what}", "Correct the table.")


def _add_powers(net: Any, bus: Floats, numbers: Wholes) -> None:
    """Demand and shunts of the buses; negative demand is generation."""
    import pandapower as pp

    p_mw, q_mvar = _of(bus, "PD"), _of(bus, "QD")
    feeding = p_mw < 0
    drawing = ~feeding & ((p_mw > 0) | (q_mvar != 0))
    pp.create_loads(net, numbers[drawing], p_mw[drawing], q_mvar[drawing])
    pp.create_sgens(net, numbers[feeding], -p_mw[feeding], -q_mvar[feeding], type="")
    g_mw, b_mvar = _of(bus, "GS"), _of(bus, "BS")
    shunted = (g_mw != 0) | (b_mvar != 0)
    # A positive BS feeds reactive power; pandapower counts what a shunt draws.
    pp.create_shunts(net, numbers[shunted], q_mvar=-b_mvar[shunted], p_mw=g_mw[shunted])


def _words_for(fuels: Sequence[str], count: int) -> list[str]:
    """The word for each generator's kind; none where not every fuel is given."""
    if len(fuels) != count:
        return [""] * count
    words = [fuel.strip().lower() for fuel in fuels]
    return ["" if word in NO_FUEL else MEANT.get(word, word) for word in words]


def _add_generators(
    net: Any, gen: Floats, kind_of: dict[int, int], words: Sequence[str]
) -> tuple[str, ...]:
    """The first generator in service of a bus holds its voltage, if the bus's type says so.

    Type 3 makes an external grid of it, type 2 a generator; all others have a fixed power. Without
    any of type 3, MATPOWER takes the first of type 2 as the reference.
    """
    import pandapower as pp

    running = _of(gen, "GEN_STATUS") > 0
    on, word = gen[running], np.array(words, dtype=object)[running]
    at = _whole(on, "GEN_BUS")
    kind = np.array([kind_of[bus] for bus in at], dtype=int)
    notes: tuple[str, ...] = ()
    if len(on) and not (kind == ALL["REF"]).any() and (kind == ALL["PV"]).any():
        reference = at[np.argmax(kind == ALL["PV"])]
        kind[at == reference] = ALL["REF"]
        notes = (
            f"No generator in service is at a bus of type 3: bus {reference}, the first of type 2, "
            "is the grid connection.",
        )
    _, first = np.unique(at, return_index=True)
    holds = np.isin(np.arange(len(on)), first)
    # Where several hold one bus, the last has the say.
    v_pu = dict(zip(at.tolist(), _of(on, "VG").tolist(), strict=True))
    # Those with a fuel state the most that they can give; others are as large as what they give.
    told = (word != "") & (gen.shape[1] >= ALL["PMIN"])
    most_mw, least_mw = (
        np.where(told, _of(on, limit), np.nan) if told.any() else np.full(len(on), np.nan)
        for limit in ("PMAX", "PMIN")
    )
    for row in np.flatnonzero(holds & (kind == ALL["REF"])):
        pp.create_ext_grid(net, at[row], vm_pu=v_pu[at[row]], name=f"swing bus {at[row]}")
    for row in np.flatnonzero(holds & (kind == ALL["PV"])):
        p_mw, s_mva = _of(on, "PG")[row], _of(on, "MBASE")[row]
        pp.create_gen(
            net, at[row], p_mw=p_mw, vm_pu=v_pu[at[row]], sn_mva=s_mva, type=word[row],
            max_p_mw=most_mw[row], min_p_mw=least_mw[row],
        )  # fmt: skip
    fixed = ~holds | (kind == ALL["PQ"])
    given = _of(on, "PG")[fixed], _of(on, "QG")[fixed]
    limits = {"max_p_mw": most_mw[fixed], "min_p_mw": least_mw[fixed]} if word.any() else {}
    pp.create_sgens(net, at[fixed], *given, type=word[fixed].tolist(), **limits)
    return notes


def _add_branches(net: Any, branch: Floats) -> None:
    """Lines, and transformers where a branch has a ratio, a shift or two levels."""
    ends = _whole(branch, "F_BUS"), _whole(branch, "T_BUS")
    kv = [net.bus["vn_kv"].loc[end].to_numpy() for end in ends]
    tap = np.where(_of(branch, "TAP") == 0, 1.0, _of(branch, "TAP"))
    plain = (kv[0] == kv[1]) & (tap == 1) & (_of(branch, "SHIFT") == 0)
    _add_lines(net, branch, plain)
    for row in np.flatnonzero(~plain):
        _add_transformer(net, branch[row : row + 1], float(tap[row]))


def _names(branch: Floats) -> list[str]:
    ends = zip(_whole(branch, "F_BUS"), _whole(branch, "T_BUS"), strict=True)
    return [f"{start}-{end}" for start, end in ends]


def _add_lines(net: Any, branch: Floats, plain: Flags) -> None:
    import pandapower as pp

    lines = branch[plain]
    start, end = _whole(lines, "F_BUS"), _whole(lines, "T_BUS")
    kv = net.bus["vn_kv"].loc[start].to_numpy()
    base_ohm = kv**2 / net.sn_mva
    rating_mva = _rating_mva(lines)
    pp.create_lines_from_parameters(
        net,
        start,
        end,
        length_km=1.0,
        r_ohm_per_km=_of(lines, "BR_R") * base_ohm,
        x_ohm_per_km=_of(lines, "BR_X") * base_ohm,
        c_nf_per_km=_of(lines, "BR_B") / base_ohm / (2 * np.pi * F_HZ) * 1e9,
        max_i_ka=np.where(rating_mva < NO_LIMIT_MVA, rating_mva / kv / np.sqrt(3), NO_LIMIT_KA),
        name=_names(lines),
        in_service=_of(lines, "BR_STATUS") > 0,
    )


def _rating_mva(branch: Floats) -> Floats:
    """RATE_A, where 0 means that there is none."""
    rating = _of(branch, "RATE_A")
    return np.where((rating > 0) & (rating < NO_LIMIT_MVA), rating, NO_LIMIT_MVA)


def _add_transformer(net: Any, branch: Floats, tap: float) -> None:
    """A branch as MATPOWER's ideal transformer at its beginning, before a series impedance.

    The tap changer is at the beginning, whichever voltage that has; charging is a shunt at either
    end, as pandapower's transformers can only draw reactive power.
    """
    import pandapower as pp

    start, end = int(_whole(branch, "F_BUS")[0]), int(_whole(branch, "T_BUS")[0])
    from_high = net.bus.at[start, "vn_kv"] >= net.bus.at[end, "vn_kv"]
    high, low = (start, end) if from_high else (end, start)
    s_mva = float(_rating_mva(branch)[0])
    on_percent = 100.0 * s_mva / net.sn_mva
    r, x = float(_of(branch, "BR_R")[0]), float(_of(branch, "BR_X")[0])
    closed = bool(_of(branch, "BR_STATUS")[0] > 0)
    shift = float(_of(branch, "SHIFT")[0])
    pp.create_transformer_from_parameters(
        net,
        high,
        low,
        sn_mva=s_mva,
        vn_hv_kv=net.bus.at[high, "vn_kv"],
        vn_lv_kv=net.bus.at[low, "vn_kv"],
        vkr_percent=r * on_percent,
        vk_percent=float(np.sign(x) or 1.0) * float(np.hypot(r, x)) * on_percent,
        pfe_kw=0.0,
        i0_percent=0.0,
        shift_degree=shift if from_high else -shift,
        tap_side="hv" if from_high else "lv",
        tap_neutral=0,
        tap_pos=1,
        tap_step_percent=100.0 * (tap - 1.0),
        tap_changer_type="Ratio",
        name=_names(branch)[0],
        in_service=closed,
    )
    half_mvar = float(_of(branch, "BR_B")[0]) * net.sn_mva / 2
    if half_mvar and closed:
        pp.create_shunt(net, start, q_mvar=-half_mvar / tap**2, name=f"charging of {start}-{end}")
        pp.create_shunt(net, end, q_mvar=-half_mvar, name=f"charging of {start}-{end}")
