"""Your own parts in a run: a controller, a forecaster, or weights that change by step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from vppres.contract.decision import Decider, Decision
from vppres.contract.forecast import ForecastErrors
from vppres.contract.observation import Observation
from vppres.control.by_weight import ByWeight
from vppres.control.guard.check import misshapen
from vppres.core.arrays import Floats
from vppres.core.errors import InputError, Problem
from vppres.day.options import RunOptions
from vppres.forecasts.interface import ForecastMethod
from vppres.model.site import Site

MPC = "mpc"
WHERE = "run_day"


@dataclass(frozen=True, eq=False)
class Own:
    """Replacements for parts of a run."""

    #: Makes a controller of a site, ``controller(site)``; a class will do. What it makes has
    #: ``horizon_steps(t0)`` and ``decide(observation)``.
    controller: Callable[[Site], Decider] | None = None
    forecaster: ForecastMethod | None = None  #: has ``forecast(history, issued_at, steps)``
    #: The customers' weights of each step: an array of shape (T, C), or a function of the
    #: observation that gives them, shape (C,).
    weights: Callable[[Observation], ArrayLike] | ArrayLike | None = None

    def check(self, options: RunOptions) -> None:
        """Refuse what would have no effect, and parts that lack their methods.

        Raises
        ------
        InputError
            With the cures.
        """
        if problems := [*self._problems(options)]:
            raise InputError(problems)

    def _problems(self, options: RunOptions) -> Iterator[Problem]:
        weights, controller = self.weights is not None, self.controller is not None
        if weights and (controller or options.controller != MPC):
            message = "are for the controller mpc, which plans anew in each step"
            cure = "Leave out the weights, or use controller = 'mpc' of RunOptions."
            yield Problem(WHERE, message, cure, field="weights")
        if weights and options.shares_supply:
            message = (
                "are those of every step, so that none is left to be shared by rotation or minimum"
            )
            cure = "Leave out the weights, or rotation and minimum_on_h of RunOptions."
            yield Problem(WHERE, message, cure, field="weights")
        if controller and not callable(cast(object, self.controller)):
            message = "is called with the site, once for each set of batteries that is in use"
            cure = "Give the class, or a function that makes a controller of a site."
            yield self._of_controller(message, cure)
        if controller and options.move_switches:
            cure = "Leave out move_switches of RunOptions."
            yield self._of_controller("leaves the switches as they are", cure)
        forecasts = callable(getattr(self.forecaster, "forecast", None))
        if self.forecaster is not None and (isinstance(self.forecaster, type) or not forecasts):
            message = "must have a method forecast(history, issued_at, steps)"
            cure = "Give an object, Persistence(), not its class."
            yield Problem(WHERE, message, cure, field="forecaster", value=_name(self.forecaster))
        if self.forecaster is not None and options.errors != ForecastErrors():
            message = "makes its own errors, so that none can be given"
            cure = "Leave out biases and errors."
            yield Problem(WHERE, message, cure, field="forecaster")

    def _of_controller(self, message: str, cure: str) -> Problem:
        return Problem(WHERE, message, cure, field="controller", value=_name(self.controller))

    def made_controller(self, site: Site) -> Decider | None:
        """The controller of a site, checked; None if the package's decides.

        Raises
        ------
        InputError
            If it lacks one of its methods.
        """
        if self.controller is None:
            return None
        made = self.controller(site)
        for method in ("horizon_steps", "decide"):
            if not callable(getattr(made, method, None)):
                cure = "It needs horizon_steps(t0) and decide(observation)."
                raise InputError(self._of_controller(f"lacks the method {method}", cure))
        return WellFormed(made, site)

    def record(self) -> dict[str, Any]:
        """Names of the parts that are replaced, for the run's options."""
        given = {"controller": self.controller, "forecaster": self.forecaster}
        found = {name: _name(part) for name, part in given.items() if part is not None}
        if self.weights is not None:
            found["weights"] = _name(self.weights) if callable(self.weights) else "by step"
        return {"own": found} if found else {}

    def weights_at(self, observation: Observation, n_customers: int) -> Floats:
        """The weights of a step, checked.

        Raises
        ------
        InputError
            If they are no weights of the customers.
        """
        given = self.weights
        rows = np.atleast_1d(np.asarray(() if callable(given) else given))
        t0 = observation.t0
        row = given(observation) if callable(given) else rows[t0] if t0 < len(rows) else ()
        try:
            found = np.asarray(row, dtype=float)
        except ValueError:  # words
            found = np.zeros(0)
        if found.shape != (n_customers,) or not np.isfinite(found).all() or (found <= 0.0).any():
            raise InputError.of(
                f"weights of step {t0}",
                f"must be {n_customers} numbers above 0, one for each customer",
                "Give one row for each step, in the order of scenario.customers.",
            )
        return found


class WellFormed:
    """A controller of your own whose decisions have the site's arrays, with numbers alone."""

    def __init__(self, inner: Decider, site: Site) -> None:
        self.inner = inner
        self.site = site

    def horizon_steps(self, t0: int) -> range:
        """Steps for which the controller wants a forecast."""
        return self.inner.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The controller's decision.

        Raises
        ------
        InputError
            If it is none: no step is decided by rule for that.
        """
        found = self.inner.decide(observation)
        is_decision = isinstance(found, Decision)
        odd = misshapen(found, self.site) if is_decision else ["is no Decision"]
        if odd:
            raise InputError.of(
                f"decision of step {observation.t0}",
                "; ".join(odd),
                "Return a Decision of a Dispatch with the site's items and finite numbers.",
                field="controller",
                value=_name(type(self.inner)),
            )
        return found


class ByStepWeights:
    """A controller whose customers have other weights from step to step."""

    def __init__(self, controllers: ByWeight, own: Own, weight: Floats) -> None:
        self._controllers = controllers
        self._own = own
        self._controllers.change_to(weight)

    def horizon_steps(self, t0: int) -> range:
        """Steps of its controllers' windows."""
        return self._controllers.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The decision with the weights of the step."""
        weight = self._own.weights_at(observation, len(self._controllers.weight))
        self._controllers.change_to(weight)
        return self._controllers.decide(observation)


def _name(part: Any) -> str:
    """How a part is called where it was defined."""
    named = part if hasattr(part, "__qualname__") else type(part)
    return f"{named.__module__}.{named.__qualname__}"
