"""The controller for a plant of one's own: measure, ``step``, carry out the set-points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import pandas as pd

from vppres.contract.decision import Decider
from vppres.contract.forecast import ForecastErrors
from vppres.contract.operating_point import OperatingPoint
from vppres.contract.switching import SwitchingState
from vppres.core.notebook import facts_html
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.simulate import Day
from vppres.day.trajectory import StepRecord
from vppres.live.measurement import Measurement, see, step_at
from vppres.physics.cold_load import ColdLoad
from vppres.scenario.network import BusId
from vppres.scenario.scenario import Scenario


class Feeder(Protocol):
    """What :func:`vppres.feeders.sources.import_network` yields; only the buses matter here."""

    @property
    def bus_of(self) -> Mapping[int, BusId]:
        """Bus of the scenario for every bus of the source."""


@dataclass(frozen=True, eq=False)
class SetPoints:
    """The decision for one step, as tables by identifier.

    Parameters
    ----------
    time : pandas.Timestamp
        Beginning of the step.
    customers : DataFrame
        ``bus``, ``tier``, demand ``load_kw`` and ``load_kvar``, and whether it is ``served``.
    batteries : DataFrame
        ``bus``, ``p_kw`` (charging positive), ``q_kvar`` (injection positive), and ``soc_end``, the
        state of charge that is expected after the step.
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
        none was needed) with its ``fallback_reason``; and what was ``estimated``.
    """

    time: pd.Timestamp
    customers: pd.DataFrame
    batteries: pd.DataFrame
    pv: pd.DataFrame
    buses: pd.DataFrame
    import_kw: float
    solve: Mapping[str, Any]

    def apply_to(self, net: Any, feeder: Feeder) -> None:
        """Write the set-points into a pandapower net.

        Loads of the customers get their measured demand (0 if they are off), PV systems become
        static generators and batteries become storages, named by their identifiers. Everything
        else in the net stays as it is.

        Parameters
        ----------
        net : pandapowerNet
            The net that the feeder was imported from.
        feeder : ImportedFeeder
            What :func:`vppres.feeders.sources.import_network` made of it.
        """
        from vppres.feeders.actuate import write_set_points

        write_set_points(net, feeder.bus_of, self.customers, self.pv, self.batteries)

    def _repr_html_(self) -> str:
        """Heading and tables for a notebook."""
        on = self.customers["served"]
        head = facts_html(f"Set-points of {self.time:%Y-%m-%d %H:%M}", {
            "customers on": f"{int(on.sum())} of {len(on)}", "import (kW)": f"{self.import_kw:.1f}",
            "solve": f"{self.solve['status']}, {self.solve['solve_s']:.2f} s",
            "fallback": self.solve["fallback_reason"] or "none"})
        tables = (self.customers, self.batteries, self.pv)
        return head + "".join(table.to_html(float_format="{:.3f}".format) for table in tables)


class Controller:
    """A controller of a site, to be put behind a SCADA system or a simulator.

    Make it with :meth:`of`; then call :meth:`step` at the beginning of every step. Between two
    steps it keeps the compiled problems, the plan of a full horizon, and the AC operating point of
    its last set-points, around which it linearises the voltages.

    Examples
    --------
    >>> import vppres
    >>> day = vppres.load_scenario("uk-heatwave-2022")
    >>> controller = Controller.of(day, vppres.RunOptions(horizon_h=0))
    >>> now = Measurement(controller.times[0], soc=dict.fromkeys(day.batteries.id, 0.5))
    >>> decision = controller.step(now)
    >>> bool(decision.customers["served"].all())
    True
    """

    def __init__(self, scenario: Scenario, options: RunOptions, decider: Decider) -> None:
        self.scenario = scenario
        self.options = options
        self._decider = decider
        self._operating_point: OperatingPoint | None = None
        self._kept: tuple[SwitchingState | None, ColdLoad] | None = None

    @classmethod
    def of(cls, scenario: Scenario, options: RunOptions | None = None) -> Controller:
        """The controller of a scenario's site.

        Parameters
        ----------
        scenario : Scenario
            The site, its time grid, and the series that stand in for what is not measured.
        options : RunOptions, optional
            As for :func:`vppres.day.simulate.run_day`; forecast errors, heating and seed have no
            meaning here.
        """
        exact = replace(options or RunOptions(), errors=ForecastErrors(), thermal="off")
        return cls(scenario, exact, make_controller(scenario, exact))

    @property
    def times(self) -> pd.DatetimeIndex:
        """Beginnings of the steps that can be decided on."""
        return self.scenario.grid.times

    def window(self, time: pd.Timestamp) -> pd.DatetimeIndex:
        """Times for which the decision at ``time`` uses forecasts, ``time`` itself included."""
        steps = self._decider.horizon_steps(step_at(self.scenario.grid, time))
        return self.times[steps.start:steps.stop]

    def step(self, observation: Measurement) -> SetPoints:
        """Decide on the step that begins now.

        Parameters
        ----------
        observation : Measurement
            What is measured and expected. A full-horizon controller plans at its first call, which
            has to be the first step.

        Returns
        -------
        SetPoints
            The decision, with the AC power flow that it should lead to.

        Raises
        ------
        InputError
            With every value of the measurement that does not fit the scenario.
        SolveError
            If the window has no answer and the options have no guard.
        VerificationError
            If the AC power flow of the set-points does not converge.
        """
        seen = see(self.scenario, observation, self.scenario.batteries.t_ref_c)
        day = Day(seen.scenario, self.options)
        day.state = seen.state
        day.operating_point = self._operating_point
        if self._kept is not None:  # who was served since when
            day.switching, day.plant.cold_load = self._kept
        record = day.play(self._decider, seen.t)
        self._operating_point = day.operating_point
        self._kept = day.switching, day.plant.cold_load
        return _set_points(seen.scenario, record)


def _set_points(scenario: Scenario, step: StepRecord) -> SetPoints:
    """The tables of a step."""
    c = scenario.customers
    pv = scenario.pv
    b = scenario.batteries
    solve = {name: getattr(step, name) for name in (
        "status", "gap", "objective", "bound", "solve_s", "corrected", "fallback",
        "fallback_reason", "estimated")}
    return SetPoints(
        time=scenario.grid.times[step.t],
        customers=_table(c.id, bus=c.bus, tier=c.tier, load_kw=step.load_kw,
                         load_kvar=step.load_kvar, served=step.served),
        batteries=_table(b.id, bus=b.bus, p_kw=step.charge_kw - step.discharge_kw,
                         q_kvar=step.batt_q_kvar, soc_end=step.soc_end),
        pv=_table(pv.id, bus=c.bus[pv.owner(c)], available_kw=step.pv_available_kw,
                  p_kw=step.pv_self_kw + step.pv_export_kw, curtailed_kw=step.pv_curtailed_kw,
                  q_kvar=step.pv_q_kvar),
        buses=_table(scenario.network.buses, index="bus", v_ac_pu=step.v_ac_pu),
        import_kw=float(step.p_grid_kw), solve={**solve, "reason": step.correction_reason})


def _table(names: Any, index: str = "id", **columns: Any) -> pd.DataFrame:
    """Columns by identifier."""
    return pd.DataFrame(columns, index=pd.Index(names, name=index))
