"""The record of a run as arrays, and each step's window as the controller saw it."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.ahead import KindsAhead, past_days_of
from vppres.contract.decision import batteries_out, undimmed
from vppres.contract.forecast import Forecast, ForecastErrors
from vppres.contract.observation import Observation
from vppres.contract.operating_point import OperatingPoint
from vppres.contract.terminal import Terminal
from vppres.control.converged import dark_steps, physics_of
from vppres.control.phased_window import PhasedLinearisation
from vppres.core.arrays import Complexes, Flags, Floats, Wholes
from vppres.day.forecasting import PAPER, DayForecasts, named_forecasts
from vppres.day.metrics import line_loading
from vppres.day.outages import GridSeen, OutageView, believed_outages
from vppres.day.priority import site_of, weighed
from vppres.day.recorder import OFF_BY_FAULT
from vppres.day.trajectory import Trajectory
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import Owed, SwitchingState
from vppres.kinds.customer.record import off_before_h
from vppres.kinds.kind import MOVE_KW as MOVE_KW
from vppres.kinds.table import KINDS, parts, units_of
from vppres.model.beyond_paper.former_phases import FormerPhases
from vppres.model.beyond_paper.lines_out import LinesOut
from vppres.model.beyond_paper.ratings import LineRatings
from vppres.model.beyond_paper.table import Beyond, beyond_paper
from vppres.model.data import WindowData
from vppres.model.formulas import bus_injections
from vppres.model.own_state import with_own_state
from vppres.model.parts import parts_of
from vppres.model.phases import NOTHING_FORMS, Supply, phased_model
from vppres.model.ratings import with_ratings
from vppres.scenario.faults import parts_by_bus
from vppres.scenario.network import BusId
from vppres.solve.ladder import WindowSolver
from vppres.solve.shadow_price_model import FixedDecisions

NEARLY_ALL = 1.0 - 1e-4
"""Largest share of a customer that was not served. In full, the limits of its PV system's export
and curtailment may bind together with that of its service, and share the price between them."""

FULL_HORIZON = "full-horizon"
PERFECT = "perfect"


BY_PARTS = (FormerPhases, LinesOut)
"""Additions that are compiled for the parts of a window."""


class Recorded:
    """A finished run, step by step.

    Columns that only some modes write are used where they are there. Without a ``weight``, (C,),
    plans have that of the scenario.
    """

    def __init__(self, trajectory: Trajectory, weight: Floats | None = None) -> None:
        self.trajectory = trajectory
        self.scenario = trajectory.scenario
        self.options = trajectory.options
        self.site = site_of(trajectory.scenario, trajectory.options)
        self.counted = 1.0
        if weight is not None:
            total = self.site.customers.weight.sum()
            self.site = weighed(self.site, trajectory.scenario, trajectory.options, weight)
            self.counted = float(self.site.customers.weight.sum() / total)
        self.n_steps = len(trajectory.steps)
        self.served = trajectory.by_step("customers", "served")
        self.share = trajectory.supplied
        self.shed = trajectory.by_step("customers", "shed")
        self.load_kw = trajectory.by_step("customers", "p_load_kw")
        self.off_by_fault = np.full(self.served.shape, "", dtype=object)
        if OFF_BY_FAULT in trajectory.customers:
            self.off_by_fault = trajectory.by_step("customers", OFF_BY_FAULT)
        self.charge_kw = trajectory.by_step("batteries", "charge_kw")
        self.discharge_kw = trajectory.by_step("batteries", "discharge_kw")
        self.batt_q_kvar = trajectory.by_step("batteries", "q_kvar")
        self.soc_start = trajectory.by_step("batteries", "soc_start")
        self.soc_end = trajectory.by_step("batteries", "soc_end")
        self.curtailed_kw = trajectory.by_step("pv", "curtailed_kw")
        self.v_ac_pu = trajectory.by_step("buses", "v_ac_pu")
        self.flow_kw = trajectory.by_step("lines", "p_ac_kw")
        self.flow_kvar = trajectory.by_step("lines", "q_ac_kvar")

    @cached_property
    def battery_kw(self) -> Floats:
        """Power of each battery, charging positive, shape (T, B).

        Made once: every step keeps its row, and with it the whole array.
        """
        return np.asarray(self.charge_kw - self.discharge_kw)

    @cached_property
    def off_before_h(self) -> Floats:
        """How long each customer had been off at the beginning of each step in h, (T, C)."""
        return off_before_h(self.served, self.scenario.grid.dt_h)

    def of_kind(self, kind: str, column: str) -> Floats:
        """A column of a kind of flexible power by step and unit, (T, n)."""
        table = KINDS[kind].table
        there = table in self.trajectory.tables
        return self.trajectory.by_step(table, column) if there else np.zeros((self.n_steps, 0))

    def _ahead(self, steps: range) -> KindsAhead:
        """Flexible power as it was known at the beginning of a window."""
        records = parts("words")
        states = {
            kind: records[kind].state_of(self.trajectory.rows(KINDS[kind].table, steps.start))
            for kind in units_of(self.scenario)
        }
        return KindsAhead.of(self.scenario, steps, states, self.past_days)

    @cached_property
    def past_days(self) -> dict[str, Any]:
        """Past days that plans expected vehicles by; None without any."""
        return past_days_of(self.scenario, int(self.options["seed"]))

    @cached_property
    def _owed(self) -> list[Owed]:
        """Demand that could still be caught up at the beginning of each step."""
        owed = [Owed.of(self.site.customers, self.site.dt_h)]
        for load_kw, share in zip(self.load_kw, self.share, strict=True):
            owed.append(owed[-1].after(load_kw, share))
        return owed

    @cached_property
    def _steps(self) -> list[dict[Hashable, Any]]:
        """Rows of the steps table."""
        return self.trajectory.steps.to_dict("records")

    @property
    def n_seen(self) -> int:
        """Steps of the longest window."""
        horizon = float(self.options.get("horizon_h") or 0.0)
        return min(self.scenario.grid.steps_in_horizon(horizon), self.n_steps)

    @property
    def rules(self) -> bool:
        """Whether switching rules restrained who is served."""
        return SwitchingRules(**self.options.get("switching", {})).active

    def imported_kw(self, t: int) -> float:
        """Import at the slack bus in a step."""
        return float(self.trajectory.steps["p_grid_kw"].iloc[t])

    def note(self, t: int, column: str) -> str:
        """A column of text of the steps table, empty where there is none."""
        value = self._steps[t].get(column)
        return "" if value is None or pd.isna(value) else str(value)

    def flag(self, t: int, column: str) -> bool:
        """A column of yes and no of the steps table, no where there is none."""
        return self.note(t, column) in ("True", "1", "1.0")

    def battery_note(self, t: int, column: str) -> Floats:
        """A column of numbers of the batteries' table, shape (B,), zeros where there is none."""
        if column not in self.trajectory.batteries.columns:
            return np.zeros(len(self.site.batteries))
        return np.asarray(np.nan_to_num(self.trajectory.by_step("batteries", column)[t]))

    @property
    def soc_asked(self) -> float | None:
        """State of charge that batteries were to keep at the end; None for none."""
        asked: float | None = self.options.get("soc_end")
        return asked

    @cached_property
    def beyond(self) -> Beyond:
        """Additions of the windows to the paper's problem; the first and last have all of them."""
        last = max(self.n_steps - self.n_seen, 0)
        there = {name: shape for t in (0, last) for name, shape in self._beyond_of(t)}
        return tuple(there.items())

    def beyond_at(self, t: int) -> Beyond:
        """Additions of the window at step ``t``: those of all, and those by its parts."""
        if not self.scenario.faults:
            return self.beyond
        of_all = [each for each in self.beyond if each[0] not in BY_PARTS]
        seen = self.seen(t)
        own = ((each, each.shape(self.site, seen)) for each in BY_PARTS)
        return (*of_all, *((each, shape) for each, shape in own if shape is not None))

    def _beyond_of(self, t: int) -> Beyond:
        seen = self.seen(t)
        ratings = LineRatings.shape(self.site, seen)
        rated = () if ratings is None else ((LineRatings, ratings),)
        return (*beyond_paper(self.site, seen), *rated)

    @cached_property
    def _parts(self) -> Wholes:
        """Number of the part of each bus in each step, (T, N)."""
        out = self.scenario.out_of_service(range(self.n_steps))
        return parts_by_bus(self.scenario.network, out.lines)

    def behind(self, t: int, bus: BusId) -> str:
        """The line between a bus and the part with the grid in a step; empty for none."""
        number = int(self._parts[t, self.scenario.network.bus_index[bus]])
        return self.scenario.behind(number, t) if number else ""

    def cut_off(self, t: int) -> Flags:
        """Customers that lines which are out or open cut off the grid's bus in a step, (C,)."""
        index = self.scenario.network.bus_index
        at = [index[each] for each in self.scenario.customers.bus]
        return np.asarray(self._parts[t, at] != 0, dtype=bool)

    def beside(self, t: int, bus: BusId) -> Flags:
        """Batteries in the same part of the feeder as a bus in a step, (B,)."""
        index = self.scenario.network.bus_index
        at = [index[each] for each in self.scenario.batteries.bus]
        return np.asarray(self._parts[t, at] == self._parts[t, index[bus]], dtype=bool)

    def left_out(self, t: int) -> Flags:
        """Batteries that could not be used in a step, shape (B,)."""
        return batteries_out(self.note(t, "estimated"), self.site.batteries.id)

    def seen(self, t: int) -> WindowData:
        """The window that the controller saw at step ``t``, from the recorded state.

        A battery that was left out counts as empty.

        A correction saw its own step alone. The full horizon planned with the forecast of the first
        step; of that, the window has as many steps as ``horizon_h`` asks for.
        """
        told = self.observation(t)
        data = WindowData.of(told, self.site, self.options.get("centre", "lossless"))
        empty = self.site.batteries.soc_min
        seen = replace(
            data,
            load_kw=np.vstack([self.load_kw[t], data.load_kw[1:]]),
            soc=np.where(self.left_out(t), empty, self.soc_start[t]),
        )
        if self.site.phases:
            return self._by_phase(t, seen)
        seen = with_own_state(self.site, seen)
        return with_ratings(self.site, seen) if self.site.rated else seen

    @cached_property
    def v_node_pu(self) -> Floats:
        """AC voltages by phase, (T, m)."""
        assert self.trajectory.nodes is not None
        return self.trajectory.by_step("nodes", "v_ac_pu")

    def source(self, t: int) -> int:
        """Supply of a step of a phased feeder: the grid, or what formed islands."""
        model, island = phased_model(self.site), self.scenario.outage[t : t + 1]
        out = self.scenario.out_of_service(range(t, t + 1))
        parts = parts_of(self.site, out, self.soc_start[t], island, needs_former=True)
        if not parts.whole:
            return model.source_in(parts, bool(island[0]))
        return int(model.sources_of(island[0], self.trajectory.forms(t)))

    def supply(self, t: int) -> Supply | None:
        """The supply itself; None where nothing held a voltage."""
        source = self.source(t)
        return None if source == NOTHING_FORMS else phased_model(self.site).supplies[source]

    def former_kva(self, t: int) -> Complexes:
        """Complex power of its sources on each phase in a step with power, (K,)."""
        (p,), (q,) = self.drawn(t)
        found = phased_model(self.site).solved(self.source(t), p, q)
        assert found is not None
        return found.source_kva

    def currents(self, t: int) -> Complexes:
        """Currents of a phased feeder in a step as shares of their ratings, (k,)."""
        model = phased_model(self.site)
        nothing = np.zeros(len(model.rated), dtype=complex)
        if not np.isfinite(self.v_ac_pu[t]).any():
            return nothing
        (p,), (q,) = self.drawn(t)
        source = self.source(t)
        found = model.solved(source, p, q)
        return nothing if found is None else model.supplies[source].loadings.currents(found.v)

    def drawn(self, t: int) -> tuple[Floats, Floats]:
        """Power of a phased feeder's assets in a step, (1, D) each, the formers' own left out."""
        order = ("customers", "pv", "batteries", *self.site.kinds)
        p, q = (-np.concatenate([each[name] for name in order])[None, :] for each in self._given(t))
        formers = phased_model(self.site).devices(self.source(t))
        p[0, formers] = q[0, formers] = 0.0
        return p, q

    def _by_phase(self, t: int, seen: WindowData) -> WindowData:
        """A window of a phased feeder, its first step linearised at what was recorded."""
        headroom = float(self.options["headroom"])
        seen, _ = seen.formed(self.site, dark_steps(self.site, seen), headroom)
        physics = physics_of(self.site, seen, headroom)
        at = PhasedLinearisation(phased_model(self.site))
        data = at.at_rest(replace(seen, physics=physics))
        p, q = (np.pad(one, [(0, data.n_steps - 1), (0, 0)]) for one in self.drawn(t))
        first = (np.arange(data.n_steps) == 0) & (at.model.sources(data) == self.source(t))
        first &= np.isfinite(self.v_ac_pu[t]).any()
        points = at.model.points(data, p, q, first)
        found = at.at(data, p, q, points, first & points.converged)
        return with_ratings(self.site, found) if self.site.rated else found

    def observation(self, t: int) -> Observation:
        """Observation of the controller in that window."""
        length = 1 if self.flag(t, "corrected") else self.n_seen
        steps = range(t, min(t + length, self.n_steps))
        return replace(self._observation_at(t, steps), operating_point=self._operating_point(t - 1))

    def held(self, t: int, n_steps: int) -> FixedDecisions:
        """Fixed decisions: customers served in the step stay so, batteries that moved keep mode.

        Those that were left out do not charge, and as they count as empty do not discharge. Who was
        not served may be served by nearly all of its demand.
        """
        lowest = np.zeros((n_steps, len(self.site.customers)))
        lowest[0] = self.served[t]
        highest = np.ones(lowest.shape)
        highest[0] = np.where(self.served[t], 1.0, NEARLY_ALL)
        power = self.battery_kw[t]
        return FixedDecisions(
            lowest,
            highest,
            (power > MOVE_KW).astype(float),
            ((power >= -MOVE_KW) & ~self.left_out(t)).astype(float),
        )

    @cached_property
    def loading(self) -> Floats:
        """AC current of each line as a share of its rating, (T, L); NaN for a line without one."""
        return line_loading(self.trajectory)

    @cached_property
    def _eta_charge(self) -> Floats:
        return self.trajectory.by_step("batteries", "eta_charge")

    @cached_property
    def _eta_discharge(self) -> Floats:
        return self.trajectory.by_step("batteries", "eta_discharge")

    @cached_property
    def _forecaster(self) -> DayForecasts:
        known = self.options["controller"] == PERFECT
        errors = ForecastErrors(**({} if known else self.options.get("errors", {})))
        name = PAPER if known else self.options.get("forecaster", PAPER)
        file = self.options.get("forecast_file")
        return named_forecasts(self.scenario, name, errors, int(self.options["seed"]), file)

    def _forecast(self, t: int, steps: range) -> Forecast:
        """Forecast of a window; its first step is the actual one."""
        now = self._forecaster.at(t, steps)
        if self.options["controller"] not in (FULL_HORIZON, PERFECT):
            return now
        planned = self._forecaster.at(0, steps)
        return Forecast(
            np.vstack([now.load_kw[:1], planned.load_kw[1:]]),
            np.vstack([now.pv_kw[:1], planned.pv_kw[1:]]),
            now.price_gbp_per_kwh,
            now.grid_limit_kw,
            now.temperature_c,
            now.export,
            out=now.out,
        )

    def _observation_at(self, t: int, steps: range) -> Observation:
        """Observation of the controller: of outages no more than could be known."""
        forecast = self._forecast(t, steps)
        ends = steps.stop == self.n_steps
        seen = Observation(
            t,
            forecast,
            self.soc_start[t],
            self._eta_charge[t],
            self._eta_discharge[t],
            SwitchingState.start(SwitchingRules(), self.site.dt_h, len(self.site.customers)),
            self._owed[t],
            ~self.left_out(t),
            ahead=self._ahead(steps),
            terminal=Terminal.of(self.soc_asked, forecast, ends),
            ends=ends,
            whole=undimmed(self.note(t, "estimated"), self.site.customers.id),
        )
        told = self._view.told(seen, self._grid_seen[t], self.scenario, t, self._forecaster)
        return told.counted(self.counted)

    @cached_property
    def believed(self) -> Floats:
        """Probability of an outage in each step as it was known at each, (T, T)."""
        return believed_outages(self.scenario, self.options)

    @cached_property
    def solver(self) -> WindowSolver:
        """Solves windows of the run again, for what-ifs."""
        return WindowSolver(self.site)

    @cached_property
    def _view(self) -> OutageView:
        return OutageView.create(self.scenario, self.options)

    @cached_property
    def _grid_seen(self) -> list[GridSeen]:
        """History of the grid at each step."""
        steps = zip(self.scenario.grid.times, self.scenario.grid_limit_kw, strict=True)
        found = accumulate(steps, lambda seen, now: seen.after(*now), initial=GridSeen())
        return list(found)[1:]

    def _operating_point(self, t: int) -> OperatingPoint | None:
        """The AC solution of a step, None before the first and after a blackout."""
        if t < 0 or not np.isfinite(self.v_ac_pu[t]).any():
            return None
        out = self.scenario.out_of_service(range(t, t + 1))
        p_kw, q_kvar = (bus_injections(self.site, each) for each in self._given(t))
        return OperatingPoint(
            self.v_ac_pu[t],
            self.flow_kw[t],
            self.flow_kvar[t],
            p_kw,
            q_kvar,
            bool(self.scenario.outage[t]),
            lines_out=out.lines[0],
        )

    def _given(self, t: int) -> tuple[dict[str, Floats], dict[str, Floats]]:
        """Power that devices gave in a step by table, in kW and kvar."""
        run = self.trajectory
        q_load_kvar = run.by_step("customers", "q_load_kvar")[t]
        active = {
            "pv": run.by_step("pv", "self_kw")[t] + run.by_step("pv", "export_kw")[t],
            "customers": -self.load_kw[t] * self.share[t],
            "batteries": -self.battery_kw[t],
            **{kind: self._given_kw(kind)[t] for kind in self.site.kinds},
        }
        reactive = {
            "pv": run.by_step("pv", "q_kvar")[t],
            "customers": -q_load_kvar * self.share[t],
            "batteries": self.batt_q_kvar[t],
            **{kind: self._given_kvar(kind)[t] for kind in self.site.kinds},
        }
        return active, reactive

    def _given_kw(self, kind: str) -> Floats:
        """Power of each unit of a kind, negative where it took, (T, n)."""
        power_kw = self.of_kind(kind, "p_kw")
        return power_kw if KINDS[kind].gives else -power_kw

    def _given_kvar(self, kind: str) -> Floats:
        """Reactive power of each unit of a kind, (T, n): none where no unit forms islands."""
        return (
            self.of_kind(kind, "q_kvar")
            if "q_kvar" in self.trajectory.tables[KINDS[kind].table]
            else 0.0 * self._given_kw(kind)
        )
