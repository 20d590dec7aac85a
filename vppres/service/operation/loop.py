"""Decides each step as it begins, aligned to the clock; what was missed is not caught up.

Between two steps it decides anew as soon as something has changed that the plan does not know.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from vppres.core.errors import VppresError
from vppres.service.operation.runner import Runner

RETRY_S = 5.0
"""After which a step or a new plan that could not be kept is tried again."""

SETTLE_S = 0.5
"""What else changes within this time is decided in one go, and a second source may speak."""

LONGEST_WAIT_S = 30.0
"""After which the clock is read again, which may have been set, and alarms are looked at."""

log = logging.getLogger(__name__)


class Loop(threading.Thread):
    """A thread that decides the present step whenever there is a new one."""

    def __init__(self, runner: Runner) -> None:
        super().__init__(name="vppres-loop", daemon=True)
        self.runner = runner
        self._end = threading.Event()

    def run(self) -> None:
        """Go on until the end."""
        self._guarded(self.runner.hearing.look)
        while not self._end.is_set():
            self._guarded(self.runner.watch.check_alarms)
            changes = self.runner.changes
            once_s = self._once()
            self._guarded(self.runner.on_plan)
            changes.new.wait(min(once_s, LONGEST_WAIT_S, self._to_next_turn_s()))
            self._guarded(self.runner.hearing.note_turns)
            if not changes.reasons or self._end.wait(SETTLE_S):
                continue
            if not self._guarded(self.runner.anew):
                self._end.wait(RETRY_S)
                changes.new.set()

    def end(self) -> None:
        """Stop after the present step."""
        self._end.set()
        self.runner.changes.new.set()
        self.join()

    def _guarded(self, act: Callable[[], object]) -> bool:
        """Do something; whether it was done. The loop must outlive whatever it calls."""
        try:
            act()
        except VppresError as error:
            log.error("step: %s", error)
            return False
        except Exception:
            log.exception("step")
            return False
        return True

    def _to_next_turn_s(self) -> float:
        """How long until the mode ends, or an event begins or ends, in s."""
        try:
            return self.runner.hearing.to_next_turn_s()
        except VppresError:  # the database does not answer: the next turn says so
            return RETRY_S

    def _once(self) -> float:
        """Decide the present step if it is new; the time until the next one, in s."""
        runner = self.runner
        if runner.played:  # its steps are asked for
            return LONGEST_WAIT_S
        if not self._guarded(runner.step):
            return RETRY_S
        now = runner.clock.now()
        return float((runner.begun(now) + runner.length - now).total_seconds())
