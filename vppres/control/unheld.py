"""Island steps that nothing can hold, of a window that has no dispatch with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vppres.core.arrays import Flags, Wholes
from vppres.core.errors import InfeasibleError, LimitError, NumericalError
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.data import WindowData
from vppres.solve.deadline import Deadline
from vppres.solve.ladder import WindowSolver


@dataclass(frozen=True, eq=False)
class UnheldSteps:
    """Search for the steps that make a window infeasible."""

    solver: WindowSolver
    at_rest: Callable[[WindowData, Flags], WindowData]  #: a window with its dark steps, to solve
    whole: WindowData  #: the window as it was observed
    dark: Flags  #: steps that are blacked out anyway, (W,)
    deadline: Deadline

    def found(self, start: WindowData) -> Flags:
        """Further steps to black out, (W,); ``start`` is the window that has no dispatch."""
        beyond = self._beyond_batteries(start) | self._beyond_set()
        return beyond if beyond.any() else self._beyond_storage()

    def _beyond_batteries(self, start: WindowData) -> Flags:
        """Island steps that no supply schedule has a dispatch for: for capacitors, for example.

        Rules on switching, which may ask for more supply than there is, count for nothing here.
        """
        beyond = np.zeros(start.n_steps, dtype=bool)
        if not start.drawn:
            return beyond
        free = replace(start, switching=None)
        for step in np.flatnonzero(start.dark & lit_steps(start)):
            try:
                self.solver.solve(free.part(slice(step, step + 1)), self.deadline.left_s)
            except InfeasibleError:
                beyond[step] = True
            except (NumericalError, LimitError):
                pass  # not proven
        return beyond

    def _beyond_set(self) -> Flags:
        """Steps from the first on that the set which forms the grid cannot hold with any customers.

        Nothing may take its least power, or its fuel may not last for all that has to be served.
        """
        whole = self.whole
        formers = whole.ahead.formers().values()
        none = np.zeros(whole.n_steps, dtype=bool)
        formed = np.flatnonzero(sum((forms.any(axis=1) for forms in formers), start=none))
        return self._not_held(whole, formed)

    def _beyond_storage(self) -> Flags:
        """Island steps from which on batteries are full of what the network gives.

        None where time is up before that is proven.
        """
        whole = self.whole
        free = replace(whole, switching=None)
        given = np.flatnonzero(whole.dark & (whole.network_gives_kw > 0.0) & ~self.dark)
        beyond = np.zeros(whole.n_steps, dtype=bool)
        if len(given) and not self._is_held(free, self.dark):
            beyond = self._not_held(free, given)
        return beyond & (not self.deadline.passed)

    def _not_held(self, whole: WindowData, steps: Wholes) -> Flags:
        """The last of some steps, so many that a window is held without them, (W,).

        With all of them lit it is not.
        """
        held, missed = 0, len(steps)
        while missed - held > 1:
            tried = (held + missed) // 2
            later = np.isin(np.arange(whole.n_steps), steps[tried:])
            if self._is_held(whole, self.dark | later):
                held = tried
            else:
                missed = tried
        return np.isin(np.arange(whole.n_steps), steps[held:])

    def _is_held(self, whole: WindowData, dark: Flags) -> bool:
        """Whether a window has a dispatch with some steps blacked out."""
        try:
            self.solver.solve(self.at_rest(whole, dark), self.deadline.left_s)
        except (InfeasibleError, NumericalError, LimitError):
            return False
        return True
