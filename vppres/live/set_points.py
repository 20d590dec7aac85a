"""The decision for one step, as tables by identifier."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags
from vppres.core.notebook import facts_html
from vppres.day.inversions import lower_tiers_now
from vppres.day.recorder import OFF_BY_FAULT, ROTATED, StepRecord
from vppres.day.trajectory import FORMS, SHARE, Feeder, supplied
from vppres.feeders.actuate import Feeding
from vppres.kinds.customer.physics import SwitchingState
from vppres.kinds.fields import SetPointsOfKinds
from vppres.kinds.kind import UnitsNow
from vppres.kinds.table import KINDS, parts
from vppres.live.by_phase import ByPhase
from vppres.live.foreseen import Foreseen
from vppres.live.proposal import Proposal
from vppres.scenario.configuration import Branches, out_of_branches
from vppres.scenario.scenario import Scenario
from vppres.solve.result import Status

SOLVE_FIGURES = (
    "status",
    "gap",
    "objective",
    "bound",
    "solve_s",
    "corrected",
    "fallback",
    "fallback_reason",
    "estimated",
)
"""Figures of the solution in set-points, of every step's record."""


MORE = ("off_h", ROTATED, SHARE, OFF_BY_FAULT)
"""Columns of customers that not all sites and steps have."""

SHED = "shed"
"""The status of an optimal plan that its island does not hold as a whole."""


