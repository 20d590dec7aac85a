"""The arithmetic of a MATPOWER case on its own tables, with numpy and within limits.

Values are matrices of real numbers. Functions are those of a list; nothing is looked up, loaded or
run, and sizes and the amount of work are limited.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from vppres.feeders.matpower.names import ALL, FUNCTIONS
from vppres.feeders.matpower.text import (
    Assign,
    Call,
    Colon,
    Define,
    End,
    Expression,
    Loop,
    Name,
    Opaque,
    Operation,
    Program,
    Refused,
    Rows,
    Statement,
    Table,
)

_Matrix = npt.NDArray[Any]
"""Real numbers, or truth values as comparisons make them; always two dimensions."""

MOST_NUMBERS = 2_000_000
"""Of one matrix. The largest case that comes with MATPOWER has two thirds of it in its buses."""

MOST_WORK = 100_000_000
"""Numbers that all operations together may make."""

STATEMENT_WORK = 500  # what a statement costs beside its numbers
NAMED: dict[str, float | bool] = {
    "pi": np.pi,
    "eps": 2.0**-52,
    **dict.fromkeys(("Inf", "inf"), np.inf),
    **dict.fromkeys(("NaN", "nan"), np.nan),
    "true": True,
    "false": False,
}


def tables_of(program: Program) -> dict[str, _Matrix]:
    r"""The fields of the case after its last statement, by name, shape (rows, columns) each.

    Raises
    ------
    Refused
        At the first statement that is no arithmetic on known values, or beyond the limits.

    Examples
    --------
    >>> from vppres.feeders.matpower.text import parse
    >>> tables_of(parse("mpc.bus = [1 5e3; 2 7e3];\nmpc.bus(:, 2) = mpc.bus(:, 2) / 1e3;"))["bus"]
    array([[1., 5.],
           [2., 7.]])
    """
    memory = _Memory()
    with np.errstate(all="ignore"):
        memory.run(program.statements)
    prefix = f"{program.case}."
    return {
        name.removeprefix(prefix): value
        for name, value in memory.values.items()
        if name.startswith(prefix)
    }


class _Wrong(Exception):
    """Why an expression has no value here; the statement gives it its line."""


@dataclass
class _Memory:
    """Values by name, and the work that is left."""

    values: dict[str, _Matrix] = field(default_factory=dict)
    opaque: set[str] = field(default_factory=set)
    work_left: int = MOST_WORK

    def run(self, statements: tuple[Statement, ...]) -> None:
        """Carry out statements in order."""
        for statement in statements:
            try:
                self._spend(STATEMENT_WORK)
                if isinstance(statement, Assign):
                    self._assign(statement)
                elif isinstance(statement, Define):
                    self._define(statement)
                else:
                    self._loop(statement)
            except _Wrong as wrong:
                raise Refused(statement.line, str(wrong)) from None
            except RecursionError:
                raise Refused(statement.line, "has too long an expression") from None

    def _spend(self, numbers: int) -> None:
        self.work_left -= numbers
        if self.work_left < 0:
            raise _Wrong("takes more work than the arithmetic of a case")

    def _sized(self, shape: tuple[int, ...]) -> None:
        """Refuse a matrix before it is made."""
        numbers = int(np.prod([max(int(n), 0) for n in shape], dtype=object))
        if numbers > MOST_NUMBERS:
            raise _Wrong(f"makes a matrix of more than {MOST_NUMBERS} numbers")
        self._spend(numbers)

    # Statements

    def _assign(self, statement: Assign) -> None:
        name = statement.target
        if isinstance(statement.value, Opaque):
            self.opaque.add(name)
            self.values.pop(name, None)
            return
        if not statement.index:
            self.values[name] = self.value(statement.value).copy()
            self._spend(self.values[name].size)
            return
        if name in self.opaque:
            return
        if name not in self.values:
            raise _Wrong(f"changes '{name}', which has no value yet")
        if isinstance(statement.value, Table) and not statement.value.value.size:
            self._remove(name, statement.index)
        else:
            self._change(name, statement.index, self.value(statement.value))

    def _change(self, name: str, index: tuple[Expression, ...], value: _Matrix) -> None:
        """``name(index) = value``, where the places exist."""
        whole = self.values[name]
        if len(index) == 1:
            flat: _Matrix = whole.flatten(order="F")
            at = self._places(index[0], flat.size)
            if value.size not in (1, at.size):
                raise _Wrong(f"puts {value.size} values into {at.size} places of '{name}'")
            flat[at] = value.flatten(order="F")
            self._spend(flat.size)
            self.values[name] = flat.reshape(whole.shape, order="F")
            return
        rows, columns = self._rows_and_columns(index, whole)
        shape = (len(rows), len(columns))
        if value.shape not in ((1, 1), shape):
            raise _Wrong(f"puts {_by(value.shape)} values into {_by(shape)} places of '{name}'")
        self._spend(len(rows) * len(columns))
        whole[np.ix_(rows, columns)] = value

    def _remove(self, name: str, index: tuple[Expression, ...]) -> None:
        """``name(index, :) = []`` and the same for columns."""
        whole = self.values[name]
        axes = [axis for axis, part in enumerate(index) if not isinstance(part, Colon)]
        if len(index) != 2 or len(axes) != 1:
            raise _Wrong(f"removes neither rows nor columns of '{name}'")
        at = self._places(index[axes[0]], whole.shape[axes[0]])
        self._spend(whole.size)
        self.values[name] = np.delete(whole, at, axis=axes[0])

    def _define(self, statement: Define) -> None:
        """Names of columns."""
        if not statement.names:
            self.values |= {name: _scalar(value) for name, value in ALL.items()}
            return
        if statement.function not in FUNCTIONS:
            raise _Wrong(f"takes several outputs of '{statement.function}'")
        outputs = [*FUNCTIONS[statement.function].values()]
        if len(statement.names) > len(outputs):
            raise _Wrong(f"takes {len(statement.names)} outputs of '{statement.function}'")
        for name, value in zip(statement.names, outputs, strict=False):
            self.values[name] = _scalar(value)

    def _loop(self, loop: Loop) -> None:
        """The body for every column of the values."""
        for column in self.value(loop.values).T:
            self.values[loop.name] = column.reshape(-1, 1)
            self.run(loop.body)

    # Expressions

    def value(self, node: Expression) -> _Matrix:
        """Value of an expression as a matrix."""
        found = self._value(node)
        self._spend(found.size)
        return found

    def _value(self, node: Expression) -> _Matrix:
        if isinstance(node, Table):
            return node.value
        if isinstance(node, Name):
            return self._named(node.name)
        if isinstance(node, Call):
            return self._called(node)
        if isinstance(node, Operation):
            return self._operated(node)
        if isinstance(node, Rows):
            return self._joined(node)
        raise _Wrong("has a text, a cell, ':' or 'end' where a number is expected")

    def _named(self, name: str) -> _Matrix:
        if name in self.values:
            return self.values[name]
        if name in NAMED:
            return np.array([[NAMED[name]]])
        if name in ALL:
            raise _Wrong(f"has '{name}' before define_constants or another function defines it")
        raise _Wrong(f"has '{name}', which is no number that is known here")

    def _called(self, node: Call) -> _Matrix:
        """Elements of a variable, or a function's value."""
        if node.name in self.values:
            return self._elements(self.values[node.name], node.arguments)
        if node.name in CALLS:
            least, most, _ = CALLS[node.name]
            if not least <= len(node.arguments) <= most:
                raise _Wrong(f"gives '{node.name}' {len(node.arguments)} arguments")
            arguments = [_number(self.value(argument)) for argument in node.arguments]
            return self._computed(node.name, arguments)
        raise _Wrong(f"calls '{node.name}', which is not evaluated")

    def _computed(self, name: str, arguments: list[_Matrix]) -> _Matrix:
        """A function's value; it is real."""
        if name in _MAKERS:
            self._sized(_shape(arguments))
        else:
            self._sized(_common_shape(arguments))
        found = np.atleast_2d(np.asarray(CALLS[name][2](*arguments)))
        return _real(found, arguments)

    def _elements(self, whole: _Matrix, index: tuple[Expression, ...]) -> _Matrix:
        """``name(index)``."""
        if len(index) == 1:
            return self._picked(whole, index[0])
        rows, columns = self._rows_and_columns(index, whole)
        self._sized((len(rows), len(columns)))
        return whole[np.ix_(rows, columns)]

    def _picked(self, whole: _Matrix, index: Expression) -> _Matrix:
        """Elements by their number, column by column: in the index's shape, or along a vector."""
        found: _Matrix = whole.flatten(order="F")[self._places(index, whole.size)]
        self._spend(whole.size)
        if isinstance(index, Colon):
            return found.reshape(-1, 1)
        if 1 in whole.shape:
            return found.reshape((1, -1) if whole.shape[0] == 1 else (-1, 1))
        asked = self.value(_without_end(index, whole.size))
        return found.reshape((-1, 1) if asked.dtype == bool else asked.shape, order="F")

    def _rows_and_columns(self, index: tuple[Expression, ...], whole: _Matrix) -> tuple[Any, Any]:
        if len(index) != 2:
            raise _Wrong(f"has {len(index)} indices")
        return self._places(index[0], whole.shape[0]), self._places(index[1], whole.shape[1])

    def _places(self, index: Expression, size: int) -> Any:
        """Positions from 0 that an index means, of so many."""
        if isinstance(index, Colon):
            return np.arange(size)
        found: _Matrix = self.value(_without_end(index, size)).flatten(order="F")
        if found.dtype == bool:
            found = np.flatnonzero(found) + 1.0
        if not np.isfinite(found).all() or (found != np.floor(found)).any() or (found < 1).any():
            raise _Wrong("has an index that is no whole number from 1")
        if (found > size).any():
            raise _Wrong(f"has the index {found.max():.0f}, beyond the last, {size}")
        return found.astype(int) - 1

    def _operated(self, node: Operation) -> _Matrix:
        """An operator's value."""
        values = [self.value(operand) for operand in node.operands]
        if node.operator == ":":
            return self._range(values)
        if len(values) == 1:
            return _SIGNS[node.operator](values[0])
        left, right = values
        if node.operator == "*" and 1 not in (left.size, right.size):
            return self._product(left, right)
        if node.operator == "/" and right.size != 1:
            raise _Wrong("divides by a matrix: './' divides element by element")
        if node.operator == "^" and not left.size == right.size == 1:
            raise _Wrong("has the power of a matrix: '.^' takes it element by element")
        self._sized(_common_shape(values))
        found = np.asarray(_OPERATORS[node.operator](_number(left), _number(right)))
        return _real(found, values)

    def _product(self, left: _Matrix, right: _Matrix) -> _Matrix:
        """Rows times columns."""
        if left.shape[1] != right.shape[0]:
            raise _Wrong(f"multiplies {_by(left.shape)} by {_by(right.shape)} numbers")
        self._sized((left.shape[0], right.shape[1]))
        self._spend(left.size * right.shape[1])
        return np.asarray(_number(left) @ _number(right))

    def _range(self, parts: list[_Matrix]) -> _Matrix:
        """``first:last`` and ``first:step:last``."""
        if any(part.size != 1 for part in parts):
            raise _Wrong("has a range between values that are not single numbers")
        numbers = [float(part[0, 0]) for part in parts]
        first, last = numbers[0], numbers[-1]
        step = numbers[1] if len(numbers) == 3 else 1.0
        if not np.isfinite(numbers).all():
            raise _Wrong("has a range without an end")
        count = int(np.floor((last - first) / step * (1 + 1e-12))) + 1 if step else 0
        self._sized((1, count))
        return (first + step * np.arange(max(count, 0))).reshape(1, -1)

    def _joined(self, node: Rows) -> _Matrix:
        """Matrices side by side and one above the other."""
        rows = []
        for row in node.rows:
            parts = [self.value(part) for part in row]
            parts = [part for part in parts if part.size] or parts[:1]
            if len({part.shape[0] for part in parts}) > 1:
                raise _Wrong("puts matrices of different heights side by side")
            rows.append(np.hstack(parts))
        rows = [row for row in rows if row.size] or rows[:1]
        if len({row.shape[1] for row in rows}) > 1:
            raise _Wrong("puts rows of different lengths one above the other")
        if not rows:
            return np.zeros((0, 0))
        self._sized((sum(len(row) for row in rows), rows[0].shape[1]))
        return np.vstack(rows)


