"""The radial configuration with the least losses: of all, or the best that a search found.

If there are few enough radial configurations, the AC power flow of each is solved, and the answer
is exact. Otherwise branch exchange (Civanlar et al., IEEE Transactions on Power Delivery 3(3),
1988, DOI 10.1109/61.193906) takes the best exchange of two branches again and again, and starts
anew from random exchanges of the best configuration (iterated local search).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.feeders.reconfiguration.flows import ConfigurationFlows, Flows
from vppres.feeders.reconfiguration.loops import SwitchedNetwork
from vppres.scenario.network import BusId

AT_ONCE = 1024
"""Configurations that are solved together: their arrays stay in the processor's cache."""

EXCHANGES = (2, 5)
"""Least and most random exchanges before a new start."""

SAME_KW = 1e-6
"""Losses up to which two configurations count as equal; fewer operations decide between them."""

WITHIN = 1e-6
"""Excess of a limit, in pu or as a share, that counts as none."""

Progress = Callable[[int, int], None]
"""Called with what is done and how much there is."""


@dataclass(frozen=True)
class ConfigurationLimits:
    """Limits of a configuration: voltages in pu, and whether ratings of branches count."""

    v_min_pu: float
    v_max_pu: float
    ratings: bool = True

    def excess(self, flows: Flows) -> Floats:
        """By how much each configuration is beyond its limits, (T,): pu, and shares of ratings."""
        low = np.maximum(self.v_min_pu - flows.v_min_pu, 0.0)
        high = np.maximum(flows.v_max_pu - self.v_max_pu, 0.0)
        over = np.maximum(flows.loading - 1.0, 0.0) if self.ratings else 0.0
        found = np.where(np.isinf(flows.losses_kw), np.inf, low + high + over)
        return np.asarray(np.where(found <= WITHIN, 0.0, found))


NO_LIMITS = ConfigurationLimits(0.0, np.inf, ratings=False)


@dataclass(frozen=True)
class Configuration:
    """One radial configuration and its AC power flow."""

    opened: tuple[int, ...]  #: branches that are open, in ascending order
    losses_kw: float  #: active losses; infinite if no power flow was found
    #: Lowest and highest voltage.
    v_min_pu: float
    v_max_pu: float
    bus_min: BusId  #: bus with the lowest voltage
    loading: float  #: largest current over its rating; 0 where no branch has one
    #: By how much limits are exceeded, in pu and shares of ratings; 0 if they are kept.
    excess: float


@dataclass(frozen=True)
class LeastLoss:
    """Result of a search."""

    count: int  #: number of radial configurations
    solved: int  #: number of configurations whose power flow was found, repeated ones included
    exact: bool  #: whether all of them were: nothing is better than ``best``
    present: Configuration  #: the configuration as it is
    best: Configuration  #: the least losses within the limits; if none keeps them, the least excess
    unlimited: Configuration  #: the least losses of all, whatever the limits


class _Best:
    """The best configuration that was seen under some limits."""

    def __init__(self, limits: ConfigurationLimits, present: Wholes) -> None:
        self.limits = limits
        self._present = present
        self.key = (np.inf, np.inf, np.inf)
        self.opened = present

    def see(self, opened: Wholes, flows: Flows) -> bool:
        """Take the best of some configurations, if it is better; whether it was."""
        excess = self.limits.excess(flows)
        near = np.flatnonzero(excess <= excess.min())
        near = near[flows.losses_kw[near] <= flows.losses_kw[near].min() + SAME_KW]
        moves = (~np.isin(opened[near], self._present)).sum(axis=1)
        one = near[np.lexsort((flows.losses_kw[near], moves))[0]]
        key = (float(excess[one]), float(flows.losses_kw[one]), float(moves.min()))
        if not _is_better(key, self.key):
            return False
        self.key, self.opened = key, opened[one]
        return True


def _is_better(one: tuple[float, float, float], other: tuple[float, float, float]) -> bool:
    """Whether limits are exceeded by less, or losses are less, or equal with fewer operations."""
    if one[0] != other[0]:
        return one[0] < other[0]
    if abs(one[1] - other[1]) > SAME_KW or np.isinf(other[1]):
        return one[1] < other[1]
    return one[2] < other[2]


