"""The options of a run."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from vppres.contract.forecast import ForecastErrors
from vppres.contract.operating_point import CENTRES, Centre
from vppres.control.baselines import ReserveRule
from vppres.control.converged import DEFAULT_HEADROOM, DEFAULT_PASSES
from vppres.control.full_horizon import PV_CHECKS, PVCheck
from vppres.core.errors import InputError, Problem
from vppres.physics.thermal import ThermalScheme
from vppres.scenario.rules import SwitchingRules
from vppres.solve.dispatch import POLYGON_SIDES
from vppres.solve.result import SolveLimits

CONTROLLERS = ("mpc", "full-horizon", "perfect", "idle", "reserve")
PERFECT = "perfect"
MODES = ("paper", "physical")


@dataclass(frozen=True)
class RunOptions:
    """How a day is run.

    Parameters
    ----------
    controller : {"mpc", "full-horizon", "perfect", "idle", "reserve"}
        Who decides; ``perfect`` is the full horizon without forecast errors, whatever ``errors``
        says.
    horizon_h : float
        Prediction horizon of the MPC in h.
    solver, method : str
        Names in the solver table and of the method.
    errors : ForecastErrors
        Forecast errors of load and PV.
    thermal : ThermalScheme
        Battery heating.
    seed : int
        Seed of the forecast errors.
    limits : SolveLimits
        Gaps and time limit of a window.
    polygon_sides : int
        Sides of an inverter's polygon where the solver needs one.
    centre : {"lossless", "literal", "none"}
        Linearisation centre of the voltages.
    pv_check : {"absorbing", "literal"}
        Reading of the full horizon's PV check.
    mode : {"paper", "physical"}
        The paper's island, or one that grid-forming batteries hold, planned with losses.
    headroom : float
        Physical mode: share of a grid-forming battery's inverter that plans leave free in an
        island.
    passes : int
        Physical mode: largest number of linearisations of a window.
    switching : SwitchingRules
        Rules on switching customers; none by default.
    guard : bool
        Whether decisions are checked and replaced where they cannot be carried out.
    protect_critical : bool
        Whether the guard serves the first tier in every step that can serve it.
    reserve : ReserveRule
        When and how far the controller ``reserve`` charges.
    """

    controller: str = "mpc"
    horizon_h: float = 5.0
    solver: str = "highs"
    method: str = "decomposed"
    errors: ForecastErrors = field(default_factory=ForecastErrors)
    thermal: ThermalScheme = "off"
    seed: int = 0
    limits: SolveLimits = field(default_factory=SolveLimits)
    polygon_sides: int = POLYGON_SIDES
    centre: Centre = "lossless"
    pv_check: PVCheck = "absorbing"
    mode: str = "paper"
    headroom: float = DEFAULT_HEADROOM
    passes: int = DEFAULT_PASSES
    switching: SwitchingRules = field(default_factory=SwitchingRules)
    guard: bool = True
    protect_critical: bool = False
    reserve: ReserveRule = field(default_factory=ReserveRule)

    def __post_init__(self) -> None:
        choices: dict[str, tuple[str, ...]] = {"controller": CONTROLLERS, "centre": CENTRES,
                                               "pv_check": PV_CHECKS, "mode": MODES}
        problems = [Problem("options", "is not known", f"Use one of: {', '.join(allowed)}.",
                            field=name, value=getattr(self, name))
                    for name, allowed in choices.items() if getattr(self, name) not in allowed]
        if not (np.isfinite(self.horizon_h) and self.horizon_h >= 0):
            problems.append(Problem("options", "must be zero or positive", "Give hours.",
                                    field="horizon_h", value=self.horizon_h))
        if not 0 <= self.headroom < 1:
            problems.append(Problem("options", "must be a share from 0 to below 1",
                                    "Give a share of the inverter's rating, for example 0.1.",
                                    field="headroom", value=self.headroom))
        if self.passes < 0:
            problems.append(Problem("options", "must not be negative", "Give a whole number from "
                                    "zero.", field="passes", value=self.passes))
        if problems:
            raise InputError(problems)

    def as_record(self) -> dict[str, Any]:
        """The options as JSON can hold them."""
        return asdict(self)
