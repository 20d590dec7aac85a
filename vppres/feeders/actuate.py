"""A step of a run, or the set-points of one, put into the pandapower net that the feeder came from.

What the scenario took over is switched off in the net, and put back as the scenario has it; lines,
transformers and shunts stay as they are. So a power flow of the net is that of the scenario.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InputError, Problem
from vppres.core.units import kw_to_mw
from vppres.kinds.table import KINDS
from vppres.scenario.formers import bus_of_former, largest_forming_battery
from vppres.scenario.network import BusId
from vppres.scenario.scenario import Scenario

OURS = "vppres"
"""Column of the net that marks what was put into it; with ``opened``, a grid that was opened."""

REPLACED = ("load", "sgen", "gen", "storage", "motor", "asymmetric_load", "asymmetric_sgen")
DEMAND = ("load", "motor", "asymmetric_load", "ward", "xward")
_PUT, _OPENED = "put", "opened"


@dataclass(frozen=True, eq=False)
class Feeding:
    """Supply of the feeder in a step, and power of its buses that no customer owns."""

    bus: BusId | None  #: the bus whose voltage is held; None where the feeder is blacked out
    v_pu: float  #: that voltage
    #: Whether the grid holds it. In the paper's islands no device does: a source stands at the
    #: grid's bus all the same, and gives their losses.
    from_grid: bool
    fixed: pd.DataFrame  #: ``bus``, ``p_kw`` and ``q_kvar`` of constant power

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        outage: bool,
        mode: str,
        v_ac_pu: Floats,
        forms: Mapping[str, Flags],
    ) -> Feeding:
        """Asset that holds the voltage of a step.

        ``v_ac_pu`` (N,) is NaN in a blackout; ``forms`` marks units that form the grid, by kind.
        """
        net = scenario.network
        b = scenario.batteries
        by_unit, bus = bus_of_former(scenario, forms), net.slack_bus
        former = largest_forming_battery(scenario)
        if by_unit is not None:
            # What the unit gives of reactive power comes from what holds the voltage.
            bus = by_unit
        elif outage and mode == "physical" and former is not None:
            # The island gets and gives nothing: any bus may hold the voltage that it has.
            bus = b.bus[former]
        v_pu = float(v_ac_pu[net.bus_index[bus]])
        dark = bool(np.isnan(v_pu))
        draws = (net.p_fixed_kw != 0) | (net.q_fixed_kvar != 0)
        fixed = pd.DataFrame(
            {
                "bus": net.buses[draws],
                "p_kw": net.p_fixed_kw[draws],
                "q_kvar": net.q_fixed_kvar[draws],
            },
            index=[f"fixed at {name}" for name in net.buses[draws]],
        )
        return cls(None if dark else bus, v_pu, not outage, fixed.iloc[:0] if dark else fixed)


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
                table = _beside(table, units, word)
        return table


def _beside(table: pd.DataFrame, more: pd.DataFrame | None, word: str) -> pd.DataFrame:
    """A table with other assets below it, whose power factor is 1."""
    if more is None:
        return table
    named = more[["bus", "p_kw"]].assign(q_kvar=0.0).rename(index=f"{word} {{}}".format)
    return pd.concat([table, named])


def put_into_net(net: Any, bus_of: Mapping[int, BusId], powers: PowerTables) -> None:
    """Put a step into a net, in place; a second call replaces the first.

    Branches that were opened for the import have to be open in ``net``; ``bus_of`` has the bus of
    the scenario for every supplied bus of the net.
    """
    bus_in_net = {bus: source for source, bus in reversed([*bus_of.items()])}
    problems = _unknown_buses(powers, bus_in_net) + _without_load(net, bus_of, powers.customers)
    if problems:
        raise InputError(problems)
    _switch_off(net, bus_of)
    _feed(net, bus_of, bus_in_net, powers.feeding)
    drawn = pd.concat([powers.drawn, powers.feeding.fixed])
    # A storage counts consumption as positive, reactive power too.
    stored = powers.stored.assign(q_kvar=-powers.stored["q_kvar"])
    for table, rows in (("load", drawn), ("sgen", powers.fed), ("storage", stored)):
        for name, row in rows.iterrows():
            _write(net, table, str(name), bus_in_net[row["bus"]], row["p_kw"], row["q_kvar"])


def _unknown_buses(powers: PowerTables, bus_in_net: Mapping[BusId, int]) -> list[Problem]:
    """Buses of the step that the net does not have."""
    tables = (powers.drawn, powers.fed, powers.stored, powers.feeding.fixed)
    items = pd.concat([table["bus"] for table in tables])
    return [
        Problem(
            "set-points",
            "is not a bus of the net",
            "Give the net and the feeder that the scenario was made from.",
            field=f"bus of {name}",
            value=bus,
        )
        for name, bus in items.items()
        if bus not in bus_in_net
    ]


def _without_load(net: Any, bus_of: Mapping[int, BusId], customers: pd.DataFrame) -> list[Problem]:
    """Customers at buses where the net never had a load."""
    loaded = {
        bus_of.get(int(bus))
        for table in DEMAND
        if table in net
        for bus in net[table].loc[~_ours(net[table], _PUT), "bus"]
    }
    return [
        Problem(
            "set-points",
            "the net has no load at this bus",
            "Give the net that the scenario was made from.",
            field=f"bus of {name}",
            value=bus,
        )
        for name, bus in customers["bus"].items()
        if bus not in loaded
    ]


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
    """Close or open the grid, and put a source of its own where a battery holds the voltage."""
    import pandapower as pp

    grids = net.ext_grid
    grids.loc[_ours(grids, _PUT), "in_service"] = False
    opened = _ours(grids, _OPENED)
    closed = grids["bus"].isin(bus_of) & grids["in_service"].astype(bool)
    if feeding.from_grid:
        at_slack = grids["bus"].map(bus_of) == feeding.bus
        grids.loc[opened, "in_service"] = True
        grids.loc[closed & ~at_slack, "in_service"] = False
        grids.loc[(opened | closed) & at_slack, "vm_pu"] = feeding.v_pu
        return
    grids.loc[closed, "in_service"] = False
    _mark(net, "ext_grid", grids.index[closed], _OPENED)
    if feeding.bus is not None:
        source = pp.create_ext_grid(
            net, bus_in_net[feeding.bus], vm_pu=feeding.v_pu, name="holds the island"
        )
        _mark(net, "ext_grid", [source], _PUT)


def _write(net: Any, table: str, name: str, bus: int, p_kw: float, q_kvar: float) -> None:
    """Power of our own element of that name; it is made if there is none."""
    import pandapower as pp

    p_mw = float(kw_to_mw(p_kw))
    q_mvar = float(kw_to_mw(q_kvar))
    found = np.flatnonzero((net[table]["name"] == name) & _ours(net[table], _PUT))
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
    _mark(net, table, [made], _PUT)


def _ours(table: pd.DataFrame, word: str) -> pd.Series[bool]:
    """Rows that bear a mark of ours."""
    if OURS not in table:
        return pd.Series(False, table.index)
    return table[OURS] == word


def _mark(net: Any, table: str, rows: Any, word: str) -> None:
    """Mark rows of a table as ours."""
    if OURS not in net[table]:
        net[table][OURS] = pd.Series("", net[table].index, dtype=object)
    net[table].loc[rows, OURS] = word
