"""Typed errors: every failure a caller can react to has its own class."""

from __future__ import annotations

import os
import sysconfig
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from traceback import walk_tb
from typing import Any

from vppres.core.text import brief, visible

_LIBRARIES = tuple(f"{path}{os.sep}" for path in map(sysconfig.get_path, ("stdlib", "purelib")))
_PACKAGE = f"{Path(__file__).parents[1]}{os.sep}"


@dataclass(frozen=True)
class Problem:
    """One mistake in the input: where it is, what is wrong, how to cure it.

    Examples
    --------
    >>> print(Problem("pv.csv", "must be positive", "Give a rating in kW.", row=3,
    ...               field="p_max_kw", value=-5.0))
    pv.csv, row 3, p_max_kw = -5.0: must be positive. Give a rating in kW.
    """

    where: str  #: file name, or the name of the table when the data did not come from a file
    message: str  #: what is wrong, without the value and the place
    cure: str  #: what the user should do
    #: Line in the file (the header of a table is line 1), or position in the table.
    row: int | None = None
    field: str | None = None  #: column or key
    value: object = None  #: the offending value as it was read
    more: int = 0  #: further mistakes of the same kind
    rows: tuple[int, ...] = ()  #: rows of the first of these, if all are in one column

    def __str__(self) -> str:
        place = self.where
        if self.row is not None:
            place += f", row {self.row}"
        if self.field is not None:
            place += f", {self.field}"
            if self.value is not None:
                place += f" = {self.value}"
        more = f", and {self.more} more" if self.more else ""
        if self.rows:
            left = ", ..." if self.more > len(self.rows) else ""
            rows = ", ".join(map(str, (self.row, *self.rows)))
            more = f" (in {self.more + 1} rows: {rows}{left})"
        # Places and values are others' text: long words are cut, and what would steer a terminal is
        # written out.
        return visible(brief(f"{place}: {self.message}{more}. {self.cure}"))


def first_line(error: BaseException) -> str:
    """First line of an exception's message; its type's name if the message is empty.

    >>> first_line(KeyError("bus"))
    "lacks 'bus'"
    """
    if isinstance(error, KeyError):
        return f"lacks {error}"
    return next(iter(str(error).splitlines()), type(error).__name__)


def named_line(error: BaseException) -> str:
    """An exception's name and the first line of what it says.

    >>> named_line(ValueError("no such bus"))
    'ValueError: no such bus'
    """
    lines = str(error).splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def function_of(error: BaseException) -> str:
    """The function that an exception comes from: the innermost one outside of libraries."""
    frames = [frame.f_code for frame, _ in walk_tb(error.__traceback__)]
    written = [code for code in frames if not code.co_filename.startswith(_LIBRARIES)]
    own = [code for code in written if not code.co_filename.startswith(_PACKAGE)]
    code = (own or written or frames)[-1]
    return f"{code.co_qualname}, {Path(code.co_filename).name} line {code.co_firstlineno}"


class VppresError(Exception):
    """Base of all errors that vppres raises on purpose."""

    exit_status = 1


class InputError(VppresError):
    """The user's data or options are wrong; carries every problem that was found.

    Parameters
    ----------
    problems : iterable of Problem or str
        At least one.
    """

    exit_status = 2

    def __init__(self, problems: Iterable[Problem] | Problem | str) -> None:
        if isinstance(problems, (Problem, str)):
            problems = [problems]  # type: ignore[list-item]
        self.problems: tuple[Problem | str, ...] = tuple(problems)
        super().__init__("\n".join(str(p) for p in self.problems))

    @classmethod
    def of(cls, where: str, message: str, cure: str, **place: Any) -> InputError:
        """The error of one :class:`Problem`; ``place`` is its row, field and value.

        >>> print(InputError.of("pv.csv", "must be positive", "Give a rating in kW.", row=3))
        pv.csv, row 3: must be positive. Give a rating in kW.
        """
        return cls(Problem(where, message, cure, **place))


class StorageError(VppresError):
    """The disk took no more; the message says what was kept."""


class ReportError(VppresError):
    """Figures or report of a run could not be made; the run itself was written."""


class ModelError(VppresError):
    """The optimisation model cannot be built as asked, for example because it is not DPP."""


class SolveError(VppresError):
    """A solver gave no usable answer."""


class InfeasibleError(SolveError):
    """The window has no feasible dispatch."""


class UnboundedError(SolveError):
    """The window's objective is unbounded: the data are wrong."""


class NumericalError(SolveError):
    """The solver gave up for numerical reasons."""


class LimitError(SolveError):
    """Time ran out before the first feasible dispatch."""


class SolverLostError(SolveError):
    """The process that was solving a window died, ran out of memory or passed its deadline."""


class VerificationError(VppresError):
    """The AC power flow has no solution or was not found, or contradicts the dispatch."""
