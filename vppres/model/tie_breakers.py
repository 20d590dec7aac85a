"""The last level: minimise f4 and f5 with service, battery modes, cost and curtailment held.

With these held most of the problem is constant: one signed power per battery replaces charge,
discharge and mode, PV self-consumption is data, and where nothing is curtailed PV export is data
too, so that a PV inverter's disc leaves a plain interval for the reactive power.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats
from vppres.model import constraints as families
from vppres.model import objective as terms
from vppres.model.beyond_paper.physical import PhysicalParameters
from vppres.model.data import WindowData
from vppres.model.problem import disc_sides, require_dpp
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


class TieBreakerModel:
    """Tie-breakers over W steps; feasible exactly if the held values can be had in the network.

    Parameters
    ----------
    site : Site
        Fixed data.
    n_steps : int
        Steps W of the window.
    curtailing : bool
        Whether PV power may be curtailed, up to the held sum.
    physical : bool
        Whether losses, the island's reference and headroom are part of the problem.
    moves : bool
        Whether batteries are to stay near the previous plan.
    """

    def __init__(self, site: Site, n_steps: int, curtailing: bool,
                 physical: bool = False, moves: bool = False) -> None:
        self.site = site
        self.n_steps = n_steps
        self.curtailing = curtailing
        W = n_steps
        P = len(site.pv)
        B = len(site.batteries)
        self.p = Parameters.create(site, W)
        self.physical = PhysicalParameters.create(site, W) if physical else None
        self.P_batt = cp.Variable((W, B), name="P_batt")
        self.gain = cp.Parameter((W, B), name="gain", nonneg=True)
        self.P_min, self.P_max = (cp.Parameter((W, B), name=n) for n in ("P_min", "P_max"))
        self.charging = cp.Parameter((W, B), name="charging", nonneg=True)
        self.Q_pv_max = cp.Parameter((W, P), name="Q_pv_max", nonneg=True)
        self.near = [cp.Parameter((W, B), name=n) for n in ("near_factor", "near_value") if moves]
        self.f2_held = cp.Parameter(name="f2_held")
        self.f3_held = cp.Parameter(name="f3_held")
        self.v = self._variables()
        self.constraints = self._constraints()
        self.problem = cp.Problem(self._objective(), list(self.constraints.values()))
        require_dpp(self.problem, f"tie-breakers of {n_steps} steps")

    def _variables(self) -> Variables:
        """The paper's variables, expressions where something is held."""
        free = Variables.create(self.site, self.n_steps, "fixed", "relaxed")
        P_curt = free.P_curt if self.curtailing else cp.Constant(np.zeros(free.P_curt.shape))
        P_ch = cp.multiply(self.charging, self.P_batt)
        return Variables(
            x_served=free.x_served, P_self=self.p.P_self_max,
            P_exp=self.p.P_pv - self.p.P_self_max - P_curt, P_curt=P_curt, Q_pv=free.Q_pv,
            P_ch=P_ch, P_dch=P_ch - self.P_batt, delta=self.charging, P_batt=self.P_batt,
            Q_batt=free.Q_batt,
            SoC=free.SoC, P_grid=free.P_grid, Q_grid=free.Q_grid, u=free.u, P_flow=free.P_flow,
            Q_flow=free.Q_flow)

    def _constraints(self) -> families.Named:
        """The network's families as they are, the devices' with what is held put in."""
        args = (self.site, self.v, self.p)
        b = self.site.batteries
        named: families.Named = {}
        sides = disc_sides(self.site, self.n_steps)
        pv_discs = families.inverter_polygons(sides) if sides else families.pv_disc
        batteries = families.battery_half_polygon(sides) if sides else families.battery_disc
        for family in (families.circular_charging, families.grid_connection,
                       *families.NETWORK_FAMILIES):
            named |= family(*args)
        named |= batteries(*args)
        if self.curtailing:
            named["pv_inverter_capacity"] = pv_discs(*args)["pv_inverter_capacity"]
            named["pv_export"] = self.v.P_exp >= 0
        else:
            named["pv_reactive_limit"] = cp.abs(self.v.Q_pv) <= self.Q_pv_max
        soc = self.v.SoC
        step = self.site.dt_h / b.energy_kwh[None, :]
        energy: families.Named = {
            "battery_soc_start": soc[0] == self.p.SoC_0,
            "battery_soc_dynamics":
                soc[1:] == soc[:-1] + cp.multiply(step, cp.multiply(self.gain, self.P_batt)),
            "battery_soc_min": b.soc_min[None, :] <= soc[1:],
            "battery_soc_max": soc[1:] <= b.soc_max[None, :],
        }
        named |= energy
        if self.physical:
            named = self.physical.amended(named, self.site, self.v)
        named["delta_lindistflow"] = _sharper(named["delta_lindistflow"], 1e2)
        return named | {name: _sharper(named[name], 1e4) for name in energy} | {
            "battery_power_min": self.P_batt >= self.P_min,
            "battery_power_max": self.P_batt <= self.P_max,
            "cost_held": terms.f2_cost(*args) <= self.f2_held,
            "curtailment_held": terms.f3_curtailment(*args) <= self.f3_held,
        }

    def _objective(self) -> cp.Minimize:
        """f4 and f5 as weighted, scaled: f4 over the squared base voltage is about kW of loss.

        Moves away from the previous plan come on top, in the same unit.
        """
        args = (self.site, self.v, self.p)
        w = self.site.weights
        heaviest = max(w.lambda_l, w.lambda_q) or 1.0
        scale = 1.0 / (1000.0 * self.site.network.base_kv**2 * heaviest)
        moved = 0.0
        if self.near:
            factor, value = self.near
            moved = cp.sum_squares(cp.multiply(factor, self.P_batt) - value)
        return cp.Minimize(scale * w.lambda_l * terms.f4_flows(*args)
                           + scale * w.lambda_q * terms.f5_reactive(*args) + moved)

    def fill(self, data: WindowData, dispatch: Dispatch, charging: Flags,
             f2_held_gbp: float, f3_held_kwh: float) -> None:
        """Write the window's data and what is held of a dispatch."""
        site = self.site
        P_max = self.site.batteries.p_max_kw
        self.p.fill(site, data, dispatch.served)
        if self.physical:
            self.physical.fill(site, data)
        self.charging.value = charging.astype(float)
        self.gain.value = np.where(charging, data.eta_charge, 1.0 / data.eta_discharge)
        self.P_min.value = np.where(charging, 0.0, -P_max)
        self.P_max.value = np.where(charging, P_max, 0.0)
        self.Q_pv_max.value = np.sqrt(np.maximum(site.pv.s_max_kva**2 - data.pv_kw**2, 0.0))
        self.f2_held.value = f2_held_gbp
        self.f3_held.value = f3_held_kwh
        if data.moves is not None:
            for parameter, value in zip(self.near, data.moves.targets(P_max), strict=True):
                parameter.value = value

    def dispatch(self, served: Flags) -> Dispatch:
        """The solution of the last solve, exactly in its modes."""
        return self.v.dispatch(self.site, served)


def _sharper(constraint: cp.Constraint, factor: float) -> cp.Constraint:
    """The same constraint in smaller units.

    An interior-point solver allows residuals in proportion to the largest value of the solution,
    thousands of kW here; what is a fraction of one needs smaller units to be met as sharply.
    """
    left, right = constraint.args
    if isinstance(constraint, cp.constraints.Equality):
        return factor * left == factor * right
    return factor * left <= factor * right


def charging_modes(dispatch: Dispatch) -> Flags:
    """Mode of every battery and step; an idle battery takes the fleet's."""
    net: Floats = dispatch.charge_kw - dispatch.discharge_kw
    fleet = net.sum(axis=1, keepdims=True) >= 0
    return np.where(np.abs(net) > 1e-6, net > 0, fleet)