def _scalar(value: float) -> _Matrix:
    return np.array([[float(value)]])


def _number(value: _Matrix) -> _Matrix:
    """Truth values as 0 and 1."""
    return value.astype(float) if value.dtype == bool else value


def _by(shape: tuple[int, ...]) -> str:
    return " by ".join(map(str, shape))


def _common_shape(values: list[_Matrix]) -> tuple[int, ...]:
    """Shape of what an operation makes element by element."""
    try:
        return np.broadcast_shapes(*(value.shape for value in values))
    except ValueError:
        raise _Wrong(
            f"combines {' and '.join(_by(value.shape) for value in values)} numbers"
        ) from None


def _shape(arguments: list[_Matrix]) -> tuple[int, ...]:
    """Shape that ``zeros`` and ``ones`` are asked for."""
    sizes = [float(n) for argument in arguments for n in argument.flatten()] or [1.0]
    if not all(n >= 0 and n == np.floor(n) and np.isfinite(n) for n in sizes) or len(sizes) > 2:
        raise _Wrong("asks for a matrix of no size")
    return (int(sizes[0]), int(sizes[-1]))


def _real(found: _Matrix, arguments: list[_Matrix]) -> _Matrix:
    """A result, unless it is not a number though all that it comes from are."""
    known = all(np.isfinite(_number(argument)).all() for argument in arguments)
    if known and np.isnan(_number(found)).any():
        raise _Wrong("has a result that is no real number")
    return found


