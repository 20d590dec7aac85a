"""Decides each step as it begins, aligned to the clock; what was missed is not caught up."""

from __future__ import annotations

import logging
import threading

from vppres.core.errors import VppresError
from vppres.service.runner import Runner

RETRY_S = 5.0
"""After which a step that could not be kept is tried again."""

LONGEST_WAIT_S = 30.0
"""After which the clock is read again: somebody may have set it."""

log = logging.getLogger(__name__)


class Loop(threading.Thread):
    """A thread that decides the present step whenever there is a new one.

    Parameters
    ----------
    runner : Runner
        Who decides.
    """

    def __init__(self, runner: Runner) -> None:
        super().__init__(name="vppres-loop", daemon=True)
        self.runner = runner
        self._end = threading.Event()

    def run(self) -> None:
        """Go on until the end."""
        while not self._end.is_set():
            self._end.wait(min(self._once(), LONGEST_WAIT_S))

    def end(self) -> None:
        """Stop after the present step."""
        self._end.set()
        self.join()

    def _once(self) -> float:
        """Decide the present step if it is new; the time until the next one, in s."""
        runner = self.runner
        try:
            runner.step()
        except VppresError as error:
            log.error("step: %s", error)
            return RETRY_S
        except Exception:
            # The loop must outlive whatever it calls; the step is tried again.
            log.exception("step")
            return RETRY_S
        now = runner.clock.now()
        return float((runner.begun(now) + runner.length - now).total_seconds())
