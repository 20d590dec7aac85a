"""Threads of a process build and solve problems one after another.

Solvers of equal sites share compiled problems, which are filled, solved and read. Nor can two
different problems be built at a time: cvxpy numbers variables by a counter that threads can turn
back, and two variables of one number are one variable. Most of a window's time is spent in Python,
which threads share anyway; processes are what makes windows faster.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

_turn = threading.RLock()


def one_at_a_time(solve: Callable[P, R]) -> Callable[P, R]:
    """Let a function wait until no other thread is in one of its kind; it may call others.

    Examples
    --------
    >>> @one_at_a_time
    ... def countdown(n: int) -> int:
    ...     return n if n == 0 else countdown(n - 1)
    >>> countdown(3)
    0
    """

    @wraps(solve)
    def waiting(*args: P.args, **kwargs: P.kwargs) -> R:
        with _turn:
            return solve(*args, **kwargs)

    return waiting


def _new_turn() -> None:
    """In a fork: the thread that had the turn is not there to give it back."""
    global _turn
    _turn = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_new_turn)
