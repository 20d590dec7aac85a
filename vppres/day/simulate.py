"""The closed loop: observe, decide, actuate, verify, record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vppres.contract.decision import Decider, Decision, SolveInfo, Switched
from vppres.contract.dispatch import Dispatch
from vppres.contract.forecast import ForecastErrors
from vppres.contract.observation import Observation
from vppres.contract.operating_point import OperatingPoint
from vppres.core.arrays import Flags, Floats
from vppres.core.errors import ModelError, VppresError, function_of
from vppres.day.assembly import make_controller
from vppres.day.checks import check_parts
from vppres.day.faults import FaultInjector, FaultPlan
from vppres.day.forecasting import DayForecasts, MeasuredForecasts, basis_of, forecasts_of
from vppres.day.kind_tables import records_of
from vppres.day.observer import Observer
from vppres.day.options import PERFECT, RunOptions
from vppres.day.outages import BELIEF, LIKELY
from vppres.day.own import Own
from vppres.day.recorder import OFF_BY_FAULT, ROTATED, Recorder, StepRecord, voltage_figures
from vppres.day.trajectory import (
    LINES_OUT,
    SHARE,
    SWITCHED,
    SWITCHES_OPEN,
    SWITCHING_AHEAD,
    SWITCHING_GAIN,
    SWITCHING_ORDER,
    SWITCHING_WHY,
    Trajectory,
    in_a_row,
)
from vppres.forecasts.interface import ForecastMethod
from vppres.io.python_door import check_scenario
from vppres.model.site import Site
from vppres.physics.feeder import PowerFlow, power_flows
from vppres.physics.powerflow import ACResult
from vppres.plant.collapse import realise
from vppres.plant.island import IslandPlant, Settled
from vppres.plant.parts import PlantInParts
from vppres.plant.plant import CLIP_TOLERANCE_KW, BatteryState, Plant, Realised
from vppres.scenario.configuration import Branches, Configured, in_configuration
from vppres.scenario.formers import forming_batteries
from vppres.scenario.parts import parts_record, split_sheddable
from vppres.scenario.priority import STRICT
from vppres.scenario.scenario import Scenario
from vppres.solve.result import Status

Progress = Callable[[int, int], None]


def run_day(
    scenario: Scenario,
    options: RunOptions | None = None,
    progress: Progress | None = None,
    faults: FaultPlan | None = None,
    *,
    controller: Callable[[Site], Decider] | None = None,
    forecaster: ForecastMethod | None = None,
    weights: Callable[[Observation], ArrayLike] | ArrayLike | None = None,
    steps: int | None = None,
) -> Trajectory:
    """Run a scenario from its first step to its last.

    Parameters
    ----------
    scenario : Scenario
        The actual day.
    options : RunOptions, optional
        Controller, solver, forecast errors; by default the paper's ideal case at H = 5.
    progress : callable, optional
        Called as ``progress(steps done, steps in all)`` after every step.
    faults : FaultPlan, optional
        Faults of the day; none if not given.
    controller : callable, optional
        Makes a controller of your own of a site, ``controller(site)``; a class with
        ``horizon_steps(t0)`` and ``decide(observation)``, for example. The guard checks it too.
    forecaster : ForecastMethod, optional
        Your own, with ``forecast(history, issued_at, steps)``.
    weights : callable or array, optional
        The customers' weights of each step: an array of shape (T, C), or a function of the
        observation, shape (C,).
    steps : int, optional
        How many steps are run; all if not given. The controller sees the others ahead.

    Returns
    -------
    Trajectory

    Raises
    ------
    InputError
        If an option is unknown, or the scenario holds a number that no equipment has.
    SolveError
        If a window has no solution and the guard is off.
    Exception
        Whatever your own parts raise, with the step and the function in a note.
    """
    options = (options or RunOptions()).on(scenario)
    own = Own(controller, forecaster, weights)
    own.check(options)
    check_scenario(scenario)
    check_parts(scenario)
    divided = split_sheddable(scenario)
    injector = FaultInjector(faults, divided) if faults else None
    decider = make_controller(divided, options, injector, own=own)
    run = Day(divided, options, injector, forecaster).run(decider, progress, steps)
    return replace(run, options={**run.options, **parts_record(scenario), **own.record()})


@dataclass(frozen=True, eq=False)
class PlantIn:
    """The plant of a day in a configuration, and its power flows."""

    day: Configured
    plant: Plant
    ac: PowerFlow
    island_ac: PowerFlow
    island: IslandPlant
    in_parts: PlantInParts

    @classmethod
    def of(cls, day: Configured, options: RunOptions) -> PlantIn:
        """The plant of a configuration, in its first state."""
        plant = Plant(day.scenario, options.thermal, options.rules)
        ac, island_ac = power_flows(day.scenario)
        island = IslandPlant(plant, island_ac)
        return cls(day, plant, ac, island_ac, island, PlantInParts(plant))


class Day:
    """State of a run between two steps."""

    def __init__(
        self,
        scenario: Scenario,
        options: RunOptions,
        faults: FaultInjector | None = None,
        forecaster: ForecastMethod | None = None,
    ) -> None:
        self.scenario = scenario
        self.options = options.on(scenario)
        self.faults = faults
        self.branches = Branches.of(scenario)
        self._plants: dict[bytes, PlantIn] = {}
        self._work_in(self._plant_in(self.branches.closed))
        self.state = self.plant.initial_state()
        errors = ForecastErrors() if options.controller == PERFECT else options.errors
        if faults:
            errors = faults.plan.forecast_errors(errors)
        self.forecaster: DayForecasts = (
            forecasts_of(scenario, self.options, errors)
            if forecaster is None
            else MeasuredForecasts(scenario, forecaster)
        )
        self.observer = Observer.of(scenario, self.options.as_record(), self.forecaster)
        moves = self.options.move_switches and scenario.switches.movable.any()
        self.recorder = Recorder(scenario, self.branches if moves else None)
        self.operating_point: OperatingPoint | None = None
        self.battery_kw: Floats | None = None
        self.import_kw: float | None = None
        self.served: Flags | None = None
        self.flexible_kw: float | None = None
        self.outage_messages = ""

    def observe(self, controller: Decider, t: int) -> Observation:
        """Observation of the controller at step ``t``."""
        s = self.state
        seen = self.observer.at(
            controller.horizon_steps(t),
            self.plant.states_at(t),
            soc=s.soc,
            eta_charge=s.eta_charge,
            eta_discharge=s.eta_discharge,
            switching=self.plant.switching,
            owed=self.plant.owed,
            online=np.ones(len(s.soc), dtype=bool),
            operating_point=self.operating_point,
            battery_kw=self.battery_kw,
            import_kw=self.import_kw,
            served=self.served,
            flexible_kw=self.flexible_kw,
        )
        self.outage_messages = seen.outage_messages
        return self.faults.observe(seen) if self.faults else seen

    def run(
        self, controller: Decider, progress: Progress | None = None, steps: int | None = None
    ) -> Trajectory:
        """All steps of the day, or the first ones, and their record."""
        n_steps = self.scenario.grid.n_steps if steps is None else steps
        for t in range(n_steps):
            self.step(controller, t)
            if progress:
                progress(t + 1, n_steps)
        plan: Dispatch | None = getattr(controller, "plan", None)
        return self.recorder.finish(self.options.as_record(), _promised(plan, self.scenario))

    def step(self, controller: Decider, t: int) -> None:
        """Observe, decide, actuate, verify, record."""
        try:
            self.recorder.add(self.play(controller, t))
        except Exception as error:
            if isinstance(error, ModelError) or not isinstance(error, VppresError):
                error.add_note(f"In step {t} of the day, in {function_of(error)}.")
            raise

    def play(self, controller: Decider, t: int) -> StepRecord:
        """One step without its record's place in the run: what was decided and what came of it."""
        decision = controller.decide(self.observe(controller, t))
        if self.faults:
            decision = self.faults.actuate(t, decision)
        return self.settle(t, decision)

    def settle(self, t: int, decision: Decision) -> StepRecord:
        """Record of a decision's step; the day is at the step after it."""
        if decision.switched is not None:
            self.go_on_in(decision.switched.closed)
        done = self.carry_out(t, decision)
        kinds = records_of(self.plant, t, done)
        result = done.ac
        record = _record(self.scenario, t, decision, self.state, done, self.options)
        steps = {**record.steps, **basis_of(self.forecaster, t)}
        if self.scenario.faults:
            out = self.scenario.out_of_service(range(t, t + 1))
            steps[LINES_OUT] = " and ".join(out.names(self.scenario.network, 0))
        if self.options.outages in (BELIEF, LIKELY):
            steps["outage_messages"] = self.outage_messages
        record = replace(record, steps=steps, kinds=kinds)
        if decision.switched is not None:
            record = self._in_order(record, decision.switched, result)
        out = self.configured.scenario.out_of_service(range(t, t + 1))
        self.operating_point = (
            None
            if done.dark
            else OperatingPoint(
                result.v_pu,
                result.p_from_kw,
                result.q_from_kvar,
                self.plant.places.at_buses(done.p_injection_kw),
                self.plant.places.at_buses(done.q_injection_kvar),
                bool(self.scenario.outage[t]),
                lines_out=out.lines[0],
            )
        )
        self.battery_kw = done.battery_kw
        # An island that batteries hold has no meter of import; what was not found is no reading.
        metered = not (self._held_by_batteries(t) or done.ac_failed)
        self.import_kw = result.p_slack_kw if metered else None
        self.served = done.served
        self.flexible_kw = done.flexible_kw
        self.state = self.plant.advance(t, self.state, done)
        return record

    def carry_out(self, t: int, decision: Decision) -> Settled:
        """Outcome of a decision; physical mode's islands hold themselves, and so do parts."""
        out = self.configured.scenario.out_of_service(range(t, t + 1))
        if out.lines.any():
            every = np.ones(len(self.scenario.batteries), dtype=bool)
            online = every if self.faults is None else self.faults.online(t)
            held = self._held_by_batteries(t)
            return self.in_parts.settle(t, decision, self.state, out, held, online)
        if not self._held_by_batteries(t):
            flow = self.island_ac if self.scenario.outage[t] else self.ac
            return realise(self.plant, flow, t, decision, self.state)
        if self.faults:
            self.island.formers = self.faults.online(t) & forming_batteries(self.scenario)
        return self.island.settle(t, self.plant.apply(t, decision, self.state), self.state)

    def _plant_in(self, closed: Flags) -> PlantIn:
        """The plant of a configuration, made once."""
        key = closed.tobytes()
        if key not in self._plants:
            day = in_configuration(self.scenario, self.branches, closed)
            self._plants[key] = PlantIn.of(day, self.options)
        return self._plants[key]

    def _work_in(self, now: PlantIn) -> None:
        """Work with the plant of a configuration, and its power flows."""
        self.configured, self.plant, self.in_parts = now.day, now.plant, now.in_parts
        self.ac, self.island_ac, self.island = now.ac, now.island_ac, now.island

    def go_on_in(self, closed: Flags) -> None:
        """Go on with the plant of a configuration, in the state of the one before."""
        now = self._plant_in(closed)
        if now.plant is not self.plant:
            now.plant.go_on_from(self.plant)
        self._work_in(now)

    def _until(self, t: int, steps: int) -> str:
        """The end of some steps by the clocks at the site, in words; empty for none."""
        grid = self.scenario.grid
        return f" until {grid.local(grid.times[t] + steps * grid.step):%H:%M}" if steps else ""

    def _in_order(self, record: StepRecord, switched: Switched, ac: ACResult) -> StepRecord:
        """A record with buses and branches in the order of the day, and what was switched."""
        day, branches = self.configured, self.branches
        arriving = {"p_ac_kw": ac.p_to_kw, "q_ac_kvar": ac.q_to_kvar}
        of_switches = {
            SWITCHED: switched.moved,
            SWITCHING_ORDER: "\n".join(switched.order),
            SWITCHES_OPEN: in_a_row(branches.open_names(switched.closed)),
            SWITCHING_AHEAD: switched.ahead,
            SWITCHING_GAIN: switched.gain,
            SWITCHING_WHY: switched.why + self._until(record.t, switched.until),
            "configurations": switched.configurations,
            "partitions_bounded": switched.bounded,
            "configurations_planned": switched.planned,
        }
        return replace(
            record,
            steps={**record.steps, **of_switches},
            buses={name: day.at_buses(values) for name, values in record.buses.items()},
            lines={
                name: day.at_branches(values, arriving.get(name))
                for name, values in record.lines.items()
            },
        )

    def _held_by_batteries(self, t: int) -> bool:
        """Whether a step is an island of physical mode."""
        return self.options.mode == "physical" and bool(self.scenario.outage[t])


