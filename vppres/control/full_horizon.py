"""Full-horizon optimisation (paper, Section 4.1): plan the day once, follow the plan, correct."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np

from vppres.contract.decision import Decision, SolveInfo
from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.contract.terminal import Terminal
from vppres.control.guard.check import worst_words
from vppres.control.planner import OnePass, Planner, decided, plan_with_rules
from vppres.control.remembered import PART
from vppres.core.arrays import Floats
from vppres.kinds.batteries.physics import BatteriesAhead, power_beyond_kw
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.timegrid import TimeGrid
from vppres.solve.ladder import WindowSolver

PVCheck = Literal["absorbing", "literal"]

SOC_TOLERANCE = 1e-6
POWER_TOLERANCE_KW = 1e-3
BALANCE_TOLERANCE_KW = 1.0


class FullHorizonController:
    """One plan for the whole day, three feasibility checks at every step, one-step corrections.

    Parameters
    ----------
    solver : WindowSolver
        Solves the plan and the corrections.
    grid : TimeGrid
        The day's steps.
    pv_check : {"absorbing", "literal"}
        ``literal``: the planned split must equal the actual PV power and respect the actual load.
        ``absorbing``: planned service and battery set-points stand and the split follows the actual
        PV power; only batteries, inverters and the grid balance can be violated.
    centre : {"lossless", "literal", "none"}
        Linearisation centre of the corrections.
    planner : Planner, optional
        Plans the windows; one solve at the centre if not given.
    physical : bool, optional
        Whether set-points end where the energy of a battery does. What is missing shows in the
        balance then; in the paper's mode it is a violation by itself.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {
        "plan": Dispatch | None,
        "loss_kw": Floats | None,
        "first": int,
        "guessed": bool,
        "planner": PART,
    }

    def __init__(
        self,
        solver: WindowSolver,
        grid: TimeGrid,
        pv_check: PVCheck = "absorbing",
        centre: Centre = "lossless",
        planner: Planner | None = None,
        physical: bool = False,
    ) -> None:
        self.solver = solver
        self.grid = grid
        self.centre = centre
        self.physical = physical
        self.planner = planner or OnePass(solver, centre)
        self.literal = pv_check == "literal"
        self.plan: Dispatch | None = None
        self.loss_kw: Floats | None = None
        self.first = 0
        self.guessed = False

    def horizon_steps(self, t0: int) -> range:
        """The rest of the day while there is no plan for it, then the step itself."""
        return range(t0, t0 + 1 if self._has_planned(t0) else self.grid.n_steps)

    def _has_planned(self, t0: int) -> bool:
        """Whether the plan reaches the step: a live controller may know more by now."""
        return self.plan is not None and t0 < self.first + self.plan.n_steps

    def decide(self, observation: Observation) -> Decision:
        """Follow the plan if it passes the checks, otherwise correct the step."""
        info = SolveInfo(status="planned")
        window = WindowData.of(observation, self.solver.site, self.centre)
        if self.plan is None or not self._has_planned(observation.t0):
            solution = plan_with_rules(self.planner, observation)
            self.plan = solution.dispatch
            self.loss_kw = solution.loss_kw
            self.first = observation.t0
            self.guessed = observation.open_ended
            info = decided(self.solver, solution).info
        row = observation.t0 - self.first
        now = window.first(1).for_service(self.plan.served[row : row + 1])
        plan = self._within_energy(row, observation) if self.physical else self.plan
        reasons = self.violations(plan, row, now, observation.forecast.export_now_kw)
        connected = self.guessed and not now.dark[0]
        if not reasons and connected and not self.plan.served[row].all():
            kept = self._step_without_disconnections(observation, row)
            if (kept.dispatch.served[0] & ~self.plan.served[row]).any():
                return kept
        if not reasons:
            return Decision(plan, row, info)
        return self._solve_step_alone(observation, "; ".join(reasons))

    def _within_energy(self, row: int, observation: Observation) -> Dispatch:
        """The plan, in whose row no battery is charged beyond full or discharged beyond empty.

        A former carries what the plan's losses leave open to AC, so it is never charged quite as
        planned. That is no reason to give the plan up for the step alone, which sees no outage
        ahead.
        """
        assert self.plan is not None
        site = self.solver.site
        b = site.batteries
        now = BatteriesAhead.of(b, observation, site.dt_h)
        charge_kw, discharge_kw = self.plan.charge_kw.copy(), self.plan.discharge_kw.copy()
        net_kw = charge_kw[row] - discharge_kw[row]
        charge_kw[row] = np.clip(net_kw, 0.0, now.charge_to_kw(b.soc_max))
        discharge_kw[row] = np.clip(-net_kw, 0.0, now.discharge_to_kw(b.soc_min))
        return replace(self.plan, charge_kw=charge_kw, discharge_kw=discharge_kw)

    def _solve_step_alone(self, observation: Observation, reason: str) -> Decision:
        """Optimise the step alone (H = 0) with actual values."""
        decision = decided(self.solver, plan_with_rules(self.planner, observation, 1))
        return replace(decision, corrected=True, reason=reason)

    def _step_without_disconnections(self, observation: Observation, row: int) -> Decision:
        """The step alone, with those who would be off for an outage that is only likely, or over.

        Batteries are charged as far as the plan has it, where no customer is off for it.
        """
        assert self.plan is not None
        b = self.solver.site.batteries
        planned = float(self.plan.soc[row + 1] @ b.energy_kwh / b.energy_kwh.sum())
        now = observation.forecast.first(1)
        alone = replace(observation, forecast=now, terminal=Terminal.of(planned, now, ends=True))
        return self._solve_step_alone(
            alone, "grid: an outage whose end is not known takes nobody off with grid"
        )

    def violations(
        self, plan: Dispatch, t: int, now: WindowData, export_limit_kw: float
    ) -> list[str]:
        """Names of the checks that row ``t`` of a plan fails, with the worst item of each.

        ``now`` is that step alone, as it is measured when it is due.
        """
        site = self.solver.site
        loss_kw = 0.0 if self.loss_kw is None else float(self.loss_kw[t])
        checks = (
            _check_battery(site, plan, t, now),
            self._check_pv(site, plan, t, now),
            _check_grid(site, plan, t, now, loss_kw, export_limit_kw),
            _check_switching(site, plan, t, now),
        )
        return [text for text in checks if text]

    def _check_pv(self, site: Site, plan: Dispatch, t: int, now: WindowData) -> str:
        """PV power distribution feasibility, in the reading that was chosen."""
        pv_kw = now.pv_kw[0]
        if self.literal:
            through = plan.pv_self_kw[t] + plan.pv_export_kw[t]
            split = np.abs(through + plan.pv_curtailed_kw[t] - pv_kw)
            beyond = plan.pv_self_kw[t] - site.behind_meter(now.load_kw[0])
            apparent = np.hypot(through, plan.pv_q_kvar[t])
            excess = np.max([split, beyond, apparent - site.pv.s_max_kva], axis=0)
        else:
            # Reactive power gives way to active power in the inverter itself.
            through = pv_kw - np.minimum(plan.pv_curtailed_kw[t], pv_kw)
            excess = through - site.pv.s_max_kva
        return worst_words("pv", site.pv.id, excess - POWER_TOLERANCE_KW, excess, "kW")


