"""A phased feeder: a row for each voltage that is watched, and discs of the former's phases.

Squared voltages and the former's power by phase are linear in what assets draw, with the slopes of
the source that holds the voltage (:mod:`vppres.model.phases`). Rows of both sources are stated for
all steps; in steps of the other one their limits are wide.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Floats
from vppres.model.beyond_paper.addition import Addition
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.phases import GRID, ISLAND, PhasedModel, phased_model
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

SIDES = 32
"""Sides of the polygon inside a phase's disc: it takes 0.5 % of the rating away."""

WIDE_PU2 = 100.0
"""A limit of squared voltages that no dispatch meets."""


@dataclass(frozen=True, eq=False)
class ThreePhases(Addition):
    """Letters of the former's power by phase, and the limits of a window of W steps."""

    of_network: ClassVar[tuple[str, ...]] = ("P_former", "Q_former")

    model: PhasedModel
    watched: tuple[int, ...]
    sources: tuple[int, ...]
    P_former: cp.Variable
    Q_former: cp.Variable
    limits: dict[int, tuple[cp.Parameter, cp.Parameter]]
    P_offset: cp.Parameter
    Q_offset: cp.Parameter
    room: cp.Parameter

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """The voltages that are watched, and which sources there are."""
        if data.phased is None:
            return None
        sources = tuple(
            source for source, steps in ((GRID, ~data.dark), (ISLAND, data.dark)) if steps.any()
        )
        return data.phased.watched, sources

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Any) -> Self:
        """Letters and parameters of a window."""
        watched, sources = shape
        W = v.P_grid.size
        model = phased_model(site)
        sources = tuple(s for s in sources if s < len(model.flows))

        def limit(name: str) -> cp.Parameter:
            return cp.Parameter((W, len(watched)), name=name)

        return cls(
            model,
            watched,
            sources,
            cp.Variable((W, 3), name="P_former"),
            cp.Variable((W, 3), name="Q_former"),
            {s: (limit(f"u_low_{s}"), limit(f"u_high_{s}")) for s in sources},
            cp.Parameter((W, 3), name="P_former_0"),
            cp.Parameter((W, 3), name="Q_former_0"),
            cp.Parameter((W,), name="former_room", nonneg=True),
        )

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Rows of voltages by source, and the former's phases where it is one."""
        found: Named = {}
        rows = list(self.watched)
        for source in self.sources if rows else ():
            slopes = self.model.slopes[source]
            u = self._linear(site, v, p, slopes.u_p[rows], slopes.u_q[rows], source)
            low, high = self.limits[source]
            found[f"node_voltage_min_{source}"] = u >= low
            found[f"node_voltage_max_{source}"] = u <= high
        return found | (self._former(site, v, p) if ISLAND in self.sources else {})

    def _former(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Power of the former's phases, and the polygons in their discs."""
        slopes = self.model.slopes[ISLAND]
        by_p, by_q = slopes.former_p, slopes.former_q
        P = self._linear(site, v, p, by_p.real, by_q.real, ISLAND)
        Q = self._linear(site, v, p, by_p.imag, by_q.imag, ISLAND)
        angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
        sides = [
            np.cos(angle) * self.P_former[:, phase] + np.sin(angle) * self.Q_former[:, phase]
            for phase in range(3)
            for angle in angles
        ]
        reach = float(np.cos(np.pi / SIDES))
        room = cp.reshape(reach * self.room, (self.room.size, 1), order="F")
        return {
            "former_active": self.P_former == self.P_offset + P,
            "former_reactive": self.Q_former == self.Q_offset + Q,
            "former_phases": room @ np.ones((1, len(sides))) >= cp.vstack(sides).T,
        }

    def _linear(
        self, site: Site, v: Variables, p: Parameters, by_p: Floats, by_q: Floats, source: int
    ) -> cp.Expression:
        """What slopes (rows, D) make of the assets' powers, (W, rows)."""
        C, P = len(site.customers), len(site.pv)
        if source == ISLAND and self.model.former_device is not None:
            by_p, by_q = by_p.copy(), by_q.copy()
            by_p[:, self.model.former_device] = by_q[:, self.model.former_device] = 0.0
        of_customers = by_p[:, :C] + by_q[:, :C] * site.customers.q_per_p
        total = cp.multiply(p.P_load, v.x_served) @ of_customers.T
        if P:
            total = total - (v.P_self + v.P_exp) @ by_p[:, C : C + P].T
            total = total - v.Q_pv @ by_q[:, C : C + P].T
        if len(site.batteries):
            total = total + v.P_batt @ by_p[:, C + P :].T - v.Q_batt @ by_q[:, C + P :].T
        return total

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        phased = data.phased
        assert phased is not None
        rows = list(self.watched)
        for source, (low, high) in self.limits.items():
            if not rows:
                break
            here = (data.dark if source == ISLAND else ~data.dark)[:, None]
            offset = phased.u_offset[:, rows]
            write(low, np.where(here, phased.u_min[:, rows] - offset, -WIDE_PU2))
            write(high, np.where(here, phased.u_max[:, rows] - offset, WIDE_PU2))
        island = data.dark[:, None]
        write(self.P_offset, np.where(island, phased.former_offset.real, 0.0))
        write(self.Q_offset, np.where(island, phased.former_offset.imag, 0.0))
        write(self.room, np.where(data.dark, phased.room_kva, _any_kva(site, data)))


def _any_kva(site: Site, data: WindowData) -> float:
    """More than all assets together draw or give."""
    ratings = site.batteries.s_max_kva.sum() + site.pv.s_max_kva.sum()
    load = (data.load_kw @ (1.0 + np.abs(site.customers.q_per_p))).max(initial=0.0)
    return float(2.0 * (ratings + load))


def out_of_limits(site: Site, data: WindowData, p_kw: Floats, q_kvar: Floats) -> Floats:
    """By how much linear squared voltages leave their limits, (W, m); negative inside."""
    phased = data.require_phased()
    model = phased_model(site)
    u = phased.u_offset + model.linear(data, p_kw, q_kvar)[0]
    over = np.maximum(u - phased.u_max, phased.u_min - u)
    return np.where(model.limited[None, :], over, -np.inf)
