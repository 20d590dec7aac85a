"""Commands of a script as OpenDSS gets them: by full names, without files and without code.

Runs in the process of the reader, where the engine itself says which classes, properties and
options it knows. A property may be abbreviated or stand by its place: which one it is, is found
here by the engine's rules, and written by its full name. So none is reached that is not meant.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np
import opendssdirect as dss

from vppres.feeders.dss.refused import RefusedLine, cut

IDLE = ("monitor", "energymeter", "sensor")
"""Classes that only measure: OpenDSS does not see them."""

CODE = re.compile(r"(user|shaft)(model|data)|dyna(dll|data)|dynamiceq|dynout", re.I)
"""Properties that name a library, or feed one."""

TRACES = "debugtrace"
"""A property that writes a file and changes nothing else: it is left out."""

FILES = {"csvfile": "", "pqcsvfile": "", "sngfile": "<f4", "dblfile": "<f8"}
"""Properties whose value is a file, and the numbers that it holds; text where there are none."""

_SET = """
voltagebases defaultbasefrequency basefrequency earthmodel loadmult genmult loadmodel algorithm
tolerance maxiterations maxcontroliter controlmode allowduplicates longlinecorrection normvminpu
normvmaxpu emergvminpu emergvmaxpu year allocationfactors %growth
"""
SET = frozenset(_SET.split())
"""Options that OpenDSS gets. All others are of a study or of its figures."""

CONTROLMODES = ("off", "static")

FUSES = 6
"""Most conductors of a fuse."""

COLUMNS = {
    "loadshape": ("hour", "mult"),
    "tshape": ("hour", "temp"),
    "priceshape": ("hour", "price"),
    "growthshape": ("year", "mult"),
    "xycurve": ("xarray", "yarray"),
    "spectrum": ("harmonic", "%mag", "angle"),
}
"""Properties that the columns of a file are; one column alone is the last but for a spectrum."""

MOST_VALUES = 1_000_000

Values = list[list[str]]


class Commands:
    """Texts of a job's commands, one by one.

    ``left_out`` has the options that were, ``elements`` what the commands are of, by their number.
    """

    def __init__(self, files: dict[str, str]) -> None:
        self.files = files
        self.left_out: dict[str, None] = {}
        self.elements: dict[int, str] = {}
        self.count = 0
        self.element = ""
        self.named_levels = False

    def text(self, verb: str, target: str, values: Values) -> str:
        """Command for the engine; empty if it gets none.

        Raises
        ------
        RefusedLine
            If the command asks for what is not done here.
        """
        self.count += 1
        if verb == "set":
            return self._set(values)
        if verb in ("new", "edit", "~", "batchedit"):
            return self._element(verb, target, values)
        if verb in ("open", "close", "enable", "disable"):
            if _kind(target) in IDLE:
                return ""
            words = [f'{verb} object="{target}"']
            return " ".join(words + [f"{name}={text}" for name, text, _ in values])
        if verb == "setkvbase":
            names = ("bus", "kvll", "kvln")
            return " ".join([verb, *self._written(names, values, "setkvbase")])
        return verb

    def _set(self, values: Values) -> str:
        """``set`` with the options that a network needs."""
        words = []
        for name, text, quote in values:
            option = _full(name, _options()) if name else ""
            mode = option == "controlmode" and not text.strip().lower().startswith(CONTROLMODES)
            if option not in SET or mode:
                self.left_out[option or name or text] = None
            else:
                self.named_levels |= option == "voltagebases"
                words.append(_assigned(option, text, quote))
        return " ".join(["set", *words]) if words else ""

    def _element(self, verb: str, target: str, values: Values) -> str:
        """``new``, ``edit`` and what continues them."""
        if verb != "~":
            self.element = target.lower()
        self.elements[self.count - 1] = self.element
        kind = _kind(self.element)
        if kind in IDLE:
            return ""
        if verb == "batchedit" and not re.fullmatch(r"[\w.*+?\[\]^$|\\-]+", target):
            raise RefusedLine(
                f"'{cut(target)}' is not a pattern", "Write: batchedit class.pattern."
            )
        if kind not in _schema():
            raise RefusedLine(
                f"'{cut(kind)}' is not a class of OpenDSS", "Correct it, or remove the element."
            )
        head = verb if verb == "~" else f'{verb} "{target}"'
        if verb == "batchedit":  # a pattern, which no quotes may hold
            head = f"{verb} {target}"
        return " ".join([head, *self._written(_schema()[kind], values, kind)])

    def _written(self, names: tuple[str, ...], values: Values, kind: str) -> Iterator[str]:
        """Properties by their full names, each with its value as it stands."""
        place = -1
        for name, text, quote in values:
            full = _full(name, names) if name else ""
            place = names.index(full) if full else place + 1
            if (name and not full) or place >= len(names):
                what = f"'{cut(name)}'" if name else f"the value '{cut(text)}' beyond its last"
                raise RefusedLine(
                    f"{kind} has {what}, which is not a property of OpenDSS",
                    "Correct or remove it.",
                )
            full = names[place]
            if CODE.fullmatch(full):
                raise RefusedLine(f"{kind} has '{full}', which names code", "Remove it.")
            if full == TRACES:
                continue
            if (kind, full) == ("fuse", "action"):  # OpenDSS writes past the end of its own array
                full, text, quote = "state", " ".join([text] * FUSES), "["
            if full in FILES:
                yield from self._in_file(kind, text, FILES[full], full)
            elif "=" in text:
                yield f"{full}=[{self._numbers_of(text)}]"
            else:
                yield _assigned(full, text, quote)

    def _in_file(self, kind: str, name: str, form: str, full: str) -> Iterator[str]:
        """The values of a file, as the properties that it stands for."""
        columns = COLUMNS[kind]
        table = self._binary(name, form)[:, None] if form else _table(self._content(name), name)
        if full == "pqcsvfile":
            columns = ("hour", "mult", "qmult")
        count = min(table.shape[1], len(columns))
        known = columns[:count] if kind in ("spectrum", "xycurve") else columns[-count:]
        if not (kind == "loadshape" and "hour" in known):
            yield f"npts={len(table)}" if kind != "spectrum" else f"numharm={len(table)}"
        else:
            yield f"npts={len(table)} interval=0"
        for column, values in zip(known, table.T, strict=False):
            yield f"{column}=[{_row(values)}]"

    def _numbers_of(self, text: str) -> str:
        """Numbers instead of ``file=name, column=2, header=yes`` in an array."""
        parts = dict(
            (key.strip().lower(), value.strip())
            for key, _, value in (each.partition("=") for each in re.split(r"[,\s]+(?=\w+=)", text))
        )
        name = next((parts.pop(key) for key in [*parts] if key in ("file", "csvfile")), None)
        binary = next((key for key in ("sngfile", "dblfile") if key in parts), "")
        if binary:
            name = parts.pop(binary)
            return _row(self._binary(name, FILES[binary]))
        column = next((parts.pop(key) for key in [*parts] if "column".startswith(key)), "1")
        header = next((parts.pop(key) for key in [*parts] if "header".startswith(key)), "no")
        if name is None or parts or not column.isdecimal():
            raise RefusedLine(f"'{cut(text)}' is not a value", "Write numbers, or file=name.csv.")
        table = _table(self._content(name), name, header.lower().startswith(("y", "t")))
        if not 1 <= int(column) <= table.shape[1]:
            raise RefusedLine(f"{cut(name)} has no column {column}", "Correct the column.")
        return _row(table[:, int(column) - 1])

    def _binary(self, name: str, form: str) -> Any:
        """Numbers of a file that holds nothing else."""
        content, size = self._content(name).encode("latin-1"), np.dtype(form).itemsize
        found = np.frombuffer(content[: len(content) // size * size], form)
        if len(content) % size or not np.isfinite(found).all():
            raise RefusedLine(
                f"{cut(name)} holds no numbers of {size} bytes", "Write it anew, or a csvfile."
            )
        return found

    def _content(self, name: str) -> str:
        """A file's bytes as Latin-1 text."""
        name = name.strip().strip("\"'")
        if name not in self.files:
            raise RefusedLine(
                f"names the file {cut(name)}, which is not in the master's folder",
                "Copy the file into the folder, and name it from there.",
            )
        return self.files[name]