def _promised(plan: Dispatch | None, scenario: Scenario) -> dict[str, Any] | None:
    """Promise of a full horizon's plan; None where it was made later in the day."""
    if plan is None or plan.n_steps < scenario.grid.n_steps:
        return None
    return {
        "served": plan.supplied.tolist(),
        "energy_kwh": (plan.soc @ scenario.batteries.energy_kwh).tolist(),
        "p_grid_kw": plan.p_grid_kw.tolist(),
    }


def _record(
    scenario: Scenario,
    t: int,
    decision: Decision,
    state: BatteryState,
    done: Settled,
    options: RunOptions,
) -> StepRecord:
    plan, row = decision.dispatch, decision.row
    buses = {"v_model_pu": plan.v_pu[row], "v_ac_pu": done.ac.v_pu}
    lines = {
        "p_model_kw": plan.p_flow_kw[row],
        "q_model_kvar": plan.q_flow_kvar[row],
        "p_ac_kw": done.ac.p_from_kw,
        "q_ac_kvar": done.ac.q_from_kvar,
    }
    nodes = {"v_model_pu": _planned_v_pu(done.ac, decision), "v_ac_pu": done.ac.v_node_pu}
    labels = dict(zip(("bus", "phase"), np.array(done.ac.nodes, dtype=object).T, strict=False))
    held_by_batteries = str(options.mode) == "physical" and bool(scenario.outage[t])
    steps = {
        **_of_power_flow(done, held_by_batteries),
        **voltage_figures(**nodes),
        **_of_solution(decision, done),
        "ac_failed": done.ac_failed,
        **_effort(decision.info, done.clipped_kw),
        "mode": str(options.mode),
        "passes": float(decision.info.passes),
        **_island_notes(scenario, done),
        **_of_rules(decision.info, options),
        **_by_phase(done, held_by_batteries),
    }
    return StepRecord(
        t,
        steps,
        _of_customers(scenario, decision, done),
        _of_pv(scenario.pv_kw[t], done),
        _of_batteries(state, done),
        buses,
        lines,
        {**labels, **nodes},
    )


