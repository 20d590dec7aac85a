"""A MATPOWER case written as a MATLAB function: its tables, and the units that it converts.

Nothing is run. A statement is a table of numbers, a text or cell, which are left out, a number, or
columns times a number: ``mpc.branch(:, [BR_R BR_X]) = mpc.branch(:, [BR_R BR_X]) / Zbase``. Such an
expression is parsed by Python, and computed node by node with numpy. All else is refused with its
line.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from vppres.core.arrays import Floats


def _numbered(first: int, names: str) -> dict[str, int]:
    return {name: number for number, name in enumerate(names.split(), start=first)}


FUNCTIONS = {
    "idx_bus": _numbered(1, "PQ PV REF NONE")
    | _numbered(1, "BUS_I BUS_TYPE PD QD GS BS BUS_AREA VM VA BASE_KV ZONE VMAX VMIN")
    | _numbered(14, "LAM_P LAM_Q MU_VMAX MU_VMIN"),
    "idx_brch": _numbered(1, "F_BUS T_BUS BR_R BR_X BR_B RATE_A RATE_B RATE_C TAP SHIFT BR_STATUS")
    | _numbered(14, "PF QF PT QT MU_SF MU_ST")
    | _numbered(12, "ANGMIN ANGMAX")
    | _numbered(20, "MU_ANGMIN MU_ANGMAX"),
    "idx_gen": _numbered(1, "GEN_BUS PG QG QMAX QMIN VG MBASE GEN_STATUS PMAX PMIN")
    | _numbered(22, "MU_PMAX MU_PMIN MU_QMAX MU_QMIN")
    | _numbered(11, "PC1 PC2 QC1MIN QC1MAX QC2MIN QC2MAX RAMP_AGC RAMP_10 RAMP_30 RAMP_Q APF"),
    "idx_cost": _numbered(1, "PW_LINEAR POLYNOMIAL")
    | _numbered(1, "MODEL STARTUP SHUTDOWN NCOST COST"),
}
"""Outputs of each function in their order, with their values."""

ALL = {name: value for outputs in FUNCTIONS.values() for name, value in outputs.items()}
"""What ``define_constants`` defines."""

CURE = "Load the case in MATPOWER, write it with savecase, and import that file."
"""The way out for whatever is not read here."""

MOST_REFUSED = 20
MOST_STATEMENTS = 1000  # the cases that come with MATPOWER have some 40
MOST_SIGNS = 200_000  # brackets, and ends of statements and lines outside of tables
MOST_WORK = 100_000_000  # numbers that all operations together may make
LONGEST = 200  # characters of an expression, or of what it is assigned to

_TEXT_OR_COMMENT = re.compile(r"'(?:[^'\n]|'')*'|\"[^\"\n]*\"|[%#][^\n]*")
_CONTINUED = re.compile(r"\.\.\.[^\n]*\n")
_SIGN = re.compile(r"\[[^()\[\]{}]*\]|[;,\n()\[\]{}]")  # a table of numbers is one
_DEEPER = {"(": 1, "[": 1, "{": 1, ")": -1, "]": -1, "}": -1}

_NAME = re.compile(r"[A-Za-z][\w.]*", re.ASCII)
_HEAD = re.compile(r"function\s+(?:(\w+)\s*=\s*)?\w+(?:\s*\(\s*\))?$")
_CONSTANTS = re.compile(r"\[([\w\s,~!]*)\]\s*=\s*(\w+)(?:\s*\(\s*\))?$")
_CELL_OR_STRUCTURE = re.compile(r"[A-Za-z]\w*(?:\.\w+){2,}|[A-Za-z][\w.]*\s*\{")
_EXPRESSION = re.compile(r"[\w\s.,:+\-*/^()\[\]]*", re.ASCII)
# Elements of a table: all rows or one, and a column, a range of them, or some in brackets.
_PART = re.compile(r"([A-Za-z][\w.]*)\s*\(\s*(:|\w+)\s*,\s*(\w+(?:\s*:\s*\w+)?|\[[\w\s,]+\])\s*\)")
# One operand at least is a number, so that MATLAB's two products are one.
_OPERATOR = re.compile(r"\.(?=[*/^])")
_BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_CALLS: dict[str, Callable[[Any], Any]] = {
    "acos": np.arccos,
    "cos": np.cos,
    "sin": np.sin,
    "sqrt": np.sqrt,
    "tan": np.tan,
}


class Refused(Exception):
    """A statement that is not read: its line, and why."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line
        self.message = message


