"""Windows of a phased feeder: solve, power flow by phase of the candidate, linearise, solve again.

Rows of voltages are stated only for nodes that a candidate has put outside its limits. Limits give
way to what the feeder has without control, so that a window always has a dispatch.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any, ClassVar

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.control.converged import (
    DEFAULT_HEADROOM,
    DEFAULT_PASSES,
    FIRST_SHARE,
    LOSS_TOLERANCE_KW,
    SOC_NUDGE,
    VOLTAGE_TOLERANCE_PU,
    dark_steps,
    in_the_dark,
    physics_of,
    without_power,
)
from vppres.core.arrays import Complexes, Flags, Floats
from vppres.core.errors import InfeasibleError, LimitError, NumericalError
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.beyond_paper.phases import out_of_limits
from vppres.model.data import PhasedWindow, WindowData
from vppres.model.linearise import Drawn
from vppres.model.phases import PhasedPoints, phased_model
from vppres.physics.phased_sources import farthest
from vppres.solve.deadline import Deadline
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import Status, WindowSolution

MOST_ROUNDS = 6
"""Times that nodes outside their limits are added to a window's rows."""

MOST_NEW = 12
"""Nodes that are added in a round, those farthest outside first."""

INSIDE_PU2 = 2e-5
"""By how much a squared voltage may leave its limit before its node gets rows: 1e-5 pu."""

PASSES = 2 * DEFAULT_PASSES
"""Passes of a window: the former's phases settle later than its voltages."""


