"""A scenario: network, assets, series and weights; everything a day needs, frozen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Wholes, freeze_arrays
from vppres.core.errors import InputError
from vppres.core.notebook import facts_html
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.fields import OfKinds
from vppres.kinds.vehicles import sessions_by_step
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.fairness import Fairness, Interruption
from vppres.scenario.faults import (
    LineFault,
    OpenLine,
    OutOfService,
    check_places,
    known_faults,
    line_name,
)
from vppres.scenario.formers import forming_batteries
from vppres.scenario.history import History
from vppres.scenario.network import Network
from vppres.scenario.option_table import default_of
from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.scenario.phases import BALANCED, Phases, check_phases
from vppres.scenario.source import Source
from vppres.scenario.switches import Switches, switch_problems
from vppres.scenario.timegrid import TimeGrid

DEFAULT_VOLL_GBP_PER_KWH = 16.94
"""Value of lost load of British homes and small businesses on a winter weekday's peak, in prices of
2013: London Economics, "The Value of Lost Load (VoLL) for Electricity in Great Britain", for Ofgem
and DECC, 2013."""


SOFT = "soft"
"""Limits of voltages or currents that give way, with grid, to what the feeder has without control.
"""

HARD = "hard"
"""Voltage limits that customers are switched off for."""

LIMIT = "limit"
"""Ratings of lines that plans keep."""

REPORT = "report"
"""Ratings of lines that are reported only."""


@dataclass(frozen=True)
class ObjectiveWeights:
    """Weights of the objective (paper, Parameter Selection); powers in kW."""

    lambda_grid: float = 1e-6  #: per GBP of grid import
    lambda_curt: float = 0.1  #: per kW of curtailed PV power
    lambda_l: float = 1e-14  #: per ohm kVA² of branch flow
    lambda_q: float = 1e-15  #: per squared utilisation of a device's inverter by reactive power


@dataclass(frozen=True)
class ControllerDefaults:
    """Options of a scenario, which ``vppres run`` uses where none is given."""

    kind: str = default_of("controller")
    horizon_h: float = default_of("horizon_h")
    mode: str = default_of("mode")
    soc_end: float | None = default_of("soc_end")
    outages: str = default_of("outages")
    voltage_limits: str = default_of("voltage_limits")
    ratings: str = default_of("ratings")


@dataclass(frozen=True)
class Priority:
    """How tiers are ranked: by ``weights`` against each other, or in ``strict`` order."""

    rule: str = default_of("priority")


@dataclass(frozen=True)
class Headroom:
    """Share of a forming battery's rating that plans of physical mode leave free in an island."""

    share: float = default_of("headroom")


def _zero() -> Floats:
    """A number without dimension: the same in all steps."""
    return np.zeros(())


