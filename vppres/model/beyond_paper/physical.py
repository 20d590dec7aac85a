"""What physical mode changes in a window's problem: losses, the island's reference, headroom.

The paper's families that would not hold in an island are stated with other limits, under their
names: losses and ratings are arguments of the families, the rest is here. Every datum is a
parameter, so that a problem is compiled once. Why the paper's mode has none of these parameters,
at zero: ``docs/decisions/physical-parameters.md``.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Floats
from vppres.model.constraints import Named, battery_soc_limits
from vppres.model.data import Physics, WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

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
        shapes = {
            "P_loss": (W, N),
            "Q_loss": (W, N),
            "held": (W, N),
            "u_root_min": (W,),
            "u_root_max": (W,),
            "P_room": (W, B),
            "S_room": (W, B),
            "SoC_min": (W, B),
        }
        # A series capacitor gives reactive power where others lose it.
        signed = {"Q_loss"} if (site.network.x_ohm < 0).any() else set()
        return cls(
            **{
                name: cp.Parameter(shape, name=name, nonneg=name not in signed)
                for name, shape in shapes.items()
            }
        )

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        physics = data.require_physics()
        net = site.network
        island = physics.reference > 0
        values = {
            "P_loss": at_far_ends(physics.loss_kw),
            "Q_loss": at_far_ends(physics.loss_kvar),
            "held": np.eye(net.n_buses)[physics.reference],
            "u_root_min": np.where(island, net.v_min_pu**2, 0.0),
            "u_root_max": np.where(island, net.v_max_pu**2, _U_ANY),
            "P_room": active_room_kw(site, physics),
            "S_room": site.batteries.s_max_kva - physics.headroom_kw,
            "SoC_min": site.batteries.soc_min + physics.soc_reserve,
        }
        for f in fields(self):
            write(getattr(self, f.name), values[f.name])

    @property
    def rating(self) -> cp.Parameter | None:
        """Apparent power that plans may use, (W, B); None where there is no battery."""
        return self.S_room if self.S_room.shape[1] else None

    def in_island(self, named: Named, site: Site, v: Variables, p: Parameters) -> Named:
        """The constraints with the voltage held where it is, and batteries less their headroom."""
        if "voltage_slack" in named:
            kept = {name: c for name, c in named.items() if name != "voltage_slack"}
            named = kept | self._voltages(site, v)
        if len(site.batteries):
            named = named | self._headroom(v) | battery_soc_limits(site, v, p, self.SoC_min)
        return named

    def _voltages(self, site: Site, v: Variables) -> Named:
        """The voltage is held at the grid's bus, or at a battery's while the grid is away."""
        net = site.network
        held = cp.sum(cp.multiply(self.held, v.u), axis=1)
        u_held: cp.Expression | float = net.v_slack_pu**2
        if net.has_ratios:
            u_held = self.held @ net.u_pu2(net.held_pu)
        return {
            "voltage_reference": held == u_held,
            "root_voltage_min": v.u[:, 0] >= self.u_root_min,
            "root_voltage_max": v.u[:, 0] <= self.u_root_max,
        }

    def _headroom(self, v: Variables) -> Named:
        """Active power less the headroom, in both directions."""
        return {
            "headroom_charge": v.P_batt <= self.P_room,
            "headroom_discharge": -v.P_batt <= self.P_room,
        }


def active_room_kw(site: Site, physics: Physics) -> Floats:
    """Largest active power that a plan may ask of each battery, (W, B)."""
    return np.asarray(site.batteries.active_max_kw - physics.headroom_kw)


def at_far_ends(loss: Floats) -> Floats:
    """Losses of the lines (W, L) at the buses where they end, (W, N): line l ends at bus l + 1."""
    return np.pad(loss, ((0, 0), (1, 0)))