@dataclass(frozen=True, eq=False)
class SetPoints(SetPointsOfKinds):
    """The decision for one step, as tables by identifier.

    Parameters
    ----------
    time : pandas.Timestamp
        Beginning of the step.
    customers : DataFrame
        ``bus``, ``tier``, demand ``load_kw`` and ``load_kvar``, and whether it is ``served``;
        ``off_h``, for how long it is off by the end of the step, on sites with longest times off;
        ``rotated_weight``, its weight in the plan, if supply is shared within tiers;
        ``share``, the part of its demand that it gets, on sites that dim customers;
        ``shed``, whether the plan served it and the island cannot;
        ``off_by_fault``, why its part of the feeder is blacked out, where lines are out.
    batteries : DataFrame
        ``bus``, ``p_kw`` (charging positive), ``q_kvar`` (injection positive), ``soc``, the state
        of charge that was decided on, and ``soc_end``, the one that is expected after the step.
    pv : DataFrame
        ``bus``, ``available_kw``, ``p_kw`` to be fed, ``curtailed_kw`` and ``q_kvar`` (injection
        positive).
    buses : DataFrame
        ``v_ac_pu``, the voltage that an AC power flow of the set-points gives.
    import_kw : float
        Power from the grid in that power flow, losses included.
    solve : mapping
        How the decision was found: ``status``, ``gap``, ``objective``, ``bound``, ``solve_s``;
        ``corrected`` with its ``reason`` where a plan was overruled; ``fallback`` ("none" where
        none was needed) with its ``fallback_reason``; what was ``estimated``; and with beliefs of
        outages ``stored_value_gbp_per_kwh``, what one more stored kWh is worth later, and
        ``outage_messages``, which of several messages about one outage counts. ``dark_reason`` says
        why an island is blacked out, ``ac_failed`` why its lines do not carry the plan. In strict
        order ``levels`` has how many steps of the window the plan supplies to customers of each
        tier, and how many it could at most; ``inverted`` names a customer off supply whose demand
        lower tiers and charging batteries take now, and when the plan supplies it; ``shorter`` one
        for which what they take would do for a part of the step.
    feeding : Feeding
        What holds the voltages, and which lines and ties carry.
    foreseen : Foreseen
        What the plan that it is taken from foresees for the steps after it.
    chargers : DataFrame or None
        ``bus``, ``vehicle``, when it ``leaves``, ``p_kw`` (charging positive), ``p_limit_kw``, the
        most that it may charge with, ``energy_kwh`` and ``needed_kwh`` of the vehicle; None without
        chargers.
    thermal_loads : DataFrame or None
        ``customer``, ``bus``, ``p_kw`` of the machine, ``setpoint_c`` for its thermostat,
        ``indoor_c``, the temperature that was decided on, and ``indoor_end_c``, the one that is
        expected after the step; None without thermal loads.
    gensets : DataFrame or None
        ``bus``, whether each set is ``running``, ``p_kw``, how long it was on (negative: off) as
        ``hours_before`` and gave what as ``p_before_kw``, ``fuel_litres`` that were decided on,
        ``fuel_end_litres``, and whether it is ``out``; None without generating sets.
    lines_out : tuple of str
        Lines and buses that are out of service, in words.
    switches_open : tuple of str
        Names of the lines and ties that are open in the plan.
    proposal : Proposal
        Switches that an operator is to move, with ``move_switches``.
    by_phase : ByPhase or None
        Voltages and the source's power by phase; None without phases. Customers, batteries and PV
        systems have a column ``phases`` then: a power is that of all its phases, in equal parts.
    """

    time: pd.Timestamp
    customers: pd.DataFrame
    batteries: pd.DataFrame
    pv: pd.DataFrame
    buses: pd.DataFrame
    import_kw: float
    solve: Mapping[str, Any]
    feeding: Feeding
    foreseen: Foreseen
    by_phase: ByPhase | None = None
    lines_out: tuple[str, ...] = ()
    switches_open: tuple[str, ...] = ()
    proposal: Proposal = field(default_factory=Proposal)

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        step: StepRecord,
        foreseen: Foreseen,
        after: SwitchingState,
        kinds: Mapping[str, UnitsNow],
        closed: Flags,
        proposal: Proposal,
    ) -> SetPoints:
        """The set-points of a step that was decided.

        ``scenario`` is the site with what is taken for true of the step, and ``step`` what the
        decision should lead to; ``after`` has switching duties after it, ``kinds`` the units of
        each kind as the step found them, and ``closed`` the lines and ties that are closed, (E,).
        """
        branches = Branches.of(scenario)
        out = scenario.out_of_service(range(1))
        off_h = {"off_h": after.off_h} if after.limits_time_off else {}
        return cls(
            time=scenario.grid.times[step.t],
            customers=_customers(scenario, {**step.customers, **off_h}),
            batteries=_batteries(scenario, step.batteries),
            pv=_pv(scenario, step.pv),
            buses=_table(scenario.network.buses, index="bus", v_ac_pu=step.buses["v_ac_pu"]),
            import_kw=float(step.steps["p_grid_kw"]),
            solve=_solve(step) | _priority(scenario, step, foreseen),
            feeding=Feeding.of(
                scenario,
                bool(scenario.outage[step.t]),
                str(step.steps["mode"]),
                np.asarray(step.buses["v_ac_pu"], dtype=float),
                {kind: row[FORMS] for kind, row in step.kinds.items() if FORMS in row},
                closed & ~out_of_branches(out, branches.ends)[0],
            ),
            foreseen=foreseen,
            by_phase=ByPhase.of(scenario, step),
            lines_out=tuple(out.names(scenario.network, 0)),
            switches_open=branches.open_names(closed),
            proposal=proposal,
            **_of_kinds(scenario, step, kinds),
        )

    def apply_to(self, net: Any, feeder: Feeder) -> None:
        """Write the set-points into a pandapower net.

        What the scenario took over (loads, generators, storages) is switched off. Customers become
        loads with their measured demand (0 if they are off), PV systems static generators,
        batteries storages, named by their identifiers, chargers storages, as "charger k1", machines
        that cool or heat loads, as "machine h1", and generating sets static generators, as
        "set g1", all marked in a column ``vppres``. Lines that are open or out are taken out of
        service, closed ties are closed. In an outage the grid is opened; where batteries hold an
        island or a part, a source at the bus of the largest holds its voltage and gives nothing.

        Parameters
        ----------
        net : pandapowerNet
            The net that the feeder was imported from; branches opened for the import are open.
        feeder : ImportedFeeder
            What :func:`vppres.feeders.sources.import_network` made of it.
        """
        from vppres.feeders.actuate import PowerTables, put_into_net

        on = supplied(self.customers)
        drawn = self.customers.assign(
            p_kw=self.customers["load_kw"] * on, q_kvar=self.customers["load_kvar"] * on
        )
        kinds = {kind: table for kind in KINDS if (table := getattr(self, kind)) is not None}
        powers = PowerTables(drawn, self.pv, self.batteries, self.feeding, kinds)
        put_into_net(net, feeder.bus_of, powers)

    def _repr_html_(self) -> str:
        """Heading and tables for a notebook."""
        on = self.customers["served"]
        head = facts_html(
            f"Set-points of {self.time:%Y-%m-%d %H:%M}",
            {
                "customers on": f"{int(on.sum())} of {len(on)}",
                "import (kW)": f"{self.import_kw:.1f}",
                "solve": f"{self.solve['status']}, {self.solve['solve_s']:.2f} s",
                "fallback": self.solve["fallback_reason"] or "none",
            },
        )
        tables = (self.customers, self.batteries, self.pv)
        return head + "".join(table.to_html(float_format="{:.3f}".format) for table in tables)