def tables_of(text: str) -> dict[str, Floats]:
    r"""The fields of a case after its last statement, by name, shape (rows, columns) each.

    Raises
    ------
    ExceptionGroup
        Of :class:`Refused`, one for each statement that is not read; arithmetic is only tried
        before the first of them.

    Examples
    --------
    >>> tables_of("mpc.bus = [1 5e3; 2 7e3];\nmpc.bus(:, 2) = mpc.bus(:, 2) / 1e3;")["bus"]
    array([[1., 5.],
           [2., 7.]])
    """
    case = _Case()
    refused: list[Refused] = []
    for count, (line, statement) in enumerate(_statements(text)):
        if statement == "return" or len(refused) == MOST_REFUSED:
            break
        try:
            if count == MOST_STATEMENTS:
                raise _Wrong(f"has more than {MOST_STATEMENTS} statements")
            case.read(statement, compute=not refused)
        except _Wrong as wrong:
            refused.append(Refused(line, str(wrong)))
        if count == MOST_STATEMENTS:
            break
    if refused:
        raise ExceptionGroup("", refused)
    prefix = f"{case.name}."
    return {
        name.removeprefix(prefix): value
        for name, value in case.values.items()
        if name.startswith(prefix)
    }


def words_of(text: str, field: str) -> tuple[str, ...]:
    r"""The texts of a cell of a case, such as ``genfuel``; none where it has no such cell.

    Examples
    --------
    >>> words_of("mpc.genfuel = {\n'dfo';  % standby\n'solar'};", "genfuel")
    ('dfo', 'solar')
    """
    text = _TEXT_OR_COMMENT.sub(
        lambda found: "" if found[0][0] in "%#" else found[0], _without_block_comments(text)
    )
    cells = re.findall(rf"^[ \t]*\w+\.{field}\s*=\s*\{{([^{{}}]*)\}}", text, re.MULTILINE)
    return tuple(found[0][1:-1] for found in _TEXT_OR_COMMENT.finditer(cells[-1] if cells else ""))


class _Wrong(Exception):
    """Why a statement is not read; it is given its line where it is."""


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """The statements with the lines in which they begin; texts are empty, comments left out."""
    text = _without_block_comments(text.replace("\v", " "))
    text = _TEXT_OR_COMMENT.sub(lambda found: "" if found[0][0] in "%#" else "''", text)
    text = _CONTINUED.sub("\v", text) + "\n"
    begin = depth = 0
    line = 1
    for sign in islice(_SIGN.finditer(text), MOST_SIGNS):
        depth = max(depth + _DEEPER.get(sign[0], 0), 0)
        if depth or sign[0] not in ";,\n":
            continue
        statement = text[begin : sign.end()]
        if statement[:-1].strip():
            yield line + _lines(statement[: -len(statement.lstrip())]), statement[:-1].strip()
        line += _lines(statement)
        begin = sign.end()
    if text[begin:].strip():  # a bracket that is not closed, or too many signs
        yield line, text[begin:].strip()


def _without_block_comments(text: str) -> str:
    """Lines of which those between ``%{`` and ``%}`` are empty."""
    found = []
    inside = False
    for line in text.splitlines():
        word = line.strip()
        inside = inside or word in ("%{", "#{")
        found.append("" if inside else line)
        inside = inside and word not in ("%}", "#}")
    return "\n".join(found)


def _lines(text: str) -> int:
    return text.count("\n") + text.count("\v")


