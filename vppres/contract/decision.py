"""Decision of a controller, and the interface of controllers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields
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


UNDIMMED = "{} cannot be dimmed"
"""How a record's ``estimated`` names a customer that had to get its whole demand, before why."""


def undimmed(estimated: str, names: Iterable[object]) -> Flags | None:
    """Which customers a decision could not dim, by what its record says, (C,); None for none.

    Examples
    --------
    >>> undimmed("soc b01 is late; shop cannot be dimmed (no relay)", ["shop", "p"]).tolist()
    [True, False]
    """
    said = estimated.split("; ")
    found = [any(one.startswith(UNDIMMED.format(name)) for one in said) for name in names]
    return np.array(found) if any(found) else None


LEAST_OBJECTIVE = 0.01
"""Gaps are relative to the objective, or to this many weighted customer hours where it is smaller:
half of a low-priority customer for an hour, below which no objective differs from zero."""


@dataclass(frozen=True, eq=False)
class SolveInfo:
    """How a dispatch was found, and what is proven about it; NaN where nothing was solved."""

    #: Paper's objective F of the dispatch and a proven upper bound on it.
    objective: float = np.nan
    bound: float = np.nan
    status: str = "not_solved"
    #: How much more service (f1 and f3 as weighted) could at most be had, in weighted customer
    #: hours.
    service_gap: float = np.nan
    #: How much cheaper the same service could at most be had, over all supply schedules, in GBP.
    cost_gap_gbp: float = np.nan
    #: Wall time of the window in seconds, and the part of it inside solvers.
    solve_s: float = 0.0
    solver_s: float = 0.0
    #: What was solved, in order, with its solver and, if not optimal, its status:
    #: ``service[highs]``, ``tie_breakers[clarabel]:infeasible``.
    stages: tuple[str, ...] = ()
    #: Linearisations that the dispatch took; with more than one, objective, bound and gaps are
    #: those of the window as it was linearised when the supply schedule was decided.
    passes: int = 1
    compilations: int = 0  #: problems that the solver had compiled by then
    switching_relaxed: bool = False  #: whether duties of the past were dropped for an answer
    levels: str = ""  #: units that each tier gets in strict order, and could at most
    moved_kw: float = np.nan  #: by how much batteries leave the plan before
    stored_value_gbp_per_kwh: float = np.nan  #: what one more stored kWh is worth later

    @property
    def figures(self) -> SolveInfo:
        """Figures alone: a solution has its window's dispatch beside them."""
        return SolveInfo(**{f.name: getattr(self, f.name) for f in fields(SolveInfo)})

    @property
    def gap_abs(self) -> float:
        """Certified absolute gap."""
        return max(self.bound - self.objective, 0.0)

    @property
    def gap(self) -> float:
        """Certified gap relative to the objective."""
        if np.isinf(self.bound):
            return np.inf
        return self.gap_abs / max(abs(self.objective), LEAST_OBJECTIVE)


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

    @property
    def step(self) -> Dispatch:
        """The step that is decided, one row."""
        return self.dispatch.step(self.row)


class Decider(Protocol):
    """Interface of what decides one step at a time: controllers, and the guard around them."""

    def horizon_steps(self, t0: int) -> range:
        """Steps for which it wants a forecast at step ``t0``."""

    def decide(self, observation: Observation) -> Decision:
        """Set-points of step ``observation.t0``."""
