"""Certificate of a window while it is being solved: incumbent, bounds and gaps.

The proofs are in ``docs/method.md``, section *Why the bounds hold*. They are stated there for
prices of any sign: ``CostRange.least_gbp`` is zero where no price is negative.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.terms import Terms, evaluate
from vppres.solve.result import Outcome, SolveLimits, Status

COST_GAP_REL = 1e-3
COST_GAP_GBP = 1e-3
"""Gap of the search for a cheaper set: 0.1% of the cost, far below what a forecast of prices and
demand knows, and a tenth of a penny where there is next to no cost."""


@dataclass(frozen=True, eq=False)
class OwnValues:
    """Values of what only the page has in a solution: its term of F, and its letters."""

    value: float = 0.0
    letters: Mapping[str, Floats] = field(default_factory=dict)


NO_OWN_VALUES = OwnValues()


@dataclass(frozen=True, eq=False)
class Candidate:
    """A dispatch with its objective terms."""

    data: WindowData  #: the window, with the demand that the supply schedule brings about
    dispatch: Dispatch  #: what would be carried out
    terms: Terms  #: its objective terms
    service: float  #: f1 and f3 as weighted, and f6: F without cost and tie-breakers
    value: float  #: F without the tie-breakers
    cost_bound_gbp: float  #: what its supply schedule costs at least
    in_network: bool  #: whether flows, reactive power and voltages have been found too
    own: OwnValues = NO_OWN_VALUES  #: what only the page has

    @classmethod
    def of(
        cls,
        site: Site,
        data: WindowData,
        dispatch: Dispatch,
        slack_gbp: float,
        in_network: bool,
        own: OwnValues = NO_OWN_VALUES,
    ) -> Candidate:
        """A dispatch whose set costs at most ``slack_gbp`` less than the dispatch does."""
        terms = evaluate(site, data, dispatch, own.value)
        value = terms.upper_levels(site.weights)
        service = value + site.weights.lambda_grid * terms.f2
        cost_gbp = terms.f2 - slack_gbp
        return cls(data, dispatch, terms, service, value, cost_gbp, in_network, own)

    def carried_by(self, site: Site, dispatch: Dispatch, own: OwnValues) -> Candidate:
        """Candidate with the same set and cost in the network, and a dispatch that carries them."""
        terms = evaluate(site, self.data, dispatch, own.value)
        return replace(self, dispatch=dispatch, terms=terms, own=own, in_network=True)


@dataclass(frozen=True)
class CostRange:
    """Cost of import and export (GBP) that no dispatch of a window falls below or exceeds."""

    least_gbp: float
    dearest_gbp: float

    @classmethod
    def of(cls, site: Site, data: WindowData) -> CostRange:
        """All import that can ever be useful, in the steps in which it earns or costs money.

        What a window has beyond the paper says what it makes of that.
        """
        price = data.price_gbp_per_kwh
        most_kwh = data.grid_p_max_kw(site) * site.dt_h
        least, dearest = np.minimum(price, 0.0) * most_kwh, np.maximum(price, 0.0) * most_kwh
        for addition, _ in beyond_paper(site, data):
            least, dearest = addition.cost_range(site, data, least, dearest)
        return cls(float(least.sum()), float(dearest.sum()))


class Certificate:
    """The best dispatch of a window so far, bounds on what any other is worth, and the record.

    Attributes
    ----------
    best : Candidate or None
        The best dispatch.
    bound : float
        Upper bound on F of all dispatches.
    service_bound : float
        Upper bound on F without its cost.
    cost_bound_gbp : float
        Lower bound on the cost of all dispatches that serve as much as the best.
    stages : list of str
        What was solved, in order: name, solver and, where it is not optimal, status.
    solver_s : float
        Seconds in solvers.
    wasteful : bool
        Whether some set has no dispatch only because its batteries would charge and discharge at
        once: bounds that allow it are not to be reached.
    """

    def __init__(self, limits: SolveLimits, lambda_grid: float, cost: CostRange) -> None:
        self.limits = limits
        self.lambda_grid = lambda_grid
        self.cost = cost
        self.best: Candidate | None = None
        self.bound = np.inf
        self.service_bound = np.inf
        self.cost_bound_gbp = -np.inf
        self.stages: list[str] = []
        self.solver_s = 0.0
        self.wasteful = False
        self._nothing: Outcome | None = None
        self._ran_out = False

    # The record.

    def note(self, stage: str, outcome: Outcome) -> None:
        """Record that a stage ran, and on which solver."""
        named = f"{stage}[{outcome.solver}]"
        optimal = outcome.status == Status.OPTIMAL
        self.stages.append(named if optimal else f"{named}:{outcome.status}")
        self.solver_s += outcome.solve_s
        self._ran_out |= outcome.status == Status.NO_ANSWER

    def learn(self, stage: str, outcome: Outcome) -> bool:
        """Record a search of a relaxation and what it proves; whether it has an answer."""
        self.note(stage, outcome)
        self.prove(outcome)
        if outcome.status.has_answer:
            self.bound_by(outcome.bound)
        return outcome.status.has_answer

    def ran(self, stage: str) -> bool:
        """Whether a stage ran."""
        return any(name.startswith(f"{stage}[") for name in self.stages)

    # Dispatches.

    def keep(self, found: Candidate | None) -> None:
        """Keep a dispatch if it is the best so far."""
        if found is not None and (self.best is None or found.value > self.best.value):
            self.best = found

    @property
    def answered(self) -> bool:
        """Whether there is a dispatch that the network carries."""
        return self.best is not None and self.best.in_network

    # Bounds on F.

    def bound_by(self, value: float) -> None:
        """F is at most the optimum of a relaxation."""
        self.bound = min(self.bound, value)

    def bound_service(self, service: float) -> None:
        """F without its cost is at most so much; the cost is at least the least there can be."""
        self.bound_by(service - self.lambda_grid * self.cost.least_gbp)

    def everyone_is_served(self, service: float, smallest_loss: float) -> None:
        """All service there can be is had by the best: every other set loses a customer.

        A set that leaves one out is worth at most the rest at the least cost there can be.
        """
        assert self.best is not None
        self.service_bound = service
        self.cost_bound_gbp = self.best.cost_bound_gbp
        everyone = service - self.lambda_grid * self.cost_bound_gbp
        others = service - smallest_loss - self.lambda_grid * self.cost.least_gbp
        self.bound = max(everyone, others)

    def least_service_of_better(self) -> float:
        """Service, without its cost, that every dispatch better than the best has at least."""
        assert self.best is not None
        return self.best.value + self.lambda_grid * self.cost.least_gbp

    def worth(self, service: float, cost_gbp: float) -> float:
        """F of so much service at a cost."""
        return service - self.lambda_grid * cost_gbp

    def least_cost_gbp(self, outcome: Outcome) -> float:
        """Lower bound on cost from a stage, or what is known without it."""
        if not outcome.status.has_answer:
            return self.cost.least_gbp
        return max(outcome.bound, self.cost.least_gbp)

    # The end.

    @property
    def certified(self) -> bool:
        """Whether the best dispatch is within the gaps of the bound."""
        best = self.best
        return best is not None and self.limits.met(self.bound, best.value)

    def prove(self, outcome: Outcome) -> None:
        """Keep a relaxation's proof that there is nothing to find."""
        if outcome.status in (Status.INFEASIBLE, Status.UNBOUNDED):
            self._nothing = outcome

    @property
    def nothing_to_find(self) -> bool:
        """Whether a relaxation has proven that there is no dispatch."""
        return self._nothing is not None

    def no_answer(self, late: bool) -> Outcome:
        """Why there is no dispatch: a relaxation's proof if there is one, otherwise the time.

        A stage may also have had no time before the window is late: to compile what it needs.
        """
        status = Status.NO_ANSWER if late or self._ran_out else Status.NUMERICAL
        return self._nothing or Outcome(status, np.nan, np.nan, 0.0)

    def service_gap(self) -> float:
        """How much more service there can be.

        Whatever serves more than the bound on F allows would have to cost more than is possible.
        """
        assert self.best is not None
        allowed = self.bound + self.lambda_grid * self.cost.dearest_gbp
        return max(min(self.service_bound, allowed) - self.best.service, 0.0)

    def cost_gap_gbp(self) -> float:
        """How much cheaper the same service can be.

        Whatever serves as much for less than the bound on F allows would be worth more than that.
        """
        assert self.best is not None
        bound_gbp = max(self.cost_bound_gbp, self.cost.least_gbp)
        if self.lambda_grid > 0.0:
            bound_gbp = max(bound_gbp, (self.best.service - self.bound) / self.lambda_grid)
        return max(self.best.terms.f2 - bound_gbp, 0.0)

    def status(self, objective: float, late: bool) -> Status:
        """Status of the incumbent, by its F with the tie-breakers."""
        if self.limits.met(self.bound, objective):
            return Status.OPTIMAL
        return Status.TIME_LIMIT if late else Status.GAP_OPEN


def cost_gap_gbp(cost_gbp: float) -> float:
    """Gap at which the search for a cheaper set may stop, in GBP."""
    return COST_GAP_REL * abs(cost_gbp) + COST_GAP_GBP
