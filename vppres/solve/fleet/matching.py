"""Whole customers whose demand takes up the sun of a step that can store nothing.

Every kW that they miss is lost, so the step asks for the set of most worth whose demand just fits:
a knapsack with hundreds of sets that are nearly as good. A search by binaries finds them one by
one; exchanging two customers, or twice two, comes within a watt.
"""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes

ROUNDS = 50
"""Exchanges at most: each is the best there is, and most steps need three to ten."""

NEAR = 200
"""Who may leave and who may enter, each: those whose worth for demand is nearest to where the sun
ends. All of 10,000 customers would be 25 million pairs."""

NOBODY = -1


def exchanged(worth: Floats, load_kw: Floats, given_kw: float) -> Flags:
    """A set of customers of nearly the most worth whose demand is no more than what is given.

    Parameters
    ----------
    worth : array, shape (C,)
        Of each customer; those of none or less are left out.
    load_kw : array, shape (C,)
        Demand.
    given_kw : float
        Most demand of all.

    Examples
    --------
    By worth for demand the first would be alone; the others take up 10 kW:

    >>> exchanged(np.array([7.0, 5.0, 4.9]), np.array([6.0, 5.0, 5.0]), 10.0).tolist()
    [False, True, True]
    """
    served = np.zeros(len(worth), dtype=bool)
    left_kw = given_kw
    order = np.argsort(-worth / np.maximum(load_kw, 1e-12), kind="stable")
    order = order[worth[order] > 0.0]
    for customer in order:
        if load_kw[customer] <= left_kw:
            served[customer] = True
            left_kw -= float(load_kw[customer])
    for _ in range(ROUNDS):
        leave = order[served[order]][-NEAR:]
        enter = order[~served[order]][:NEAR]
        left_kw = given_kw - float(load_kw @ served)
        moves = _best_two(leave, enter, worth, load_kw, left_kw)
        if moves is None:
            break
        leave, enter = moves
        served[leave[leave != NOBODY]] = False
        served[enter[enter != NOBODY]] = True
    return served


def _best_two(
    leave: Wholes, enter: Wholes, worth: Floats, load_kw: Floats, left_kw: float
) -> tuple[Wholes, Wholes] | None:
    """Who leaves and who enters in the two moves of most worth, None if they gain nothing.

    A move is one who leaves, one who enters, both or neither; the best partner of each is that of
    most worth among those that need no more than what is left.
    """
    pairs = np.meshgrid(np.append(NOBODY, leave), np.append(NOBODY, enter))
    leave, enter = (side.ravel() for side in pairs)
    kw, gain = (_changed(values, leave, enter) for values in (load_kw, worth))
    order = np.argsort(kw, kind="stable")
    leave, enter, kw, gain = leave[order], enter[order], kw[order], gain[order]
    most = np.maximum.accumulate(gain)
    best = np.maximum.accumulate(np.where(gain == most, np.arange(len(gain)), 0))
    last = np.searchsorted(kw, left_kw - kw, side="right") - 1
    partner = best[last]
    same_leaves = (leave == leave[partner]) & (leave != NOBODY)
    same_enters = (enter == enter[partner]) & (enter != NOBODY)
    possible = (last >= 0) & ~same_leaves & ~same_enters
    total = np.where(possible, gain + gain[partner], -np.inf)
    move = int(np.argmax(total))
    if total[move] <= 1e-12 * float(np.abs(worth).sum()):
        return None
    both = np.array([move, partner[move]])
    return leave[both], enter[both]


def _changed(values: Floats, leave: Wholes, enter: Wholes) -> Floats:
    """What moves add of some value of each customer."""
    padded = np.append(values, 0.0)  # of nobody, who is the last
    return np.asarray(padded[enter] - padded[leave])
