"""Last observation that a guard of a live controller took for true.

A live controller keeps no decision, and makes its guard anew after a restart: so all guards are
watched.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

from vppres.contract.decision import Decision
from vppres.contract.observation import Observation
from vppres.control.guard.guard import GuardedController
from vppres.live.controller import Controller

_SEEN: WeakKeyDictionary[GuardedController, Observation] = WeakKeyDictionary()
_decide = GuardedController.decide


def _watched(guard: GuardedController, observation: Observation) -> Decision:
    decision = _decide(guard, observation)
    assert decision.seen is not None
    _SEEN[guard] = decision.seen
    return decision


GuardedController.decide = _watched  # type: ignore[method-assign,assignment]


def guard_of(controller: Controller) -> tuple[GuardedController, Observation]:
    """The guard of a controller, and what its last decision took for true."""
    guard = controller._decider
    assert isinstance(guard, GuardedController)
    return guard, _SEEN[guard]
