"""Options of a guard."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vppres.contract.operating_point import Centre
from vppres.control.guard.check import PAPER, Tolerances
from vppres.model.site import Site
from vppres.solve.ladder import WindowSolver

SolverOf = Callable[[Site], WindowSolver]


@dataclass(frozen=True)
class GuardOptions:
    """Limits, fallbacks and errors that a guard works with."""

    tiers: tuple[str, ...]  #: names of the tiers, the most important first
    #: Whether a customer of the first tier is served in every step that can serve it, whatever the
    #: plan would rather save the energy for.
    protect_critical: bool = False
    centre: Centre = "lossless"  #: linearisation centre of the voltages
    within: Tolerances = PAPER  #: what passes as a decision that can be carried out
    #: Whether batteries hold the islands, and so do not follow their set-points there.
    physical: bool = False
    #: Errors that get a fallback; others are raised. In operation any error does: a step without an
    #: answer is worse than all of them.
    answers: tuple[type[Exception], ...] = (Exception,)