def _without_end(node: Expression, size: int) -> Expression:
    """The expression with a number for ``end``."""
    if isinstance(node, End):
        return Table(_scalar(size))
    if isinstance(node, Operation):
        return Operation(node.operator, tuple(_without_end(o, size) for o in node.operands))
    if isinstance(node, Rows):
        return Rows(tuple(tuple(_without_end(part, size) for part in row) for row in node.rows))
    if isinstance(node, Call) and node.name in CALLS:
        return Call(node.name, tuple(_without_end(part, size) for part in node.arguments))
    return node


def _along(
    reduce: Callable[..., Any],
) -> Callable[..., Any]:
    """A reduction along a dimension: the one asked for, or the first that is not 1."""

    def reduced(value: _Matrix, dimension: _Matrix | None = None) -> Any:
        if dimension is None:
            axis = 1 if value.shape[0] == 1 else 0
        elif dimension.size == 1 and dimension[0, 0] in (1.0, 2.0):
            axis = int(dimension[0, 0]) - 1
        else:
            raise _Wrong("reduces along a dimension other than 1 and 2")
        if not value.shape[axis]:
            raise _Wrong("reduces an empty matrix")
        return reduce(value, axis=axis, keepdims=True)

    return reduced


def _extreme(pair: Callable[..., Any], reduce: Callable[..., Any]) -> Callable[..., Any]:
    """``max`` and ``min``: of two values, or along the first dimension."""
    along = _along(reduce)

    def extreme(value: _Matrix, other: _Matrix | None = None) -> Any:
        return along(value) if other is None else pair(value, other)

    return extreme


