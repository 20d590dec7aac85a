"""Most service, then the least cost of as much, by any relaxation that counts service in units.

The proofs are in ``docs/method.md``, *Why the bounds hold*.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from vppres.core.arrays import Flags
from vppres.model.numerics import ROUNDING
from vppres.solve.certificate import Candidate, cost_gap_gbp
from vppres.solve.deadline import HALF, Deadline
from vppres.solve.fleet.relaxation import weight_grid
from vppres.solve.programs import HALF_UNIT, WHOLE_GAP
from vppres.solve.result import Outcome
from vppres.solve.task import COST_SHARE, WindowTask


class Relaxation(ABC):
    """A relaxation of a window whose service is a multiple of a unit, less what is curtailed.

    Attributes
    ----------
    stage : str
        Beginning of the names of its stages.
    is_last : bool
        Whether none that is closer to the whole problem counts service.
    searches_cost : bool
        Whether a search for a cheaper set is worth its time.
    deadline : Deadline
        When service and cost must be done.
    unit : float
        Granularity of the weights.
    """

    stage = ""
    is_last = False
    searches_cost = True

    def __init__(self, task: WindowTask, deadline: Deadline) -> None:
        self.task = task
        self.site = task.site
        self.data = task.data
        self.cache = task.cache
        self.deadline = deadline
        self.unit = weight_grid(task.site.customers.weight * task.site.dt_h)

    @abstractmethod
    def service(self, gap: float) -> tuple[Outcome, Flags | None]:
        """Most service in units, and a set that has it."""

    def counted(self, best: Candidate) -> tuple[float, float]:
        """Service and cost (GBP) of a dispatch, as the relaxation tells them apart."""
        return best.service, best.terms.f2

    @abstractmethod
    def least_cost(self, units_min: float, everyone: bool) -> Outcome:
        """Least cost of shares of customers with so many units, in GBP.

        With ``everyone`` all customers are supplied in steps without a limit of import.
        """

    @abstractmethod
    def cheaper(
        self, units_min: float, everyone: bool, best: Candidate, gap_gbp: float, deadline: Deadline
    ) -> tuple[Outcome, Flags | None]:
        """Least cost of all sets with so many units, and a set that is cheaper than the best."""

    @abstractmethod
    def keep(self, served: Flags) -> None:
        """Keep the dispatch of a set if it is the best so far."""


def service_then_cost(relaxation: Relaxation) -> None:
    """Service first, on the weights' grid, then the cost of all sets that serve as much."""
    task = relaxation.task
    known = task.certificate
    outcome, served = relaxation.service(task.gap / relaxation.unit)
    known.note(f"{relaxation.stage}service", outcome)
    if served is None:
        known.prove(outcome)
        return
    service_bound = relaxation.unit * outcome.bound
    known.bound_service(service_bound)
    relaxation.keep(served)
    best = known.best
    if best is None:
        return
    if relaxation.is_last or service_bound - best.service <= task.gap:
        known.service_bound = service_bound
        _least_cost(relaxation, best)


def _least_cost(relaxation: Relaxation, best: Candidate) -> None:
    """Cheapest set that serves as much, the bound on the cost of all, and so the bound on F.

    A set that serves less than what is admitted either serves too little to be better than the
    dispatch at hand, or costs at least what the linear relaxation says.
    """
    known = relaxation.task.certificate
    unit = relaxation.unit
    service, cost_gbp = relaxation.counted(best)
    needed = known.least_service_of_better()
    # Rounding must exclude no set of exactly that service.
    admitted = max(needed, service - HALF_UNIT * unit)
    everyone = known.service_bound - admitted < WHOLE_GAP * unit
    units_min = (admitted - ROUNDING) / unit
    least = relaxation.least_cost(units_min, everyone)
    known.note(f"{relaxation.stage}least_cost", least)
    fewer = -np.inf
    if admitted > needed:
        of_fewer = relaxation.least_cost((needed - ROUNDING) / unit, everyone=False)
        known.note(f"{relaxation.stage}least_cost", of_fewer)
        fewer = known.worth(admitted, known.least_cost_gbp(of_fewer))

    known.cost_bound_gbp = -np.inf

    def prove(outcome: Outcome) -> None:
        """Bound F of all sets by what those cost that serve as much."""
        bound_gbp = known.least_cost_gbp(outcome)
        # The same service has as much curtailment, which is no cost in the record.
        same_gbp = bound_gbp - (cost_gbp - best.terms.f2)
        known.cost_bound_gbp = max(known.cost_bound_gbp, same_gbp)
        as_much = known.worth(known.service_bound, bound_gbp)
        known.bound_by(max(best.value, fewer, as_much))

    prove(least)
    gap_gbp = cost_gap_gbp(best.terms.f2)
    if best.terms.f2 - known.cost_bound_gbp <= gap_gbp or not relaxation.searches_cost:
        return
    deadline = relaxation.deadline.part(COST_SHARE if known.certified else HALF)
    outcome, served = relaxation.cheaper(units_min, everyone, best, gap_gbp, deadline)
    known.note(f"{relaxation.stage}cost_level", outcome)
    prove(outcome)
    if served is None or (served == best.dispatch.served).all():
        return
    if outcome.value < cost_gbp:
        relaxation.keep(served)