class PhasedPlanner:
    """Plans windows of a phased site that its three-phase power flow agrees with.

    Parameters
    ----------
    solver : WindowSolver
        Solves the windows.
    headroom : float, optional
        Share of a grid-forming battery's rating, and of each phase of it, that stays free.
    passes : int, optional
        Largest number of solves and power flows of a window.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {"_watched": tuple[int, ...]}

    def __init__(
        self, solver: WindowSolver, headroom: float = DEFAULT_HEADROOM, passes: int = PASSES
    ) -> None:
        self.solver = solver
        self.headroom = headroom
        self.passes = passes
        self.model = phased_model(solver.site)
        self._watched: tuple[int, ...] = ()

    def plan(
        self, observation: Observation, n_steps: int | None = None, within_s: float = inf
    ) -> WindowSolution:
        """Solution of the observed window, or of its first steps.

        Raises
        ------
        SolveError
            If no dispatch was found.
        """
        site = self.solver.site
        whole = WindowData.of(observation, site, "none")
        whole = whole if n_steps is None else whole.first(n_steps)
        physics = physics_of(site, whole, self.headroom)
        dark = dark_steps(site, whole)
        data = replace(without_power(whole, dark), physics=physics)
        data = self._at_rest(data)
        deadline = Deadline(min(self.solver.limits.time_s, within_s))
        data, solution = self._decide(data, deadline.part(FIRST_SHARE))
        solution = self._converge(data, solution, deadline)
        return in_the_dark(site, whole, dark, solution, self.solver.limits)

    # Where a window is linearised.

    def _at_rest(self, data: WindowData) -> WindowData:
        """The window at the AC points of everyone served that can be: its first guess."""
        u, former = self.model.at_no_load(data.dark)
        room = self.model.rating_kva(data.require_physics().headroom_kw)
        phased = PhasedWindow(u, former, u, u, room, self._watched)
        n = data.n_steps
        nothing = np.zeros((n, self.solver.site.network.n_buses))
        data = replace(data, phased=phased, drawn=Drawn(nothing, nothing))
        p, q = self._without_control(data)
        lit = lit_steps(data) & ~data.dark
        points = self.model.points(data, p, q, lit)
        rest = np.zeros_like(p)
        in_island = lit_steps(data) & data.dark
        at_rest = self.model.points(data, rest, rest, in_island)
        data = self._at(data, p, q, points, lit & points.converged)
        return self._at(data, rest, rest, at_rest, in_island & at_rest.converged)

    def _without_control(self, data: WindowData) -> tuple[Floats, Floats]:
        """What assets draw with everyone served, PV power as it comes and batteries idle."""
        site = self.solver.site
        usable = np.minimum(data.pv_kw, site.pv.s_max_kva)
        load = np.minimum(data.load_kw.sum(axis=1), inf)[:, None]
        given = usable.sum(axis=1)[:, None]
        # An import-only connection takes no more PV power than is used.
        most = load + data.export_max_kw(site)[:, None]
        share = np.minimum(np.divide(most, given, where=given > 0, out=np.ones_like(given)), 1.0)
        idle = np.zeros((data.n_steps, len(site.batteries)))
        p = np.hstack([data.load_kw, -usable * share, idle])
        q = np.hstack([data.load_kw * site.customers.q_per_p, np.zeros_like(usable), idle])
        return p, q

    def _at(
        self, data: WindowData, p: Floats, q: Floats, points: PhasedPoints, steps: Flags
    ) -> WindowData:
        """The window linearised at AC points in some steps; the others stay as they are."""
        phased, drawn = data.phased, data.drawn
        assert phased is not None and drawn is not None
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
        phased = data.phased
        assert phased is not None
        net = self.solver.site.feeder
        p, q = self._without_control(data)
        p[data.dark] = q[data.dark] = 0.0
        own = phased.u_offset + self.model.linear(data, p, q)[0]
        low, high = np.minimum(net.v_min_pu**2, own), np.maximum(net.v_max_pu**2, own)
        return replace(data, phased=replace(phased, u_min=low, u_max=high))

    # Decisions and passes.

    def _decide(self, data: WindowData, deadline: Deadline) -> tuple[WindowData, WindowSolution]:
        """The served set, with rows for all nodes that it would put outside their limits."""
        solution = self._solved(data, deadline)
        for _ in range(MOST_ROUNDS):
            wider = self._wider(data, solution.dispatch)
            if wider is None or deadline.passed:
                break
            data = wider
            solution = self._solved(data, deadline)
        return data, solution

    def _solved(self, data: WindowData, deadline: Deadline) -> WindowSolution:
        """A window solved; states of charge that miss a need by rounding are nudged."""
        try:
            return self.solver.solve(data, deadline.left_s)
        except (InfeasibleError, NumericalError):
            b = self.solver.site.batteries
            soc = np.minimum(data.soc + SOC_NUDGE, b.soc_max)
            return self.solver.solve(replace(data, soc=soc), deadline.left_s)

    def _wider(self, data: WindowData, dispatch: Dispatch) -> WindowData | None:
        """The window with rows of nodes that a dispatch puts outside; None if there are none."""
        phased = data.phased
        assert phased is not None
        served = data.for_service(dispatch.served)
        p, q = self.model.drawn(served, dispatch)
        over = out_of_limits(self.solver.site, served, p, q)
        over = np.where(lit_steps(data)[:, None], over, -np.inf).max(axis=0)
        over[list(phased.watched)] = -np.inf
        worst = np.argsort(over)[::-1][:MOST_NEW]
        new = {int(i) for i in worst if over[i] > INSIDE_PU2}
        if not new:
            return None
        self._watched = tuple(sorted({*phased.watched, *new}))
        return replace(data, phased=replace(phased, watched=self._watched))

    def _converge(
        self, data: WindowData, solution: WindowSolution, deadline: Deadline
    ) -> WindowSolution:
        """The candidate at which model and power flow meet."""
        decided = solution
        lit = lit_steps(data)
        passes = 1
        decisions = 1
        while True:
            served = data.for_service(solution.dispatch.served)
            p, q = self.model.drawn(served, solution.dispatch)
            points = self.model.points(data, p, q, lit)
            agreed = self._agree(data, p, q, points, lit)
            closer = self._at(data, p, q, points, lit & points.converged)
            wider = self._wider(closer, solution.dispatch)
            if (agreed and wider is None) or passes >= self.passes or deadline.passed:
                break
            closer = wider or closer
            again = self.solver.solve_served(
                closer,
                solution.dispatch.served,
                solution.dispatch,
                keeps_turns=passes > 1,
                within_s=deadline.left_s,
            )
            if again is None:
                if decisions == 4:
                    break
                decisions += 1
                try:
                    again = decided = self.solver.solve(closer, deadline.left_s)
                except (InfeasibleError, NumericalError, LimitError):
                    break
            data, solution = closer, again
            passes += 1
        carried = bool(points.converged[lit].all())
        v = np.sqrt(np.maximum(self._model_u(data, p, q), 0.0))
        return replace(
            decided,
            status=decided.status if carried else Status.INACCURATE,
            dispatch=replace(solution.dispatch, v_pu=self.at_buses(v), v_node_pu=v),
            terms=solution.terms,
            loss_kw=solution.loss_kw,
            passes=passes,
        )

    def _model_u(self, data: WindowData, p: Floats, q: Floats) -> Floats:
        """Squared voltages of the linear model, (W, m)."""
        phased = data.phased
        assert phased is not None
        return phased.u_offset + self.model.linear(data, p, q)[0]

    def _agree(
        self, data: WindowData, p: Floats, q: Floats, points: PhasedPoints, lit: Flags
    ) -> bool:
        """Whether voltages, former and what the network draws agree in every step with power."""
        if not lit.any():
            return True
        if not points.converged[lit].all():
            return False
        phased, drawn = data.phased, data.drawn
        assert phased is not None and drawn is not None
        v = np.sqrt(np.maximum(self._model_u(data, p, q), 0.0))
        off_pu = np.abs(v - np.sqrt(points.u_pu2))[lit].max()
        off_kw = np.abs(points.network_kw - drawn.kw.sum(axis=1))[lit].max()
        former: Complexes = phased.former_offset + self.model.linear(data, p, q)[1]
        island = lit & data.dark
        off_kva = np.abs(former - points.source_kva)[island].max(initial=0.0)
        return bool(
            off_pu <= VOLTAGE_TOLERANCE_PU
            and off_kw <= LOSS_TOLERANCE_KW
            and off_kva <= LOSS_TOLERANCE_KW
        )

    def at_buses(self, v_pu: Floats) -> Floats:
        """Voltages of the network's buses, (W, N): of each that of the node farthest from 1 pu."""
        return farthest(v_pu, self.model.at_bus, self.solver.site.network.n_buses)