def _kind(target: str) -> str:
    """Class of an element; a circuit is its source."""
    kind = target.partition(".")[0].strip().lower()
    return "vsource" if kind == "circuit" else kind


@cache
def _schema() -> dict[str, tuple[str, ...]]:
    """Properties of each class, in the engine's order."""
    dss.Text.Command("clear")
    dss.Text.Command("new circuit.schema")
    found = {}
    for kind in dss.Basic.Classes():
        with suppress(Exception):  # a control wants an element, and is there nevertheless
            dss.Text.Command(f"new {kind}.schema")
        dss.Circuit.SetActiveElement(f"{kind}.schema")
        dss.ActiveClass.Name("schema")
        names = dss.Element.AllPropertyNames()
        found[kind.lower()] = tuple(name.lower() for name in names)
    dss.Text.Command("clear")
    return found


@cache
def _options() -> tuple[str, ...]:
    """Options of ``set``, in the engine's order."""
    executive = dss.Executive
    return tuple(executive.Option(i).lower() for i in range(1, executive.NumOptions() + 1))


def _full(name: str, names: tuple[str, ...]) -> str:
    """The name that is meant: itself, else the first that begins so; empty for none."""
    name = name.strip().lower()
    if name in names:
        return name
    return next((each for each in names if name and each.startswith(name)), "")


def _assigned(name: str, text: str, quote: str) -> str:
    """A property and its value, in the quotes in which it stood."""
    closed = {"(": ")", "[": "]", "{": "}"}.get(quote, quote)
    return f"{name}={quote}{text}{closed}"


def _table(content: str, name: str, header: bool = False) -> Any:
    """Numbers of a text, in columns; a first line of words is a header."""
    rows = [[cell for cell in re.split(r"[,;\s]+", line.strip()) if cell]
            for line in content.splitlines()]  # fmt: skip
    rows = [row for row in rows if row][int(header) :]
    try:
        float(rows[0][0])
    except (ValueError, IndexError):
        rows = rows[1:]
    width = min(map(len, rows), default=0)
    try:
        table = np.array([[float(cell) for cell in row[:width]] for row in rows])
    except ValueError:
        table = np.zeros((0, 0))
    if not table.size or table.size > MOST_VALUES or not np.isfinite(table).all():
        raise RefusedLine(f"{cut(name)} holds no columns of numbers", "Give one value a line.")
    return table


def _row(values: Any) -> str:
    """Numbers as an array has them."""
    return " ".join(f"{value:.17g}" for value in values)
