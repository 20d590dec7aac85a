"""Model predictive control (paper, Section 4.2): solve the window, carry out its first step."""

from __future__ import annotations

from vppres.controllers.base import Decision, Observation, OnePass, Planner, SolveInfo
from vppres.controllers.switching import plan_with_rules
from vppres.model.linearise import Centre
from vppres.solve.methods import WindowSolver
from vppres.timegrid import TimeGrid


class MPCController:
    """Receding horizon ``t0 .. t0 + H``, cut at the end of the day.

    Parameters
    ----------
    solver : WindowSolver
        Solves the windows; compiled problems are kept between steps.
    grid : TimeGrid
        The day's steps.
    horizon_h : float
        Prediction horizon H in h; 0 looks at the current step only.
    centre : {"lossless", "literal", "none"}
        Linearisation centre of the voltages.
    planner : Planner, optional
        Plans the windows; one solve at the centre if not given.
    """

    def __init__(self, solver: WindowSolver, grid: TimeGrid, horizon_h: float,
                 centre: Centre = "lossless", planner: Planner | None = None) -> None:
        self.solver, self.grid, self.horizon_h, self.centre = solver, grid, horizon_h, centre
        self.planner = planner or OnePass(solver, centre)

    def horizon_steps(self, t0: int) -> range:
        """Steps of the window at ``t0``."""
        return self.grid.window(t0, self.horizon_h)

    def decide(self, observation: Observation) -> Decision:
        """Solve the observed window and take its first step."""
        solution, relaxed = plan_with_rules(self.planner, observation)
        return Decision(solution.dispatch, 0,
                        SolveInfo.of(solution, self.solver.cache.compilations, relaxed))
