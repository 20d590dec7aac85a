"""From a pandapower net to a radial feeder of series impedances.

pandapower's own conversion to its branch model does the work: it joins buses over closed switches,
opens what is open, leaves out what has no supply, and models every kind of transformer. What is
left here is to merge parallel branches, to refuse what the model cannot hold, and to say what was
simplified.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names
from vppres.core.errors import InputError, Problem, VerificationError
from vppres.core.units import kva_to_a, mw_to_kw
from vppres.feeders.elements import NetCase, few, in_service, label, supplied
from vppres.feeders.feeder import Deviation, ImportedFeeder
from vppres.feeders.net_assets import generators_of, loads_of, motors_as_loads, storages_of
from vppres.feeders.notes import notes_of
from vppres.feeders.ratings import rating_mva, shared_rating
from vppres.io.messages import did_you_mean
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.network import BusId, Network, find_loops

BRANCHES = ("line", "trafo", "trafo3w", "impedance")
# Three-phase loads, controlled devices and direct current have no place in the model.
UNSUPPORTED = (
    "asymmetric_load",
    "asymmetric_sgen",
    "ward",
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
FROM, TO, R, X, B, TAP = 0, 1, 2, 3, 4, 8  # columns of the branch table of pandapower's case


@dataclass(frozen=True, eq=False)
class _Loads:
    """Loads in the network's bus order, shape (N,) each."""

    p_kw: Floats
    q_kvar: Floats
    tier: Names


