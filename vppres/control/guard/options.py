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
    """Limits, fallbacks and errors that a guard works with.

    Parameters
    ----------
    tiers : tuple of str
        Names of the tiers, the most important first.
    protect_critical : bool
        Whether a customer of the first tier is served in every step that can serve it, whatever the
        plan would rather save the energy for.
    centre : {"lossless", "literal", "none"}
        Linearisation centre of the voltages.
    within : Tolerances
        What passes as a decision that can be carried out.
    physical : bool
        Whether batteries hold the islands, and so do not follow their set-points there.
    answers : tuple of type
        Errors that get a fallback; others are raised. In operation any error does: a step without
        an answer is worse than all of them.
    """

    tiers: tuple[str, ...]
    protect_critical: bool = False
    centre: Centre = "lossless"
    within: Tolerances = PAPER
    physical: bool = False
    answers: tuple[type[Exception], ...] = (Exception,)
