"""Sets improved in blocks of successive steps, where a search of all steps at once does not end.

Switching rules join every step to the others, and where nothing can be stored hardly anything else
does: a search of two steps, all other service held, takes hundredths of a second and finds what
one of twenty steps does not in its time. That is fix-and-optimise (Helber and Sahling, *A
fix-and-optimize approach for the multi-level capacitated lot sizing problem*,
doi:10.1016/j.ijpe.2009.08.022). It proves nothing of other sets. ``docs/method.md``, *Sets in
blocks of steps*.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vppres.contract.switching import SwitchingData
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.solve.deadline import Deadline
from vppres.solve.programs import (
    DIRECT,
    PROOF,
    Program,
    ProgramSolution,
    begin_with,
)
from vppres.solve.result import Outcome, Status

SOON_SHARE = 0.15
"""Share of the time in which a search of all steps at once may end before blocks are tried: most
windows with rules need less, and blocks would take longer."""

BLOCKS_SHARE = 0.6
"""Share of the time left that blocks may take: what a search of all steps at once has not found by
the rest of it, it seldom finds. Where blocks are small they end by themselves."""

GAIN_SHARE = 0.1
"""Share of the window's gap that a block must gain for the others to be tried again."""

LENGTHS = (1, 2, 4, 8)
"""Steps of a block. Longer ones take longer, and come after shorter ones have nothing to gain."""

BLOCK_NODES = 10
"""Nodes of a block's search: with a hundred, fewer blocks are searched for hardly better ones."""


class Answer(NamedTuple):
    """What a program is worth with the values of its columns."""

    value: float
    x: Floats

    def outcome(self, solve_s: float) -> Outcome:
        """The same as the outcome of a search that says nothing of other answers."""
        return Outcome(Status.GAP_OPEN, self.value, -np.inf, solve_s, DIRECT)


@dataclass(frozen=True, eq=False)
class BlockSearch:
    """Searches a program for better sets, block by block.

    Attributes
    ----------
    program : Program
        Its whole numbers are those of service, or follow from them.
    service : array, shape (W, C)
        Columns of service.
    follow : sequence of arrays, shape (W, C) each
        Columns that service decides: its changes and what they add.
    rules : SwitchingData
        The window's rules.
    gap_abs : float
        The window's gap, in the program's objective.
    deadline : Deadline
        When the last search ends.
    """

    program: Program
    service: Wholes
    follow: Sequence[Wholes]
    rules: SwitchingData
    gap_abs: float
    deadline: Deadline

    @property
    def gain(self) -> float:
        """Smallest gain that counts."""
        return GAIN_SHARE * self.gap_abs

    def improved(self, sets: Iterable[Flags]) -> Answer | None:
        """The best answer found from the first of some sets (W, C) on that has any."""
        best = next((answer for answer in map(self.answer_of, sets) if answer is not None), None)
        if best is None:
            return None
        lengths = self._lengths()
        level = 0
        while level < len(lengths) and not self.deadline.passed:
            found = self._with_blocks_of(lengths[level], best)
            level = 0 if level > 0 and found is not best else level + 1
            best = found
        return best

    def _lengths(self) -> list[int]:
        """Steps of a block, in the order of trial.

        Where actions are limited no step is searched alone: it would take those of the others.
        """
        least = 1 if self.rules.actions_suffice else 2
        return [length for length in LENGTHS if least <= length < len(self.service)]

    def answer_of(self, served: Flags) -> Answer | None:
        """What a set is worth, None where it has no answer."""
        least = self.program.x_lower[self.service]
        most = self.program.x_upper[self.service]
        if (served < least).any() or (served > most).any():
            return None
        program = self.program.with_held(self.service, served)
        found = ProgramSolution.of(program.loaded(self.gain, more=PROOF), self.deadline)
        return Answer(found.value, found.x) if found.status.has_answer else None

    def _with_blocks_of(self, length: int, best: Answer) -> Answer:
        """The best answer when no block of a length has anything to gain any more."""
        blocks = [self._free(block) for block in _blocks(len(self.service), length)]
        block = in_vain = 0
        while in_vain < len(blocks) and not self.deadline.passed:
            found = self._search(blocks[block], best)
            gains = found is not None and found.value < best.value - self.gain
            best = found if found is not None and gains else best
            in_vain = 0 if gains else in_vain + 1
            block = (block + 1) % len(blocks)
        return best

    def _free(self, block: Flags) -> Flags:
        """Columns that a block (W,) may change: all but service and what follows elsewhere."""
        reach = max(self.rules.steps.cold, 1)
        changes = np.convolve(block, np.ones(1 + reach))[: len(block)] > 0.0
        free = np.ones(len(self.program.cost), dtype=bool)
        free[self.service[~block]] = False
        for columns in self.follow:
            free[columns[~changes]] = False
        return free

    def _search(self, free: Flags, best: Answer) -> Answer | None:
        """Search the free columns, all others held; it begins with the best."""
        program = self.program.of_columns(free, best.x)
        solver = program.loaded(self.gain, BLOCK_NODES, more=PROOF)
        begin_with(solver, np.arange(len(program.cost)), best.x[free])
        found = ProgramSolution.of(solver, self.deadline)
        if not found.status.has_answer:
            return None
        x = best.x.copy()
        x[free] = found.x
        return Answer(float(self.program.cost @ x), x)


def _blocks(n_steps: int, length: int) -> Iterator[Flags]:
    """Blocks of a length side by side, (W,) each, then those halfway between them."""
    steps = np.arange(n_steps)
    for begin in (0, length // 2 - length):
        for first in range(begin, n_steps, length):
            yield (steps >= first) & (steps < first + length)
