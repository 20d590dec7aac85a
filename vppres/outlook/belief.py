"""Probabilities of outages at a step, as a chain of states.

An outage is not there, or has lasted for some steps; the state of the present step is seen. Of the
steps to come a belief says with which probability each announced outage begins, that of an outage
that was not announced, and how long outages of each kind last. Announced outages come in their
order: once one has come, only later ones are waited for. One that begins while another lasts goes
on behind it: a step is out if any of them touches it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vppres.core.arrays import Flags, Floats, freeze_arrays

HALF = 0.5
"""Probability from which an outage is the likely future."""


@dataclass(frozen=True, eq=False)
class OutageBelief:
    """Belief at a step about it and the ``T - 1`` steps behind it.

    Examples
    --------
    An outage that begins for certain in two steps and lasts two:

    >>> sure = OutageBelief([[0, 0, 1, 0, 0, 0]], [[1, 0], [0, 1]], hazard=0.0)
    >>> sure.certain
    True
    >>> sure.out_probability
    array([0., 0., 1., 1., 0., 0.])
    """

    #: Probability that each announced outage begins at a step, given all that is seen, (A, T):
    #: nothing at the present one. Its sum is below 1 where it may not come at all.
    onset: Floats
    #: Probability of each length in steps, from 1, (A + 1, D); row 0 is that of outages that were
    #: not announced.
    duration: Floats
    hazard: float  #: probability that such an outage begins at a step
    out: bool = False  #: whether the present step is one of an outage
    kind: int = 0  #: row of ``duration`` that the present outage has
    elapsed: int = 0  #: steps that it has lasted before the present one
    words: str = ""  #: which messages count, where several speak of one outage

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def n_steps(self) -> int:
        """Steps T."""
        return int(self.onset.shape[1])

    @property
    def n_announced(self) -> int:
        """Announced outages A."""
        return len(self.onset)

    @cached_property
    def restored(self) -> Floats:
        """Probability that an outage of ``k + 1`` steps has no other, (A + 1, D).

        Beyond all lengths that have a probability an outage is over.
        """
        longer = self.duration[:, ::-1].cumsum(axis=1)[:, ::-1]
        over = np.ones_like(self.duration)
        np.divide(self.duration, longer, where=longer > 1e-12, out=over)
        return over

    @cached_property
    def began(self) -> Floats:
        """Probability that an announced outage begins at a step if it has not before, (A, T)."""
        waiting = 1.0 - np.hstack([np.zeros((self.n_announced, 1)), self.onset.cumsum(axis=1)])
        share = np.divide(
            self.onset,
            waiting[:, :-1],
            where=waiting[:, :-1] > 1e-12,
            out=np.zeros_like(self.onset),
        )
        return np.clip(share, 0.0, 1.0)

    def onsets_from(self, come: int, t: int) -> Floats:
        """Probabilities of what begins at step ``t``, (A + 1,): row 0 is what was not announced.

        ``come`` is the number of announced outages that have come, or been passed over.
        """
        found = np.zeros(self.n_announced + 1)
        quiet = 1.0
        for kind in range(come, self.n_announced):
            found[kind + 1] = quiet * self.began[kind, t]
            quiet *= 1.0 - self.began[kind, t]
        found[0] = quiet * self.hazard
        return found

    @cached_property
    def covers(self) -> Floats:
        """Probability that each announced outage began some steps before a step and still lasts.

        By outage, the step and the steps before it, (A, T, T).
        """
        T = self.n_steps
        longer = self.duration[1:, ::-1].cumsum(axis=1)[:, ::-1]
        lasts = np.zeros((self.n_announced, T))
        n = min(T, longer.shape[1])
        lasts[:, :n] = longer[:, :n]
        found = np.zeros((self.n_announced, T, T))
        for t in range(T):
            found[:, t, : t + 1] = self.onset[:, t::-1] * lasts[:, : t + 1]
        return found

    def behind(self, kind: int, t: int) -> list[tuple[int, Floats]]:
        """Announced outages that still last in step ``t`` when one of a kind has ended before it.

        Each with the probability of the steps that it has lasted, (T,), given that none before it
        does: outages that come later than that one only.
        """
        if not kind or t >= self.n_steps:
            return []
        later = range(kind, self.n_announced)
        return [(row + 1, self.covers[row, t]) for row in later if self.covers[row, t].any()]

    @cached_property
    def certain(self) -> bool:
        """Whether nothing is left to chance: every probability is zero or one."""
        begins = self.hazard == 0.0 and np.isin(self.onset, (0.0, 1.0)).all()
        announced = self.duration[1:][self.onset.any(axis=1)]
        ends = self.restored[self.kind, self.elapsed :] if self.out else np.zeros(0)
        return bool(
            begins and np.isin(announced, (0.0, 1.0)).all() and np.isin(ends, (0.0, 1.0)).all()
        )

    @cached_property
    def out_probability(self) -> Floats:
        """Probability that each step is one of an outage, (T,)."""
        A = self.n_announced
        D = self.duration.shape[1]
        waiting = np.zeros(A + 1)
        lasting = np.zeros((A + 1, D))
        if self.out:
            lasting[self.kind, min(self.elapsed, D - 1)] = 1.0
        else:
            waiting[0] = 1.0
        found = [float(self.out)]
        for t in range(1, self.n_steps):
            over = lasting * self.restored
            on = lasting - over
            lasting = np.zeros((A + 1, D))
            lasting[:, 1:] = on[:, :-1]
            lasting[:, -1] += on[:, -1]
            # What was not announced leaves all that was announced to wait for.
            arrived = waiting.copy()
            waiting = over.sum(axis=1)
            for kind in range(1, A + 1):
                for other, began in self.behind(kind, t):
                    n = min(self.n_steps, D)
                    lasting[other, :n] += waiting[kind] * began[:n]
                    waiting[kind] *= 1.0 - began.sum()
            for come in range(A + 1):
                begins = self.onsets_from(come, t)
                lasting[:, 0] += arrived[come] * begins
                waiting[come] += arrived[come] * (1.0 - begins.sum())
            found.append(float(lasting.sum()))
        return np.array(found)

    @cached_property
    def likely(self) -> Flags:
        """The most likely future, (T,): whether each step is one of an outage.

        The present outage ends at the median of what is left of it. An announced one comes at its
        most likely time, where it comes with a probability of one half or more, and lasts as long
        as its median says. Where everything is certain this is what comes.
        """
        out = np.zeros(self.n_steps, dtype=bool)
        if self.out:
            out[: self._median(self.kind, self.elapsed) - self.elapsed] = True
        for kind, onset in enumerate(self.onset, start=1):
            if onset.sum() >= HALF:
                begin = int(np.argmax(onset))
                out[begin : begin + self._median(kind, 0)] = True
        return out

    def _median(self, kind: int, elapsed: int) -> int:
        """Steps that half of all outages of a kind that have lasted so long do not exceed."""
        longer = self.duration[kind, elapsed:]
        if longer.sum() <= 1e-12:
            return elapsed + 1
        half = np.searchsorted(longer.cumsum(), HALF * longer.sum() * (1.0 - 1e-9))
        return elapsed + int(half) + 1