def _of_customers(scenario: Scenario, decision: Decision, done: Settled) -> dict[str, Any]:
    """Demand, and who was supplied; weights and shares where plans have them."""
    columns: dict[str, Any] = {
        "p_load_kw": done.load_kw,
        "q_load_kvar": done.load_kw * scenario.customers.q_per_p,
        "served": done.served,
        "shed": done.shed,
    }
    if decision.weight is not None:
        columns[ROTATED] = decision.weight
    if scenario.customers.dimmable.any():
        columns[SHARE] = done.served * done.share
    if scenario.faults or decision.switched is not None:
        nothing = np.full(len(done.served), "", dtype=object)
        columns[OFF_BY_FAULT] = nothing if done.off is None else done.off
    return columns


def _of_pv(available_kw: Floats, realised: Realised) -> dict[str, Floats]:
    """Available power of PV systems, and its use."""
    return {
        "available_kw": available_kw,
        "self_kw": realised.pv_self_kw,
        "export_kw": realised.pv_export_kw,
        "curtailed_kw": realised.pv_curtailed_kw,
        "q_kvar": realised.pv_q_kvar,
    }


def _of_batteries(state: BatteryState, done: Settled) -> dict[str, Floats]:
    """Powers of batteries, and their state before and after the step."""
    return {
        "charge_kw": done.charge_kw,
        "discharge_kw": done.discharge_kw,
        "q_kvar": done.batt_q_kvar,
        "soc_start": state.soc,
        "soc_end": done.soc_end,
        "eta_charge": state.eta_charge,
        "eta_discharge": state.eta_discharge,
        "temperature_c": state.t_cell_c,
        "mismatch_kw": done.mismatch_kw,
    }


