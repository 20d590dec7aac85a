"""A radial feeder from a meshed net: the branches with the least current are opened.

The heuristic of Shirmohammadi and Hong (IEEE Transactions on Power Delivery 4(2), 1989, DOI
10.1109/61.25637): solve the AC power flow of the meshed net, open the branch with the least current
of all that lie in a loop, and begin again until there is no loop. A branch that carries little
changes little when it is opened, so losses stay near those of the mesh.
"""

from __future__ import annotations

from math import ceil
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from vppres.core.errors import InputError
from vppres.core.units import mw_to_kw
from vppres.feeders.net.elements import label
from vppres.feeders.net.reduce import BRANCHES, case_of, without_stubs
from vppres.scenario.network import find_loops

N_PHASES = 3
MOST_FLOWS = 100
"""Power flows of one search; a net with more loops loses several branches after each."""

EXACT = 1e-6
"""Share of the loads to which the power at each bus is solved for: beside lines of a micro-ohm the
last digits of the flows are rounding."""
LEAST_MVA = 1e-8

NO_FLOW = (
    "The AC power flow of the net has no solution with all its loops or without: where it has "
    "none, the branches with the least current in the source's own are opened, or without it those "
    "with the largest impedance."
)

FIRST_END = {"line": "from", "trafo": "hv", "impedance": "from"}
"""Word for the first end in the columns of each table."""

Element = tuple[str, Any]


class Opening(NamedTuple):
    """Opened loops of a net."""

    notes: tuple[str, ...] = ()  #: on the branches that are open, and the effect
    moved_pu: float | None = None  #: largest change of a voltage; None: not known


def open_loops(net: Any, name: str) -> Opening:
    """Open branches in place until the net is radial.

    Parallel branches count as one. Transformers with three windings are never opened. Where the
    power flow has no solution, or branches lack phases, the branches with the least current in the
    source's own are opened, or those with the largest impedance.
    """
    before = after = _solved(net)
    closing = _closing(net, after is not None)
    n_loops = len(closing)
    at_once = ceil(n_loops / MOST_FLOWS)
    opened: list[Element] = []
    while closing:
        found = [element for elements in closing[-at_once:] for element in elements]
        if any(table not in FIRST_END for table, _ in found):
            message = f"has {len(closing)} loops of transformers with three windings"
            raise InputError.of(name, message, "Open one of each with --open.")
        for table, i in found:
            net[table].loc[i, "in_service"] = False
        opened += found
        after = _solved(net)
        closing = _closing(net, after is not None)
    if not opened:
        return Opening()
    names = ", ".join(label(net, *element) for element in opened)
    note = (
        f"The net is meshed: to open its {n_loops} loops (--open-loops), those branches are "
        f"taken out of service that carry the least current: {names}."
    )
    if before is None or after is None:
        return Opening((note, NO_FLOW))
    moved_pu = float((after - before).abs().max())
    effect = (
        f"Against the mesh, opening moves voltages by at most {moved_pu:.2g} pu; losses are "
        f"{after.name:.1f} kW instead of {before.name:.1f} kW."
    )
    return Opening((note, effect), moved_pu)


def _solved(net: Any) -> pd.Series[float] | None:
    """Voltages by bus, with the losses as its name; None without an AC solution."""
    import pandapower as pp

    load_mva = float(np.hypot(net.load["p_mw"], net.load["q_mvar"]).sum())
    tolerance_mva = max(EXACT * load_mva, LEAST_MVA)
    try:
        pp.runpp(net, calculate_voltage_angles="auto", tolerance_mva=tolerance_mva, numba=False)
    except pp.LoadflowNotConverged:
        return None
    losses_mw = sum(float(net[f"res_{table}"]["pl_mw"].sum()) for table in BRANCHES)
    v_pu: pd.Series[float] = net.res_bus["vm_pu"].rename(float(mw_to_kw(losses_mw)))
    return v_pu


def _closing(net: Any, solved: bool) -> list[list[Element]]:
    """Branches that close loops where those with the most current are laid first.

    They come in the order of falling current; parallel branches are together. Branches with more
    phases are laid before those with fewer, which could not supply what hangs on the others.
    """
    branches, _ = without_stubs(case_of(net))
    given, phases = _given(net, "carried_kva"), _given(net, "phases")
    # A balanced flow says little of branches that lack phases, the source's own solution all.
    by_flow = solved and not (given and any(each < N_PHASES for each in phases.values()))
    current = _currents(net) if by_flow else given or _admittances(branches)
    pairs: dict[tuple[int, int], list[Element]] = {}
    columns = (branches[column] for column in ("from", "to", "table", "element"))
    for start, end, table, i in zip(*columns, strict=True):
        if start != end:
            pairs.setdefault((min(start, end), max(start, end)), []).append((table, i))
    # Windings of larger transformers are laid before all others.
    laid = sorted(
        pairs.items(),
        key=lambda pair: (
            -min(sum(phases.get(element, np.inf) for element in pair[1]), N_PHASES),
            -sum(current.get(element, np.inf) for element in pair[1]),
        ),
    )
    ends = np.array([pair for pair, _ in laid], dtype=object).reshape(-1, 2)
    return [laid[row][1] for row, _ in find_loops(ends[:, 0], ends[:, 1])]


def _given(net: Any, column: str) -> dict[Element, float]:
    """Texts of the source on its branches; empty where there are none."""
    return {
        (table, i): float(value)
        for table in FIRST_END
        if column in net[table]
        for i, value in net[table][column].items()
    }


def _currents(net: Any) -> dict[Element, float]:
    """Current of each branch in the last power flow, in MVA at nominal voltage."""
    found: dict[Element, float] = {}
    for table, end in FIRST_END.items():
        result = net[f"res_{table}"]
        v_pu = net.res_bus["vm_pu"].reindex(net[table][f"{end}_bus"]).to_numpy()
        current = np.hypot(result[f"p_{end}_mw"], result[f"q_{end}_mvar"]) / v_pu
        found |= {(table, i): value for i, value in current.fillna(0.0).items()}
    return found


def _admittances(branches: pd.DataFrame) -> dict[Element, float]:
    """Series admittance of each branch that can be opened, in pu."""
    inside = branches[branches["table"].isin([*FIRST_END])]
    elements = zip(inside["table"], inside["element"], strict=True)
    return dict(zip(elements, 1 / np.hypot(inside["r"], inside["x"]), strict=True))
