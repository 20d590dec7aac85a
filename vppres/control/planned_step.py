"""The first step of a plan: what devices do in it, and what that puts into the network."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.contract.decision import Decision
from vppres.control.step_state import StepState
from vppres.core.arrays import Flags, Floats
from vppres.model.formulas import bus_injections, curtailed_kw
from vppres.model.phases import phased_model
from vppres.model.site import Site


@dataclass(frozen=True, eq=False)
class PlannedStep:
    """The step's row of a plan, as floats."""

    served: Floats  # a share of those that are dimmed
    curtailed_kw: Floats
    pv_q_kvar: Floats
    charge_kw: Floats
    discharge_kw: Floats
    batt_q_kvar: Floats
    v_pu: Floats
    taken_kw: dict[str, Floats]
    given_kvar: dict[str, Floats]
    running: dict[str, Flags]

    @classmethod
    def of(cls, decision: Decision, site: Site) -> PlannedStep:
        """The step that is decided."""
        plan = decision.dispatch
        row = decision.row
        return cls(
            np.asarray(plan.supplied[row], dtype=float),
            plan.pv_curtailed_kw[row],
            plan.pv_q_kvar[row],
            plan.charge_kw[row],
            plan.discharge_kw[row],
            plan.batt_q_kvar[row],
            plan.v_pu[row],
            {kind: plan.taken_by(kind, units)[row] for kind, units in site.kinds.items()},
            {kind: np.nan_to_num(kvar[row]) for kind, kvar in plan.given_kvar.items()},
            {kind: plan.running_of(kind, units)[row] for kind, units in site.kinds.items()},
        )

    def inside(self, part: StepState) -> PlannedStep:
        """Powers of devices of a part of the feeder, 0 for all others."""
        site = part.site
        pv, batteries = part.items(site.pv_bus), part.items(site.battery_bus)
        units = {kind: part.items(place) for kind, place in site.unit_bus.items()}
        return replace(
            self,
            served=self.served * part.items(site.customer_bus),
            curtailed_kw=self.curtailed_kw * pv,
            pv_q_kvar=self.pv_q_kvar * pv,
            charge_kw=self.charge_kw * batteries,
            discharge_kw=self.discharge_kw * batteries,
            batt_q_kvar=self.batt_q_kvar * batteries,
            taken_kw={kind: kw * units[kind] for kind, kw in self.taken_kw.items()},
            given_kvar={kind: kvar * units[kind] for kind, kvar in self.given_kvar.items()},
        )

    def sun_kw(self, state: StepState) -> Floats:
        """PV power that is used or exported, (P,)."""
        served_kw = state.load_kw * self.served
        return state.pv_kw - curtailed_kw(state.site, self.curtailed_kw, state.pv_kw, served_kw)

    @property
    def battery_kw(self) -> Floats:
        """Power that batteries give, (B,)."""
        return self.discharge_kw - self.charge_kw

    def injections(self, state: StepState) -> tuple[Floats, Floats]:
        """Injections of all buses in kW and kvar, (N,) each."""
        site, load_kw = state.site, state.load_kw * self.served
        p_kw = {"pv": self.sun_kw(state), "batteries": self.battery_kw, "customers": -load_kw}
        p_kw |= {kind: -kw for kind, kw in self.taken_kw.items()}
        q_kvar = {"pv": self.pv_q_kvar, "batteries": self.batt_q_kvar}
        q_kvar |= {"customers": -load_kw * site.customers.q_per_p, **self.given_kvar}
        return bus_injections(site, p_kw), bus_injections(site, q_kvar)

    def drawn(self, state: StepState, source: int) -> tuple[Floats, Floats]:
        """Power that devices of a feeder with phases draw beside a source, (D,) each."""
        return phased_model(state.site).powers(
            source,
            load_kw=state.load_kw * self.served,
            pv=(self.sun_kw(state), self.pv_q_kvar),
            batteries=(self.battery_kw, self.batt_q_kvar),
            taken_kw=self.taken_kw,
            given_kvar=self.given_kvar,
        )
