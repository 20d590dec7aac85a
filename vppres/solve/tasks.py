"""Messages of a controller and a solver's process.

Each is pickled, which says where it ends, so that a stream of them needs nothing between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from vppres.core.errors import InputError
from vppres.model.beyond_paper.table import own_additions
from vppres.model.site import Site
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

OUT_OF_MEMORY = 77
"""Status with which a solver's process ends when memory runs out: no other end has it."""


def _own_parts() -> tuple[str, ...]:
    """Names of your own parts that are added in this process."""
    return tuple(part.__qualname__ for part in own_additions())


@dataclass(frozen=True, eq=False)
class Setup:
    """Setup of a solver; those of equal content are equal."""

    #: Makes the solver of the fields that follow; a class or function of a module, so that its name
    #: is all that crosses the socket.
    factory: Callable[[Site, str, str, SolveLimits, int], WindowSolver]
    site: Site  #: fixed data
    #: Names of the method and in the table of solvers.
    method: str
    solver: str
    limits: SolveLimits  #: gaps and time limit of a window
    polygon_sides: int  #: sides of an inverter's polygon
    own: tuple[str, ...] = field(default_factory=_own_parts)  #: your own parts that the problem has

    @cached_property
    def key(self) -> str:
        """Content in words."""
        return (
            f"{self.factory!r} {self.site.key} {self.method} {self.solver} {self.limits} "
            f"{self.polygon_sides}"
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Setup) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def make(self) -> WindowSolver:
        """The solver.

        Raises
        ------
        InputError
            If the problem has parts of your own that this process does not know.
        """
        if self.own != _own_parts():
            raise InputError.of(
                "options",
                f"does not know the problem's own parts ({', '.join(self.own)})",
                "Solve in this process, or write them into the package's page.",
                field="isolate",
                value="true",
            )
        return self.factory(self.site, self.method, self.solver, self.limits, self.polygon_sides)


@dataclass(frozen=True, eq=False)
class Task:
    """A method of a solver to be called."""

    setup: Setup  #: of the solver
    method: str  #: name of the method
    args: tuple[Any, ...]  #: what it is called with


@dataclass(frozen=True, eq=False)
class Reply:
    """Reply to a task: a value or an error."""

    value: Any = None
    error: Exception | None = None
    compilations: int = 0
