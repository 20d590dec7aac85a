"""What a controller sees and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vppres.forecast import Forecast
from vppres.model.data import Dispatch, Site, WindowData
from vppres.model.linearise import Centre, OperatingPoint, delta_offset
from vppres.model.moves import Moves
from vppres.model.switching import SwitchingState
from vppres.solve.methods import WindowSolver
from vppres.solve.result import WindowSolution

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Observation:
    """What may be known at the beginning of a step: forecasts and measurements, no future truth.

    Parameters
    ----------
    t0 : int
        The step to decide on.
    forecast : Forecast
        Forecast of the window; its first step is the actual one.
    soc, eta_charge, eta_discharge : array, shape (B,)
        Measured state of charge and efficiencies.
    operating_point : OperatingPoint or None
        Last AC operating point, None before the first.
    switching : SwitchingState, optional
        Switching rules and what was really served so far; None without rules.
    moves : Moves, optional
        The plan before, where the controller is to stay near it.
    battery_kw : array, shape (B,), optional
        Measured charging power of the step before, negative where discharged.
    online : array of bool, shape (B,), optional
        Batteries that report to be able to work; all if not given.
    """

    t0: int
    forecast: Forecast
    soc: Floats
    eta_charge: Floats
    eta_discharge: Floats
    operating_point: OperatingPoint | None = None
    switching: SwitchingState | None = None
    moves: Moves | None = None
    battery_kw: Floats | None = None
    online: NDArray[np.bool_] | None = None

    def window(self, site: Site, centre: Centre) -> WindowData:
        """The data of the window's problem."""
        f = self.forecast
        W = len(f.price_gbp_per_kwh)
        rules = None if self.switching is None else self.switching.window(W)
        offset = delta_offset(site.network, self.operating_point, centre)
        return WindowData(f.load_kw, f.pv_kw, f.price_gbp_per_kwh, f.grid_limit_kw, self.soc,
                          self.eta_charge, self.eta_discharge,
                          np.tile(offset, (W, 1)), switching=rules,
                          moves=self.moves)


@dataclass(frozen=True)
class SolveInfo:
    """How a decision was found, for the record."""

    objective: float = np.nan
    bound: float = np.nan
    gap: float = np.nan
    gap_abs: float = np.nan
    gap_service: float = np.nan
    gap_cost_gbp: float = np.nan
    status: str = "not_solved"
    solve_s: float = 0.0
    solver_s: float = 0.0
    compilations: int = 0
    stages: str = ""
    passes: int = 1
    switching_relaxed: bool = False
    moved_kw: float = np.nan

    @classmethod
    def of(cls, solution: WindowSolution, compilations: int,
           switching_relaxed: bool = False) -> SolveInfo:
        """Record of a window's solution."""
        return cls(solution.objective, solution.bound, solution.gap, solution.gap_abs,
                   solution.service_gap, solution.cost_gap_gbp, str(solution.status),
                   solution.solve_s, solution.solver_s, compilations, " ".join(solution.stages),
                   solution.passes, switching_relaxed)


@dataclass(frozen=True, eq=False)
class Decision:
    """Set-points of one step: row ``row`` of a dispatch.

    Parameters
    ----------
    dispatch : Dispatch
        The plan that the step is taken from.
    row : int
        The step's row in the plan.
    info : SolveInfo
        How the plan was found; empty where an old plan is followed.
    corrected : bool
        Whether a plan was overruled for this step.
    reason : str
        Why it was.
    fallback : str
        What took the place of the controller's own answer, ``none`` if nothing did.
    fallback_reason : str
        Why it had to, and what it leaves open.
    estimated : str
        Measurements that were estimated and batteries that are out, in words.
    """

    dispatch: Dispatch
    row: int = 0
    info: SolveInfo = field(default_factory=SolveInfo)
    corrected: bool = False
    reason: str = ""
    fallback: str = "none"
    fallback_reason: str = ""
    estimated: str = ""


class Planner(Protocol):
    """Turns an observation into the solution of its window."""

    def plan(self, observation: Observation, n_steps: int | None = None) -> WindowSolution:
        """Solution of the observed window, or of its first steps."""


@dataclass(frozen=True, eq=False)
class OnePass:
    """The paper's mode: one solve, linearised at the last AC point.

    Parameters
    ----------
    solver : WindowSolver
        Solves the windows.
    centre : {"lossless", "literal", "none"}
        Linearisation centre of the voltages.
    """

    solver: WindowSolver
    centre: Centre = "lossless"

    def plan(self, observation: Observation, n_steps: int | None = None) -> WindowSolution:
        """Solution of the observed window, or of its first steps."""
        data = observation.window(self.solver.site, self.centre)
        return self.solver.solve(data if n_steps is None else data.first(n_steps))


class Controller(Protocol):
    """A controller decides one step at a time."""

    def horizon_steps(self, t0: int) -> range:
        """Steps for which it wants a forecast at step ``t0``."""

    def decide(self, observation: Observation) -> Decision:
        """Set-points of step ``observation.t0``."""