def least_loss(
    feeder: SwitchedNetwork,
    p_kw: Floats,
    q_kvar: Floats,
    limits: ConfigurationLimits,
    *,
    most: int = 1_000_000,
    attempts: int = 100,
    seed: int = 0,
    progress: Progress = lambda done, total: None,
) -> LeastLoss:
    """The radial configuration with the least losses under the limits.

    Up to so many configurations as ``most`` all are solved; else the search starts so many times as
    ``attempts``. ``progress`` is called with the configurations or starts that are done, and their
    number.
    """
    flows = ConfigurationFlows(feeder, p_kw, q_kvar)
    count = feeder.count
    exact = count <= most
    present = feeder.present
    kept, free = (_Best(own, present) for own in (limits, NO_LIMITS))
    if exact:
        solved = _solve_all(feeder, flows, (kept, free), count, progress)
    else:
        search = _Search(feeder, flows, (free, kept), np.random.default_rng(seed))
        solved = search.run(attempts, progress)
    rows = np.array([present, kept.opened, free.opened])
    now, best, unlimited = _described(feeder, rows, flows.solve(rows), limits)
    return LeastLoss(count, solved, exact, now, best, unlimited)


def _solve_all(
    feeder: SwitchedNetwork,
    flows: ConfigurationFlows,
    bests: tuple[_Best, ...],
    count: int,
    progress: Progress,
) -> int:
    """Solve every configuration; for how many a power flow was found."""
    done = solved = 0
    for opened in feeder.configurations(AT_ONCE):
        found = flows.solve(opened)
        for best in bests:
            best.see(opened, found)
        done += len(opened)
        solved += int(np.isfinite(found.losses_kw).sum())
        progress(done, count)
    return solved


class _Search:
    """Iterated branch exchange, once for each kind of limits."""

    def __init__(
        self,
        feeder: SwitchedNetwork,
        flows: ConfigurationFlows,
        bests: tuple[_Best, ...],
        random: np.random.Generator,
    ) -> None:
        self.feeder = feeder
        self.flows = flows
        self.bests = bests
        self.random = random
        self.solved = 0
        # What no exchange improves under its limits: coming there again ends a descent.
        self.ends: set[tuple[ConfigurationLimits, frozenset[int]]] = set()

    def run(self, attempts: int, progress: Progress) -> int:
        """Search from the present configuration and from the best ones; how many were solved."""
        for attempt in range(attempts):
            tried: list[tuple[int, ...]] = []
            for best in self.bests:
                # Where the limits cost nothing, the best is the same with them and without.
                start = tuple(sorted(map(int, best.opened)))
                if start not in tried:
                    tried.append(start)
                    self._descend(best.limits, self._moved(best.opened) if attempt else best.opened)
            progress(attempt + 1, attempts)
        return self.solved

    def _moved(self, opened: Wholes) -> Wholes:
        """Another configuration, some random exchanges away."""
        for _ in range(self.random.integers(EXCHANGES[0], EXCHANGES[1], endpoint=True)):
            near = self.feeder.exchanges(opened, int(self.random.integers(len(opened))))
            if len(near):
                opened = near[self.random.integers(len(near))]
        return opened

    def _descend(self, limits: ConfigurationLimits, opened: Wholes) -> None:
        """Take the best exchange of one open branch after another, until none improves."""
        own = _Best(limits, self.feeder.present)
        own.see(opened[None], self._solve(opened[None]))
        place = since = 0
        while since < len(opened) and (limits, frozenset(own.opened.tolist())) not in self.ends:
            near = self.feeder.exchanges(own.opened, place)
            better = len(near) > 0 and own.see(near, self._solve(near))
            since = 0 if better else since + 1
            place = (place + 1) % len(opened)
        self.ends.add((limits, frozenset(own.opened.tolist())))

    def _solve(self, opened: Wholes) -> Flows:
        """Solve some configurations, and show them to all that look for the best."""
        found = self.flows.solve(opened)
        self.solved += int(np.isfinite(found.losses_kw).sum())
        for best in self.bests:
            best.see(opened, found)
        return found


def _described(
    feeder: SwitchedNetwork, rows: Wholes, flows: Flows, limits: ConfigurationLimits
) -> list[Configuration]:
    """Some configurations with their figures."""
    excess = limits.excess(flows)
    return [
        Configuration(
            opened=tuple(sorted(map(int, opened))),
            losses_kw=float(flows.losses_kw[i]),
            v_min_pu=float(flows.v_min_pu[i]),
            v_max_pu=float(flows.v_max_pu[i]),
            bus_min=feeder.network.buses[flows.bus_min[i]],
            loading=float(flows.loading[i]),
            excess=float(excess[i]),
        )
        for i, opened in enumerate(rows)
    ]
