"""From a pandapower net to a radial feeder of lines with ratios, charging and shunts.

pandapower's own conversion to its branch model does the work: it joins buses over closed switches,
opens what is open, leaves out what has no supply, and models every kind of transformer. What is
left here is to make one branch of parallel ones and one bus of the ends of next to no impedance
(:mod:`vppres.feeders.net.branches`), to refuse what the model cannot hold, and to say what was
simplified.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Complexes, Floats
from vppres.core.errors import InputError, Problem
from vppres.core.text import flaw_of_name, named
from vppres.core.units import kva_to_a, kw_at_1_pu_to_us, mw_to_kw
from vppres.feeders.closeness import PandapowerFlow, causes_of, deviation_of, solve_source
from vppres.feeders.feeder import Generators, ImportedFeeder
from vppres.feeders.net.assets import generators_of, loads_of, motors_as_loads, storages_of
from vppres.feeders.net.branches import (
    EVEN,
    Stub,
    closed_switches,
    joined_rows,
    parallel_as_one,
    split_stubs,
    two_ports,
)
from vppres.feeders.net.elements import NetCase, in_service, label, supplied
from vppres.feeders.net.grids import one_grid
from vppres.feeders.net.notes import notes_of, told_left_out
from vppres.feeders.net.ratings import rating_mva
from vppres.feeders.net.switches import ENDS, switches_of, told_open_transformers
from vppres.feeders.net.taps import told_idle_taps
from vppres.io.messages import did_you_mean
from vppres.io.schema import MIN_OHM, MIN_POWER_FACTOR
from vppres.scenario.network import BusId, Network, find_loops

BRANCHES = ("line", "trafo", "trafo3w", "impedance")
# Three-phase loads, controlled devices and direct current have no place in the model.
UNSUPPORTED = (
    "asymmetric_load",
    "asymmetric_sgen",
    "xward",
    "dcline",
    "svc",
    "ssc",
    "tcsc",
    "vsc",
    "b2b_vsc",
    "bus_dc",
    "line_dc",
    "load_dc",
    "source_dc",
)
LOOPS_SHOWN = 2
SAME_DEGREE = 1e-6
LONGEST_TITLE = 100
GS, BS, KV = 4, 5, 9
"""Columns of the buses of pandapower's case."""


def _own_name(net: Any) -> str:
    """Name of a net, if it can be shown."""
    name = str(net.get("name") or "").strip()
    return "" if flaw_of_name(name, LONGEST_TITLE) else name


def feeder_of(
    net: Any,
    name: str,
    open_branches: Sequence[str] = (),
    bus_ids: Mapping[int, BusId] | None = None,
) -> ImportedFeeder:
    """Reduce a pandapower net to a feeder; the net is not changed.

    ``open_branches`` are out of service first, as ``line 7`` or by their name. ``bus_ids`` has the
    identifier of each bus, which is its index in the net where it is not given.

    Raises
    ------
    InputError
        If the net has an element that the model cannot hold, no or several external grids, or
        loops; each problem names the element.
    """
    net = copy.deepcopy(net)
    notes = [*one_grid(net, name, None, bus_ids)]
    case, (joined, stubs, closed) = _radial(net, name, open_branches)
    ids = _identifiers(joined, bus_ids)
    solved = solve_source(net)
    loads = _loads(net, joined, ids)
    generators, condensers = _without_power(generators_of(net, joined, ids))
    storages, storage_notes = storages_of(net, joined, ids)
    left_out = (*told_left_out(net, case, bus_ids),)
    network = _network(joined, ids, fixed_power(loads, condensers))
    of_customers = loads[has_customer(loads)].reindex(network.buses)
    # The first bus of a row is the one that stays.
    bus_in_net = {ids[row]: bus for bus, row in reversed(joined.bus_at.items())}
    feeder = ImportedFeeder(
        name=name,
        network=network,
        p_load_kw=of_customers["p_kw"].fillna(0.0).to_numpy(),
        q_load_kvar=of_customers["q_kvar"].fillna(0.0).to_numpy(),
        generators=generators,
        storages=storages,
        loads=loads_of(net, joined, ids),
        bus_of={bus: ids[row] for bus, row in joined.bus_at.items()},
        notes=(
            *notes,
            *left_out,
            *notes_of(net, case, stubs, closed, condensers),
            *told_idle_taps(net, solved),
            *told_open_transformers(net, joined),
            *storage_notes,
        ),
        left_out=left_out,
        causes=tuple(causes_of(net, case)),
        source_flow=PandapowerFlow(net, bus_in_net),
        title=_own_name(net),
        switches=switches_of(net, joined, ids, network),
        source_solves=solved,
    )
    return replace(feeder, deviation=deviation_of(net, solved, feeder))