def _of_rules(info: SolveInfo, options: RunOptions) -> dict[str, Any]:
    """Levels that a strict order proves of its tiers, and the value of stored energy by beliefs."""
    found: dict[str, Any] = {}
    if options.priority == STRICT:
        found["levels"] = info.levels
    if options.outages == BELIEF:
        found["stored_value_gbp_per_kwh"] = info.stored_value_gbp_per_kwh
    return found


def _planned_v_pu(ac: ACResult, decision: Decision) -> Floats:
    """Planned voltages of the nodes, NaN where nothing was planned of them."""
    plan = decision.dispatch
    planned = plan.v_node_pu if ac.phases else plan.v_pu
    return np.full_like(ac.v_node_pu, np.nan) if planned is None else planned[decision.row]


def _by_phase(done: Settled, held_by_batteries: bool) -> dict[str, Any]:
    """Power of grid and former by phase, unbalance, and the fullest phase; NaN in a blackout."""
    ac = done.ac
    if not ac.phases:
        return {}
    nothing = np.full(len(ac.phases), np.nan)
    of_former = done.former_kva
    if of_former is None:
        of_former = ac.source_kva if held_by_batteries else nothing
    sources = {"former": of_former, "import": nothing if held_by_batteries else ac.source_kva}
    found = {
        f"{source}_{phase}_kva": abs(kva)
        for source, of_phases in sources.items()
        for phase, kva in zip(ac.phases, of_phases, strict=True)
    }
    loading = {"loading_max": ac.loading, "loading_at": ac.loading_at}
    return {"former": done.former, **found, "unbalance_max": ac.unbalance, **loading}


