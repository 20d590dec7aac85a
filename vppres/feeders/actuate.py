"""A step of a run, or the set-points of one, put into the pandapower net that the feeder came from.

What the scenario took over is switched off in the net, and put back as the scenario has it; lines
that are out or open are taken out of service, ties that are closed are closed, and capacitors that
islands cannot hold are switched off there. All else stays as it is. So a power flow of the net is
that of the scenario.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names, Wholes
from vppres.core.errors import InputError, Problem
from vppres.core.units import kw_to_mw
from vppres.feeders.net.marked import (
    OPENED,
    PUT,
    mark,
    ours,
    put_back,
    set_branches,
    switch_off_shunts,
)
from vppres.kinds.table import KINDS
from vppres.scenario.configuration import Branches, forest
from vppres.scenario.formers import bus_of_former, formers_within
from vppres.scenario.network import BusId, Network
from vppres.scenario.scenario import Scenario

REPLACED = ("load", "sgen", "gen", "storage", "motor", "asymmetric_load", "asymmetric_sgen")
DEMAND = ("load", "motor", "asymmetric_load", "ward", "xward")


def holder_of(
    scenario: Scenario,
    outage: bool,
    mode: str,
    forms: Mapping[str, Flags],
    buses: Flags | None = None,
) -> BusId:
    """Bus whose voltage is held in a part of the feeder; the whole feeder if no part is given.

    ``forms`` marks units that form the grid, by kind, ``buses`` those of the part, (N,).
    """
    net = scenario.network
    inside = np.ones(net.n_buses, dtype=bool) if buses is None else buses
    at: BusId | None
    for kind, flags in forms.items():
        own = flags & inside[_positions(net, getattr(scenario, kind).buses(scenario.customers))]
        # What the unit gives of reactive power comes from what holds the voltage.
        if (at := bus_of_former(scenario, {kind: own})) is not None:
            return at
    batteries = scenario.batteries
    if inside[0] and not (outage and mode == "physical"):
        return net.slack_bus
    formers = formers_within(scenario, inside[_positions(net, batteries.bus)])
    if formers.any():
        # The island gets and gives nothing: any bus may hold the voltage that it has.
        at = batteries.bus[np.argmax(np.where(formers, batteries.s_max_kva, -1.0))]
    else:
        at = net.buses[np.argmax(inside)]
    return at


def _positions(net: Network, buses: Names) -> Wholes:
    """Positions of buses in the network."""
    return np.array([net.bus_index[bus] for bus in buses], dtype=int)


@dataclass(frozen=True, eq=False)
class Feeding:
    """Supply of the feeder in a step: what holds the voltage, and which branches carry."""

    held: Mapping[BusId, float]  #: buses whose voltage is held, one in each part, and it in pu
    #: Bus whose voltage the grid holds; None without grid. In the paper's islands no device does: a
    #: source stands at the grid's bus all the same, and gives their losses.
    grid_bus: BusId | None
    fixed: pd.DataFrame  #: ``bus``, ``p_kw`` and ``q_kvar`` of constant power
    without_shunts: frozenset[BusId]  #: buses in islands whose shunts are switched off there
    carries: Flags  #: which of the branches carry, (E,)
    branches: Branches  #: lines and ties of the scenario

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        outage: bool,
        mode: str,
        v_ac_pu: Floats,
        forms: Mapping[str, Flags],
        carries: Flags,
    ) -> Feeding:
        """Devices that hold the voltages of a step, in which some branches carry, (E,).

        ``v_ac_pu`` (N,) is NaN in a blackout; ``forms`` marks units that form the grid, by kind.
        """
        net = scenario.network
        branches = Branches.of(scenario)
        _, parts = forest(branches.ends, np.flatnonzero(carries), net.n_buses)
        lit = np.isfinite(v_ac_pu)
        held = {}
        for number in np.unique(parts[lit]):
            bus = holder_of(scenario, outage, mode, forms, parts == number)
            held[bus] = float(v_ac_pu[net.bus_index[bus]])
        draws = ((net.p_fixed_kw != 0) | (net.q_fixed_kvar != 0)) & lit
        fixed = pd.DataFrame(
            {
                "bus": net.buses[draws],
                "p_kw": net.p_fixed_kw[draws],
                "q_kvar": net.q_fixed_kvar[draws],
            },
            index=[f"fixed at {name}" for name in net.buses[draws]],
        )
        grid_bus = net.slack_bus if not outage and lit[0] else None
        of_grid = (parts == 0) & (not outage)
        off = frozenset(net.buses[~of_grid & ~net.island].tolist())
        return cls(held, grid_bus, fixed, off, carries, branches)


@dataclass(frozen=True, eq=False)
class PowerTables:
    """Powers of a step by identifier: ``bus``, ``p_kw`` and ``q_kvar`` in each table.

    What ``customers`` and ``batteries`` take is positive in kW, what ``pv`` feeds likewise; kvar
    are drawn by customers and injected by PV systems and batteries. Units of ``kinds`` have a power
    factor of 1, and no column ``q_kvar``; what those of generators feed is positive.
    """

    customers: pd.DataFrame
    pv: pd.DataFrame
    batteries: pd.DataFrame
    feeding: Feeding
    kinds: Mapping[str, pd.DataFrame]

    @property
    def fed(self) -> pd.DataFrame:
        """PV systems, then units that are generators."""
        return self._with_units(self.pv, "sgen")

    @property
    def drawn(self) -> pd.DataFrame:
        """Customers, then units that are loads."""
        return self._with_units(self.customers, "load")

    @property
    def stored(self) -> pd.DataFrame:
        """Batteries, then units that are storages."""
        return self._with_units(self.batteries, "storage")

    def _with_units(self, table: pd.DataFrame, element: str) -> pd.DataFrame:
        """A table with the units that stand in a table of the net below it, named by their word."""
        for kind, units in self.kinds.items():
            where, word = KINDS[kind].element
            if where == element:
                own = units[["bus", "p_kw"]].assign(q_kvar=0.0)
                table = pd.concat([table, own.rename(index=f"{word} {{}}".format)])
        return table


def put_into_net(net: Any, bus_of: Mapping[int, BusId], powers: PowerTables) -> None:
    """Put a step into a net, in place; a second call replaces the first.

    Branches that were opened for the import have to be open in ``net``; ``bus_of`` has the bus of
    the scenario for every supplied bus of the net.
    """
    bus_in_net = {bus: source for source, bus in reversed([*bus_of.items()])}
    if problems := [*_unfit(net, bus_of, powers)]:
        raise InputError(problems)
    feeding = powers.feeding
    put_back(net)
    set_branches(net, bus_of, feeding.branches, feeding.carries)
    switch_off_shunts(net, bus_of, feeding.without_shunts)
    _switch_off(net, bus_of)
    _feed(net, bus_of, bus_in_net, feeding)
    drawn = pd.concat([powers.drawn, feeding.fixed])
    # A storage counts consumption as positive, reactive power too.
    stored = powers.stored.assign(q_kvar=-powers.stored["q_kvar"])
    for table, rows in (("load", drawn), ("sgen", powers.fed), ("storage", stored)):
        for name, row in rows.iterrows():
            _write(net, table, str(name), bus_in_net[row["bus"]], row["p_kw"], row["q_kvar"])


def _unfit(net: Any, bus_of: Mapping[int, BusId], powers: PowerTables) -> Iterator[Problem]:
    """Buses of the step that the net does not have, and customers where it never had a load."""
    tables = (powers.drawn, powers.fed, powers.stored, powers.feeding.fixed)
    loaded = {
        bus_of.get(int(bus))
        for table in DEMAND
        if table in net
        for bus in net[table].loc[~ours(net[table], PUT), "bus"]
    }
    whole = "Give the net and the feeder that the scenario was made from."
    own = "Give the net that the scenario was made from."
    of_step = pd.concat([table["bus"] for table in tables])
    for rows, known, message, cure in (
        (of_step, {*bus_of.values()}, "is not a bus of the net", whole),
        (powers.customers["bus"], loaded, "the net has no load at this bus", own),
    ):
        for name, bus in rows.items():
            if bus not in known:
                yield Problem("set-points", message, cure, field=f"bus of {name}", value=bus)


def _switch_off(net: Any, bus_of: Mapping[int, BusId]) -> None:
    """Take what the scenario took over, and what was put in before, out of service."""
    for table in REPLACED:
        if table in net and len(net[table]):
            net[table].loc[net[table]["bus"].isin(bus_of), "in_service"] = False
    for table in ("ward", "xward"):
        if table in net and len(net[table]):
            net[table].loc[net[table]["bus"].isin(bus_of), ["ps_mw", "qs_mvar"]] = 0.0


def _feed(
    net: Any,
    bus_of: Mapping[int, BusId],
    bus_in_net: Mapping[BusId, int],
    feeding: Feeding,
) -> None:
    """Close or open the grid, and put a source of its own into each part that has no grid."""
    import pandapower as pp

    grids = net.ext_grid
    grids.drop(grids.index[ours(grids, PUT)], inplace=True)
    opened = ours(grids, OPENED)
    closed = grids["bus"].isin(bus_of) & grids["in_service"].astype(bool)
    at_grid = (grids["bus"].map(bus_of) == feeding.grid_bus) & (feeding.grid_bus is not None)
    grids.loc[opened & at_grid, "in_service"] = True
    grids.loc[closed & ~at_grid, "in_service"] = False
    mark(net, "ext_grid", grids.index[closed & ~at_grid], OPENED)
    for bus, v_pu in feeding.held.items():
        if bus == feeding.grid_bus:
            grids.loc[(opened | closed) & at_grid, "vm_pu"] = v_pu
            continue
        source = pp.create_ext_grid(net, bus_in_net[bus], vm_pu=v_pu, name="holds the island")
        mark(net, "ext_grid", [source], PUT)


def _write(net: Any, table: str, name: str, bus: int, p_kw: float, q_kvar: float) -> None:
    """Power of our own element of that name; it is made if there is none."""
    import pandapower as pp

    p_mw = float(kw_to_mw(p_kw))
    q_mvar = float(kw_to_mw(q_kvar))
    found = np.flatnonzero((net[table]["name"] == name) & ours(net[table], PUT))
    if len(found):
        row = net[table].index[found[0]]
        net[table].loc[row, ["p_mw", "q_mvar"]] = p_mw, q_mvar
        net[table].loc[row, "in_service"] = True
        return
    if table == "load":
        made = pp.create_load(net, bus, p_mw=p_mw, q_mvar=q_mvar, name=name)
    elif table == "sgen":
        made = pp.create_sgen(net, bus, p_mw=p_mw, q_mvar=q_mvar, name=name, type="PV")
    else:
        made = pp.create_storage(net, bus, p_mw=p_mw, q_mvar=q_mvar, max_e_mwh=np.nan, name=name)
    mark(net, table, [made], PUT)
