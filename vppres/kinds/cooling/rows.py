"""Cooling and heat: rooms and tanks with a comfort band, and machines that keep them in it.

The temperature follows from the power by the exact solution of one resistance and one capacity.
What is missed of the band has a price, so that nothing is ever infeasible. All of a window together
count a quarter of a step of the customer of the least weight. There are no binaries. Without
thermal loads no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import ClassVar, Self

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.kinds.cooling.physics import Rooms
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
    #: See :class:`vppres.kinds.cooling.physics.Rooms`, (W, H).
    keeps: cp.Parameter
    drift: cp.Parameter
    per_kw: cp.Parameter
    most: cp.Parameter
    lowest: cp.Parameter
    highest: cp.Parameter
    price: cp.Parameter  #: price of a K over a step, in weighted customer hours, (W, H)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether there are any."""
        return (data.ahead.find(Rooms) is not None) or None

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
        return {"thermal_loads": (self.power, None)}

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
        rooms = data.ahead.known(Rooms)
        write(self.keeps, rooms.keeps)
        write(self.drift, rooms.drift_c)
        write(self.per_kw, rooms.c_per_kw)
        write(self.most, rooms.most_kw)
        write(self.lowest, rooms.t_min_c)
        write(self.highest, rooms.t_max_c)
        write(self.price, price_of(site, rooms))

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Penalty for temperatures outside the band."""
        rooms = data.ahead.known(Rooms)
        over, under = rooms.missed_c(rooms.t_c(machine_kw(site, dispatch)))
        return {"own": -float((price_of(site, rooms) * (over + under)).sum())}

    def of_dispatch(self, site: Site, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """Power and temperature of each."""
        rooms = data.ahead.known(Rooms)
        power_kw = machine_kw(site, dispatch)
        t_c = rooms.t_c(power_kw)
        over, under = rooms.missed_c(t_c)
        letters = zip(self.by_dispatch, (power_kw, t_c, over, under), strict=True)
        return AdditionDispatch(dict(letters))

    def read(self, found: Dispatch) -> Dispatch:
        """The power of each machine."""
        power_kw = np.reshape(np.asarray(self.power.value, dtype=float), self.power.shape)
        return found.acting("thermal_loads", np.where(power_kw < NOISE_KW, 0.0, power_kw))


def machine_kw(site: Site, dispatch: Dispatch) -> Floats:
    """Power of each machine, (W, H)."""
    return dispatch.taken_by("thermal_loads", site.thermal_loads)


def price_of(site: Site, rooms: Rooms) -> Floats:
    """Price of a K outside the band over a step, (W, H)."""
    return site.dt_h * rooms.price(float(site.customers.weight.min()), site.dt_h)


ROWS = ThermalLoadsModel