def _size(value: _Matrix, dimension: _Matrix | None = None) -> Any:
    if dimension is None:
        return np.array([value.shape], dtype=float)
    at = int(dimension[0, 0]) if dimension.size == 1 else 0
    if at not in (1, 2):
        raise _Wrong("asks for a size other than that of dimension 1 or 2")
    return float(value.shape[at - 1])


def _find(value: _Matrix) -> _Matrix:
    """Places that are not zero, along the value if it is a row."""
    at = np.flatnonzero(value.flatten(order="F")) + 1.0
    return at.reshape(1, -1) if value.shape[0] == 1 else at.reshape(-1, 1)


def _rounded(value: _Matrix) -> _Matrix:
    """To whole numbers, halves away from zero."""
    return np.sign(value) * np.floor(np.abs(value) + 0.5)


_SIGNS: dict[str, Callable[[_Matrix], _Matrix]] = {
    "+": _number,
    "-": lambda value: -_number(value),
    "~": lambda value: value == 0,
    "'": lambda value: value.T,
}
_OPERATORS: dict[str, Callable[[_Matrix, _Matrix], Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    ".*": np.multiply,
    "/": np.divide,
    "./": np.divide,
    "^": np.power,
    ".^": np.power,
    "==": np.equal,
    "~=": np.not_equal,
    "!=": np.not_equal,
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
    "&": np.logical_and,
    "&&": np.logical_and,
    "|": np.logical_or,
    "||": np.logical_or,
}
_ELEMENTWISE: dict[str, Callable[[_Matrix], Any]] = {
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "sind": lambda value: np.sin(np.deg2rad(value)),
    "cosd": lambda value: np.cos(np.deg2rad(value)),
    "tand": lambda value: np.tan(np.deg2rad(value)),
    "asind": lambda value: np.rad2deg(np.arcsin(value)),
    "acosd": lambda value: np.rad2deg(np.arccos(value)),
    "atand": lambda value: np.rad2deg(np.arctan(value)),
    "deg2rad": np.deg2rad,
    "rad2deg": np.rad2deg,
    "exp": np.exp,
    "log": np.log,
    "log10": np.log10,
    "abs": np.abs,
    "sign": np.sign,
    "round": _rounded,
    "floor": np.floor,
    "ceil": np.ceil,
    "fix": np.trunc,
    "isnan": np.isnan,
    "isinf": np.isinf,
}
_PAIRWISE: dict[str, Callable[[_Matrix, _Matrix], Any]] = {
    "atan2": np.arctan2,
    "hypot": np.hypot,
    "power": np.power,
    "times": np.multiply,
    "rdivide": np.divide,
    "plus": np.add,
    "minus": np.subtract,
    "mod": np.mod,
    "rem": np.fmod,
}
_MAKERS = {
    "zeros": lambda *sizes: np.zeros(_shape([*sizes])),
    "ones": lambda *sizes: np.ones(_shape([*sizes])),
}
# Function: fewest and most arguments, and what computes it.
CALLS: dict[str, tuple[int, int, Callable[..., Any]]] = {
    **{name: (1, 1, function) for name, function in _ELEMENTWISE.items()},
    **{name: (2, 2, function) for name, function in _PAIRWISE.items()},
    **{name: (0, 2, function) for name, function in _MAKERS.items()},
    "sum": (1, 2, _along(np.sum)),
    "prod": (1, 2, _along(np.prod)),
    "mean": (1, 2, _along(np.mean)),
    "any": (1, 2, _along(np.any)),
    "all": (1, 2, _along(np.all)),
    "max": (1, 2, _extreme(np.maximum, np.max)),
    "min": (1, 2, _extreme(np.minimum, np.min)),
    "size": (1, 2, _size),
    "numel": (1, 1, lambda value: float(value.size)),
    "length": (1, 1, lambda value: float(max(value.shape) if value.size else 0)),
    "isempty": (1, 1, lambda value: np.array([[value.size == 0]])),
    "find": (1, 1, _find),
}
