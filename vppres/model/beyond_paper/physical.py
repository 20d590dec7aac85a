"""What physical mode changes in a window's problem: losses, the island's reference, headroom.

The paper's constraints are built first; those that would not hold in an island that batteries hold
are then stated anew under their names. Every datum is a parameter, so that a problem is compiled
once.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Floats
from vppres.model.constraints import Named
from vppres.model.data import Physics, WindowData
from vppres.model.site import Site
from vppres.model.variables import Variables

_U_ANY = 4.0  # no limit on the grid's squared voltage while the grid holds it


@dataclass(frozen=True, eq=False)
class PhysicalParameters:
    """What a window of W steps has beyond :class:`vppres.model.variables.Parameters`.

    ``P_loss`` and ``Q_loss`` are the lines' losses at the buses where they end; ``held`` marks the
    bus that holds the voltage; ``u_root_min`` and ``u_root_max`` limit the grid's bus where that is
    another one; ``P_room``, ``S_room`` and ``SoC_min`` are the batteries' limits less headroom.
    """

    P_loss: cp.Parameter
    Q_loss: cp.Parameter
    held: cp.Parameter
    u_root_min: cp.Parameter
    u_root_max: cp.Parameter
    P_room: cp.Parameter
    S_room: cp.Parameter
    SoC_min: cp.Parameter

    @classmethod
    def create(cls, site: Site, W: int) -> PhysicalParameters:
        """Parameters of a window of W steps."""
        N = site.network.n_buses
        B = len(site.batteries)
        shapes = {"P_loss": (W, N), "Q_loss": (W, N), "held": (W, N), "u_root_min": (W,),
                  "u_root_max": (W,), "P_room": (W, B), "S_room": (W, B), "SoC_min": (W, B)}
        return cls(**{name: cp.Parameter(shape, name=name, nonneg=True)
                      for name, shape in shapes.items()})

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        physics = data.require_physics()
        net = site.network
        island = physics.reference > 0
        values = {
            "P_loss": _at_far_ends(physics.loss_kw), "Q_loss": _at_far_ends(physics.loss_kvar),
            "held": np.eye(net.n_buses)[physics.reference],
            "u_root_min": np.where(island, net.v_min_pu**2, 0.0),
            "u_root_max": np.where(island, net.v_max_pu**2, _U_ANY),
            "P_room": active_room_kw(site, physics),
            "S_room": site.batteries.s_max_kva - physics.headroom_kw,
            "SoC_min": site.batteries.soc_min + physics.soc_reserve,
        }
        for f in fields(self):
            getattr(self, f.name).value = values[f.name]

    def amended(self, named: Named, site: Site, v: Variables) -> Named:
        """The paper's constraints with those restated that losses, island or headroom change."""
        changed = self._voltages(site, v) if "voltage_slack" in named else {}
        for name, loss in (("active_power_balance", self.P_loss),
                           ("reactive_power_balance", self.Q_loss),
                           ("total_power_balance", cp.sum(self.P_loss, axis=1))):
            if name in named:
                supply, demand = named[name].args
                changed[name] = supply == demand + loss
        if len(site.batteries):
            changed |= self._batteries(named, site, v)
        kept = {name: c for name, c in named.items() if name != "voltage_slack"}
        return kept | changed

    def _voltages(self, site: Site, v: Variables) -> Named:
        """The voltage is held at the grid's bus, or at a battery's while the grid is away."""
        return {
            "voltage_reference":
                cp.sum(cp.multiply(self.held, v.u), axis=1) == site.network.v_slack_pu**2,
            "root_voltage_min": v.u[:, 0] >= self.u_root_min,
            "root_voltage_max": v.u[:, 0] <= self.u_root_max,
        }

    def _batteries(self, named: Named, site: Site, v: Variables) -> Named:
        """Power, apparent power and energy less the headroom."""
        changed: Named = {
            "headroom_charge": v.P_batt <= self.P_room,
            "headroom_discharge": -v.P_batt <= self.P_room,
            "battery_soc_min": v.SoC[1:] >= self.SoC_min,
        }
        disc = named.get("battery_inverter_capacity")
        if isinstance(disc, cp.SOC):
            changed["battery_inverter_capacity"] = cp.SOC(
                cp.vec(self.S_room, order="F"), disc.args[1], axis=0)
        elif disc is not None:  # half planes, one block of rows for each angle
            blocks = disc.args[0].shape[0] // v.P_batt.shape[0]
            reach = disc.args[1].value / np.tile(site.batteries.s_max_kva,
                                                 (disc.args[1].shape[0], 1))
            changed["battery_inverter_capacity"] = (
                disc.args[0] <= cp.multiply(reach, cp.vstack([self.S_room] * blocks)))
        return changed


def active_room_kw(site: Site, physics: Physics) -> Floats:
    """Largest active power that a plan may ask of each battery, (W, B)."""
    return np.asarray(site.batteries.active_max_kw - physics.headroom_kw)


def _at_far_ends(loss: Floats) -> Floats:
    """Losses of the lines (W, L) at the buses where they end, (W, N): line l ends at bus l + 1."""
    return np.pad(loss, ((0, 0), (1, 0)))
