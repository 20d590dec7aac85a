"""From a failed validation to problems that a user can cure."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from difflib import get_close_matches
from math import isfinite
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from vppres.core.arrays import Wholes
from vppres.core.errors import Problem
from vppres.core.text import named
from vppres.io import schema

MAX_PROBLEMS_PER_FILE = 50
MAX_PROBLEMS_PER_KIND = 10
MAX_ROWS_PER_PROBLEM = 5
# To look for near names costs the product of both numbers of names: few are enough to see a habit.
_MAX_NAMES_COMPARED = 2000
_MAX_COMPARED_LENGTH = 100
_MAX_VALUE_LENGTH = 60
_MAX_NAMES_IN_CURE = 12

_MESSAGES = {
    "missing": "is missing",
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than_equal": "must be at most {le:g}",
    "float_type": "is not a number",
    "float_parsing": "is not a number",
    "finite_number": "is not a finite number",
    "int_type": "is not a whole number",
    "int_parsing": "is not a whole number",
    "bool_type": "is not true or false",
    "string_type": "is not text",
    "string_too_short": "is empty",
    "string_pattern_mismatch": "is not allowed",
    "string_too_long": "is longer than {max_length} characters",
    "too_short": "is empty",
    "literal_error": "must be {expected}",
    "datetime_type": "is not a date and time",
    "timezone_aware": "has no time zone",
    "model_type": "is not a table",
    "dict_type": "is not a table",
    "list_type": "is not a list of tables",
}
_CURES = {
    "datetime_type": "Write it with offset and without quotes, for example 2022-07-19T12:00:00Z.",
    "timezone_aware": "Write it with an offset, for example 2022-07-19T12:00:00Z.",
    "bool_type": "Write true or false, without quotes.",
    "list_type": "Write [[outages]] with start and end for each outage.",
}
_VALUES = re.compile(r"[\d(:']")  # where the values in a message begin
_FILE_CURE = "Give a file name in the scenario folder that ends in .csv or .parquet."


def problems_of(
    error: ValidationError, model: type[BaseModel], where: str, row: int | None = None
) -> list[Problem]:
    """One problem for each mistake that the validation of ``model`` found.

    ``row`` is the line in the file: a missing value is an empty cell there, and a missing key
    elsewhere.
    """
    return [_problem(details, model, where, row) for details in error.errors()]


def did_you_mean(name: str, known: Iterable[str], otherwise: str) -> str:
    """A cure for an unknown name: the nearest known name, or all known names if they are few.

    >>> did_you_mean("critcal", ["critical", "high"], "Add it.")
    'Did you mean critical?'
    >>> did_you_mean("x", ["critical", "high"], "Add it.")
    'Add it. Known: critical, high.'
    """
    names = [str(k) for k in known]
    short = [k for k in names[:_MAX_NAMES_COMPARED] if len(k) <= _MAX_COMPARED_LENGTH]
    near = get_close_matches(name, short, n=1) if len(name) <= _MAX_COMPARED_LENGTH else []
    if near:
        return f"Did you mean {near[0]}?"
    if 0 < len(names) <= _MAX_NAMES_IN_CURE:
        return f"{otherwise} Known: {named(names)}."
    return otherwise


class Suggestions:
    """Cures for many unknown names: the first ones are compared with the known names.

    A message lists no more than ``MAX_PROBLEMS_PER_KIND`` mistakes of a kind, so that
    comparing more of them would be work for nothing.

    ``otherwise`` is the cure where no name is near.
    """

    def __init__(self, known: Iterable[str], otherwise: str) -> None:
        self._known = list(known)
        self._otherwise = otherwise
        self._given = 0

    def cure(self, name: str) -> str:
        """The cure for one name."""
        self._given += 1
        if self._given > MAX_PROBLEMS_PER_KIND:
            return self._otherwise
        return did_you_mean(name, self._known, self._otherwise)


def shown(value: object) -> str | None:
    """A value as a message shows it; nothing for an empty one."""
    text = str(value)
    if text == "":
        return None
    return text if len(text) <= _MAX_VALUE_LENGTH else text[:_MAX_VALUE_LENGTH] + "..."


def in_order(problems: Iterable[Problem], files: Iterable[str]) -> list[Problem]:
    """Problems by file and row, those of one kind folded; of very many, the first and a count."""
    place = {file: i for i, file in enumerate(dict.fromkeys(files))}
    by_file: dict[str, list[Problem]] = {}
    for problem in problems:
        by_file.setdefault(problem.where, []).append(problem)
    ordered: list[Problem] = []
    for file in sorted(by_file, key=lambda name: place.get(name, -1)):
        found = folded(sorted(by_file[file], key=lambda p: -1 if p.row is None else p.row))
        ordered += found[:MAX_PROBLEMS_PER_FILE]
        more = sum(1 + problem.more for problem in found[MAX_PROBLEMS_PER_FILE:])
        if more > 0:
            ordered.append(Problem(file, f"has {more} more problems", "Fix those above first."))
    return ordered


def few(positions: Sequence[int] | Wholes, make: Callable[[int], Problem]) -> list[Problem]:
    """The problems at the first positions, of which the last one counts the others.

    >>> print(*few(range(25), lambda i: Problem("a.csv", "is empty", "Fill it.", row=i)))
    a.csv, row 0: is empty (in 25 rows: 0, 1, 2, 3, 4, ...). Fill it.
    """
    made = [make(int(i)) for i in positions[:MAX_PROBLEMS_PER_KIND]]
    found = folded(made)
    more = len(positions) - len(made)
    if more > 0:
        found[-1] = replace(found[-1], more=found[-1].more + more)
    return found


def folded(problems: Iterable[Problem]) -> list[Problem]:
    """Problems in their order, the first of each kind, the last one listed counting the others.

    A kind is a message, without the values in it, and the column of a row's problem. Rows of a
    column that have one cure are one problem.

    >>> column = [Problem("a.csv", "is empty", "Fill it.", row=i, field="x") for i in range(15)]
    >>> print(*folded(column))
    a.csv, row 0, x: is empty (in 15 rows: 0, 1, 2, 3, 4, ...). Fill it.
    """
    kept: list[Problem] = []
    places: dict[tuple[str, str | None], list[int]] = {}
    columns: dict[tuple[str, str, str | None, str], int] = {}
    for problem in problems:
        kind = _VALUES.split(problem.message)[0]
        field = None if problem.row is None else problem.field
        column = (problem.where, kind, field, problem.cure)
        same = places.setdefault((kind, field), [])
        if problem.row is not None and column in columns:
            first = kept[columns[column]]
            rows = (*first.rows, problem.row, *problem.rows)[: MAX_ROWS_PER_PROBLEM - 1]
            more = first.more + 1 + problem.more
            kept[columns[column]] = replace(first, more=more, rows=rows)
        elif len(same) < MAX_PROBLEMS_PER_KIND:
            columns[column] = len(kept)
            same.append(len(kept))
            kept.append(problem)
        else:
            last = kept[same[-1]]
            kept[same[-1]] = replace(last, more=last.more + 1 + problem.more)
    return kept


def _problem(details: ErrorDetails, model: type[BaseModel], where: str, row: int | None) -> Problem:
    kind = details["type"]
    place = tuple(part for part in details["loc"] if part != "[key]")  # a name of a tier
    owner, field = _find(model, place)
    name = dotted(place)
    if kind == "extra_forbidden":
        return Problem(
            where,
            "is not a known key",
            did_you_mean(str(place[-1]), owner.model_fields, "Remove it."),
            field=name,
        )
    template = _MESSAGES.get(kind, details["msg"][:1].lower() + details["msg"][1:])
    message = template.format(**details.get("ctx", {})) if kind in _MESSAGES else template
    if row is not None and kind == "missing":
        message = "is empty"
    has_value = kind not in ("missing", "too_short")
    cure = _CURES.get(kind, schema.cure(field))
    if kind == "flawed_name":
        cure = details["ctx"]["cure"]
    elif kind == "string_pattern_mismatch" and owner is schema.FilesSection:
        cure = _FILE_CURE
    if kind in ("float_type", "int_type") and _is_number(details["input"]):
        message, cure = "is text", "Write the number without quotes."
    return Problem(
        where,
        message,
        cure,
        row=row,
        field=name,
        value=shown(details["input"]) if has_value else None,
    )


def _is_number(value: object) -> bool:
    """Whether a value is a number written as text."""
    try:
        return isinstance(value, str) and isfinite(float(value))
    except ValueError:
        return False


def dotted(place: tuple[int | str, ...]) -> str:
    """A place in scenario.toml, for example ``outages[1].start`` (the first outage is 1)."""
    text = ""
    for part in place:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _find(
    model: type[BaseModel], place: tuple[int | str, ...]
) -> tuple[type[BaseModel], FieldInfo]:
    """The innermost model and field on the way to a place."""
    owner = model
    field = FieldInfo()
    inner: type[BaseModel] | None = model
    for part in place:
        if inner is None or isinstance(part, int):
            continue
        owner = inner
        if part not in inner.model_fields:
            break
        field = inner.model_fields[part]
        inner = _inner_model(field.annotation)
    return owner, field


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    """The model that a field holds, alone or in a list."""
    for kind in (annotation, *get_args(annotation)):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None