def _radial(
    net: Any, name: str, open_branches: Sequence[str]
) -> tuple[NetCase, tuple[NetCase, list[Stub], list[str]]]:
    """The case of a net that the model can hold, and what :func:`_joined` makes of it."""
    _raise(_check_elements(net, name) + _check_slack(net, name))
    open_named(net, name, open_branches)
    case = case_of(net)
    found = _joined(case)
    branches = found[0].branches
    _raise(_check_loops(branches, name) or _check_branches(branches, name))
    return case, found


def _raise(problems: list[Problem]) -> None:
    if problems:
        raise InputError(problems)


def _check_elements(net: Any, name: str) -> list[Problem]:
    """Elements that the model cannot hold."""
    problems = [
        Problem(
            name,
            f"{label(net, table, i)} is not supported",
            "Replace it by loads, static generators and lines, or take it out of service.",
        )
        for table in UNSUPPORTED
        if table in net
        for i in in_service(net, table).index
    ]
    problems += [
        Problem(
            name,
            f"{label(net, table, i)} begins and ends at bus {net[table][start].at[i]}",
            "Correct its buses, or take it out of service.",
        )
        for table, (start, end) in ENDS.items()
        for i in in_service(net, table).query(f"{start} == {end}").index
    ]
    impedance = in_service(net, "impedance")
    skewed = (impedance["rft_pu"] != impedance["rtf_pu"]) | (
        impedance["xft_pu"] != impedance["xtf_pu"]
    )
    return problems + [
        Problem(
            name,
            f"{label(net, 'impedance', i)} differs between its two directions",
            "Give it the same impedance in both.",
        )
        for i in impedance.index[skewed]
    ]


def _check_slack(net: Any, name: str) -> list[Problem]:
    """Whether there is a grid connection, at a bus in service."""
    grids = in_service(net, "ext_grid")
    if grids.empty:
        return [Problem(name, "has no external grid", "Add one at the bus of the grid connection.")]
    bus = int(grids["bus"].iloc[0])
    if net.bus["in_service"].at[bus]:
        return []
    where = f"{label(net, 'ext_grid', grids.index[0])} is at bus {bus}, which is out of service"
    return [Problem(name, where, "Put the bus into service.")]


def open_named(net: Any, name: str, wanted: Sequence[str]) -> None:
    """Take branches out of service."""
    found = {}
    for table in BRANCHES:
        for i in net[table].index:
            found[f"{table} {i}"] = table, i
            found.setdefault(str(net[table]["name"].at[i]), (table, i))
    _raise(
        [
            Problem(
                name,
                f"has no branch '{text}' to open",
                did_you_mean(text, sorted(found), "Name a branch, for example 'line 0'."),
            )
            for text in wanted
            if text not in found
        ]
    )
    for text in wanted:
        table, i = found[text]
        net[table].loc[i, "in_service"] = False