def _check_battery(site: Site, plan: Dispatch, t: int, now: WindowData) -> str:
    """Battery dispatch feasibility: inverter disc, and SoC with the actual efficiencies."""
    b = site.batteries
    beyond = power_beyond_kw(b, plan.charge_kw[t], plan.discharge_kw[t], plan.batt_q_kvar[t])
    over_kva = beyond["inverter"]
    disc = worst_words("battery inverter", b.id, over_kva - POWER_TOLERANCE_KW, over_kva, "kVA")
    known = BatteriesAhead.of(b, now, site.dt_h)
    outside = np.maximum(*known.soc_beyond(known.after(plan.charge_kw[t] - plan.discharge_kw[t])))
    return disc or worst_words(
        "battery energy", b.id, outside - SOC_TOLERANCE, outside, "of capacity"
    )


def _check_grid(
    site: Site, plan: Dispatch, t: int, now: WindowData, loss_kw: float, export_limit_kw: float
) -> str:
    """Grid import feasibility: what the AC power flow imports, net of its losses.

    Net of losses the AC import is the sum of the nodal demands, so no power flow is needed to know
    it; losses count as far as the plan has paid for them. A surplus beyond what the grid takes
    violates as a shortage does, and an import-only connection takes none.
    """
    load_kw, pv_kw, limit = now.load_kw[0], now.pv_kw[0], float(now.grid_limit_kw[0])
    served = plan.supplied[t]
    # What an owner consumes cannot be curtailed.
    own = np.minimum(pv_kw, site.behind_meter(load_kw * served))
    curtailed = np.minimum(plan.pv_curtailed_kw[t], pv_kw - own)
    battery_kw = plan.charge_kw[t] - plan.discharge_kw[t]
    needed = load_kw @ served + loss_kw + battery_kw.sum() - (pv_kw - curtailed).sum()
    if needed > limit + BALANCE_TOLERANCE_KW:
        return f"grid import: {needed - limit:.1f} kW above what the grid gives"
    surplus = -needed - export_limit_kw
    if surplus > BALANCE_TOLERANCE_KW:
        return f"grid import: {surplus:.1f} kW surplus that cannot be exported"
    return ""


def _check_switching(site: Site, plan: Dispatch, t: int, now: WindowData) -> str:
    """Whether the planned service obeys the switching rules after what was really served."""
    rules = now.switching
    if rules is None:
        return ""
    broken = rules.broken(plan.served[t : t + 1])
    if not broken.any():
        return ""
    first = site.customers.id[np.argmax(broken)]
    return f"switching rules: {broken.sum()} customers may not be switched as planned ({first})"
