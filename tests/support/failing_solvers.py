"""Solvers that end badly at one window, for processes that are to survive it or to be replaced.

The window is known by the price of its first step; all others are solved.
"""

from __future__ import annotations

import ctypes
import math
import os
from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np

from vppres.core.errors import InfeasibleError, InputError, Problem
from vppres.model.data import WindowData
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution

BAD_PRICE = 9.75
"""Price of the first step at which a solver fails, in GBP/kWh."""

FOR_EVER_S = 3600


def bad(data: WindowData) -> WindowData:
    """The window at which a solver fails."""
    prices = np.array(data.price_gbp_per_kwh)
    prices[0] = BAD_PRICE
    return replace(data, price_gbp_per_kwh=prices)


class Failing(WindowSolver, ABC):
    """Fails at the window with the bad price."""

    def solve(self, data: WindowData, within_s: float = math.inf) -> WindowSolution:
        """Solve a window, or fail at it."""
        if data.price_gbp_per_kwh[0] == BAD_PRICE:
            self.fail()
        return super().solve(data, within_s)

    @abstractmethod
    def fail(self) -> None:
        """Fail in the way of the class."""


class Sleeping(Failing):
    """Waits in compiled code, which lets other threads of the process go on."""

    def fail(self) -> None:
        ctypes.CDLL(None).sleep(FOR_EVER_S)


class Blocking(Failing):
    """Waits in compiled code that holds the interpreter's lock: no other thread goes on."""

    def fail(self) -> None:
        ctypes.PyDLL(None).sleep(FOR_EVER_S)


class Crashing(Failing):
    """Reads where there is nothing."""

    def fail(self) -> None:
        ctypes.string_at(0)


class Counting(Crashing):
    """Says how often a window was solved in its process, in place of the compiled problems."""

    solved = 0

    @property
    def compilations(self) -> int:
        """Windows solved so far, by all solvers of the process."""
        return Counting.solved

    def solve(self, data: WindowData, within_s: float = math.inf) -> WindowSolution:
        """Solve a window and count it."""
        Counting.solved += 1
        return super().solve(data, within_s)


class Hungry(Failing):
    """Asks for more memory than it may have, in pieces."""

    def fail(self) -> None:
        held = [np.empty(10_000_000) for _ in range(10_000)]
        raise AssertionError(f"800 GB were there: {len(held)}")


class HungryInC(Failing):
    """Does as compiled code does that finds no memory: says so and aborts."""

    def fail(self) -> None:
        libc = ctypes.CDLL(None)
        libc.malloc.restype = ctypes.c_void_p
        libc.malloc.argtypes = [ctypes.c_size_t]
        while libc.malloc(1 << 28):
            pass
        os.write(2, b"terminate called after throwing an instance of 'std::bad_alloc'\n")
        os.abort()


class Leaving(Failing):
    """Ends its process with a status of its own."""

    def fail(self) -> None:
        os._exit(3)


class Infeasible(Failing):
    """Raises an error of the package."""

    def fail(self) -> None:
        raise InfeasibleError("The window has no feasible dispatch.")


class Refusing(Failing):
    """Raises an error that carries more than its text."""

    def fail(self) -> None:
        raise InputError(
            [
                Problem("pv.csv", "must be positive", "Give a rating.", row=3),
                Problem("pv.csv", "is not there", "Give one.", field="id"),
            ]
        )


class Local(Failing):
    """Raises an error that cannot be pickled."""

    def fail(self) -> None:
        class HomeMadeError(Exception):
            pass

        raise HomeMadeError("nobody knows me")
