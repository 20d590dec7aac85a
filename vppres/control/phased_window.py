"""Windows of a phased feeder at AC points of its phases.

Limits give way to what the feeder has without control, so that a window always has a dispatch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.control.converged import LOSS_TOLERANCE_KW, VOLTAGE_TOLERANCE_PU
from vppres.core.arrays import Complexes, Flags, Floats
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.data import PhasedWindow, WindowData
from vppres.model.linearise import Drawn
from vppres.model.own_state import share_of
from vppres.model.phases import PhasedModel, PhasedPoints


@dataclass(frozen=True, eq=False)
class PhasedLinearisation:
    """Where windows of a phased site are linearised, and whether a plan is what AC says there."""

    model: PhasedModel

    def at_rest(self, data: WindowData, watched: tuple[int, ...]) -> WindowData:
        """The window at the AC points of everyone served that can be: its first guess."""
        u, former = self.model.at_no_load(data.dark)
        room = self.model.rating_kva(data.require_physics().headroom_kw)
        phased = PhasedWindow(u, former, u, u, room, watched)
        n = data.n_steps
        nothing = np.zeros((n, self.model.site.network.n_buses))
        data = replace(data, phased=phased, drawn=Drawn(nothing, nothing))
        p, q = self._without_control(data)
        lit = lit_steps(data) & ~data.dark
        points = self.model.points(data, p, q, lit)
        rest = np.zeros_like(p)
        in_island = lit_steps(data) & data.dark
        at_rest = self.model.points(data, rest, rest, in_island)
        data = self.at(data, p, q, points, lit & points.converged)
        return self.at(data, rest, rest, at_rest, in_island & at_rest.converged)

    def _without_control(self, data: WindowData) -> tuple[Floats, Floats]:
        """What assets draw with everyone served, PV power as it comes and batteries idle."""
        site = self.model.site
        usable = np.minimum(data.pv_kw, site.pv.s_max_kva)
        # An import-only connection takes no more PV power than is used.
        most = data.load_kw.sum(axis=1) + data.export_max_kw(site)
        share = share_of(most, usable.sum(axis=1))[:, None]
        idle = np.zeros((data.n_steps, len(site.batteries)))
        pv = (usable * share, np.zeros_like(usable))
        return self.model.powers(data.dark, data.load_kw, pv, (idle, idle))

    def at(
        self, data: WindowData, p: Floats, q: Floats, points: PhasedPoints, steps: Flags
    ) -> WindowData:
        """The window linearised at AC points in some steps; the others stay as they are."""
        phased, drawn = data.require_phased(), data.drawn
        assert drawn is not None
        u, former = self.model.offsets(data, p, q, points)
        here = steps[:, None]
        u = np.where(here, u, phased.u_offset)
        former = np.where(here, former, phased.former_offset)
        kw, kvar = drawn.kw.copy(), drawn.kvar.copy()
        at = data.require_physics().reference
        rows = np.flatnonzero(steps)
        kw[rows, at[rows]] = points.network_kw[rows]
        kvar[rows, at[rows]] = points.network_kvar[rows]
        found = replace(phased, u_offset=u, former_offset=former)
        data = replace(data, phased=found, drawn=Drawn(kw, kvar))
        return self._limited(data)

    def _limited(self, data: WindowData) -> WindowData:
        """Limits that give way to the voltages without control, and in an island to those at rest.

        They are those of the window's own linearisation, so that this state is a dispatch of it.
        """
        phased = data.require_phased()
        net = self.model.site.feeder
        p, q = self._without_control(data)
        p[data.dark] = q[data.dark] = 0.0
        own = phased.u_offset + self.model.linear(data, p, q)[0]
        low, high = np.minimum(net.v_min_pu**2, own), np.maximum(net.v_max_pu**2, own)
        return replace(data, phased=replace(phased, u_min=low, u_max=high))

    def v_pu(self, data: WindowData, p: Floats, q: Floats) -> Floats:
        """Voltages of the linear model, (W, m)."""
        u = data.require_phased().u_offset + self.model.linear(data, p, q)[0]
        return np.sqrt(np.maximum(u, 0.0))

    def agree(
        self, data: WindowData, p: Floats, q: Floats, points: PhasedPoints, lit: Flags
    ) -> bool:
        """Whether voltages, former and what the network draws agree in every step with power."""
        if not lit.any():
            return True
        if not points.converged[lit].all():
            return False
        phased, drawn = data.require_phased(), data.drawn
        assert drawn is not None
        off_pu = np.abs(self.v_pu(data, p, q) - np.sqrt(points.u_pu2))[lit].max()
        off_kw = np.abs(points.network_kw - drawn.kw.sum(axis=1))[lit].max()
        former: Complexes = phased.former_offset + self.model.linear(data, p, q)[1]
        island = lit & data.dark
        off_kva = np.abs(former - points.source_kva)[island].max(initial=0.0)
        return bool(
            off_pu <= VOLTAGE_TOLERANCE_PU
            and off_kw <= LOSS_TOLERANCE_KW
            and off_kva <= LOSS_TOLERANCE_KW
        )
