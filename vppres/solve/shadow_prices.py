"""Shadow prices: the pricing problem solved, and its duals read in the units of the record.

A shadow price is the slope of the optimum: what the objective would gain if one more unit of
something had been there. All of them belong to the first step of the window, but for the limits of
stored energy, which count over the whole window.
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Floats
from vppres.model.data import WindowData
from vppres.solve.result import Status
from vppres.solve.shadow_price_model import Held, PricedTerms, ShadowPriceModel
from vppres.solve.solvers import run_conic
from vppres.solve.turns import one_at_a_time


@dataclass(frozen=True, eq=False)
class ShadowPrices:
    """Gain of the objective for one more unit, in its unit: weighted customer hours or GBP.

    Parameters
    ----------
    stored_energy : array, shape (B,)
        For 1 kWh more in each battery at the beginning of the step.
    kept_energy : array, shape (B,)
        For 1 kWh more in each battery at the end of the step.
    energy_floor, energy_ceiling : array, shape (B,)
        For 1 kWh more that may be taken out or put in, over the whole window.
    battery_charging, battery_discharging : array, shape (B,)
        For 1 kW more rated power of a battery that charges or discharges.
    battery_inverter, pv_inverter : array, shape (B,) and (P,)
        For 1 kVA more of the inverter.
    voltage_floor, voltage_ceiling : array, shape (N,)
        For a limit that lies 0.001 pu further out, at each bus.
    grid : float
        For 1 kW more that may be imported, less its price.
    active, reactive : array, shape (N,)
        For 1 kW or 1 kvar put into each bus throughout the step.
    service : array, shape (C,)
        For serving each customer in the step: its weight less what its supply is worth to others.
    """

    stored_energy: Floats
    kept_energy: Floats
    energy_floor: Floats
    energy_ceiling: Floats
    battery_charging: Floats
    battery_discharging: Floats
    battery_inverter: Floats
    pv_inverter: Floats
    voltage_floor: Floats
    voltage_ceiling: Floats
    grid: float
    active: Floats
    reactive: Floats
    service: Floats


@dataclass(frozen=True, eq=False)
class PricedWindow:
    """The pricing problem's answer.

    Parameters
    ----------
    value : float
        The objective: weighted customer hours, or GBP where the cost is priced.
    served_share : array, shape (W, C)
        Share of each customer that is served.
    curtailed_kwh : float
        PV energy curtailed in the window.
    battery_kw : array, shape (W, B)
        Power of each battery, charging positive.
    soc : array, shape (W + 1, B)
        State of charge, the first row at the beginning.
    prices : ShadowPrices
        What one more unit would have bought.
    solver_s : float
        Time in the solver in s.
    """

    value: float
    served_share: Floats
    curtailed_kwh: float
    battery_kw: Floats
    soc: Floats
    prices: ShadowPrices
    solver_s: float


@one_at_a_time
def price_window(
    model: ShadowPriceModel, data: WindowData, held: Held, priced: PricedTerms, time_s: float = 20.0
) -> PricedWindow | None:
    """Solve a window's pricing problem; None where it has no answer that the solver vouches for.

    Parameters
    ----------
    model : ShadowPriceModel
        Compiled for at least as many steps as the window has.
    data : WindowData
        The window as the controller saw it.
    held : Held
        What is held of the record.
    priced : PricedTerms
        What is maximised.
    time_s : float
        Time limit in s.
    """
    model.fill(data, held, priced)
    outcome = run_conic(model.problem, time_s, duals=True)
    if outcome.status != Status.OPTIMAL:
        return None
    v = model.v
    W = data.n_steps
    return PricedWindow(
        value=outcome.value,
        served_share=np.clip(_value(v.x_served)[:W], 0.0, 1.0),
        curtailed_kwh=float(_value(v.P_curt).sum()) * model.site.dt_h,
        battery_kw=_value(v.P_batt)[:W],
        soc=_value(v.SoC)[: W + 1],
        prices=_prices(model),
        solver_s=outcome.solve_s,
    )


def _value(expression: cp.Expression) -> Floats:
    """Value of an expression in its own shape, which cvxpy drops where it is empty."""
    return np.reshape(np.asarray(expression.value, dtype=float), expression.shape)


def _prices(model: ShadowPriceModel) -> ShadowPrices:
    """The duals in the record's units; the signs are those of a gain."""
    site = model.site
    v = model.v
    net = site.network
    energy_kwh = site.batteries.energy_kwh
    mode = _value(v.delta)[0]
    dual = _Duals(model)
    # A demand on the right of the balance costs what an injection gains.
    active = -dual.rows("active_power_balance")[0]
    return ShadowPrices(
        stored_energy=dual.rows("battery_soc_start") / energy_kwh,
        kept_energy=dual.rows("battery_soc_dynamics")[0] / energy_kwh,
        energy_floor=dual.rows("battery_soc_min").sum(axis=0) / energy_kwh,
        energy_ceiling=dual.rows("battery_soc_max").sum(axis=0) / energy_kwh,
        battery_charging=dual.rows("battery_charge_mode")[0] * mode,
        battery_discharging=dual.rows("battery_discharge_mode")[0] * (1.0 - mode),
        battery_inverter=dual.disc("battery_inverter_capacity", len(site.batteries)),
        pv_inverter=dual.disc("pv_inverter_capacity", len(site.pv)),
        voltage_floor=_per_milli_pu(dual.rows("voltage_min")[0], net.v_min_pu, net.bus_ratio),
        voltage_ceiling=_per_milli_pu(dual.rows("voltage_max")[0], net.v_max_pu, net.bus_ratio),
        # In an outage the limit meets the bound of 0 from the other side, and its own dual is not
        # unique; what an injection at the slack bus gains is.
        grid=max(float(active[0] - model.p.rho_dt.value[0]), 0.0),
        active=active,
        reactive=-dual.rows("reactive_power_balance")[0],
        service=(dual.rows("service_max") - dual.rows("service_min"))[0],
    )


def _per_milli_pu(per_pu2: Floats, limit_pu: float, ratio: Floats) -> Floats:
    """From a squared limit at the buses behind the slack bus to 0.001 pu at all buses."""
    return np.concatenate([[0.0], per_pu2 * 2.0 * limit_pu * 1e-3 / ratio[1:] ** 2])


class _Duals:
    """Duals of a solved problem by the names of its constraints."""

    def __init__(self, model: ShadowPriceModel) -> None:
        self.model = model

    def rows(self, name: str) -> Floats:
        """Dual of a constraint in the constraint's shape."""
        constraint = self.model.constraints[name]
        return np.reshape(np.asarray(constraint.dual_value, dtype=float), constraint.shape)

    def disc(self, name: str, count: int) -> Floats:
        """Value of one more kVA in the first step, from a cone or from a polygon's sides."""
        W = self.model.n_steps
        sides = self.model.sides
        if count == 0:
            return np.zeros(0)
        if sides:
            per_side = self.rows(name).reshape(sides, W, count)
            return np.asarray(per_side[:, 0].sum(axis=0) * np.cos(np.pi / sides))
        of_rating = np.asarray(self.model.constraints[name].dual_value[0], dtype=float)
        return np.asarray(of_rating.reshape(count, W)[:, 0])
