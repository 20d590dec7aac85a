"""The last level: minimise f4 and f5 with service, battery modes, cost and curtailment held.

With these held most of the problem is constant: one signed power per battery replaces charge,
discharge and mode, PV self-consumption is data, and where nothing is curtailed PV export is data
too, so that a PV inverter's disc leaves a plain interval for the reactive power.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.moves import Moves
from vppres.contract.stored_value import Ending
from vppres.core.arrays import Flags, Floats
from vppres.model import constraints as families
from vppres.model import objective as terms
from vppres.model.beyond_paper.export import ExportToGrid, exporting_steps
from vppres.model.beyond_paper.physical import PhysicalParameters
from vppres.model.beyond_paper.terminal import HeldAtEnd
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.forms import (
    NETWORK,
    added_demand,
    fill_end,
    in_order,
    stored_at_end,
    with_demand,
    without,
)
from vppres.model.numerics import disc_sides, require_dpp, write
from vppres.model.polygons import Polygon, battery_half_polygon, pv_polygon
from vppres.model.problem import paper_constraints
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

SHARPER_VOLTAGE = 1e2
SHARPER_ENERGY = 1e4
"""Factors on both sides of rows in pu² and in shares of a capacity. An interior-point solver allows
residuals in proportion to the largest value of the solution, thousands of kW here; what is a
fraction of one needs smaller units to be met as sharply."""

KEPT_TOLERANCE = 1e-6
"""Share of the capacity by which the energy that a dispatch keeps for later may be missed."""

SQUARED = ("P_flow", "Q_flow", "Q_pv", "Q_batt")
"""Variables whose squares are minimised."""

KEPT = (
    "circular_charging",
    "grid_active_limit",
    "grid_reactive_max",
    "grid_reactive_min",
    *NETWORK,
    "battery_inverter_capacity",
    "pv_inverter_capacity",
)
"""The paper's constraints that are still there when service and modes are held."""


@dataclass(frozen=True, eq=False)
class HeldModes:
    """Modes, cost and curtailment that are held, for a window of W steps.

    Parameters
    ----------
    charging : cvxpy.Parameter, shape (W, B)
        1 where a battery charges, 0 where it discharges.
    gain : cvxpy.Parameter, shape (W, B)
        Energy stored for each kWh at the terminals, with the sign of the power.
    P_min, P_max : cvxpy.Parameter, shape (W, B)
        Limits of the power in that mode.
    Q_pv_max : cvxpy.Parameter, shape (W, P)
        What the PV inverters' discs leave for reactive power.
    f2, f3 : cvxpy.Parameter
        Largest cost in GBP and curtailment in kWh.
    """

    charging: cp.Parameter
    gain: cp.Parameter
    P_min: cp.Parameter
    P_max: cp.Parameter
    Q_pv_max: cp.Parameter
    f2: cp.Parameter
    f3: cp.Parameter

    @classmethod
    def create(cls, site: Site, W: int) -> HeldModes:
        """Parameters of a window of W steps."""
        B = len(site.batteries)
        P = len(site.pv)
        return cls(
            charging=cp.Parameter((W, B), name="charging", nonneg=True),
            gain=cp.Parameter((W, B), name="gain", nonneg=True),
            P_min=cp.Parameter((W, B), name="P_min"),
            P_max=cp.Parameter((W, B), name="P_max"),
            Q_pv_max=cp.Parameter((W, P), name="Q_pv_max", nonneg=True),
            f2=cp.Parameter(name="f2_held"),
            f3=cp.Parameter(name="f3_held"),
        )

    def fill(self, site: Site, data: WindowData, charging: Flags) -> None:
        """Write what the modes leave; f2 and f3 are written apart."""
        P_max = site.batteries.active_max_kw
        write(self.charging, charging)
        write(self.gain, np.where(charging, data.eta_charge, 1.0 / data.eta_discharge))
        write(self.P_min, np.where(charging, 0.0, -P_max))
        write(self.P_max, np.where(charging, P_max, 0.0))
        write(self.Q_pv_max, np.sqrt(np.maximum(site.pv.s_max_kva**2 - data.pv_kw**2, 0.0)))


