"""Controllers of one site with other and other weights of its customers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from vppres.contract.decision import Decider, Decision
from vppres.contract.observation import Observation
from vppres.control.remembered import PARTS, memory_of, put_back
from vppres.core.arrays import Floats
from vppres.core.plain import Given
from vppres.model.site import Site


class ByWeight:
    """The controller with the present weights; what it remembers goes on to the next one.

    It begins with :meth:`change_to`.

    For each set of weights the controller is made anew, and the one before is dropped. Compiled
    problems of the last few are kept.

    ``weighed`` makes the site with other weights, (C,). The value of stored energy follows from the
    first ``weight``; ``given`` is what a memory does not hold, by type.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {"_parts": PARTS}

    def __init__(
        self,
        decider_of: Callable[[Site], Decider],
        weighed: Callable[[Floats], Site],
        weight: Floats,
        given: Given,
    ) -> None:
        self._decider_of = decider_of
        self._weighed = weighed
        self._given = given
        self._total = float(weighed(weight).customers.weight.sum())
        self._scale = 1.0
        self._parts: dict[bytes, Decider] = {}

    @property
    def inner(self) -> Decider:
        """The present controller."""
        return next(iter(self._parts.values()))

    @property
    def weight(self) -> Floats:
        """The present weights, (C,)."""
        return np.frombuffer(next(iter(self._parts)), dtype=float)

    def horizon_steps(self, t0: int) -> range:
        """Steps of the present controller's window."""
        return self.inner.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The decision with the present weights."""
        # Strict order has its own scale of weights, and it changes with them.
        decision = self.inner.decide(observation.counted(self._scale))
        return replace(decision, weight=self.weight)

    def change_to(self, weight: Floats) -> None:
        """Go on with other weights."""
        key = weight.tobytes()
        if key in self._parts:
            return
        memory = memory_of(self.inner, self._given) if self._parts else None
        made = self.part_for(key)
        if memory is not None:
            put_back(made, memory, self._given, "controller")

    def part_for(self, key: bytes) -> Decider:
        """The controller of weights, as bytes; the one before is dropped."""
        if key not in self._parts:
            site = self._weighed(np.frombuffer(key, dtype=float))
            self._scale = float(site.customers.weight.sum()) / self._total
            self._parts = {key: self._decider_of(site)}
        return self._parts[key]