@dataclass(frozen=True, eq=False)
class Scenario(OfKinds):
    """Definition of a day, without anything that a controller decides.

    Parameters
    ----------
    name, title : str
        Identifier and a line for headings.
    grid : TimeGrid
        ``T`` steps.
    network : Network
        ``N`` buses.
    customers, pv, batteries : Customers, PVSystems, Batteries
        Tables of length C, P, B.
    load_kw : array, shape (T, C)
        Demand of each customer if served.
    pv_kw : array, shape (T, P)
        Available power of each PV system.
    price_gbp_per_kwh : array, shape (T,)
        Import price.
    temperature_c : array, shape (T,)
        Ambient temperature.
    grid_limit_kw : array, shape (T,)
        Largest import; 0 in an outage, infinite without limit.
    priority : Priority
        How tiers are ranked in runs whose options say nothing.
    headroom : Headroom
        What plans leave free in islands in runs whose options say nothing.
    fairness : Fairness
        How supply is shared within a tier in runs whose options say nothing.
    switching : SwitchingRules
        What ``vppres run`` uses where its options say nothing.
    export_limit_kw : array, shape (T,) or ()
        Largest export, one number for all steps if it has no dimension; infinite without limit.
        Import only, 0, where nothing is given. No export in an outage, whatever it says.
    export_price_gbp_per_kwh : array, shape (T,) or ()
        What exported energy earns; 0 where nothing is given, negative where it costs.
    source : Source
        Where the feeder comes from; it changes no result.
    voll_gbp_per_kwh : float
        Value of lost load, at which the report prices energy that was not supplied.
    warnings : tuple of OutageWarning
        Messages about outages, for runs that do not know them.
    outage_statistics : OutageStatistics
        Outages without a warning, for the same runs.
    interruptions : tuple of Interruption
        Outages that were before the first step, and who was off supply in them.
    faults : tuple of LineFault
        Lines and buses that are out of service for a time.
    history : History, optional
        What was measured before the first step, for forecasters that learn from it.
    phases : Phases, optional
        The three phases of the feeder; without rows, and false, for a balanced one.
    switches : Switches
        Closed switches on lines of the network, and open ones beside them.
    chargers, sessions : Chargers, Sessions
        Chargers of electric vehicles, and when which vehicle is plugged in.
    thermal_loads : ThermalLoads
        Rooms and tanks that are cooled or heated.
    gensets, refuels : Gensets, Refuels
        Generating sets with their tanks, and deliveries of fuel.
    """

    name: str
    title: str
    grid: TimeGrid
    network: Network
    customers: Customers
    pv: PVSystems
    batteries: Batteries
    load_kw: Floats
    pv_kw: Floats
    price_gbp_per_kwh: Floats
    temperature_c: Floats
    grid_limit_kw: Floats
    tiers: tuple[str, ...] = ("critical", "high", "low")
    objective: ObjectiveWeights = ObjectiveWeights()
    controller: ControllerDefaults = ControllerDefaults()
    priority: Priority = Priority()
    headroom: Headroom = Headroom()
    fairness: Fairness = field(default_factory=Fairness)
    switching: SwitchingRules = field(default_factory=SwitchingRules)
    export_limit_kw: Floats = field(default_factory=_zero)
    export_price_gbp_per_kwh: Floats = field(default_factory=_zero)
    source: Source = field(default_factory=Source)
    voll_gbp_per_kwh: float = DEFAULT_VOLL_GBP_PER_KWH
    warnings: tuple[OutageWarning, ...] = ()
    outage_statistics: OutageStatistics = field(default_factory=OutageStatistics)
    interruptions: tuple[Interruption, ...] = ()
    faults: tuple[LineFault, ...] = ()
    history: History | None = None
    phases: Phases = BALANCED
    switches: Switches = field(default_factory=Switches.none)

    def __post_init__(self) -> None:
        ends = self.network.from_bus, self.network.to_bus
        if problems := [*switch_problems(self.switches, *ends)]:
            raise InputError(problems)
        object.__setattr__(self, "phases", self.phases or BALANCED)  # None means the same
        if self.phases:
            check_phases(self.phases, self)
        check_places(self.faults, self.network)
        freeze_arrays(self)

    @cached_property
    def outage(self) -> Flags:
        """True where the grid gives nothing, shape (T,)."""
        return self.grid_limit_kw <= 0.0

    @property
    def follows_switches(self) -> bool:
        """Whether live plans are of the feeder as its switches are read."""
        return bool(len(self.switches))

    @property
    def formers(self) -> Flags:
        """Batteries that form the grid of an island, (B,); with phases those with all three."""
        return forming_batteries(self)

    @cached_property
    def export_max_kw(self) -> Floats:
        """Largest export of each step, shape (T,): the limit, and 0 where there is no grid."""
        return np.where(self.outage, 0.0, self.export_limit_kw)

    @cached_property
    def export_price(self) -> Floats:
        """Price of exported energy in each step in GBP/kWh, shape (T,)."""
        return np.broadcast_to(self.export_price_gbp_per_kwh, self.outage.shape)

    @cached_property
    def exports(self) -> bool:
        """Whether the grid takes anything when it is there; the paper's connection imports only.

        Outages do not matter, so that the steps of a long outage are of the same kind as the rest.
        """
        return bool((self.export_limit_kw > 0.0).any())

    def out_of_service(self, steps: range, known_at: int | None = None) -> OutOfService:
        """Lines and buses that are out in some steps.

        ``known_at`` is the step in which it is known, with what is known then; with all if not
        given.
        """
        faults: Iterable[LineFault] = self.faults
        if known_at is not None:
            faults = known_faults(faults, self.grid.times[known_at], self.grid.step)
        return OutOfService.of(faults, self.network, self.grid, steps)

    def behind(self, part: int, step: int) -> str:
        """The line between a part and the grid in a step, and whether it is out or only open."""
        at = range(step, step + 1)
        there = [
            isinstance(fault, OpenLine)
            for fault in self.faults
            if OutOfService.of([fault], self.network, self.grid, at).lines[0, part - 1]
        ]
        state = "open" if there and all(there) else "out"
        return f"{line_name(self.network, part - 1)}, which is {state}"

    @cached_property
    def load_kvar(self) -> Floats:
        """Reactive demand of each customer if served, shape (T, C)."""
        return self.load_kw * self.customers.q_per_p

    @cached_property
    def session_at(self) -> Wholes:
        """Which session each charger has in each step, (T, K); -1 for none."""
        return sessions_by_step(self.chargers, self.sessions, self.grid)

    @cached_property
    def refuelled_litres(self) -> Floats:
        """Fuel that is delivered to each set at the beginning of each step, (T, G)."""
        return self.refuels.by_step(self.gensets, self.grid)

    @property
    def series(self) -> dict[str, Floats]:
        """All arrays that vary by step, by the names of the fields, (T, ...) each."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {
            name: value
            for name, value in values.items()
            if isinstance(value, np.ndarray) and value.shape[:1] == (self.grid.n_steps,)
        }

    def between(self, first: int, last: int) -> Scenario:
        """Part of the scenario from step ``first`` on, up to but without step ``last``.

        Where it has a history, the steps before join it.

        Examples
        --------
        >>> from vppres.io.find import load_scenario
        >>> noon = load_scenario("uk-heatwave-2022").between(12, 14)
        >>> noon.grid.start.hour, noon.load_kw.shape
        (12, (2, 32))
        """
        grid = replace(
            self.grid,
            start=self.grid.start + first * self.grid.step,
            n_steps=last - first,
        )
        rows: dict[str, Any] = {name: value[first:last] for name, value in self.series.items()}
        history = self.history
        if history is not None:
            history = history.followed_by(self.grid.start, self.load_kw[:first], self.pv_kw[:first])
        return replace(self, grid=grid, history=history, **rows)

    def with_outage(self, start: pd.Timestamp, end: pd.Timestamp) -> Scenario:
        """Copy of the scenario with one outage over the half-open interval ``[start, end)``."""
        times = self.grid.times
        limit = np.where(self.outage, np.inf, self.grid_limit_kw)
        limit = np.where((times >= start) & (times < end), 0.0, limit)
        return replace(self, grid_limit_kw=limit)

    @classmethod
    def from_tables(cls, tables: Mapping[str, Any]) -> Scenario:
        """The scenario of tables in memory, with the checks and messages of a folder.

        Parameters
        ----------
        tables : mapping
            ``scenario``, a dictionary with what ``scenario.toml`` says, and a DataFrame for each
            CSV file by its name without the ending, with the columns of the file. Series may have
            their times as index.

        Raises
        ------
        InputError
            With every problem of every table, by the name of its file and its row there.
        """
        found: Scenario = import_module("vppres.io.scenario_tables").scenario_of(tables)
        return found

    def to_tables(self) -> dict[str, Any]:
        """The tables that :meth:`from_tables` makes this scenario of, to be changed."""
        found: dict[str, Any] = import_module("vppres.io.scenario_tables").tables_of(self)
        return found

    def replace(self, table: str, name: object, **values: Any) -> Scenario:
        """Copy of the scenario with other values in one row of a table.

        A customer that had the weight of its tier gets that of its new one. What else follows from
        a value is not changed with it, as the power of a battery with its energy.

        Parameters
        ----------
        table : str
            Name of the file without its ending.
        name : str or int
            Identifier of the row; of ``buses`` the bus, of ``lines`` the bus that the line feeds.
        **values
            By column of the file; None empties the cell.

        Raises
        ------
        InputError
            If there is no such row, or with what a folder with these values would be refused for.

        Examples
        --------
        >>> from vppres.io.find import load_scenario
        >>> day = load_scenario("uk-heatwave-2022")
        >>> float(day.replace("batteries", "b02", energy_kwh=500).batteries.energy_kwh[0])
        500.0
        """
        door = import_module("vppres.io.scenario_tables")
        found: Scenario = door.replaced(self, table, name, values)
        return found

    def plot(self, ax: Any = None) -> Any:
        """Draw the feeder with its tiers and, below it, the series; gives back both Axes."""
        return import_module("vppres.report.plot").scenario(self, ax=ax)

    def _repr_html_(self) -> str:
        """Table of the scenario's contents, for a notebook."""
        return facts_html(
            f"{self.name}: {self.title}",
            {
                "buses": self.network.n_buses,
                "customers": len(self.customers),
                "PV systems": f"{len(self.pv)}, {self.pv.p_max_kw.sum():,.0f} kW",
                "batteries": f"{len(self.batteries)}, {self.batteries.energy_kwh.sum():,.0f} kWh",
                "steps": f"{self.grid.n_steps} of {self.grid.step_minutes:g} min",
                "steps without grid": int(self.outage.sum()),
            },
        )