def feeder_of(
    net: Any,
    name: str,
    open_branches: Sequence[str] = (),
    bus_ids: Mapping[int, BusId] | None = None,
) -> ImportedFeeder:
    """Reduce a pandapower net to a feeder; the net is not changed.

    Parameters
    ----------
    net : pandapowerNet
        Any net with one external grid.
    name : str
        Name of the source, for messages.
    open_branches : sequence of str
        Branches to take out of service first, as ``line 7`` or by their name.
    bus_ids : mapping, optional
        Identifier of each bus; its index in the net where it is not given.

    Raises
    ------
    InputError
        If the net has an element that the model cannot hold, no or several external grids, or
        loops; each problem names the element.
    """
    net = copy.deepcopy(net)
    _raise(_check_elements(net, name) + _check_slack(net, name))
    open_named(net, name, open_branches)
    case = case_of(net)
    branches, stubs = without_stubs(case)
    _raise(_check_loops(branches, name) or _check_branches(branches, name))
    ids = _identifiers(case, bus_ids)
    network = _network(_merged(branches), case, ids)
    loads = _loads(net, case, ids, network)
    storages, storage_notes = storages_of(net, case, ids)
    feeder = ImportedFeeder(
        name=name,
        network=network,
        p_load_kw=loads.p_kw,
        q_load_kvar=loads.q_kvar,
        tier=loads.tier,
        generators=generators_of(net, case, ids),
        storages=storages,
        loads=loads_of(net, case, ids),
        bus_of={bus: ids[row] for bus, row in case.bus_at.items()},
        notes=(*notes_of(net, case, stubs), *storage_notes),
    )
    return replace(feeder, deviation=_deviation(net, feeder))


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
    """Whether there is exactly one grid connection."""
    grids = [label(net, "ext_grid", i) for i in in_service(net, "ext_grid").index]
    gens = in_service(net, "gen")
    grids += [label(net, "gen", i) for i in gens.index[gens["slack"].astype(bool)]]
    if not grids:
        return [Problem(name, "has no external grid", "Add one at the bus of the grid connection.")]
    if len(grids) > 1:
        return [
            Problem(
                name,
                f"has {len(grids)} external grids: {few(grids)}",
                "Keep the one that feeds the feeder and take the others out of service.",
            )
        ]
    if grids[0].startswith("gen"):
        return [
            Problem(name, f"{grids[0]} is the grid connection", "Replace it by an external grid.")
        ]
    bus = int(in_service(net, "ext_grid")["bus"].iloc[0])
    if not net.bus["in_service"].at[bus]:
        return [
            Problem(
                name,
                f"{grids[0]} is at bus {bus}, which is out of service",
                "Put the bus into service.",
            )
        ]
    return []


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

    # With the pi model the series impedance of a transformer is that of its short circuit.
    ppc = to_ppc(
        net, calculate_voltage_angles=False, trafo_model="pi", init="flat", check_connectivity=True
    )
    at = net._pd2ppc_lookups["bus"]  # buses without supply come after all others
    bus_at = {int(bus): int(at[bus]) for bus in net.bus.index if at[bus] < len(ppc["bus"])}
    ranges = net._pd2ppc_lookups["branch"]
    # A transformer with three windings has three branches; they come winding by winding.
    origins = [
        (table, i)
        for table, (start, end) in ranges.items()
        for i in (*net[table].index,) * ((end - start) // max(len(net[table]), 1))
    ]
    inside = [
        origin for origin, used in zip(origins, ppc["internal"]["branch_is"], strict=True) if used
    ]
    columns = dict(
        zip(
            ("from", "to", "r", "x", "b", "tap"),
            ppc["branch"][:, [FROM, TO, R, X, B, TAP]].real.T,
            strict=True,
        )
    )
    branches = pd.DataFrame(
        {
            **columns,
            "table": [table for table, _ in inside],
            "element": [i for _, i in inside],
            "label": [label(net, *o) for o in inside],
            "rating_mva": [rating_mva(net, *o) for o in inside],
        }
    )
    grid = in_service(net, "ext_grid").iloc[0]
    return NetCase(
        float(ppc["baseMVA"]),
        ppc["bus"][:, 9].real,
        bus_at,
        branches.astype({"from": int, "to": int}),
        bus_at[int(grid["bus"])],
        float(grid["vm_pu"]),
    )


def without_stubs(case: NetCase) -> tuple[pd.DataFrame, list[str]]:
    """Branches without the open ends that pandapower gives a bus of their own, and their labels."""
    branches = case.branches
    stubs: list[str] = []
    own = set(case.bus_at.values())
    while True:
        buses, count = np.unique(branches[["from", "to"]].to_numpy(), return_counts=True)
        ends = set(buses[count == 1].tolist()) - own
        dangling = branches["from"].isin(ends) | branches["to"].isin(ends)
        if not dangling.any():
            return branches, stubs
        stubs += list(branches.loc[dangling, "label"])
        branches = branches[~dangling]


def _check_branches(branches: pd.DataFrame, name: str) -> list[Problem]:
    """Branches whose impedance the model cannot hold."""
    if branches.empty:
        return [
            Problem(
                name,
                "has no branch that is in service and supplied",
                "Close a switch or put a line into service.",
            )
        ]
    return [
        Problem(
            name,
            f"{branch} has a resistance of {r:.3g} pu and a reactance of {x:.3g} pu",
            "The model needs a positive resistance and no negative reactance: correct "
            "it, or replace the branch by a closed switch.",
        )
        for branch, r, x in zip(branches["label"], branches["r"], branches["x"], strict=True)
        if not (r > 0 and x >= 0)
    ]


def _merged(branches: pd.DataFrame) -> pd.DataFrame:
    """One branch between two buses: parallel ones add up by their admittance."""
    low = branches[["from", "to"]].min(axis=1)
    high = branches[["from", "to"]].max(axis=1)
    admittance = pd.Series(1 / (branches["r"] + 1j * branches["x"]).to_numpy(), branches.index)
    total = admittance.groupby([low, high], sort=False).sum()
    label = branches["label"].groupby([low, high], sort=False).agg(" with ".join)
    together = admittance.groupby([low, high], sort=False).transform("sum")
    rating = shared_rating(admittance, together, branches["rating_mva"])
    rating = rating.groupby([low, high], sort=False).min()
    z = 1 / total.to_numpy()
    ends = np.array([*total.index], dtype=int)
    return pd.DataFrame(
        {
            "from": ends[:, 0],
            "to": ends[:, 1],
            "r": z.real,
            "x": z.imag,
            "label": label.to_numpy(),
            "rating_mva": rating.to_numpy(),
        }
    )


def _check_loops(branches: pd.DataFrame, name: str) -> list[Problem]:
    """One problem for all loops, with the branches of the first ones."""
    if branches.empty:
        return []
    merged = _merged(branches)
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
    shown = "; ".join(few(loop) for loop in loops[:LOOPS_SHOWN])
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


def _network(branches: pd.DataFrame, case: NetCase, ids: Mapping[int, BusId]) -> Network:
    """The network, its impedances referred to the voltage that most of its buses have."""
    rows = np.unique(branches[["from", "to"]].to_numpy())
    levels, count = np.unique(case.bus_kv[rows], return_counts=True)
    base_kv = float(levels[np.argmax(count)])
    # In pu of each level's own base, an impedance is the same at every level: multiplying by one
    # base refers it by the square of the nominal ratio.
    base_ohm = base_kv**2 / case.base_mva
    start, end = (
        np.array([ids[row] for row in branches[side]], dtype=object) for side in ("from", "to")
    )
    r_ohm, x_ohm = (branches[part].to_numpy() * base_ohm for part in ("r", "x"))
    return Network(
        start,
        end,
        r_ohm,
        x_ohm,
        slack_bus=ids[case.slack],
        base_kv=base_kv,
        v_slack_pu=case.v_slack_pu,
        i_max_a=kva_to_a(mw_to_kw(branches["rating_mva"]), base_kv),
    )


def _loads(net: Any, case: NetCase, ids: Mapping[int, BusId], network: Network) -> _Loads:
    """Load of each bus, and the tier that its first load with a tier names."""
    loads = supplied(net, "load", case)
    bus = loads["row"].map(ids)
    drawn = loads[["p_mw", "q_mvar"]].mul(loads["scaling"].fillna(1.0), axis=0).groupby(bus).sum()
    motors = motors_as_loads(net, case)
    turning = motors[["p_mw", "q_mvar"]].groupby(motors["row"].map(ids)).sum()
    drawn = drawn.reindex(network.buses, fill_value=0.0)
    sums = drawn + turning.reindex(network.buses, fill_value=0.0)
    tier = loads["tier"].fillna("") if "tier" in loads else pd.Series("", loads.index)
    first = tier[tier != ""].groupby(bus).first().reindex(network.buses, fill_value="")
    return _Loads(mw_to_kw(sums["p_mw"]), mw_to_kw(sums["q_mvar"]), first.to_numpy(dtype=object))


def _deviation(net: Any, feeder: ImportedFeeder) -> Deviation | None:
    """The feeder's power flow against that of the net."""
    import pandapower as pp

    try:
        pp.runpp(net, calculate_voltage_angles=False, tolerance_mva=1e-9, numba=False)
        result = ACPowerFlow(feeder.network).solve(*feeder.injection)
    except (pp.LoadflowNotConverged, VerificationError):
        return None
    at = feeder.network.bus_index
    v_pu = result.v_pu[[at[bus] for bus in feeder.bus_of.values()]]
    difference = np.abs(net.res_bus["vm_pu"].loc[[*feeder.bus_of]].to_numpy() - v_pu)
    losses_mw = sum(float(net[f"res_{table}"]["pl_mw"].sum()) for table in BRANCHES)
    return Deviation(float(difference.max()), float(mw_to_kw(losses_mw)), result.losses_kw)
