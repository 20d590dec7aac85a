"""Windows of a recorded run as its controller saw them, to be solved again for shadow prices."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from vppres.contract.decision import undimmed
from vppres.contract.forecast import Forecast, ForecastErrors
from vppres.contract.observation import Observation
from vppres.contract.operating_point import OperatingPoint
from vppres.core.arrays import Floats
from vppres.day.forecasting import PAPER, named_forecasts
from vppres.day.observer import Observer
from vppres.day.options import PERFECT
from vppres.day.outages import believed_outages
from vppres.day.trajectory import Trajectory
from vppres.explain.phased import PhasedStep
from vppres.explain.recorded import Recorded
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import Owed, SwitchingState
from vppres.kinds.kind import MOVE_KW
from vppres.kinds.table import KINDS, parts, units_of
from vppres.model.beyond_paper.former_phases import FormerPhases
from vppres.model.beyond_paper.lines_out import LinesOut
from vppres.model.beyond_paper.ratings import LineRatings, with_ratings
from vppres.model.beyond_paper.table import Beyond, beyond_paper
from vppres.model.data import WindowData
from vppres.model.formulas import bus_injections
from vppres.model.own_state import with_own_state
from vppres.solve.ladder import WindowSolver
from vppres.solve.shadow_prices import FixedDecisions, ShadowPriceModel

NEARLY_ALL = 1.0 - 1e-4
"""Largest share of a customer that was not served. In full, the limits of its PV system's export
and curtailment may bind together with that of its service, and share the price between them."""

FULL_HORIZON = "full-horizon"

BY_PARTS = (FormerPhases, LinesOut)
"""Additions that are compiled for the parts of a window."""


class Windows:
    """Windows of a finished run, planned with weights, (C,), or those of the scenario."""

    def __init__(self, run: Trajectory, weight: Floats | None = None) -> None:
        self.recorded = Recorded(run, weight)
        self.site = self.recorded.site
        self._models: dict[tuple[Beyond, int], ShadowPriceModel] = {}

    def model(self, t: int, n_steps: int) -> ShadowPriceModel:
        """Pricing problem of a step, compiled once for equal lines that are out."""
        key = self.beyond_at(t), n_steps
        if key not in self._models:
            self._models[key] = ShadowPriceModel(self.site, n_steps, key[0])
        return self._models[key]

    @cached_property
    def _owed(self) -> list[Owed]:
        """Demand that could still be caught up at the beginning of each step."""
        owed = [Owed.of(self.site.customers, self.site.dt_h)]
        for load_kw, share in zip(self.recorded.load_kw, self.recorded.done.supplied, strict=True):
            owed.append(owed[-1].after(load_kw, share))
        return owed

    @property
    def n_seen(self) -> int:
        """Steps of the longest window."""
        horizon = float(self.recorded.options.get("horizon_h") or 0.0)
        return min(self.recorded.scenario.grid.steps_in_horizon(horizon), self.recorded.n_steps)

    @cached_property
    def beyond(self) -> Beyond:
        """Additions of the windows to the paper's problem; the first and last have all of them."""
        last = max(self.recorded.n_steps - self.n_seen, 0)
        there = {name: shape for t in (0, last) for name, shape in self._beyond_of(t)}
        return tuple(there.items())

    def beyond_at(self, t: int) -> Beyond:
        """Additions of the window at step ``t``: those of all, and those by its parts."""
        if not self.recorded.scenario.faults:
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

    def seen(self, t: int) -> WindowData:
        """The window that the controller saw at step ``t``, from the recorded state.

        A battery that was left out counts as empty.

        A correction saw its own step alone. The full horizon planned with the forecast of the first
        step; of that, the window has as many steps as ``horizon_h`` asks for.
        """
        told = self.observation(t)
        data = WindowData.of(told, self.site, self.recorded.options.get("centre", "lossless"))
        empty = self.site.batteries.soc_min
        seen = replace(
            data,
            load_kw=np.vstack([self.recorded.load_kw[t], data.load_kw[1:]]),
            soc=np.where(self.recorded.left_out(t), empty, data.soc),
        )
        if self.site.phases:
            return PhasedStep(self.recorded, t).linearised(seen)
        seen = with_own_state(self.site, seen)
        return with_ratings(self.site, seen) if self.site.rated else seen

    def observation(self, t: int) -> Observation:
        """Observation of the controller in that window: of outages no more than could be known."""
        length = 1 if self.recorded.flag(t, "corrected") else self.n_seen
        steps = range(t, min(t + length, self.recorded.n_steps))
        records = parts("words")
        states = {
            kind: records[kind].state_of(self.recorded.trajectory.rows(KINDS[kind].table, t))
            for kind in units_of(self.recorded.scenario)
        }
        told = self.observer.at(
            steps,
            states,
            self._forecast(t, steps),
            soc=self.recorded.soc_start(t),
            eta_charge=self.recorded.of_items(t, "batteries", "eta_charge"),
            eta_discharge=self.recorded.of_items(t, "batteries", "eta_discharge"),
            switching=SwitchingState.start(
                SwitchingRules(), self.site.dt_h, len(self.site.customers)
            ),
            owed=self._owed[t],
            online=~self.recorded.left_out(t),
            operating_point=self._operating_point(t - 1),
            whole=undimmed(self.recorded.note(t, "estimated"), self.site.customers.id),
        )
        return told.counted(self.recorded.counted)

    def held(self, t: int, n_steps: int) -> FixedDecisions:
        """Fixed decisions: customers served in the step stay so, batteries that moved keep mode.

        Those that were left out do not charge, and as they count as empty do not discharge. Who was
        not served may be served by nearly all of its demand.
        """
        lowest = np.zeros((n_steps, len(self.site.customers)))
        lowest[0] = self.recorded.done.served[t]
        highest = np.ones(lowest.shape)
        highest[0] = np.where(self.recorded.done.served[t], 1.0, NEARLY_ALL)
        power = self.recorded.battery_kw[t]
        return FixedDecisions(
            lowest,
            highest,
            (power > MOVE_KW).astype(float),
            ((power >= -MOVE_KW) & ~self.recorded.left_out(t)).astype(float),
        )

    @cached_property
    def observer(self) -> Observer:
        """Observer of the run."""
        known = self.recorded.options["controller"] == PERFECT
        errors = ForecastErrors(**({} if known else self.recorded.options.get("errors", {})))
        name = PAPER if known else self.recorded.options.get("forecaster", PAPER)
        file = self.recorded.options.get("forecast_file")
        seed = int(self.recorded.options["seed"])
        forecaster = named_forecasts(self.recorded.scenario, name, errors, seed, file)
        return Observer.of(self.recorded.scenario, self.recorded.options, forecaster)

    def _forecast(self, t: int, steps: range) -> Forecast:
        """Forecast of a window; its first step is the actual one."""
        now = self.observer.forecaster.at(t, steps)
        if self.recorded.options["controller"] not in (FULL_HORIZON, PERFECT):
            return now
        planned = self.observer.forecaster.at(0, steps)
        return replace(
            now,
            load_kw=np.vstack([now.load_kw[:1], planned.load_kw[1:]]),
            pv_kw=np.vstack([now.pv_kw[:1], planned.pv_kw[1:]]),
        )

    @cached_property
    def believed(self) -> Floats:
        """Probability of an outage in each step as it was known at each, (T, T)."""
        return believed_outages(self.recorded.scenario, self.recorded.options)

    @cached_property
    def solver(self) -> WindowSolver:
        """Solves windows of the run again, for what-ifs."""
        return WindowSolver(self.site)

    def _operating_point(self, t: int) -> OperatingPoint | None:
        """The AC solution of a step, None before the first and after a blackout."""
        if t < 0 or not np.isfinite(self.recorded.done.v_pu[t]).any():
            return None
        now = self.recorded.done
        load_kw = self.recorded.load_kw[t] * now.supplied[t]
        load_kvar = (
            self.recorded.trajectory.by_step("customers", "q_load_kvar")[t] * now.supplied[t]
        )
        given_kw = {
            "pv": now.pv_self_kw[t] + now.pv_export_kw[t],
            "customers": -load_kw,
            "batteries": -self.recorded.battery_kw[t],
            **{kind: -taken_kw[t] for kind, taken_kw in now.taken_kw.items()},
        }
        given_kvar = {
            "pv": now.pv_q_kvar[t],
            "customers": -load_kvar,
            "batteries": now.batt_q_kvar[t],
            **{kind: kvar[t] for kind, kvar in now.given_kvar.items()},
        }
        return OperatingPoint(
            now.v_pu[t],
            now.p_flow_kw[t],
            now.q_flow_kvar[t],
            bus_injections(self.site, given_kw),
            bus_injections(self.site, given_kvar),
            bool(self.recorded.scenario.outage[t]),
            lines_out=self.recorded.scenario.out_of_service(range(t, t + 1)).lines[0],
        )
