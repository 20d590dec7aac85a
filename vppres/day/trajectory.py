"""The record of a run: tidy tables of what happened, step by step.

Values are realised ones unless a column's name says ``model``. Times are the beginnings of steps.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vppres.core.arrays import Flags, Floats, Names
from vppres.core.errors import InputError
from vppres.core.notebook import facts_html
from vppres.day.wide import Wide
from vppres.kinds.fields import RunsOfKinds
from vppres.kinds.kind import Units
from vppres.kinds.table import KINDS, units_of
from vppres.scenario.configuration import Branches, out_of_branches
from vppres.scenario.network import BusId
from vppres.scenario.scenario import Scenario

if TYPE_CHECKING:
    from vppres.feeders.actuate import PowerTables

TABLES = ("steps", "customers", "pv", "batteries", "buses", "lines")
EXPLAINING_TABLES = ("explanations", "shadow_prices")
PHASED_TABLES = ("nodes",)
OPTIONAL_TABLES = (
    *EXPLAINING_TABLES,
    *PHASED_TABLES,
    *(kind.table for kind in KINDS.values()),
)
FORMS = "forms"
"""Column of the generating sets on sites where one can form the grid of an island."""
SHARE = "share"
"""Column of the customers on sites that dim some: the part of its demand that each got."""
LINES_OUT = "lines_out"
"""Column of the steps in days with faults: names of lines and buses that are out."""
SWITCHED = "switched"
"""Column of the steps in runs that move switches: the operations before each step."""
SWITCHING_ORDER = "switching_order"
"""With it: the operations one after another, each a sentence on a line of its own."""
SWITCHES_OPEN = "switches_open"
"""With it: names of the lines and ties that are open, as :func:`in_a_row`."""
SWITCHING_AHEAD = "switching_ahead"
"""With it: operations that the plan counts on, but that wait."""
SWITCHING_GAIN = "switching_gain"
"""With it: what operations are worth, in weighted customer hours."""
SWITCHING_WHY = "switching_why"
"""With it: what operations serve, or why there is none."""
TIME_ON = "time_on"
"""Column of the customers where steps were decided anew: the share of its time that each was on."""
LOSSES = "losses"
"""With it: how often each lost supply in the step."""
OPTIONS = ("controller", "horizon_h", "solver", "method", "seed")


WHOLE_SHARE = 0.995
"""Share of its demand that is shown as all of it: it rounds to 100%."""


def supplied(customers: pd.DataFrame) -> pd.Series[Any]:
    """The part of its demand that each customer got in each step, of the customers' table.

    >>> supplied(pd.DataFrame({"served": [True, False], "share": [0.4, 0.0]})).tolist()
    [0.4, 0.0]
    >>> supplied(pd.DataFrame({"served": [True, False], "time_on": [0.9, 0.5]})).tolist()
    [0.9, 0.5]
    """
    if TIME_ON not in customers:
        return taken(customers)
    if SHARE not in customers:
        return customers[TIME_ON]
    # A share is the mean while it was on. Older exports have that of the end, and 0 of who is off.
    return customers[TIME_ON] * customers[SHARE].where(customers[SHARE] > 0.0, 1.0)


def taken(customers: pd.DataFrame) -> pd.Series[Any]:
    """The part of its demand that each customer takes at the end of each step."""
    if SHARE not in customers:
        return customers["served"]
    return customers[SHARE].where(customers["served"], 0.0)


def time_on(customers: pd.DataFrame) -> pd.Series[Any]:
    """The share of each step's time in which each customer was on."""
    return customers[TIME_ON if TIME_ON in customers else "served"].astype(float)


def in_a_row(names: Iterable[str]) -> str:
    """Names as one text; those with a comma or a quotation mark are quoted.

    >>> in_a_row(["3-4", "north, old"])
    '3-4, "north, old"'
    """
    return ", ".join(
        '"{}"'.format(name.replace('"', '""')) if set(name) & {",", '"'} else name for name in names
    )


def of_a_row(text: str) -> list[str]:
    """The names of such a text.

    >>> of_a_row('3-4, "north, old"'), of_a_row("")
    (['3-4', 'north, old'], [])
    """
    return next(csv.reader([text], skipinitialspace=True), [])


class Feeder(Protocol):
    """Result of :func:`vppres.feeders.sources.import_network`; only the buses matter here."""

    @property
    def bus_of(self) -> Mapping[int, BusId]:
        """Bus of the scenario for every bus of the source."""