def _customers(scenario: Scenario, columns: Mapping[str, Any]) -> pd.DataFrame:
    """Demand and service by customer."""
    customers = scenario.customers
    return _table(
        customers.id,
        bus=customers.bus,
        **scenario.phases.column(customers.id),
        tier=customers.tier,
        load_kw=columns["p_load_kw"],
        load_kvar=columns["q_load_kvar"],
        served=columns["served"],
        shed=columns["shed"],
        **{name: columns[name] for name in MORE if name in columns},
    )


def _batteries(scenario: Scenario, columns: Mapping[str, Any]) -> pd.DataFrame:
    """Powers by battery, charging positive."""
    return _table(
        scenario.batteries.id,
        bus=scenario.batteries.bus,
        **scenario.phases.column(scenario.batteries.id),
        p_kw=columns["charge_kw"] - columns["discharge_kw"],
        q_kvar=columns["q_kvar"],
        soc=columns["soc_start"],
        soc_end=columns["soc_end"],
    )


def _pv(scenario: Scenario, columns: Mapping[str, Any]) -> pd.DataFrame:
    """Powers by PV system."""
    return _table(
        scenario.pv.id,
        bus=scenario.pv.buses(scenario.customers),
        **scenario.phases.column(scenario.pv.id),
        available_kw=columns["available_kw"],
        p_kw=columns["self_kw"] + columns["export_kw"],
        curtailed_kw=columns["curtailed_kw"],
        q_kvar=columns["q_kvar"],
    )


def _of_kinds(
    scenario: Scenario, step: StepRecord, now: Mapping[str, UnitsNow]
) -> dict[str, pd.DataFrame]:
    """Set-points of the units of each kind, with what only a live step knows of them."""
    live = parts("live")
    found = {}
    for kind, columns in step.kinds.items():
        units = getattr(scenario, kind)
        own = live[kind].set_points(scenario, step.t, columns)
        places = {"bus": units.buses(scenario.customers)}
        more = now[kind].columns() if kind in now else {}
        found[kind] = _table(units.id, **{**places, **own, **more})
    return found


def _solve(step: StepRecord) -> dict[str, Any]:
    """How the decision was found; one of which something had to be shed is not optimal."""
    figures = step.steps
    solve = {name: figures[name] for name in SOLVE_FIGURES}
    if _sheds(step) and solve["status"] == Status.OPTIMAL:
        solve["status"] = SHED
    for name in ("stored_value_gbp_per_kwh", "outage_messages", "dark_reason", "ac_failed"):
        if name in figures:
            solve[name] = figures[name]
    return {**solve, "reason": figures["correction_reason"]}


def _sheds(step: StepRecord) -> bool:
    """Whether an island that is lit supplies less than its plan."""
    return bool(step.customers["shed"].any()) and not step.steps.get("dark_reason")


def _priority(scenario: Scenario, step: StepRecord, foreseen: Foreseen) -> dict[str, str]:
    """Bounds of the tiers in strict order, and in an outage who waits while lower tiers are on."""
    columns = step.customers
    levels = "" if _sheds(step) else str(step.steps.get("levels", ""))
    found = {"levels": levels} if levels else {}
    if not scenario.outage[step.t]:
        return found
    return found | lower_tiers_now(
        scenario,
        columns["served"] > 0.5,
        columns["p_load_kw"],
        float(step.batteries["charge_kw"].sum()),
        foreseen.served.to_numpy(bool),
    )


def _table(names: Any, *, index: str = "id", **columns: Any) -> pd.DataFrame:
    """Columns by identifier."""
    return pd.DataFrame(columns, index=pd.Index(names, name=index))
