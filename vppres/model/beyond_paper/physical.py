"""Physical mode in a window's problem: losses, the island's reference, headroom.

The paper's families that would not hold in an island have other limits, under their names: losses
and ratings are parameters of the families, the rest is here. Every datum is a
parameter, so that a problem is compiled once. Why the paper's mode has none of these parameters,
at zero: ``docs/decisions/physical-parameters.md``.
"""

from __future__ import annotations

from collections.abc import Hashable
from itertools import chain

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import ModelError
from vppres.kinds.table import KINDS
from vppres.model.beyond_paper.addition import Addition
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.linearise import Drawn
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

_U_ANY = 4.0  # no limit on the grid's squared voltage while the grid holds it


class PhysicalMode(Addition):
    """Parameters of physical mode beyond :class:`vppres.model.variables.Parameters`, for W steps.

    ``P_loss`` and ``Q_loss`` are the lines' losses at the buses where they end; ``held`` marks the
    bus that holds the voltage, of those that may; ``u_root_min`` and ``u_root_max`` limit the
    grid's bus where that is another one; ``P_room``, ``S_room`` and ``SoC_min`` are the batteries'
    limits less headroom.
    """

    replaces = ("voltage_slack",)
    draws = True

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        W, N = v.u.shape
        B = len(site.batteries)
        self.P_loss = cp.Parameter((W, N), name="P_loss", nonneg=True)
        # A series capacitor gives reactive power where others lose it.
        self.Q_loss = cp.Parameter((W, N), name="Q_loss")
        self.held = cp.Parameter((W, len(holding_buses(site))), name="held", nonneg=True)
        self.u_root_min = cp.Parameter(W, name="u_root_min", nonneg=True)
        self.u_root_max = cp.Parameter(W, name="u_root_max", nonneg=True)
        self.P_room = cp.Parameter((W, B), name="P_room", nonneg=True)
        self.S_room = cp.Parameter((W, B), name="S_room", nonneg=True)
        self.SoC_min = cp.Parameter((W, B), name="SoC_min", nonneg=True)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether the window is physical."""
        return bool(data.physics) or None

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        physics = data.physics
        if not physics:
            raise ModelError("A physical problem was filled with a window of the paper's mode.")
        net = site.network
        island = physics.reference > 0
        write(self.P_loss, at_far_ends(physics.loss_kw))
        write(self.Q_loss, at_far_ends(physics.loss_kvar))
        write(self.held, physics.reference[:, None] == holding_buses(site))
        write(self.u_root_min, np.where(island, net.v_min_pu**2, 0.0))
        write(self.u_root_max, np.where(island, net.v_max_pu**2, _U_ANY))
        write(self.P_room, data.active_max_kw(site.batteries))
        write(self.S_room, site.batteries.s_max_kva - physics.headroom_kw)
        write(self.SoC_min, data.soc_min(site.batteries))

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """Losses as a demand; ratings and lowest states of charge, if there are batteries."""
        limits = {"S_max": self.S_room, "SoC_min": self.SoC_min} if len(site.batteries) else {}
        return {"P_added": self.P_loss, "Q_added": self.Q_loss, **limits}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """The voltage held where it is, and batteries less their headroom."""
        rows = self._voltages(site, v)
        if len(site.batteries):
            rows["headroom_charge"] = v.P_batt <= self.P_room
            rows["headroom_discharge"] = -v.P_batt <= self.P_room
        return rows

    def implied(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Headroom of batteries whose modes exclude each other."""
        return {"headroom_power": v.P_ch + v.P_dch <= self.P_room}

    def _voltages(self, site: Site, v: Variables) -> Named:
        """The voltage is held at the grid's bus, or at a battery's while the grid is away."""
        net = site.network
        held = cp.sum(cp.multiply(self.held, v.u[:, holding_buses(site)]), axis=1)
        u_held: cp.Expression | float = net.v_slack_pu**2
        if net.has_ratios:
            u_held = self.held @ net.u_pu2(net.held_pu)[holding_buses(site)]
        return {
            "voltage_reference": held == u_held,
            "root_voltage_min": v.u[:, 0] >= self.u_root_min,
            "root_voltage_max": v.u[:, 0] <= self.u_root_max,
        }


def holding_buses(site: Site) -> Wholes:
    """Buses at which something may hold the voltage: the grid, a battery or a unit of a kind.

    cvxpy takes a minute and 6 GB for a product with a parameter of each of 5,000 buses.
    """
    may_form = (
        units.buses(site.customers) for kind, units in site.kinds.items() if KINDS[kind].forms
    )
    buses = [site.network.bus_index[bus] for bus in chain(site.batteries.bus, *may_form)]
    return np.unique(np.array([0, *buses], dtype=int))


def taken_by_network(site: Site, data: WindowData) -> Drawn:
    """Power that the network takes at each bus: its own draw, and losses where lines end."""
    nothing = np.zeros((data.n_steps, site.network.n_buses))
    found = data.drawn or Drawn(nothing, nothing)
    if not data.physics:
        return found
    lost = (at_far_ends(each) for each in (data.physics.loss_kw, data.physics.loss_kvar))
    return Drawn(*(own + more for own, more in zip((found.kw, found.kvar), lost, strict=True)))


def at_far_ends(loss: Floats) -> Floats:
    """Losses of the lines (W, L) at the buses where they end, (W, N): line l ends at bus l + 1."""
    return np.pad(loss, ((0, 0), (1, 0)))
