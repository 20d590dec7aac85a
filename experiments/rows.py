"""Rows of the report's table: published, ours, difference, verdict, reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from experiments.published import STATEMENTS

Reason = str | Callable[[], str]


@dataclass(frozen=True)
class Row:
    """One statement beside what was found."""

    #: As in :mod:`experiments.published`; the quantity may name a case in addition.
    id: str
    quantity: str
    published: str
    #: What was found, how far it lies outside of the published range, and how far it may.
    ours: str
    difference: str
    tolerance: str
    holds: bool  #: whether it is within tolerance, or the assertion holds
    reason: str = ""  #: the measured reason where it is not; empty otherwise

    @property
    def verdict(self) -> str:
        """The verdict in a word."""
        return "yes" if self.holds else "no"


def measured(id: str, value: float, form: str = ".3f", case: str = "", reason: Reason = "") -> Row:
    """Row of a number."""
    statement = STATEMENTS[id]
    difference = statement.difference(value)
    holds = statement.holds(value)
    return Row(
        id,
        _quantity(id, case),
        statement.published,
        format(value, form),
        format(difference, form) if difference else "0",
        format(statement.tolerance, form) if statement.tolerance else "0",
        holds,
        "" if holds else _text(reason),
    )


def measured_all(
    id: str, values: Sequence[float], form: str = ".3f", case: str = "", reason: Reason = ""
) -> Row:
    """Row of several numbers, judged by the one farthest from the published range."""
    statement = STATEMENTS[id]
    worst = max(values, key=lambda value: abs(statement.difference(value)))
    row = measured(id, worst, form, case, reason)
    return replace(row, ours=numbers(values, form))


def asserted(
    id: str, facts: Mapping[str, Any], ours: str, case: str = "", reason: Reason = ""
) -> Row:
    """Row of a statement in words, true if all facts are.

    Parameters
    ----------
    id : str
        The statement.
    facts : mapping of str to bool
        What the words claim, in parts.
    ours : str
        The numbers behind it.
    case : str
        Which case, where the statement has several.
    reason : str or callable
        Why one does not hold.
    """
    failed = [name for name, true in facts.items() if not true]
    why = f"Not met: {', '.join(failed)}. {_text(reason)}".strip() if failed else ""
    return Row(id, _quantity(id, case), STATEMENTS[id].published, ours, "", "", not failed, why)


def order(row: Row) -> tuple[int, str]:
    """Sorting key: R2 before R10."""
    digits = "".join(c for c in row.id if c.isdigit())
    return int(digits), row.id


def numbers(values: Any, form: str = ".3f") -> str:
    """Numbers in a line."""
    return ", ".join(format(float(value), form) for value in np.atleast_1d(values))


def _quantity(id: str, case: str) -> str:
    quantity = STATEMENTS[id].quantity
    return f"{quantity}: {case}" if case else quantity


def _text(reason: Reason) -> str:
    return reason() if callable(reason) else reason
