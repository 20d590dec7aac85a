"""Shadow prices: the pricing problem solved, and its duals read in the units of the record.

A shadow price is the slope of the optimum: what the objective would gain if one more unit of
something had been there. All of them belong to the first step of the window, but for the limits of
stored energy, which count over the whole window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats
from vppres.model.beyond_paper.ratings import FAMILY, rated_lines
from vppres.model.data import WindowData
from vppres.model.numerics import ROUNDING
from vppres.solve.limits import run_within_limits
from vppres.solve.phase_prices import PhasePrices
from vppres.solve.result import Status
from vppres.solve.shadow_price_model import FixedDecisions, PricedTerms, ShadowPriceModel
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
    line_rating : array, shape (L,)
        For 1 kVA more through each line; of a phased feeder through each phase of one, (k,).
    line_active, line_reactive : array, shape (N,)
        What ratings of lines make of the price of 1 kW or 1 kvar at each bus.
    grid : float
        For 1 kW more that may be imported, less its price.
    active, reactive : array, shape (N,)
        For 1 kW or 1 kvar put into each bus throughout the step.
    service : array, shape (C,)
        For serving each customer in the step: its weight less what its supply is worth to others.
    phases : PhasePrices or None
        What phases make of these prices; None for a balanced feeder.
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
    line_rating: Floats
    line_active: Floats
    line_reactive: Floats
    grid: float
    active: Floats
    reactive: Floats
    service: Floats
    phases: PhasePrices | None = None

    @property
    def former_phase(self) -> Floats:
        """For 1 kVA more on each phase of the former, (3,); none of a balanced feeder."""
        return np.zeros(0) if self.phases is None else self.phases.former


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
    model: ShadowPriceModel,
    data: WindowData,
    held: FixedDecisions,
    priced: PricedTerms,
    time_s: float = 20.0,
) -> PricedWindow | None:
    """Solve a window's pricing problem; None where it has no answer that the solver vouches for.

    Parameters
    ----------
    model : ShadowPriceModel
        Compiled for at least as many steps as the window has.
    data : WindowData
        The window as the controller saw it.
    held : FixedDecisions
        What is held of the record.
    priced : PricedTerms
        What is maximised.
    time_s : float
        Time limit in s.
    """
    model.price(data, held, priced)
    assert model.data is not None
    model.phase_rows = []
    outcome = run_within_limits(model.site, model.data, model, time_s, model.phase_rows)
    if outcome.status != Status.OPTIMAL:
        return None
    value = model.value_of
    W = data.n_steps
    return PricedWindow(
        value=outcome.value,
        served_share=np.clip(value("x_served")[:W], 0.0, 1.0),
        curtailed_kwh=float(value("P_curt").sum()) * model.site.dt_h,
        battery_kw=(value("P_ch") - value("P_dch"))[:W],
        soc=value("SoC")[: W + 1],
        prices=_prices(model),
        solver_s=outcome.solve_s,
    )


def _prices(model: ShadowPriceModel) -> ShadowPrices:
    """The duals in the record's units; the signs are those of a gain."""
    site = model.site
    net = site.network
    energy_kwh = site.batteries.energy_kwh
    mode = model.value_of("delta")[0]
    dual = model.dual
    # A demand on the right of the balance costs what an injection gains.
    active = -dual("active_power_balance")[0]
    line_rating, *at_buses = _of_lines(model)
    phases = PhasePrices.of(model)
    rho_dt = -model.factors["f2"] * model.statement.p.rho_dt.value[0]
    return ShadowPrices(
        stored_energy=dual("battery_soc_start") / energy_kwh,
        kept_energy=dual("battery_soc_dynamics")[0] / energy_kwh,
        energy_floor=dual("battery_soc_min").sum(axis=0) / energy_kwh,
        energy_ceiling=dual("battery_soc_max").sum(axis=0) / energy_kwh,
        battery_charging=dual("battery_charge_rated")[0] * mode,
        battery_discharging=dual("battery_discharge_rated")[0] * (1.0 - mode),
        battery_inverter=_of_discs(model, "battery_inverter_capacity"),
        pv_inverter=_of_discs(model, "pv_inverter_capacity"),
        voltage_floor=_per_milli_pu(dual("voltage_min")[0], net.v_min_pu, net.bus_ratio)
        if phases is None
        else phases.floor,
        voltage_ceiling=_per_milli_pu(dual("voltage_max")[0], net.v_max_pu, net.bus_ratio)
        if phases is None
        else phases.ceiling,
        line_rating=line_rating if phases is None else phases.rating,
        line_active=at_buses[0],
        line_reactive=at_buses[1],
        # In an outage the limit meets the bound of 0 from the other side, and its own dual is not
        # unique; what an injection at the slack bus gains is.
        grid=max(float(active[0] - rho_dt), 0.0),
        active=active,
        reactive=-dual("reactive_power_balance")[0],
        service=(dual("service_max") - dual("service_min"))[0],
        phases=phases,
    )


def _per_milli_pu(per_pu2: Floats, limit_pu: float, ratio: Floats) -> Floats:
    """From a squared limit at the buses behind the slack bus to 0.001 pu at all buses."""
    return np.concatenate([[0.0], per_pu2 * 2.0 * limit_pu * 1e-3 / ratio[1:] ** 2])


def _of_lines(model: ShadowPriceModel) -> tuple[Floats, Floats, Floats]:
    """Value of one more kVA through each line, and what of it a kW and a kvar at each bus has."""
    net = model.site.network
    rating = np.zeros(net.n_lines)
    if FAMILY in model.rows_of:
        of_rated = model.dual(FAMILY)[0].reshape(-1, model.n_steps)[:, 0]
        rating[rated_lines(model.site)] = np.maximum(of_rated, 0.0)
    flow = np.stack([model.value_of(name)[0] for name in ("P_flow", "Q_flow")])
    # No rating limits a flow without direction.
    direction = flow / np.maximum(np.hypot(*flow), ROUNDING)
    active, reactive = (rating * direction) @ net.downstream
    return rating, active, reactive


def _of_discs(model: ShadowPriceModel, name: str) -> Floats:
    """Value of one more kVA in the first step, from cones or from the sides of polygons."""
    W = model.n_steps
    dual = model.dual(name)
    if not model.sides:
        return np.asarray(dual[0].reshape(-1, W)[:, 0])
    per_side = dual.reshape(model.sides, W, -1)
    return np.asarray(per_side[:, 0].sum(axis=0) * np.cos(np.pi / model.sides))
