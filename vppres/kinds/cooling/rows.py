"""Cooling and heat: rooms and tanks with a comfort band, and machines that keep them in it.

The temperature follows from the power by the exact solution of one resistance and one capacity.
What is missed of the band has a price, so that nothing is ever infeasible. All of a window together
count a quarter of a step of the customer of the least weight. There are no binaries. Without
thermal loads no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.kinds.cooling import OF_A_STEP
from vppres.kinds.kind import price_scale
from vppres.model.beyond_paper.addition import Addition, AdditionDispatch, Taken
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import NOISE_KW, write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


@dataclass(frozen=True, eq=False)
class ThermalLoadsModel(Addition):
    """Variables and parameters of H rooms and tanks over W steps."""

    by_dispatch: ClassVar[tuple[str, ...]] = ("th_power", "th_temperature", "th_over", "th_under")
    met: ClassVar[tuple[str, ...]] = ("th_recursion", "th_warm", "th_cold", "th_served")

    site: Site  #: fixed data
    power: cp.Variable  #: power of the machines in kW, (W, H)
    #: Temperature at the end of the step in °C, and by how much it is outside the band, (W, H).
    temperature: cp.Variable
    over: cp.Variable
    under: cp.Variable
    keeps: cp.Parameter  #: see :class:`Recursion`, as the next two, (W, H)
    drift: cp.Parameter
    per_kw: cp.Parameter
    most: cp.Parameter  #: largest power, (W, H)
    lowest: cp.Parameter  #: comfort band, (W, H)
    highest: cp.Parameter
    price: cp.Parameter  #: price of a K over a step, in weighted customer hours, (W, H)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether there are any."""
        return (KIND in data.ahead.by_kind) or None

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """Rooms and tanks of a window."""
        size = (v.x_served.shape[0], len(site.thermal_loads))
        signs = {"keeps": True, "drift": False, "per_kw": False, "most": True}
        signs |= {"lowest": False, "highest": False, "price": True}
        return cls(
            site,
            cp.Variable(size, name="th_power", nonneg=True),
            cp.Variable(size, name="th_temperature"),
            cp.Variable(size, name="th_over", nonneg=True),
            cp.Variable(size, name="th_under", nonneg=True),
            **{
                name: cp.Parameter(size, name=f"th_{name}_by_step", nonneg=nonneg)
                for name, nonneg in signs.items()
            },
        )

    def taken(self, site: Site) -> dict[str, Taken]:
        """Power of the machines, which have a power factor of 1."""
        return {KIND: (self.power, None)}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Temperature from step to step, the band, and customers that are off."""
        before = np.eye(self.power.shape[0], k=-1) @ self.temperature
        moved = self.drift + cp.multiply(self.per_kw, self.power)
        served = v.x_served[:, site.thermal_loads.owner(site.customers)]
        return {
            "th_recursion": self.temperature == cp.multiply(self.keeps, before) + moved,
            "th_warm": self.temperature - self.over <= self.highest,
            "th_cold": self.temperature + self.under >= self.lowest,
            "th_served": self.power <= cp.multiply(self.most, served),
        }

    def terms(self) -> dict[str, cp.Expression]:
        """Penalty for temperatures outside the band."""
        return {"own": -cp.sum(cp.multiply(self.price, self.over + self.under))}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the rooms and tanks of a window."""
        rooms = data.ahead.known(KIND)
        moves = Recursion.of(site, rooms)
        write(self.keeps, moves.keeps)
        write(self.drift, moves.drift_c)
        write(self.per_kw, moves.c_per_kw)
        write(self.most, rooms.most_kw)
        write(self.lowest, rooms.t_min_c)
        write(self.highest, rooms.t_max_c)
        write(self.price, price_of(site, rooms))

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Penalty for temperatures outside the band."""
        rooms = data.ahead.known(KIND)
        _, over, under = temperatures(site, rooms, machine_kw(site, dispatch))
        return {"own": -float((price_of(site, rooms) * (over + under)).sum())}

    def of_dispatch(self, site: Site, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """Power and temperature of each."""
        power_kw = machine_kw(site, dispatch)
        letters = power_kw, *temperatures(site, data.ahead.known(KIND), power_kw)
        return AdditionDispatch(dict(zip(self.by_dispatch, letters, strict=True)))

    def read(self, found: Dispatch) -> Dispatch:
        """The power of each machine."""
        power_kw = np.reshape(np.asarray(self.power.value, dtype=float), self.power.shape)
        return found.acting(KIND, np.where(power_kw < NOISE_KW, 0.0, power_kw))


@dataclass(frozen=True, eq=False)
class Recursion:
    """Temperature at a step's end: ``keeps`` of the one before, a drift, and the power, (W, H)."""

    #: Part of the temperature before a step that is left at its end; 0 in the first step, of which
    #: ``drift_c`` has that part already.
    keeps: Floats
    drift_c: Floats  #: what surroundings and gains add to it
    c_per_kw: Floats  #: what a kW of the machine adds to it, negative for cooling

    @classmethod
    def of(cls, site: Site, rooms: Any) -> Self:
        """Coefficients of a window, :class:`vppres.kinds.cooling.physics.Rooms`."""
        loads = site.thermal_loads
        keeps = np.exp(-site.dt_h / (loads.r_c_per_kw * loads.c_kwh_per_c))
        outside_c, first = rooms.outside_c, np.isfinite(rooms.begins_c)
        around_c = np.where(np.isnan(loads.around_c), outside_c, loads.around_c)
        rest_c = around_c + loads.r_c_per_kw * rooms.gain_kw
        cop = np.maximum(loads.cop + loads.cop_per_c * (outside_c - loads.cop_at_c), 1.0)
        return cls(
            np.where(first, 0.0, keeps),
            (1.0 - keeps) * rest_c + np.where(first, keeps * rooms.begins_c, 0.0),
            (1.0 - keeps) * loads.r_c_per_kw * np.where(loads.heats, cop, -cop),
        )


def temperatures(site: Site, rooms: Any, power_kw: Floats) -> tuple[Floats, Floats, Floats]:
    """Temperature at the end of each step, and by how much it is outside the band, (W, H) each."""
    moves, now = Recursion.of(site, rooms), np.zeros(power_kw.shape[1])
    rows = []
    for keeps, added in zip(moves.keeps, moves.drift_c + moves.c_per_kw * power_kw, strict=True):
        now = keeps * now + added
        rows.append(now)
    t_c = np.array(rows).reshape(power_kw.shape)
    return t_c, np.maximum(t_c - rooms.t_max_c, 0.0), np.maximum(rooms.t_min_c - t_c, 0.0)


def price_of(site: Site, rooms: Any) -> Floats:
    """Price of a K outside the band over a step, in weighted customer hours, (W, H).

    All of a window without any power count a quarter of a step of the customer of the least weight:
    no service is given up for comfort.
    """
    _, over_c, under_c = temperatures(site, rooms, np.zeros_like(rooms.most_kw))
    least_weight = float(site.customers.weight.min())
    scale = price_scale(rooms.weight, (over_c + under_c) * site.dt_h, least_weight, site.dt_h)
    return np.asarray(site.dt_h * (OF_A_STEP * scale * rooms.weight))


def machine_kw(site: Site, dispatch: Dispatch) -> Floats:
    """Power of each machine, (W, H)."""
    return dispatch.taken_by(KIND, site.thermal_loads)


KIND, ROWS = "thermal_loads", ThermalLoadsModel
