"""Decision of a controller, and the interface of controllers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.core.arrays import Flags, Floats

OUT = "battery {} is out"
"""How a record's ``estimated`` names a battery that was left out of a decision."""


def batteries_out(estimated: str, names: Iterable[object]) -> Flags:
    """Which batteries a decision left out, by what its record says, shape (B,).

    Examples
    --------
    >>> batteries_out("soc b01 is late; battery b02 is out", ["b01", "b02"]).tolist()
    [False, True]
    """
    said = set(estimated.split("; "))
    return np.array([OUT.format(name) in said for name in names], dtype=bool)


@dataclass(frozen=True)
class SolveInfo:
    """Figures of a decision's solution, for the record."""

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
    levels: str = ""
    moved_kw: float = np.nan
    stored_value_gbp_per_kwh: float = np.nan


@dataclass(frozen=True, eq=False)
class Switched:
    """The configuration of a step in which switches may move, and why it is this one."""

    closed: Flags  #: lines and ties that are closed, (E,)
    moved: str = ""  #: operations of the step, in words
    #: The operations one after another, each with what it does and the least margin after it.
    order: tuple[str, ...] = ()
    ahead: str = ""  #: operations that the plan counts on, but that wait
    #: What they are worth over the window, in weighted customer hours, beyond their price.
    gain: float = 0.0
    #: Configurations in reach, how many ways of cutting the feeder were bounded for all of them,
    #: and how many were planned.
    configurations: int = 0
    bounded: int = 0
    planned: int = 0
    why: str = ""  #: why switches move, and what it serves, or why none does
    #: The configuration that an operator is to bring about, where operations are proposed, (E,).
    proposed: Flags | None = None
    #: Steps from this one on for which it serves that; 0 where no customer is on for it.
    until: int = 0


@dataclass(frozen=True, eq=False)
class Decision:
    """Set-points of one step: row ``row`` of a dispatch."""

    dispatch: Dispatch  #: the plan that the step is taken from
    row: int = 0  #: the step's row in the plan
    #: How the plan was found; empty where an old plan is followed.
    info: SolveInfo = field(default_factory=SolveInfo)
    corrected: bool = False  #: whether a plan was overruled for this step
    reason: str = ""  #: why it was
    fallback: str = "none"  #: what replaced the controller's own answer, ``none`` if nothing did
    fallback_reason: str = ""  #: why it had to, and what it leaves open
    estimated: str = ""  #: measurements that were estimated and batteries that are out, in words
    weight: Floats | None = None  #: the customers' weights, where they are not the site's, (C,)
    seen: Observation | None = None  #: what was taken for true, where that is not what was read
    #: The configuration, in whose order buses and lines stand; None where no switch moves.
    switched: Switched | None = None


class Decider(Protocol):
    """Interface of what decides one step at a time: controllers, and the guard around them."""

    def horizon_steps(self, t0: int) -> range:
        """Steps for which it wants a forecast at step ``t0``."""

    def decide(self, observation: Observation) -> Decision:
        """Set-points of step ``observation.t0``."""
