"""Joined nodes, and matrices without some nodes; for the reader and its process alike."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

from vppres.core.units import V_PER_KV, VA_PER_KVA

N = TypeVar("N")

ANGLES = np.exp(-2j * np.pi / 3 * np.arange(3))
"""Turns of phases a, b and c."""


def beside(groups: Iterable[Sequence[N]]) -> dict[N, list[N]]:
    """Neighbours of each node by groups of joined nodes."""
    found: dict[N, list[N]] = {}
    for group in groups:
        for one in group:
            found.setdefault(one, []).extend(other for other in group if other != one)
    return found


def reached(start: N, beside: dict[N, list[N]]) -> list[N]:
    """A node, and all that are joined to it.

    >>> reached("a", beside([("a", "b"), ("c", "d"), ("b", "e")]))
    ['a', 'b', 'e']
    """
    found: dict[N, None] = {}
    new = [start]
    while new:
        each = new.pop()
        if each not in found:
            found[each] = None
            new += beside.get(each, [])
    return [*found]


def without(y: Any, gone: Sequence[int]) -> Any:
    """A matrix without some of its nodes, from which nothing else flows (Kron)."""
    kept = [i for i in range(len(y)) if i not in gone]
    own, across = y[np.ix_(kept, kept)], y[np.ix_(kept, gone)]
    return own - across @ np.linalg.pinv(y[np.ix_(gone, gone)]) @ across.T


def power_at_nominal(nodes: Sequence[int], y: Any, base_kv: float) -> complex:
    """Power of a matrix at the nominal voltages of its bus, in kW and kvar; neutrals have 0 V."""
    phases = [i for i, node in enumerate(nodes) if 1 <= node <= len(ANGLES)]
    v = base_kv * V_PER_KV / np.sqrt(3) * ANGLES[[nodes[i] - 1 for i in phases]]
    return complex((v * np.conj(y[np.ix_(phases, phases)] @ v)).sum()) / VA_PER_KVA
