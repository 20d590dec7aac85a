"""Windows of a phased feeder at AC points of its phases.

Limits give way to what the feeder has without control, so that a window always has a dispatch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.control.linearisation import DEFAULT_PASSES, LOSS_TOLERANCE_KW, VOLTAGE_TOLERANCE_PU
from vppres.core.arrays import Complexes, Flags, Floats
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.beyond_paper.ratings import KEPT_SHARE, loading_of_phases
from vppres.model.data import PhasedWindow, WindowData
from vppres.model.linearise import Drawn
from vppres.model.own_state import COLLAPSED_PU2, giving_way, share_exported, sun_used_and_left
from vppres.model.parts import at_items
from vppres.model.phases import PhasedModel, PhasedPoints
from vppres.physics.phased_sources import farthest
from vppres.solve.phases import binding

FIRST_DAMPED = 3
"""Pass after which a window moves only halfway to the AC points: two candidates whose reactive
power differs may follow each other for ever otherwise."""


@dataclass(frozen=True, eq=False)
class PhasedLinearisation:
    """Linearisation of a phased site's windows, and its comparison with AC.

    The former's phases settle later than its voltages, so that a window has twice the passes.
    """

    model: PhasedModel

    passes: ClassVar[int] = 2 * DEFAULT_PASSES
    open_kw: ClassVar[float] = LOSS_TOLERANCE_KW

    def observed(self, observation: Observation) -> WindowData:
        """The observed window; what its network draws is that of its AC points."""
        return WindowData.of(observation, self.model.site, "none")

    def at_rest(self, data: WindowData) -> WindowData:
        """The window at the AC points with all customers supplied that can be: its first guess.

        In a step without power nothing holds a voltage, and capacitors burden no former.
        """
        nothing = np.zeros((data.n_steps, self.model.site.network.n_buses))
        data = replace(data, drawn=Drawn(nothing, nothing))
        lit = lit_steps(data)
        u, former, currents = self.model.at_no_load(data)
        former[data.dark & ~lit] = currents[data.dark & ~lit] = 0.0
        rated_kva = self.model.ratings_kva(data)
        kept_kva = np.maximum(self.model.headroom_kva(data), KEPT_SHARE * rated_kva)
        room = self.model.phase_kva(data, kept_kva)
        any_u = np.full_like(u, np.inf)
        none = np.zeros((data.n_steps, 2, u.shape[1]), dtype=bool)
        any_current, no_own = np.full(currents.shape, np.inf), np.zeros(currents.shape)
        phased = PhasedWindow(
            u, former, -any_u, any_u, room, none, 0.0 * former, currents, any_current, no_own
        )
        data = replace(data, phased=phased)
        p, q = self._without_control(data)
        points = self.model.points(data, p, q, lit)
        return self.at(data, p, q, points, lit & points.converged)

    def _without_control(self, data: WindowData) -> tuple[Floats, Floats]:
        """Power of assets without control: all are served with grid, and at rest in an island.

        Batteries are idle. PV power is used behind its meter, and beyond that exported as far as
        the connection takes it and the highest voltage allows.
        """
        site, load_kw = self.model.site, data.all_cold().load_kw
        # What is behind a line that is out has its own balance.
        own, spare = (
            np.where(at_items(data.parts.beyond, site.pv_bus), 0.0, each)
            for each in sun_used_and_left(site, data)
        )
        load_kw = np.where(at_items(data.parts.beyond, site.customer_bus), 0.0, load_kw)
        drawn = data.drawn
        network_kw = data.loss_kw + np.where(data.parts.beyond, 0.0, drawn.kw).sum(axis=1)
        u, with_all = (
            data.phased.u_offset + self.model.linear(data, *self._with_sun(data, kw))[0]
            for kw in (own, own + spare)
        )
        room = np.where(self.model.limited, site.feeder.v_max_pu**2 - u, np.inf)
        imported_kw = load_kw.sum(axis=1) - own.sum(axis=1) + network_kw
        share = share_exported(site, data, imported_kw, spare, with_all - u, room)
        return self._with_sun(data, own + share * spare)

    def _with_sun(self, data: WindowData, pv_kw: Floats) -> tuple[Floats, Floats]:
        """Power of assets with all customers and so much PV power; nothing in an island."""
        idle = np.zeros((data.n_steps, len(self.model.site.batteries)))
        pv = (pv_kw, np.zeros_like(pv_kw))
        load_kw = data.all_cold().load_kw
        p, q = self.model.powers(self.model.sources(data), load_kw, pv, (idle, idle))
        with_grid = data.with_grid[:, self.model.at_bus_of_assets]
        return p * with_grid, q * with_grid

    def known(self, data: WindowData, dispatch: Dispatch) -> tuple[Floats, Floats]:
        """Power of assets in a plan."""
        return self.model.drawn(data.for_service(dispatch.served), dispatch)

    def at_known(self, data: WindowData, rows: tuple[Floats, ...], steps: Flags) -> WindowData:
        """The window at what assets drew in some steps.

        A plan at rest has no losses, and its first set may be one too many.
        """
        p, q = rows
        points = self.model.points(data, p, q, steps)
        return self.at(data, p, q, points, steps & points.converged)

    def points(self, data: WindowData, dispatch: Dispatch) -> PhasedPoints:
        """AC points of a candidate, step by step."""
        return self.model.points(data, *self.known(data, dispatch), lit_steps(data))

    def closer(
        self, data: WindowData, dispatch: Dispatch, points: PhasedPoints, passes: int
    ) -> WindowData:
        """The window linearised at a candidate's AC points, or halfway there."""
        steps = lit_steps(data) & points.converged
        share = 1.0 if passes < FIRST_DAMPED else 0.5
        return self.at(data, *self.known(data, dispatch), points, steps, share)

    def finished(self, data: WindowData, dispatch: Dispatch) -> Dispatch:
        """The plan with its voltages by phase, and of each bus that farthest from 1 pu."""
        v_pu = self.v_pu(data, *self.known(data, dispatch))
        at_buses = farthest(v_pu, self.model.at_bus, self.model.site.network.n_buses)
        return replace(dispatch, v_pu=at_buses, v_node_pu=v_pu)

    def at(
        self,
        data: WindowData,
        p: Floats,
        q: Floats,
        points: PhasedPoints,
        steps: Flags,
        share: float = 1.0,
    ) -> WindowData:
        """The window linearised at AC points in some steps, or a share of the way there."""
        phased, drawn = data.phased, data.drawn
        u, former = self.model.linear(data, p, q)
        u, former = points.u_pu2 - u, points.source_kva - former
        currents = points.currents - self.model.currents(data, p, q)
        moved = share * steps[:, None]
        kw = drawn.kw + moved * (points.network_kw - drawn.kw)
        kvar = drawn.kvar + moved * (points.network_kvar - drawn.kvar)
        found = replace(
            phased,
            u_offset=phased.u_offset + moved * (u - phased.u_offset),
            former_offset=phased.former_offset + moved * (former - phased.former_offset),
            current_offset=phased.current_offset + moved * (currents - phased.current_offset),
            bound=self._binding(data, p, q, steps),
            former_kva=np.where(steps[:, None], points.source_kva, phased.former_kva),
        )
        return self._with_own_limits(replace(data, phased=found, drawn=Drawn(kw, kvar)))

    def _binding(self, data: WindowData, p: Floats, q: Floats, steps: Flags) -> Flags:
        """Limits that bind a candidate in its own window, as far as they gave way, (W, 2, m).

        Of these steps, (W,).
        """
        u = data.phased.u_offset + self.model.linear(data, p, q)[0]
        ways = [each.phased for each in giving_way(self.model.site, data)]
        room = [np.abs([u - way.u_min, way.u_max - u]) for way in ways]
        return binding(self.model, self.model.limits_at(data, steps), np.min(room, axis=0))

    def _with_own_limits(self, data: WindowData) -> WindowData:
        """Limits that give way to the feeder without control, of voltages in an island to rest.

        They are those of the window's own linearisation, so that this state is a dispatch of it.
        Hard limits of voltages give way in islands alone.
        """
        phased = data.phased
        net = self.model.site.feeder
        drawn = self._without_control(data)
        own = phased.u_offset + self.model.linear(data, *drawn)[0]
        given = self.model.site.soft_voltages | data.in_island[:, self.model.at_bus]
        own = np.where(given, np.maximum(own, COLLAPSED_PU2), np.nan)
        low, high = np.fmin(net.v_min_pu**2, own), np.fmax(net.v_max_pu**2, own)
        current = phased.current_own
        if self.model.site.soft_ratings:
            carried = loading_of_phases(self.model.site, data, *drawn)
            islands = np.asarray(data.in_island.any(axis=1))  # of all or of a part
            current = np.where(islands[:, None], 0.0, carried)
        limits = replace(phased, u_min=low, u_max=high, current_own=current)
        return replace(data, phased=limits)

    def v_pu(self, data: WindowData, p: Floats, q: Floats) -> Floats:
        """Voltages of the linear model, (W, m)."""
        u = data.phased.u_offset + self.model.linear(data, p, q)[0]
        return np.sqrt(np.maximum(u, 0.0))

    def agrees(self, data: WindowData, dispatch: Dispatch, points: PhasedPoints) -> bool:
        """Whether voltages, former and what the network draws agree in every step with power.

        No current that a plan keeps within its rating may be beyond it, nor a phase of the former.
        """
        lit = lit_steps(data)
        phased, drawn = data.phased, data.drawn
        p, q = self.known(data, dispatch)
        off_pu = np.abs(self.v_pu(data, p, q) - np.sqrt(points.u_pu2))[lit].max()
        off_kw = np.abs(points.network_kw - drawn.kw)[lit].max()
        former: Complexes = phased.former_offset + self.model.linear(data, p, q)[1]
        held = loading_of_phases(self.model.site, data, p, q) <= 1.0
        over = (held & (np.abs(points.currents) > 1.0))[lit]
        formed = self.model.formed(data) & lit[:, None]
        off_kva = np.abs(former - points.source_kva)[formed].max(initial=0.0)
        over_kva = np.abs(points.source_kva)[formed] > self.model.phase_kva(data)[formed]
        return bool(
            off_pu <= VOLTAGE_TOLERANCE_PU
            and off_kw <= LOSS_TOLERANCE_KW
            and off_kva <= LOSS_TOLERANCE_KW
            and not over.any()
            and not over_kva.any()
        )
