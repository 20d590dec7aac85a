"""The options of a run and of a new scenario, one row each.

A row of ``options.csv`` beside this module states an option's name, type, default, bounds, unit and
meaning once. From it come the checks and defaults of :class:`vppres.day.options.RunOptions`, the
command line of ``run`` and ``sweep``, the parameters of a sweep, two sections of scenario.toml with
their JSON Schema, and the table in ``docs/command-line.md``. ``new_options.csv`` and
``import_options.csv`` have those of ``new``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

from vppres.core.errors import InputError, Problem
from vppres.core.tables import packaged_table

Value = str | float | int | bool


@dataclass(frozen=True)
class NumberRange:
    """Numbers that an option takes; infinity and NaN are in none.

    Examples
    --------
    >>> [RANGES["positive"].holds(number) for number in (0.0, float("nan"), 0.1)]
    [False, False, True]
    """

    #: Bounds, which belong to the range unless it is open there.
    least: float
    most: float
    #: What to say of a number outside.
    message: str
    cure: str
    #: Whether the bound itself is outside.
    open_least: bool = False
    open_most: bool = False

    def holds(self, value: Any) -> bool:
        """Whether a number is in the range."""
        if isinstance(value, bool | str):
            return False
        above = self.least < value if self.open_least else self.least <= value
        below = value < self.most if self.open_most else value <= self.most
        return isfinite(value) and above and below


RANGES = {
    "hours": NumberRange(0, inf, "must be zero or positive", "Give hours."),
    "count": NumberRange(0, inf, "must not be negative", "Give a whole number from zero."),
    "not negative": NumberRange(0, inf, "must be zero or positive", "Give a number from 0."),
    "positive": NumberRange(0, inf, "must be positive", "Give a number above 0.", open_least=True),
    "at least one": NumberRange(1, inf, "must be at least 1", "Give a factor, for example 1.5."),
    "share": NumberRange(0, 1, "must lie between 0 and 1", "Give a share, for example 0.8."),
    "error bias": NumberRange(
        -1, inf, "must be a number not below -1", "Give a share, for example 0.05."
    ),
    "error growth": NumberRange(
        0, inf, "must be a number not below 0", "Give a share, for example 0.05."
    ),
    "headroom": NumberRange(
        0,
        1,
        "must be a share from 0 to below 1",
        "Give a share of the inverter's rating, for example 0.1.",
        open_most=True,
    ),
    "rota": NumberRange(0, 24, "must lie between 0 and 24", "Give hours of 24, for example 1."),
}
"""Ranges by the names that the tables give them."""

_KINDS: dict[str, Any] = {
    "text": str,
    "texts": list[str],
    "number": float,
    "whole number": int,
    "switch": bool,
    "three numbers": tuple[float, float, float],
}


@dataclass(frozen=True)
class Option:
    """One option of a run."""

    name: str  #: name on the command line without its hyphens in front, and of a sweep's parameter
    field: str  #: field of ``RunOptions`` that it fills; ``group.field`` for one of a group in it
    kind: type  #: ``str``, ``float``, ``int`` or ``bool``
    default: Value | None  #: value where neither the command line nor a scenario says otherwise
    meaning: str  #: what it is, as a phrase that can begin a sentence; of a switch, what it does
    words: str = ""  #: the choices in words, where their names do not say enough
    page: str = ""  #: what the documentation adds, in Markdown
    unit: str = ""  #: unit, if it has one
    #: Words that it takes; empty for numbers, and for names that another table checks.
    choices: tuple[str, ...] = ()
    #: Words that it takes besides, for studies; neither offered nor documented.
    hidden: tuple[str, ...] = ()
    range: NumberRange | None = None  #: numbers that it takes
    unset: str = ""  #: what None means
    group: str = ""  #: heading in the help
    #: Key of scenario.toml that sets it, ``section.key``; empty if a scenario cannot.
    scenario_key: str = ""
    #: Whether it is the scenario's in Python too, unless it is given there.
    follows_scenario: bool = False
    file_most: float = inf  #: largest number that scenario.toml may hold
    command_line: bool = True  #: whether ``run`` and ``sweep`` have it; Python always has
    sweep: bool = True  #: whether a sweep can vary it
    live: bool = True  #: whether it has a meaning for a live controller, whose plant is the site
    acts_with: str = ""  #: option without which it has no effect, and values of that one
    usual: bool = False  #: whether ``--help`` shows it; ``--help-all`` shows all

    @property
    def run_default(self) -> Value | None:
        """Default of its field in ``RunOptions``; None where the scenario decides."""
        return None if self.follows_scenario else self.default

    def problems(self, value: Any) -> Iterator[Problem]:
        """Faults of a value; None has no fault where it has a meaning."""
        if value is None and self.run_default is None:
            return
        if self.choices and value not in (*self.choices, *self.hidden):
            yield Problem(
                "options",
                "is not known",
                f"Use one of: {', '.join(self.choices)}.",
                field=self.field,
                value=value,
            )
        elif self.range is not None and not self.range.holds(value):
            yield Problem(
                "options", self.range.message, self.range.cure, field=self.field, value=value
            )
        elif self.kind is bool and value not in (True, False):
            message = "is neither true nor false"
            yield Problem("options", message, "Give True or False.", field=self.field, value=value)
        elif self.kind is float and (value is None or isinstance(value, bool | str)):
            yield Problem("options", "is not a number", "Give one.", field=self.field, value=value)
        elif self.kind is int and not _is_whole(value):
            message = "is not a whole number"
            yield Problem("options", message, "Give one.", field=self.field, value=value)


def _is_whole(value: Any) -> bool:
    """Whether a value is a whole number."""
    try:
        return bool(int(value) == value)
    except (TypeError, ValueError, OverflowError):
        return False


def _default(kind: type, cell: str) -> Value | None:
    """The default that a cell states; an empty one is None."""
    if not cell:
        return None
    value: Value = cell == "on" if kind is bool else kind(cell)
    return value


def _option(row: dict[str, str]) -> Option:
    """The option that a row of a table states; a column that the table has not is empty."""
    kind = _KINDS[row["type"]]
    flags = row.get("flags", "").split()
    texts = ("name", "field", "meaning", "words", "page", "unit", "unset", "group")
    texts_of_runs = ("scenario_key", "acts_with")
    return Option(
        kind=kind,
        default=_default(kind, row["default"]),
        choices=tuple(row["choices"].split()),
        hidden=tuple(row.get("hidden", "").split()),
        range=RANGES.get(row.get("range", "")),
        follows_scenario="follows-scenario" in flags,
        file_most=float(row.get("file_most") or inf),
        command_line="python-only" not in flags,
        sweep="unswept" not in flags,
        live="simulated" not in flags,
        usual="usual" in flags,
        **{name: row.get(name, "") for name in (*texts, *texts_of_runs)},
    )


OPTIONS = tuple(_option(row) for row in packaged_table(__file__, "options.csv"))
NEW_OPTIONS = tuple(_option(row) for row in packaged_table(__file__, "new_options.csv"))
"""Options of a new scenario, fields of ``NewScenarioOptions``."""

IMPORT_OPTIONS = tuple(_option(row) for row in packaged_table(__file__, "import_options.csv"))
"""Options of the network that it is made of, parameters of ``import_network``."""

_BY_FIELD = {option.field: option for option in OPTIONS}


def option_of(field: str) -> Option:
    """The option that fills a field of ``RunOptions``."""
    return _BY_FIELD[field]


def default_of(field: str) -> Any:
    """Default of the option that fills a field of ``RunOptions``.

    >>> default_of("horizon_h")
    5.0
    """
    return _BY_FIELD[field].default


def check_group(group: str, values: object) -> None:
    """Refuse values of a group of ``RunOptions`` that are out of their range."""
    parted = [(option.field.partition("."), option) for option in OPTIONS]
    problems = [
        problem
        for (name, _, field), option in parted
        if name == group and field
        for problem in option.problems(getattr(values, field))
    ]
    if problems:
        raise InputError(problems)


def section_options(section: str) -> dict[str, Option]:
    """Options that a section of scenario.toml sets, by their keys.

    >>> list(section_options("controller"))
    ['kind', 'horizon_h', 'mode', 'soc_end', 'outages', 'voltage_limits', 'ratings']
    """
    parted = [(option.scenario_key.partition("."), option) for option in OPTIONS]
    return {key: option for (name, _, key), option in parted if name == section}
