"""Shadow prices of every step of a day, level by level as the objective ranks them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.core.errors import LimitError, ModelError
from vppres.explain.costs import WORTH
from vppres.explain.windows import Windows
from vppres.model.data import WindowData
from vppres.solve.shadow_prices import FixedDecisions, PricedTerms, PricedWindow, price_window

WORTH_GBP = 1e-3
"""Smallest shadow price that counts, in GBP."""

CURTAILED_SLACK_KWH = 1e-3
WHOLE = 1e-6

OF_BATTERIES = (
    "stored_energy",
    "kept_energy",
    "energy_floor",
    "energy_ceiling",
    "battery_charging",
    "battery_discharging",
    "battery_inverter",
)
"""Shadow prices with one value for each battery."""

MORE_KWH = 1e-2
MORE_SHARE = 1e-5
"""Stored energy by which it is tried what more of it gains, and its least share of a battery's
capacity: far above what solvers leave, and what counts as a rounding of a state of charge."""

LESS = 0.99
"""Share of a price below which one more unit gains less than it says, beyond any noise."""

Price = Callable[..., PricedWindow | None]
"""Prices a window with what is held, by its terms and, if given, with more energy stored."""


@dataclass(frozen=True, eq=False)
class StepPrices:
    """The two levels of a step's pricing problem."""

    window: WindowData  #: what the controller saw
    #: Service and curtailment maximised as weighted; None if the level was not needed because all
    #: customers could be supplied, or had no answer.
    service: PricedWindow | None
    #: Cost minimised with the service of the first level; None where stored energy decides on
    #: service, where there is no grid in the window, or without answer.
    cost: PricedWindow | None
    late: bool = False  #: whether time ran out for a level

    @property
    def solved(self) -> bool:
        """Whether there are shadow prices at all."""
        return self.service is not None or self.cost is not None

    @property
    def solver_s(self) -> float:
        """Time in the solver in s."""
        return sum(level.solver_s for level in (self.service, self.cost) if level is not None)


def step_prices(windows: Windows, t: int) -> StepPrices:
    """Shadow prices of one step."""
    window, recorded = windows.seen(t), windows.recorded
    model = windows.model(t, window.n_steps)
    left_out = recorded.left_out(t)
    late = False

    def price(
        held: FixedDecisions, terms: PricedTerms, more: Floats | float = 0.0
    ) -> PricedWindow | None:
        nonlocal late
        richer = replace(window, soc=window.soc + more)
        if late:
            return None
        try:
            answer = price_window(model, richer, held, terms)
        except LimitError:  # another problem of the step is no smaller
            late = True
            return None
        except ModelError:  # a feeder that cannot carry its demand: the step was not planned either
            return None
        return answer if answer is None else _of_the_others(answer, left_out)

    held = windows.held(t, window.n_steps)
    limited = bool(np.isfinite(window.grid_limit_kw).any())
    if recorded.done.served[t].all() and not limited:
        everyone = np.ones_like(held.service_min)
        cost = price(replace(held, service_min=everyone), _cost_alone(0.0))
        if cost is not None:
            return StepPrices(window, None, cost)
    energy_kwh = recorded.site.batteries.energy_kwh
    service = _service_level(price, recorded.site.weights.lambda_curt, held, energy_kwh)
    connected = bool((window.grid_limit_kw > 0).any())
    if service is None or not connected or np.any(np.abs(service.prices.stored_energy) > WORTH):
        return StepPrices(window, service, None, late)
    share = _whole(service.served_share)
    fixed = replace(held, service_min=share, service_max=share)
    cost = price(fixed, _cost_alone(service.curtailed_kwh))
    return StepPrices(window, service, cost, late)


def _of_the_others(answer: PricedWindow, left_out: Flags) -> PricedWindow:
    """The answer in which one more unit of a battery that was left out, shape (B,), is nothing."""
    if not left_out.any():
        return answer
    prices = answer.prices
    others: dict[str, Any] = {
        name: np.where(left_out, 0.0, getattr(prices, name)) for name in OF_BATTERIES
    }
    return replace(answer, prices=replace(prices, **others))


def _service_level(
    price: Price, lambda_curt: float, held: FixedDecisions, energy_kwh: Floats
) -> PricedWindow | None:
    """Service and curtailment as weighted; if the model cannot carry what was served, without it.

    What the plant did may lie just outside the model: a plan that was followed in spite of forecast
    errors, or voltages that were allowed to leave the limits.
    """
    terms = PricedTerms(1.0, 0.0, lambda_curt)
    answer = price(held, terms)
    if answer is None:
        held = FixedDecisions(
            np.zeros_like(held.service_min),
            held.service_max,
            np.zeros_like(held.mode_min),
            np.ones_like(held.mode_max),
        )
        answer = price(held, terms)
    return answer and _as_more_gains(answer, lambda more: price(held, terms, more), energy_kwh)


def _as_more_gains(
    answer: PricedWindow, richer: Callable[[Floats], PricedWindow | None], energy_kwh: Floats
) -> PricedWindow:
    """The answer with what one more stored kWh gains, where one less would leave no dispatch.

    A plan lives on exactly the energy that it needs, and the price may be anything above it then.
    """
    told = answer.prices.stored_energy.copy()
    solved = np.zeros(len(told), dtype=bool)
    more_kwh = np.maximum(MORE_KWH, MORE_SHARE * energy_kwh)
    # A battery's price is never less than what it gains, so the most is one that is solved.
    while (told > WORTH).any() and not solved[best := int(np.argmax(told))]:
        more = richer(np.where(np.arange(len(told)) == best, more_kwh / energy_kwh, 0.0))
        if more is None:
            break
        gained = max((more.value - answer.value) / more_kwh[best], 0.0)
        if gained >= LESS * told[best]:
            break
        told[best], solved[best] = gained, True
    return replace(answer, prices=replace(answer.prices, stored_energy=told))


def _cost_alone(curtailed_kwh: float) -> PricedTerms:
    """Cost alone, with no more curtailment than the level above has."""
    return PricedTerms(0.0, 1.0, 0.0, curtailed_kwh + CURTAILED_SLACK_KWH)


def _whole(share: np.ndarray) -> np.ndarray:
    """Shares without the solver's noise at both ends."""
    return np.where(share > 1 - WHOLE, 1.0, np.where(share < WHOLE, 0.0, share))
