"""A MATPOWER case written as a MATLAB function: its tables, and the units that it converts.

Nothing is run. A statement is a table of numbers, a text or cell, which are left out, or arithmetic
on columns: ``mpc.branch(:, [BR_R BR_X]) = mpc.branch(:, [BR_R BR_X]) / (Vbase^2 / Sbase)``. Such an
expression is written in Python's words, parsed by Python, and computed node by node with numpy.
What is neither is refused with its line.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.feeders.matpower.names import ALL, FUNCTIONS

CURE = "Load the case in MATPOWER, write it with savecase, and import that file."
"""The way out for whatever is not read here."""

MOST_REFUSED = 20
MOST_STATEMENTS = 1000  # the cases that come with MATPOWER have some 40
MOST_SIGNS = 200_000  # brackets, and ends of statements and lines outside of tables
MOST_WORK = 100_000_000  # numbers that all operations together may make
LONGEST_EXPRESSION = 300  # characters

_TEXT_OR_COMMENT = re.compile(r"'(?:[^'\n]|'')*'|\"[^\"\n]*\"|[%#][^\n]*")
_CONTINUED = re.compile(r"\.\.\.[^\n]*\n")
_END_OR_BRACKET = re.compile(r"[;,\n()\[\]{}]")
_PLAIN_ROWS = re.compile(r"[^()\[\]{}]*")

_HEAD = re.compile(r"function\s+(?:(\w+)\s*=\s*)?\w+(?:\s*\(\s*\))?$")
_OUTPUTS = re.compile(r"\[([\w\s,~!]*)\]\s*=\s*(\w+)(?:\s*\(\s*\))?$")
_ASSIGNMENT = re.compile(r"([A-Za-z][\w.]*)\s*(\(.*\))?\s*=(?!=)\s*(.*)$", re.DOTALL)
_CELL_OR_STRUCTURE = re.compile(r"[A-Za-z]\w*(?:\.\w+){2,}|[A-Za-z][\w.]*\s*\{")
_NAME = re.compile(r"[A-Za-z]\w*")
_EXPRESSION = re.compile(r"[\w\s.,:+\-*/^()\[\]]*", re.ASCII)
_COLUMNS = re.compile(r"\[([^\[\]]*)\]")
_COLUMN = re.compile(r"\w+")
_WHOLE = re.compile(r"(?<=[(,])\s*:\s*(?=[,)])")  # all rows or columns
# From MATLAB's operators to such of Python's that bind alike: `*` and `/` take no two matrices, a
# range binds last, and `^`, which takes no matrix, has a sign for its exponent.
_OPERATORS = re.compile(r"\.\*|\./|\.\^|\*|\^|:")
_PYTHON = {".*": "*", "./": "//", ".^": "**", "*": "@", "^": "** +", ":": "|"}

_ELEMENTWISE: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.MatMult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.truediv,
    ast.Pow: operator.pow,
}
_CALLS: dict[str, Callable[[Any], Any]] = {
    "abs": np.abs,
    "acos": np.arccos,
    "asin": np.arcsin,
    "atan": np.arctan,
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
        if statement == "return":
            break
        try:
            if count >= MOST_STATEMENTS:
                raise _Wrong(f"has more than {MOST_STATEMENTS} statements")
            case.read(statement, compute=not refused)
        except RecursionError:
            refused.append(Refused(line, "has too long an expression"))
        except _Wrong as wrong:
            refused.append(Refused(line, str(wrong)))
            if count >= MOST_STATEMENTS or len(refused) == MOST_REFUSED:
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
    cells = re.findall(rf"^\s*\w+\.{field}\s*=\s*\{{([^{{}}]*)\}}", text, re.MULTILINE)
    return tuple(found[0][1:-1] for found in _TEXT_OR_COMMENT.finditer(cells[-1] if cells else ""))


class _Wrong(Exception):
    """Why a statement is not read; it is given its line where it is."""


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """The statements with the lines in which they begin; texts are empty, comments left out."""
    text = _without_block_comments(text.replace("\v", " "))
    text = _TEXT_OR_COMMENT.sub(lambda found: "" if found[0][0] in "%#" else "''", text)
    text = _CONTINUED.sub("\v", text) + "\n"
    begin = at = depth = 0
    line = 1
    for _ in range(MOST_SIGNS):
        found = _END_OR_BRACKET.search(text, at)
        if found is None:
            break
        at = found.end()
        sign = found[0]
        if sign in "([{":
            depth += 1
            rows = _PLAIN_ROWS.match(text, at)
            at = rows.end() if rows else at
        elif sign in ")]}":
            depth = max(depth - 1, 0)
        elif depth == 0:
            statement = text[begin : found.start()]
            ahead = len(statement) - len(statement.lstrip())
            line += _lines(statement[:ahead])
            if statement.strip():
                yield line, statement.strip()
            line += _lines(statement[ahead:] + sign)
            begin = at
    rest = text[begin:]
    if rest.strip():  # a bracket that is not closed, or too many signs
        yield line + _lines(rest[: len(rest) - len(rest.lstrip())]), rest.strip()


def _without_block_comments(text: str) -> str:
    """The same lines, those between ``%{`` and ``%}`` empty."""
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
    """Values by name, and the work that is left."""

    name: str = "mpc"
    values: dict[str, Floats] = field(default_factory=dict)
    work_left: int = MOST_WORK

    def read(self, statement: str, compute: bool) -> None:
        """Take one statement in; without ``compute`` only its kind is looked at."""
        word = _NAME.match(statement)
        first = word[0] if word else statement[0]
        if first == "function":
            self._begin(statement)
        elif statement in ("end", "endfunction", self.name) or _CELL_OR_STRUCTURE.match(statement):
            pass
        elif statement == "define_constants":
            self._name_columns(ALL)
        elif outputs := _OUTPUTS.match(statement):
            self._name_outputs(outputs[1].replace(",", " ").split(), outputs[2])
        elif assignment := _ASSIGNMENT.match(statement):
            if assignment[1] == self.name:
                raise _Wrong(f"builds {self.name} from something else than its tables")
            if compute:
                self._assign(assignment[1], assignment[2] or "", assignment[3].strip())
        else:
            raise _Wrong(f"has '{first}', which is not evaluated")

    def _begin(self, statement: str) -> None:
        """``function mpc = name``."""
        head = _HEAD.match(statement)
        if head is None or self.values:
            raise _Wrong(
                "is a case of version 1" if "[" in statement else "is a function that is no case"
            )
        self.name = head[1] or self.name

    def _name_outputs(self, names: list[str], function: str) -> None:
        """``[A, B] = idx_bus``."""
        outputs = FUNCTIONS.get(function, {})
        if len(names) > len(outputs):
            raise _Wrong(f"takes {len(names)} outputs of '{function}'")
        self._name_columns(dict(zip(names, outputs.values(), strict=False)))

    def _name_columns(self, columns: dict[str, int]) -> None:
        self.values |= {name: np.array([[float(column)]]) for name, column in columns.items()}

    def _assign(self, name: str, index: str, text: str) -> None:
        """``name = value`` or ``name(index) = value``."""
        if text.startswith(("''", "{")):
            self.values.pop(name, None)
        elif not index:
            table = _table(text)
            value = self._value(_parsed(text)) if table is None else table
            self.values[name] = value.copy()
        elif name not in self.values:
            raise _Wrong(f"changes '{name}', which has no value yet")
        else:
            whole = self.values[name]
            place = _parsed(f"x{index}")
            if not isinstance(place, ast.Call):
                raise _Wrong(f"changes something else than elements of '{name}'")
            places = self._places(place.args, whole)
            value = self._value(_parsed(text))
            shape = whole[places].shape
            if value.shape not in ((1, 1), shape):
                raise _Wrong(f"puts {_by(value.shape)} values into {_by(shape)} places of '{name}'")
            whole[places] = value

    def _value(self, node: ast.expr) -> Floats:
        """Value of an expression as a matrix."""
        with np.errstate(all="ignore"):
            found = self._computed(node)
        self.work_left -= found.size
        if self.work_left < 0:
            raise _Wrong("takes more work than the arithmetic of a case")
        return found

    def _computed(self, node: ast.expr) -> Floats:
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return np.array([[float(str(number))]])  # infinite beyond the largest
            case ast.Name() | ast.Attribute():
                return self._named(ast.unparse(node))
            case ast.List(elts=columns):
                return np.hstack([self._value(column) for column in columns])
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self._value(operand)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._value(operand)
            case ast.BinOp(left=left, op=ast.BitOr(), right=right):
                return self._range(self._value(left), self._value(right))
            case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _ELEMENTWISE:
                return self._operated(node, self._value(left), self._value(right))
            case ast.Call(func=ast.Name() | ast.Attribute(), args=arguments):
                return self._called(ast.unparse(node.func), arguments)
        raise _Wrong("has an expression that is not evaluated")

    def _named(self, name: str) -> Floats:
        if name in self.values:
            return self.values[name]
        if name == "pi":
            return np.array([[np.pi]])
        if name in ALL:
            raise _Wrong(f"has '{name}' before define_constants or another function defines it")
        raise _Wrong(f"has '{name}', which is no number that is known here")

    def _operated(self, node: ast.BinOp, left: Floats, right: Floats) -> Floats:
        """An operator's value, element by element."""
        numbers = left.size == 1, right.size == 1
        if isinstance(node.op, ast.MatMult) and not any(numbers):
            raise _Wrong("multiplies matrices: '.*' multiplies element by element")
        if isinstance(node.op, ast.Div) and not numbers[1]:
            raise _Wrong("divides by a matrix: './' divides element by element")
        if isinstance(node.op, ast.Pow):
            if any(isinstance(part, ast.Pow) for part in ast.walk(node.right)):
                raise _Wrong("has a power of a power")
            if isinstance(node.right, ast.UnaryOp) and not all(numbers):
                raise _Wrong("has the power of a matrix: '.^' takes it element by element")
        heights, widths = zip(left.shape, right.shape, strict=True)
        fits = all(len({*sizes} - {1}) < 2 for sizes in (heights, widths))
        if not fits or max(heights) * max(widths) > max(left.size, right.size):
            raise _Wrong(f"combines {_by(left.shape)} and {_by(right.shape)} numbers")
        return _real(_ELEMENTWISE[type(node.op)](left, right), left, right)

    def _range(self, first: Floats, last: Floats) -> Floats:
        """``first:last``, for columns."""
        ends = first.flatten().tolist() + last.flatten().tolist()
        most = max(ALL.values())
        if len(ends) != 2 or not all(1 <= end <= most for end in ends):
            raise _Wrong("has a range that is not one of columns")
        return np.arange(ends[0], ends[1] + 1).reshape(1, -1)

    def _called(self, name: str, arguments: list[ast.expr]) -> Floats:
        """Elements of a variable, or a function's value."""
        if name in self.values:
            whole = self.values[name]
            found: Floats = whole[self._places(arguments, whole)]
            return found
        if name not in _CALLS:
            raise _Wrong(f"calls '{name}', which is not evaluated")
        if len(arguments) != 1:
            raise _Wrong(f"gives '{name}' {len(arguments)} arguments")
        value = self._value(arguments[0])
        return _real(_CALLS[name](value), value)

    def _places(self, index: list[ast.expr], whole: Floats) -> Any:
        """Rows and columns from 0 that an index of two parts means."""
        if len(index) != 2:
            raise _Wrong(f"has {len(index)} indices where rows and columns are expected")
        return np.ix_(*(self._along(*part) for part in zip(index, whole.shape, strict=True)))

    def _along(self, index: ast.expr, size: int) -> Any:
        if isinstance(index, ast.Constant) and index.value is ...:
            return np.arange(size)
        found = self._value(index).flatten()
        if not np.isfinite(found).all() or (found != np.floor(found)).any() or (found < 1).any():
            raise _Wrong("has an index that is no whole number from 1")
        if (found > size).any():
            raise _Wrong(f"has the index {found.max():.0f}, beyond the last, {size}")
        return found.astype(int) - 1


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