@dataclass
class _Case:
    """Values by name, a number as a matrix of one, and the work that is left."""

    name: str = "mpc"
    values: dict[str, Floats] = field(default_factory=dict)
    work_left: int = MOST_WORK

    def read(self, statement: str, compute: bool) -> None:
        """Take one statement in; without ``compute`` only its kind is looked at."""
        target, assigned, text = (part.strip() for part in statement.partition("="))
        word = _NAME.match(target)
        if word is not None and word[0] == "function":
            self._begin(statement)
        elif statement in ("end", "endfunction", self.name) or _CELL_OR_STRUCTURE.match(statement):
            pass
        elif statement == "define_constants":
            self._name_columns(ALL)
        elif constants := _CONSTANTS.match(statement):
            names, outputs = constants[1].replace(",", " ").split(), FUNCTIONS.get(constants[2], {})
            if len(names) > len(outputs):
                raise _Wrong(f"takes {len(names)} outputs of '{constants[2]}'")
            self._name_columns(dict(zip(names, outputs.values(), strict=False)))
        elif word is None or not assigned or target[word.end() :].lstrip()[:1] not in ("", "("):
            first = word[0].partition(".")[0] if word else target[:1]
            raise _Wrong(f"has '{first}', which is not evaluated")
        elif target == self.name:
            raise _Wrong(f"builds {self.name} from something else than its tables")
        elif compute:
            self._assign(target, text)

    def _begin(self, statement: str) -> None:
        """``function mpc = name``."""
        head = _HEAD.match(statement)
        if head is None or self.values:
            raise _Wrong(
                "is a case of version 1" if "[" in statement else "is a function that is no case"
            )
        self.name = head[1] or self.name

    def _name_columns(self, columns: dict[str, int]) -> None:
        self.values |= {name: np.array([[float(column)]]) for name, column in columns.items()}

    def _assign(self, target: str, text: str) -> None:
        """A value for a name, or for elements of a table."""
        if text.startswith(("''", "{")):
            self.values.pop(target, None)
        elif _NAME.fullmatch(target):
            table = _table(text)
            self.values[target] = self._value(text).copy() if table is None else table
        else:
            part = _PART.fullmatch(target) if len(target) <= LONGEST else None
            if part is None:
                raise _Wrong("changes something else than a row or columns of a table")
            whole, places = self._places(part)
            value, shape = self._value(text), whole[places].shape
            if value.shape not in ((1, 1), shape):
                raise _Wrong(f"puts {_by(value.shape)} values into {_by(shape)} places")
            whole[places] = value

    def _places(self, part: re.Match[str]) -> tuple[Floats, Any]:
        """A table, and its elements that are meant."""
        whole = self._named(part[1])
        rows, columns = whole.shape
        row = range(rows) if part[2] == ":" else [self._index(part[2], rows)]
        ends = [self._index(word, columns) for word in re.findall(r"\w+", part[3])]
        return whole, np.ix_(row, range(ends[0], ends[-1] + 1) if ":" in part[3] else ends)

    def _index(self, word: str, size: int) -> int:
        """Row or column from 0 that a number or name means."""
        named = np.array([[float(word)]]) if word.isdecimal() else self._named(word)
        found = float(named[0, 0]) if named.size == 1 else np.nan
        if not 1 <= found <= size or found % 1:
            raise _Wrong(f"has the index {word}, which is no whole number from 1 to {size}")
        return int(found) - 1

    def _named(self, name: str) -> Floats:
        if name in self.values:
            return self.values[name]
        if name == "pi":
            return np.array([[np.pi]])
        if name in ALL:
            raise _Wrong(f"has '{name}' before define_constants or another function defines it")
        raise _Wrong(f"has '{name}', which is no number that is known here")

    def _value(self, text: str) -> Floats:
        """Value of an expression."""
        if "''" in text:
            raise _Wrong("has a text where a number is expected")
        odd = next((c for c in text if not _EXPRESSION.fullmatch(c)), None)
        if odd is not None:
            raise _Wrong(f"has the character '{odd if odd.isprintable() else '?'}'")
        if len(text) > LONGEST:
            raise _Wrong("has too long an expression")
        parts: list[Floats] = []

        def part(found: re.Match[str]) -> str:
            whole, places = self._places(found)
            parts.append(whole[places])
            return f"'{len(parts) - 1}'"  # no text of the file is left that it could be taken for

        words = _OPERATOR.sub("", _PART.sub(part, text)).replace("^", "**")
        try:
            node = ast.parse(" ".join(words.split()), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise _Wrong("has an expression that is not evaluated") from None
        with np.errstate(all="ignore"):
            return self._computed(node, parts)

    def _computed(self, node: ast.expr, parts: list[Floats]) -> Floats:
        found: Floats
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                found = np.array([[float(str(number))]])  # infinite beyond the largest
            case ast.Constant(value=str(number)):
                found = parts[int(number)]
            case ast.Name() | ast.Attribute():
                found = self._named(ast.unparse(node))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                found = -self._computed(operand, parts)
            case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _BINARY:
                if isinstance(sign, ast.Pow) and any(
                    isinstance(n, ast.Pow) for n in ast.walk(right)
                ):
                    raise _Wrong("has a power of a power")  # MATLAB begins with the left one
                one, other = self._computed(left, parts), self._computed(right, parts)
                numbers = one.size == 1, other.size == 1
                fits = {ast.Div: numbers[1], ast.Pow: all(numbers)}.get(type(sign), any(numbers))
                if not fits:
                    sizes = f"{_by(one.shape)} and {_by(other.shape)} numbers"
                    raise _Wrong(f"combines {sizes}: columns are only changed by one number")
                found = _BINARY[type(sign)](one, other)
            case ast.Call(func=ast.Name(name), args=[argument]) if name in _CALLS:
                found = _CALLS[name](self._computed(argument, parts))
            case ast.Call(func=function):
                raise _Wrong(f"calls '{ast.unparse(function)}', which is not evaluated")
            case _:
                raise _Wrong("has an expression that is not evaluated")
        if found.size == 1 and np.isnan(found).any():
            raise _Wrong("has a result that is no real number")
        self.work_left -= found.size
        if self.work_left < 0:
            raise _Wrong("takes more work than the arithmetic of a case")
        return found


def _table(text: str) -> Floats | None:
    """Rows of plain numbers in brackets, None for anything else."""
    if not (text.startswith("[") and text.endswith("]")):
        return None
    rows = [row.replace(",", " ").split() for row in re.split(r"[;\n]", text[1:-1])]
    filled = [row for row in rows if row]
    width = len(filled[0]) if filled else 0
    if any(len(row) != width for row in filled):
        raise _Wrong("has rows of different lengths")
    try:
        return np.array(filled, dtype=float).reshape(len(filled), width)
    except ValueError:
        return None


def _by(shape: tuple[int, ...]) -> str:
    return " by ".join(map(str, shape))