def case_of(net: Any) -> NetCase:
    """The branch model of pandapower, for a net that passed the checks."""
    from pandapower.converter.pypower.to_ppc import to_ppc

    # The models of pandapower's own power flow, so that nothing differs from it. Loads that follow
    # the voltage stay loads.
    ppc = to_ppc(
        net,
        calculate_voltage_angles=True,
        trafo_model="t",
        init="flat",
        check_connectivity=True,
        voltage_depend_loads=False,
    )
    at = net._pd2ppc_lookups["bus"]  # buses without supply come after all others
    bus_at = {int(bus): int(at[bus]) for bus in net.bus.index if at[bus] < len(ppc["bus"])}
    ranges = net._pd2ppc_lookups["branch"]
    # A transformer with three windings has three branches; they come winding by winding.
    origins = [
        (table, i)
        for table, (start, end) in ranges.items()
        for i in (*with_branch(net, table),)
        * ((end - start) // max(len(with_branch(net, table)), 1))
    ]
    inside = [
        origin for origin, used in zip(origins, ppc["internal"]["branch_is"], strict=True) if used
    ]
    beside = (_beside(ppc, name) for name in ("branch_g", "branch_g_asym", "branch_b_asym"))
    branches = two_ports(ppc["branch"].real, *beside).assign(
        table=[kind for kind, _ in inside],
        element=[i for _, i in inside],
        label=[label(net, *o) for o in inside],
        rating_mva=[rating_mva(net, *o) for o in inside],
    )
    base_mva = float(ppc["baseMVA"])
    bus: Floats = ppc["bus"].real
    grid = in_service(net, "ext_grid").iloc[0]
    return NetCase(
        base_mva,
        bus[:, KV],
        bus_at,
        branches,
        bus_at[int(grid["bus"])],
        float(grid["vm_pu"]),
        np.asarray((bus[:, GS] + 1j * bus[:, BS]) / base_mva, dtype=complex),
    )


def _beside(ppc: Any, name: str) -> Floats:
    """A column that the case has beside its table of branches, for those in service."""
    count = len(ppc["branch"])
    if name not in ppc:
        return np.zeros(count)
    values = np.asarray(ppc[name]).real
    return values if len(values) == count else values[ppc["internal"]["branch_is"]]


def with_branch(net: Any, table: str) -> list[Any]:
    """Elements of a table that have branches in pandapower's case."""
    if table != "switch":
        return [*net[table].index]
    switches = net["switch"]
    return [*switches.index[(switches["et"] == "b") & switches["closed"] & (switches["z_ohm"] > 0)]]


def without_stubs(case: NetCase) -> tuple[pd.DataFrame, list[Stub]]:
    """Branches without the open ends that pandapower gives a bus of their own, and these."""
    return split_stubs(case.branches, set(case.bus_at.values()))


def _joined(case: NetCase) -> tuple[NetCase, list[Stub], list[str]]:
    """The case with one bus for the ends of closed switches; open ends, and labels of switches.

    What open ends draw is with the shunts of the buses that they hang on.
    """
    branches, stubs = without_stubs(case)
    shunts = case.shunts.copy()
    for stub in stubs:
        shunts[stub.row] += stub.y
    closed = closed_switches(branches, case.base_mva, case.bus_kv)
    row_of = joined_rows(branches[closed], len(case.bus_kv), case.slack)
    moved = branches.assign(**{end: row_of[branches[end]] for end in ("from", "to")})
    # What lies beside a closed switch carries nothing, but it charges.
    inside = moved["from"] == moved["to"]
    for end in ("y_from", "y_to"):
        np.add.at(shunts, moved.loc[inside, "from"].to_numpy(int), moved.loc[inside, end])
    together = np.zeros_like(shunts)
    np.add.at(together, row_of, shunts)
    joined = replace(
        case,
        branches=moved[~inside],
        bus_at={bus: int(row_of[row]) for bus, row in case.bus_at.items()},
        shunts=together,
    )
    return joined, stubs, list(branches.loc[inside, "label"])


def _check_branches(branches: pd.DataFrame, name: str) -> list[Problem]:
    """Whether there is any branch, and whether parallel ones shift the phase alike."""
    problems = []
    for _, group in branches.groupby(branches[["from", "to"]].agg(frozenset, axis=1), sort=False):
        along = np.where(group["from"] == group["from"].iloc[0], 1.0, -1.0)
        turn = (along * group["shift"] + 180.0) % 360.0
        if len(group) > 1 and np.ptp(turn) > SAME_DEGREE:
            shifts = [f"{n} ({a:g})" for n, a in zip(group["label"], turn - 180.0, strict=True)]
            problems.append(
                Problem(
                    name,
                    f"has parallel branches that shift the phase differently: {named(shifts)}",
                    "A current circulates between them, which the model does not have: correct "
                    "the shifts in degrees, or open one with --open.",
                )
            )
    if problems:
        return problems
    if branches.empty:
        return [
            Problem(
                name,
                "has no branch that is in service and supplied",
                "Close a switch or put a line into service.",
            )
        ]
    return []


def _check_loops(branches: pd.DataFrame, name: str) -> list[Problem]:
    """One problem for all loops, with the branches of the first ones."""
    if branches.empty:
        return []
    merged = parallel_as_one(branches)
    between = {
        frozenset((a, b)): branch
        for a, b, branch in zip(merged["from"], merged["to"], merged["label"], strict=True)
    }
    loops = []
    for _, loop in find_loops(merged["from"].to_numpy(object), merged["to"].to_numpy(object)):
        pairs = zip(loop, [*loop[1:], loop[0]], strict=True)
        loops.append([between[frozenset((int(a), int(b)))] for a, b in pairs])
    if not loops:
        return []
    shown = "; ".join(named(loop) for loop in loops[:LOOPS_SHOWN])
    return [
        Problem(
            name,
            f"is meshed, with {len(loops)} loop{'s' if len(loops) > 1 else ''}",
            "The feeder must be radial: let --open-loops open the branches with the least current, "
            f"or open one of each loop with --open; the first consist of {shown}.",
        )
    ]


def _identifiers(case: NetCase, bus_ids: Mapping[int, BusId] | None) -> dict[int, BusId]:
    """Identifier of each row of the case: that of its first bus; star points come after all."""
    ids: dict[int, BusId] = {}
    for bus, row in case.bus_at.items():
        ids.setdefault(row, bus_ids[bus] if bus_ids else bus)
    after = max(case.bus_at) + 1
    for row in range(len(case.bus_kv)):
        if row not in ids:
            ids[row] = f"star{row}" if bus_ids else after + row
    return ids


def _network(case: NetCase, ids: Mapping[int, BusId], fixed: pd.DataFrame) -> Network:
    """The network, its impedances referred to the voltage that most of its buses have."""
    branches = parallel_as_one(case.branches)
    rows = np.unique(branches[["from", "to"]].to_numpy(int))
    levels, count = np.unique(case.bus_kv[rows], return_counts=True)
    base_kv = float(levels[np.argmax(count)])
    # In pu of each level's own base, an impedance is the same at every level: multiplying by one
    # base refers it by the square of the nominal ratio.
    base_ohm = base_kv**2 / case.base_mva
    start, end = (
        np.array([ids[int(row)] for row in branches[side]], dtype=object) for side in ("from", "to")
    )
    r_ohm, x_ohm = (branches[part].to_numpy(float) * base_ohm for part in ("r", "x"))
    line, shunts = _charging(branches, case)
    draws = fixed.reindex([ids[int(row)] for row in rows]).fillna(0.0)
    return Network(
        start,
        end,
        np.maximum(r_ohm, MIN_OHM),
        x_ohm,
        slack_bus=ids[case.slack],
        base_kv=base_kv,
        v_slack_pu=case.v_slack_pu,
        i_max_a=kva_to_a(mw_to_kw(branches["rating_mva"].to_numpy(float)), base_kv),
        ratio=branches["tap"].to_numpy(float),
        b_us=kw_at_1_pu_to_us(mw_to_kw(2 * line.imag * case.base_mva), base_kv),
        g_us=kw_at_1_pu_to_us(mw_to_kw(2 * line.real * case.base_mva), base_kv),
        drawing_bus=draws.index.to_numpy(dtype=object),
        p_shunt_kw=mw_to_kw(shunts[rows].real * case.base_mva),
        q_shunt_kvar=-mw_to_kw(shunts[rows].imag * case.base_mva),
        p_fixed_kw=draws["p_kw"].to_numpy(),
        q_fixed_kvar=draws["q_kvar"].to_numpy(),
    )


def _charging(branches: pd.DataFrame, case: NetCase) -> tuple[Complexes, Complexes]:
    """Half the charging of each branch in pu, and all shunts at the rows of the case.

    Where a branch's ends differ, as with a transformer's leakage, both are shunts of the buses.
    """
    ends = [branches[name].to_numpy(complex) for name in ("y_from", "y_to")]
    even = np.abs(ends[0] - ends[1]) <= EVEN * np.abs(ends[0])
    shunts = case.shunts.copy()
    at_from = np.where(even, 0, ends[0] / branches["tap"].to_numpy(float) ** 2)
    np.add.at(shunts, branches["from"].to_numpy(int), at_from)
    np.add.at(shunts, branches["to"].to_numpy(int), np.where(even, 0, ends[1]))
    return np.where(even, ends[0], 0), shunts


def _loads(net: Any, case: NetCase, ids: Mapping[int, BusId]) -> pd.DataFrame:
    """Load of each bus in ``p_kw`` and ``q_kvar``.

    Wards have their constant power here; their impedance is a shunt.
    """
    loads = supplied(net, "load", case)
    wards = supplied(net, "ward", case).rename(columns={"ps_mw": "p_mw", "qs_mvar": "q_mvar"})
    columns = ["row", "p_mw", "q_mvar", "scaling"]
    drawing = [loads, wards, motors_as_loads(net, case)]
    both = pd.concat([frame.reindex(columns=columns) for frame in drawing if len(frame)] or [loads])
    both = both.reindex(columns=columns)
    scaling = both["scaling"].astype(float).fillna(1.0)
    found = pd.DataFrame(
        {
            "bus": both["row"].map(ids),
            "p_kw": mw_to_kw(both["p_mw"] * scaling),
            "q_kvar": mw_to_kw(both["q_mvar"] * scaling),
        }
    )
    return found.groupby("bus", sort=False)[["p_kw", "q_kvar"]].sum()


def has_customer(loads: pd.DataFrame) -> pd.Series[bool]:
    """Buses with a load whose active power is more than a trace beside its reactive power."""
    owned: pd.Series[bool] = loads["p_kw"] > MIN_POWER_FACTOR * np.hypot(
        loads["p_kw"], loads["q_kvar"]
    )
    return owned


def fixed_power(loads: pd.DataFrame, condensers: Generators) -> pd.DataFrame:
    """Fixed power of buses, which no customer can own: without or against active demand."""
    owned = has_customer(loads)
    given = pd.DataFrame({"p_kw": -condensers.p_kw, "q_kvar": -condensers.q_kvar}, condensers.bus)
    both = pd.concat([loads.loc[~owned, ["p_kw", "q_kvar"]], given])
    return both.groupby(level=0, sort=False).sum()


def _without_power(generators: Generators) -> tuple[Generators, Generators]:
    """Generators with active power, and those with reactive power only."""
    idle = (generators.p_kw == 0) & (generators.q_kvar != 0)
    return generators.rows(~idle), generators.rows(idle)