def _parsed(text: str) -> ast.expr:
    """An expression as Python's syntax tree."""
    if "''" in text:
        raise _Wrong("has a text where a number is expected")
    odd = next((c for c in text if not _EXPRESSION.fullmatch(c)), None)
    if odd is not None:
        raise _Wrong(f"has the character '{odd if odd.isprintable() else '?'}'")
    if len(text) > LONGEST_EXPRESSION:
        raise _Wrong("has too long an expression")
    words = _WHOLE.sub("...", _COLUMNS.sub(_comma_separated, text))
    words = _OPERATORS.sub(lambda found: _PYTHON[found[0]], words)
    try:
        return ast.parse(" ".join(words.split()), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _Wrong("has an expression that is not evaluated") from None


def _comma_separated(brackets: re.Match[str]) -> str:
    """Columns in brackets, which blanks may part."""
    columns = brackets[1].replace(",", " ").split()
    if not columns or not all(_COLUMN.fullmatch(column) for column in columns):
        raise _Wrong("has brackets that hold more than columns")
    return f"[{', '.join(columns)}]"


def _by(shape: tuple[int, ...]) -> str:
    return " by ".join(map(str, shape))


def _real(found: Floats, *sources: Floats) -> Floats:
    """A result, unless it is not a number though all that it comes from are."""
    if np.isnan(found).any() and all(np.isfinite(source).all() for source in sources):
        raise _Wrong("has a result that is no real number")
    return found