@dataclass(frozen=True, eq=False)
class Trajectory(RunsOfKinds):
    """A finished run: the scenario, one tidy table for each kind of item, and how it was made.

    Parameters
    ----------
    scenario : Scenario
        The day as it was run.
    steps : DataFrame
        One row per step.
    customers, pv, batteries, buses, lines : DataFrame
        One row per step and item, in the order of time, then of the scenario.
    options : mapping
        At least ``controller``, ``horizon_h``, ``solver``, ``method`` and ``seed``; values that
        JSON can hold.
    planned : mapping, optional
        What a full-horizon plan promised: ``served``, nested lists of bool, shape (T, C);
        ``energy_kwh``, the stored energy at the beginning of each step and at the end, shape
        (T + 1,); and what else is worth keeping.
    explanations, shadow_prices : DataFrame, optional
        A reason for every action, and what one more unit of what was scarce would have bought;
        :func:`vppres.explain.day.explain_day` makes them.
    nodes : DataFrame, optional
        Voltages by phase of a phased feeder.
    vehicles : DataFrame, optional
        What chargers of electric vehicles did, one row per step and charger.
    thermal_loads : DataFrame, optional
        Power and temperature of rooms and tanks, one row per step and thermal load.
    gensets : DataFrame, optional
        Power and fuel of generating sets, one row per step and set.
    """

    scenario: Scenario
    steps: pd.DataFrame
    customers: pd.DataFrame
    pv: pd.DataFrame
    batteries: pd.DataFrame
    buses: pd.DataFrame
    lines: pd.DataFrame
    options: Mapping[str, Any]
    planned: Mapping[str, Any] | None = None
    explanations: pd.DataFrame | None = None
    shadow_prices: pd.DataFrame | None = None
    nodes: pd.DataFrame | None = None

    @property
    def imported_kw(self) -> Floats:
        """Import in the AC power flow, shape (T,); an import-only meter counts backwards too."""
        p_grid_kw = self.steps["p_grid_kw"].to_numpy(float)
        if self.scenario.exports:
            p_grid_kw = np.maximum(p_grid_kw, 0.0)
        return np.where(self.steps["outage"].to_numpy(bool), 0.0, p_grid_kw)

    @property
    def exported_kw(self) -> Floats:
        """Export in the AC power flow, shape (T,); a surplus of an import-only meter is none."""
        if not self.scenario.exports:
            return np.zeros(len(self.steps))
        p_grid_kw = self.steps["p_grid_kw"].to_numpy(float)
        return np.where(self.steps["outage"].to_numpy(bool), 0.0, np.maximum(-p_grid_kw, 0.0))

    def by_step(self, table: str, column: str) -> NDArray[Any]:
        """A column of a table with a row for each step and item, shape (T, n)."""
        values: NDArray[Any] = getattr(self, table)[column].to_numpy()
        return values.reshape(len(self.steps), len(values) // len(self.steps))

    @property
    def supplied(self) -> Floats:
        """The part of its demand that each customer got in each step, shape (T, C)."""
        share: Floats = supplied(self.customers).to_numpy(float)
        return share.reshape(len(self.steps), -1)

    @property
    def time_off(self) -> Floats:
        """The share of each step's time in which each customer was off, shape (T, C)."""
        share: Floats = 1.0 - time_on(self.customers).to_numpy(float)
        return share.reshape(len(self.steps), -1)

    @property
    def losses_of_supply(self) -> Floats:
        """How often each customer lost supply in each step, shape (T, C); before, all were on."""
        if LOSSES in self.customers:
            return np.asarray(self.by_step("customers", LOSSES), dtype=float)
        off = ~self.by_step("customers", "served")
        before = np.vstack([np.zeros_like(off[:1]), off[:-1]])
        return np.asarray(off & ~before, dtype=float)

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The six tables by name, and those of the explanation if there is one."""
        found = {name: getattr(self, name) for name in (*TABLES, *OPTIONAL_TABLES)}
        return {name: table for name, table in found.items() if table is not None}

    def apply_to(self, net: Any, feeder: Feeder, time: pd.Timestamp | str) -> None:
        """Put what happened in a step into the pandapower net that the scenario was made from.

        What the scenario took over (loads, generators, storages) is switched off in the net, and
        customers with their machines, PV systems, batteries, chargers and generating sets are put
        back. In an outage the grid is opened; where batteries hold the island, a source at the bus
        of the largest holds its voltage and gives nothing; in a blackout there is none. A power
        flow of the net is then that of the record, as far as the feeder is exact.

        Parameters
        ----------
        net : pandapowerNet
            The net, changed in place; branches that were opened for the import have to be open.
        feeder : ImportedFeeder
            What :func:`vppres.feeders.sources.import_network` made of it.
        time : pandas.Timestamp or str
            Beginning of a step, with time zone.

        Raises
        ------
        InputError
            If there is no such step, or the net is not that of the scenario.
        """
        from vppres.feeders.actuate import put_into_net

        known = {str(bus): bus for bus in self.scenario.network.buses}
        bus_of = {source: known.get(str(bus), bus) for source, bus in feeder.bus_of.items()}
        put_into_net(net, bus_of, self._powers(self.step_at(time)))

    def step_at(self, time: pd.Timestamp | str) -> int:
        """The step that begins at a time."""
        times = pd.DatetimeIndex(self.steps["time"])
        try:
            found = np.flatnonzero(times == pd.Timestamp(time))
        except (ValueError, TypeError):
            found = np.empty(0, dtype=int)
        if not len(found):
            raise InputError.of(
                "run",
                "is not the beginning of a step",
                f"Give one of {times[0].isoformat()} to {times[-1].isoformat()}, with its "
                "time zone.",
                field="time",
                value=time,
            )
        return int(found[0])

    def _powers(self, t: int) -> PowerTables:
        """Powers of a step by identifier."""
        from vppres.feeders.actuate import Feeding, PowerTables

        day = self.scenario
        rows = {name: self.rows(name, t) for name in ("customers", "pv", "batteries")}
        c, pv, b = rows["customers"], rows["pv"], rows["batteries"]
        on = taken(c).to_numpy()
        return PowerTables(
            _powers(
                day.customers.id, day.customers.bus, c["p_load_kw"] * on, c["q_load_kvar"] * on
            ),
            _powers(
                day.pv.id,
                day.pv.buses(day.customers),
                pv["self_kw"] + pv["export_kw"],
                pv["q_kvar"],
            ),
            _powers(
                day.batteries.id, day.batteries.bus, b["charge_kw"] - b["discharge_kw"], b["q_kvar"]
            ),
            Feeding.of(
                day,
                bool(self.steps["outage"].iloc[t]),
                str(self.options.get("mode", "paper")),
                self.rows("buses", t)["v_ac_pu"].to_numpy(float),
                self.forms(t),
                self.carries(t),
            ),
            {kind: self._active(kind, t) for kind in units_of(day)},
        )

    def carries(self, t: int) -> Flags:
        """Lines and ties that carry in a step, (E,): closed and not out by a fault."""
        branches = Branches.of(self.scenario)
        closed = branches.closed
        if SWITCHES_OPEN in self.steps:
            closed = branches.closed_but(of_a_row(self.steps[SWITCHES_OPEN].iloc[t]))
        out = self.scenario.out_of_service(range(t, t + 1))
        carries: Flags = closed & ~out_of_branches(out, branches.ends)[0]
        return carries

    def forms(self, t: int) -> dict[str, Flags]:
        """Units that formed the grid in a step, (n,), by kind; none where none can."""
        rows = {kind: self.rows(KINDS[kind].table, t) for kind in units_of(self.scenario)}
        return {kind: each[FORMS].to_numpy(bool) for kind, each in rows.items() if FORMS in each}

    def _active(self, kind: str, t: int) -> pd.DataFrame:
        """Powers of the units of a kind in a step by identifier."""
        units: Units = getattr(self.scenario, kind)
        buses = units.buses(self.scenario.customers)
        columns = {"bus": buses, "p_kw": self.rows(KINDS[kind].table, t)["p_kw"].to_numpy()}
        return pd.DataFrame(columns, index=pd.Index(units.id, name="id"))

    @property
    def t(self) -> Wide:
        """Columns of the tables by time, a column for each item: ``run.t.served``."""
        grid = self.scenario.grid
        return Wide(self.tables, grid.start + len(self.steps) * grid.step)

    def plot(self, kind: str = "day", **options: Any) -> Any:
        """Draw the run with matplotlib; :mod:`vppres.report.plot` has every kind of picture.

        Parameters
        ----------
        kind : str
            ``day``, ``supply``, ``energy``, ``voltages``, ``feeder`` or ``compare``.
        **options
            As the kind takes them; ``ax`` says where to draw.

        Returns
        -------
        Axes, or a sequence of them
            Where it was drawn.
        """
        return import_module("vppres.report.plot").drawn(kind, self, **options)

    def rows(self, name: str, t: int) -> pd.DataFrame:
        """The rows of a table that belong to a step; none of a table that is not there."""
        if name not in self.tables:
            return pd.DataFrame()
        table: pd.DataFrame = getattr(self, name)
        count = len(table) // len(self.steps)
        return table.iloc[t * count : (t + 1) * count]

    def _repr_html_(self) -> str:
        """The run in a few figures, for a notebook."""
        steps = self.steps
        return facts_html(
            f"Run of {self.scenario.name}",
            {
                "controller": f"{self.options['controller']}, {self.options['horizon_h']:g} h",
                "steps": len(steps),
                "steps without grid": int(steps["outage"].sum()),
                "customers served": f"{self.customers['served'].mean():.1%} of all steps",
                "lowest AC voltage": f"{steps['v_min_ac_pu'].min():.4f} pu",
                "tables": ", ".join(self.tables),
            },
        )


def _powers(names: Names, buses: Names, p_kw: Any, q_kvar: Any) -> pd.DataFrame:
    """Powers by identifier."""
    columns = {"bus": buses, "p_kw": np.asarray(p_kw), "q_kvar": np.asarray(q_kvar)}
    return pd.DataFrame(columns, index=pd.Index(names, name="id"))