def _of_power_flow(done: Settled, held_by_batteries: bool) -> dict[str, float]:
    """Figures of the AC power flow for the step as a whole."""
    return {
        # Where batteries hold the island the reference bus is one of theirs: nothing is imported.
        "p_grid_kw": 0.0 if held_by_batteries else done.ac.p_slack_kw,
        "q_grid_kvar": 0.0 if held_by_batteries else done.ac.q_slack_kvar,
        "losses_kw": done.ac.losses_kw,
    }


def _of_solution(decision: Decision, done: Settled) -> dict[str, Any]:
    """Solution of the step, and what overruled or replaced it.

    A blacked-out island is one in its status too, whatever an optimal plan had promised; what is
    wrong with an answer stays said.
    """
    info = decision.info
    refuted = done.dark and info.status == Status.OPTIMAL
    return {
        "objective": info.objective,
        "bound": info.bound,
        "gap": info.gap,
        "status": str(Status.BLACKED_OUT if refuted else info.status),
        "solve_s": info.solve_s,
        "corrected": decision.corrected,
        "correction_reason": decision.reason,
        "fallback": decision.fallback,
        "fallback_reason": decision.fallback_reason,
        "estimated": decision.estimated,
    }


def _effort(info: SolveInfo, clipped_kw: float) -> dict[str, Any]:
    """Gaps level by level, how the answer was found, and what the plant could not follow."""
    return {
        "gap_abs": info.gap_abs,
        "gap_service": info.service_gap,
        "gap_cost_gbp": info.cost_gap_gbp,
        "solver_s": info.solver_s,
        "stages": " ".join(info.stages),
        "compilations": float(info.compilations),
        "clipped_kw": clipped_kw if clipped_kw > CLIP_TOLERANCE_KW else 0.0,
        "switching_relaxed": info.switching_relaxed,
        "moved_kw": info.moved_kw,
    }


def _island_notes(scenario: Scenario, done: Settled) -> dict[str, float | str]:
    """Record of an island's step; the figures are 0 where nothing was cut."""
    net = scenario.network
    v = done.ac.v_pu
    if np.isfinite(v).any():
        v = v[np.isfinite(v)]
    within = bool(v.min() >= net.v_min_ac_pu and v.max() <= net.v_max_ac_pu)
    return {
        "dark": float(done.dark),
        "dark_reason": done.dark_reason,
        "island_mismatch_kw": float(done.mismatch_kw.sum()) + done.by_set_kw,
        "shed_kw": float(done.load_kw @ done.shed),
        "v_within_ac": float(within),
    }
