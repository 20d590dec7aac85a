"""Electric vehicles: energy that chargers give them, and take from them in a few places.

What a vehicle lacks when it leaves has a price, so that no departure is infeasible. The price is a
level of its own: all vehicles of a window together are worth less than half a step of the
customer of the least weight, and a kWh that is missed is dearer than any energy. Two-way chargers
have a binary for each step, as batteries have, since losing energy may be worth something where
PV power is curtailed. Without chargers no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats, Wholes
from vppres.kinds.kind import price_scale
from vppres.model.beyond_paper.addition import Addition, AdditionDispatch, Taken
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import NOISE_KW, write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

LATER_GBP_PER_KWH_H = 1e-6
"""Cost of charging a kWh an hour later: vehicles charge at once where that costs the same.
A day later costs less than the smallest difference of prices, 0.01 p."""


@dataclass(frozen=True, eq=False)
class Vehicles(Addition):
    """Variables and parameters of K chargers over W steps, of which V also discharge."""

    by_dispatch: ClassVar[tuple[str, ...]] = ("ev_charge", "ev_discharge", "ev_energy", "ev_short")
    met: ClassVar[tuple[str, ...]] = (
        "ev_energy",
        "ev_charging",
        "ev_full",
        "ev_lowest",
        "ev_needed",
        "ev_charging_served",
        "ev_charges",
        "ev_or_discharges",
        "ev_discharging_served",
    )

    site: Site  #: fixed data
    two_way: Wholes  #: positions of the chargers that discharge, (V,)
    #: Power at the connection in kW, (W, K); energy at the end of the step, and what lacks of it
    #: when the vehicle leaves, in kWh.
    charge: cp.Variable
    energy: cp.Variable
    short: cp.Variable
    #: Power that is given back, and 1 for a step in which a charger may charge, (W, V).
    discharge: cp.Variable | None
    charges: cp.Variable | None
    #: Largest powers, 0 where no vehicle is plugged in, or, to discharge, is known, (W, K), (W, V).
    P_most: cp.Parameter
    P_back: cp.Parameter
    #: See :class:`vppres.kinds.vehicles.physics.Plugged`, (W, K).
    stays: cp.Parameter
    held: cp.Parameter
    full: cp.Parameter
    lowest: cp.Parameter
    needed: cp.Parameter
    price: cp.Parameter  #: price of what lacks, in weighted customer hours per kWh, (W, K)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether a vehicle is plugged in."""
        return (KIND in data.ahead.by_kind and bool(data.ahead.known(KIND).here.any())) or None

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """Vehicles of a window."""
        W = v.x_served.shape[0]
        K = len(site.chargers)
        two_way = np.flatnonzero(site.chargers.two_way)
        V = len(two_way)
        every = {
            name: cp.Parameter((W, K), name=f"ev_{name}_by_step", nonneg=True)
            for name in ("stays", "held", "full", "lowest", "needed", "price")
        }
        return cls(
            site,
            two_way,
            cp.Variable((W, K), name="ev_charge", nonneg=True),
            cp.Variable((W, K), name="ev_energy", nonneg=True),
            cp.Variable((W, K), name="ev_short", nonneg=True),
            cp.Variable((W, V), name="ev_discharge", nonneg=True) if V else None,
            cp.Variable((W, V), name="ev_turn", boolean=True) if V else None,
            cp.Parameter((W, K), name="ev_P_most", nonneg=True),
            cp.Parameter((W, V), name="ev_P_back", nonneg=True),
            **every,
        )

    @property
    def drawn(self) -> cp.Expression:
        """Power that each charger takes from the network, (W, K)."""
        if self.discharge is None:
            return self.charge
        return self.charge - self.discharge @ np.eye(len(self.site.chargers))[self.two_way]

    def taken(self, site: Site) -> dict[str, Taken]:
        """Power of the chargers, which have a power factor of 1."""
        return {KIND: (self.drawn, None)}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Energy from step to step, limits, and what is needed at departure."""
        chargers = site.chargers
        W = v.x_served.shape[0]
        owned = np.flatnonzero(~chargers.alone)
        served = v.x_served[:, chargers.owner(site.customers)]
        before = np.eye(W, k=-1) @ self.energy
        stored = cp.multiply(site.dt_h * chargers.eta_charge[None, :], self.charge)
        if self.discharge is not None:
            each = np.diag(site.dt_h / chargers.eta_discharge)[self.two_way]
            stored = stored - self.discharge @ each
        rows: Named = {
            "ev_energy": self.energy == cp.multiply(self.stays, before) + self.held + stored,
            "ev_charging": self.charge <= self.P_most,
            "ev_full": self.energy <= self.full,
            "ev_lowest": self.energy >= self.lowest,
            "ev_needed": self.energy + self.short >= self.needed,
        }
        if len(owned):
            most = cp.multiply(self.P_most[:, owned], served[:, owned])
            rows["ev_charging_served"] = self.charge[:, owned] <= most
        if self.discharge is not None:
            assert self.charges is not None
            most = cp.multiply(self.P_most[:, self.two_way], self.charges)
            rows["ev_charges"] = self.charge[:, self.two_way] <= most
            back = cp.multiply(self.P_back, 1 - self.charges)
            rows["ev_or_discharges"] = self.discharge <= back
            of_owned = np.flatnonzero(~chargers.alone[self.two_way])
            if len(of_owned):
                back = cp.multiply(self.P_back, served[:, self.two_way])[:, of_owned]
                rows["ev_discharging_served"] = self.discharge[:, of_owned] <= back
        return rows

    def terms(self) -> dict[str, cp.Expression]:
        """Penalty for energy that vehicles lack, and the cost of charging later."""
        hours = self.site.dt_h * np.arange(self.charge.shape[0])
        later = LATER_GBP_PER_KWH_H * self.site.dt_h * hours
        return {
            "own": -cp.sum(cp.multiply(self.price, self.short)),
            "f2": later @ cp.sum(self.charge, axis=1),
        }

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the vehicles of a window."""
        plugged = data.ahead.known(KIND)
        chargers = site.chargers
        write(self.P_most, plugged.here * chargers.p_charge_kw)
        write(self.P_back, (plugged.known * chargers.p_discharge_kw)[:, self.two_way])
        write(self.stays, plugged.stays.astype(float))
        write(self.held, plugged.held_kwh)
        write(self.full, plugged.full_kwh)
        write(self.lowest, plugged.lowest_kwh)
        write(self.needed, plugged.needed_kwh)
        write(self.price, price_of(site, plugged))

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Penalty for energy that vehicles lack, and the cost of charging later."""
        plugged = data.ahead.known(KIND)
        power_kw = charging_kw(site, dispatch)
        energy_kwh = plugged.energy_kwh(power_kw)
        hours = site.dt_h * np.arange(len(power_kw))
        charged_kwh = site.dt_h * np.maximum(power_kw, 0.0).sum(axis=1)
        return {
            "own": -float((price_of(site, plugged) * plugged.short_kwh(energy_kwh)).sum()),
            "f2": LATER_GBP_PER_KWH_H * float(hours @ charged_kwh),
        }

    @classmethod
    def cost_range(
        cls, site: Site, data: WindowData, least_gbp: Floats, dearest_gbp: Floats
    ) -> tuple[Floats, Floats]:
        """All charging as late as can be."""
        most_kwh = site.dt_h * float(site.chargers.p_charge_kw.sum())
        hours = site.dt_h * np.arange(data.n_steps)
        return least_gbp, dearest_gbp + LATER_GBP_PER_KWH_H * hours * most_kwh

    def of_dispatch(self, site: Site, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """Power and energy of every vehicle."""
        plugged = data.ahead.known(KIND)
        power_kw = charging_kw(site, dispatch)
        energy_kwh = plugged.energy_kwh(power_kw)
        values: dict[str, Floats | float] = {
            "ev_charge": np.maximum(power_kw, 0.0),
            "ev_energy": energy_kwh,
            "ev_short": plugged.short_kwh(energy_kwh),
        }
        if self.discharge is not None:
            values["ev_discharge"] = np.maximum(-power_kw, 0.0)[:, self.two_way]
        return AdditionDispatch(values)

    def read(self, found: Dispatch) -> Dispatch:
        """The power of each charger."""
        power_kw = np.reshape(np.asarray(self.drawn.value, dtype=float), self.charge.shape)
        return found.acting(KIND, np.where(np.abs(power_kw) < NOISE_KW, 0.0, power_kw))


def charging_kw(site: Site, dispatch: Dispatch) -> Floats:
    """Power of each charger, (W, K), negative to discharge."""
    return dispatch.taken_by(KIND, site.chargers)


def price_of(site: Site, plugged: Any) -> Floats:
    """Price of a kWh that each vehicle lacks when it leaves, in weighted customer hours, (W, K)."""
    weight = np.where(plugged.due, plugged.weight, 0.0)
    least_weight = float(site.customers.weight.min())
    return price_scale(weight, plugged.full_kwh, least_weight, site.dt_h) * weight


KIND, ROWS = "chargers", Vehicles