@dataclass(frozen=True, eq=False)
class Near:
    """Squared distance ``(factor P_batt - value)**2`` from the previous plan."""

    factor: cp.Parameter
    value: cp.Parameter

    @classmethod
    def create(cls, site: Site, W: int) -> Near:
        """Parameters of a window of W steps."""
        shape = (W, len(site.batteries))
        return cls(cp.Parameter(shape, name="near_factor"), cp.Parameter(shape, name="near_value"))

    def moved(self, P_batt: cp.Expression) -> cp.Expression:
        """The distance of all batteries and steps."""
        return cp.sum_squares(cp.multiply(self.factor, P_batt) - self.value)

    def fill(self, moves: Moves, p_max_kw: Floats) -> None:
        """Write the previous plan."""
        factor, value = moves.targets(p_max_kw)
        write(self.factor, factor)
        write(self.value, value)


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
    exporting : bool
        Whether export is part of the problem, its direction held step by step.
    ending : {"", "target", "value"}
        What the problem says of what batteries hold at the end. Where it has a value, the energy
        that a dispatch keeps is held, and its value has no part in the cost.
    """

    def __init__(
        self,
        site: Site,
        n_steps: int,
        curtailing: bool,
        physical: bool = False,
        moves: bool = False,
        exporting: bool = False,
        ending: Ending = "",
    ) -> None:
        self.site = site
        self.n_steps = n_steps
        self.curtailing = curtailing
        self.p = Parameters.create(site, n_steps)
        self.physical: PhysicalParameters | None = None
        if physical:
            self.physical = PhysicalParameters.create(site, n_steps)
        self.export: ExportToGrid | None = None
        if exporting:
            self.export = ExportToGrid.create(n_steps, "fixed")
        self.terminal = HeldAtEnd.create(len(site.batteries)) if ending == "target" else None
        self.kept_share = cp.Parameter(name="kept_share") if ending == "value" else None
        self.held = HeldModes.create(site, n_steps)
        self.near: Near | None = None
        if moves and len(site.batteries):
            self.near = Near.create(site, n_steps)
        self.P_batt = cp.Variable((n_steps, len(site.batteries)), name="P_batt")
        self.v = self._variables()
        self.constraints = self._constraints()
        self.problem = cp.Problem(self._objective(), list(self.constraints.values()))
        require_dpp(self.problem, f"tie-breakers of {n_steps} steps")

    @property
    def _capacity_kwh(self) -> float:
        """Capacity of all batteries."""
        return float(self.site.batteries.energy_kwh.sum())

    def _variables(self) -> Variables:
        """The paper's variables, expressions where something is held."""
        free = Variables.create(self.site, self.n_steps, "fixed", "relaxed")
        P_curt = free.P_curt if self.curtailing else cp.Constant(np.zeros(free.P_curt.shape))
        P_ch = cp.multiply(self.held.charging, self.P_batt)
        return replace(
            free,
            P_self=self.p.P_self_max,
            P_exp=self.p.P_pv - self.p.P_self_max - P_curt,
            P_curt=P_curt,
            P_ch=P_ch,
            P_dch=P_ch - self.P_batt,
            delta=self.held.charging,
            P_batt=self.P_batt,
            **{name: terms.listed(getattr(free, name)) for name in SQUARED},
        )

    def _constraints(self) -> Named:
        """The paper's constraints with what is held put in.

        Battery modes, PV balance and self-consumption hold by the data and are dropped.
        """
        args = (self.site, self.v, self.p)
        named = in_order(paper_constraints(*args), KEPT)
        added = added_demand(self.site, None, self.physical, self.export)
        if self.export is not None:
            named |= self.export.connection(self.v.P_grid, self.p.P_grid_max)
        if added is not None:
            named = with_demand(named, *args, added)
        named |= families.delta_lindistflow(*args, factor=SHARPER_VOLTAGE)
        named = self._with_inverters(named)
        named |= self._energy()
        if self.physical is not None:
            named = self.physical.in_island(named, *args) | self._energy()
        f2 = terms.f2_cost(*args)
        if self.export is not None:
            f2 = f2 - self.export.f2_revenue
        if self.terminal is not None:
            f2 = f2 + self.terminal.f2_missing
            named |= self.terminal.reached(stored_at_end(self.site, self.v))
        if self.kept_share is not None:
            share = cp.sum(stored_at_end(self.site, self.v)) / self._capacity_kwh
            named |= {"energy_held": SHARPER_ENERGY * share >= SHARPER_ENERGY * self.kept_share}
        return named | {
            "battery_power_min": self.P_batt >= self.held.P_min,
            "battery_power_max": self.P_batt <= self.held.P_max,
            "cost_held": f2 <= self.held.f2,
            "curtailment_held": terms.f3_curtailment(*args) <= self.held.f3,
        }

    def _with_inverters(self, named: Named) -> Named:
        """Batteries of one mode need half a polygon; PV power that is data leaves an interval."""
        args = (self.site, self.v, self.p)
        rating = None if self.physical is None else self.physical.rating
        sides = disc_sides(self.site, self.n_steps)
        if sides:
            polygon = Polygon.inscribed(sides)
            named |= battery_half_polygon(self.site, self.v, polygon, rating)
            named |= pv_polygon(self.site, self.v, polygon)
        elif rating is not None:
            named |= families.battery_inverter(*args, rating)
        if self.curtailing:
            return named | {"pv_export": self.v.P_exp >= 0}
        # Not as one limit of the absolute value, of which cvxpy makes variables.
        data_leave = {
            "pv_reactive_min": self.v.Q_pv >= -self.held.Q_pv_max,
            "pv_reactive_max": self.v.Q_pv <= self.held.Q_pv_max,
        }
        return without(named, ["pv_inverter_capacity"]) | data_leave

    def _energy(self) -> Named:
        """The SoC recursion (2) with one signed power, and its limits, in smaller units."""
        b = self.site.batteries
        soc = self.v.SoC
        per_energy = self.site.dt_h / b.energy_kwh[None, :]
        change = cp.multiply(per_energy, cp.multiply(self.held.gain, self.P_batt))
        lowest = b.soc_min[None, :]
        if self.physical is not None and len(b):
            lowest = self.physical.SoC_min
        k = SHARPER_ENERGY
        return {
            "battery_soc_start": k * soc[0] == k * self.p.SoC_0,
            "battery_soc_dynamics": k * soc[1:] == k * (soc[:-1] + change),
            "battery_soc_min": k * soc[1:] >= k * lowest,
            "battery_soc_max": k * soc[1:] <= k * b.soc_max[None, :],
        }

    def _objective(self) -> cp.Minimize:
        """f4 and f5 as weighted, scaled: f4 over the squared base voltage is about kW of loss.

        Moves away from the previous plan come on top, in the same unit.
        """
        w = self.site.weights
        heaviest = max(w.lambda_l, w.lambda_q) or 1.0
        scale = 1.0 / (1000.0 * self.site.network.base_kv**2 * heaviest)
        total = scale * w.lambda_l * self._f4 + scale * w.lambda_q * self._f5
        if self.near is not None:
            total = total + self.near.moved(self.P_batt)
        return cp.Minimize(total)

    @property
    def _f4(self) -> cp.Expression:
        """Proxy of the ohmic losses, for a solver that takes squares."""
        r_ohm = self.site.network.r_ohm
        active = terms.weighted_squares(r_ohm, self.v.P_flow)
        reactive = terms.weighted_squares(r_ohm, self.v.Q_flow)
        return active + reactive

    @property
    def _f5(self) -> cp.Expression:
        """Squared utilisation of the inverters by reactive power, likewise."""
        of_pv = terms.weighted_squares(self.site.pv.s_max_kva**-2.0, self.v.Q_pv)
        of_batteries = terms.weighted_squares(self.site.batteries.s_max_kva**-2.0, self.v.Q_batt)
        return of_pv + of_batteries

    def fill(
        self,
        data: WindowData,
        dispatch: Dispatch,
        charging: Flags,
        f2_held_gbp: float,
        f3_held_kwh: float,
    ) -> None:
        """Write the window's data and what is held of a dispatch."""
        self.p.fill(self.site, data, dispatch.served)
        self.held.fill(self.site, data, charging)
        write(self.held.f2, f2_held_gbp)
        write(self.held.f3, f3_held_kwh)
        if self.physical is not None:
            self.physical.fill(self.site, data)
        if self.terminal is not None:
            fill_end(self.terminal, self.site, data)
        if self.kept_share is not None:
            kept = dispatch.soc[-1] @ self.site.batteries.energy_kwh / self._capacity_kwh
            write(self.kept_share, kept - KEPT_TOLERANCE)
        if self.export is not None:
            exporting = exporting_steps(dispatch)
            self.export.fill(self.site, data, exporting)
            write(self.p.P_grid_max, np.where(exporting, 0.0, self.p.P_grid_max.value))
        if self.near is not None and data.moves is not None:
            self.near.fill(data.moves, self.site.batteries.p_max_kw)

    def dispatch(self, served: Flags) -> Dispatch:
        """The solution of the last solve, exactly in its modes."""
        found = self.v.dispatch(self.site, served)
        return found if self.export is None else self.export.netted(found)


def charging_modes(dispatch: Dispatch) -> Flags:
    """Mode of every battery and step; an idle battery takes the fleet's."""
    net: Floats = dispatch.charge_kw - dispatch.discharge_kw
    fleet = net.sum(axis=1, keepdims=True) >= 0
    return np.where(np.abs(net) > 1e-6, net > 0, fleet)
