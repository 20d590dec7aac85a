"""Text of a MATLAB file as a tree of assignments; nothing of it is run here.

What is read is the arithmetic that case files do on their tables: assignments, indices, operators,
calls of functions by name, and loops over known values. Any other statement is refused with its
line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats

DEEPEST = 30
MOST_LINES = 500_000
MOST_TOKENS = 300_000  # without the rows of plain numbers, which are one each
MOST_REFUSED = 20

CURE = "Load the case in MATPOWER, write it with savecase, and import that file."
"""The way out for whatever is not read here."""

_BLOCKS = {"if", "while", "switch", "try", "parfor", "do", "function", "unwind_protect"}
_NUMBER = re.compile(r"(?:\d+(?:\.(?![*/^\\'])\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?")
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_OPERATOR = re.compile(r"\.[*/^']|[=~!<>]=|&&|\|\||[-+*/^=<>&|~!(),;:\[\]{}.'@\\\"]")
_BLANK = re.compile(r"[ \t\r\f]+")
# Rows of plain numbers, which is what nearly all of a case is.
_PLAIN = re.compile(r"\[([0-9eE.+\-\s;,InfNaN]*)\]")
_SIGNS = re.compile(r"(?<![eE\s;,])[+-]|[+-]\s")
_ROWS = re.compile(r"[;\n]")
_TEXT = re.compile(r"'(?:[^'\n]|'')*'|\"(?:[^\"\n]|\"\")*\"")  # a quote twice stands for itself
_BEFORE_TRANSPOSE = re.compile(r"[\w)\]}'.]")
_OPENS = {"(": ")", "[": "]", "{": "}"}


class Refused(Exception):
    """A statement that is not read: its line, why, and the cure."""

    def __init__(self, line: int, message: str, cure: str = CURE) -> None:
        super().__init__(message)
        self.line = line
        self.message = message
        self.cure = cure


# Expressions


@dataclass(frozen=True)
class Table:
    """A number, or rows of numbers."""

    value: Floats


@dataclass(frozen=True)
class Opaque:
    """A text or a cell: kept away from arithmetic."""


@dataclass(frozen=True)
class Colon:
    """All rows or columns."""


@dataclass(frozen=True)
class End:
    """The last row or column."""


@dataclass(frozen=True)
class Name:
    """A variable or constant, or a field of the case, which has a dot."""

    name: str


@dataclass(frozen=True)
class Call:
    """An indexed variable or a function of arguments: MATLAB writes both alike."""

    name: str
    arguments: tuple[Expression, ...]


@dataclass(frozen=True)
class Operation:
    """An operator between its operands; transposition and signs have one."""

    operator: str
    operands: tuple[Expression, ...]


@dataclass(frozen=True)
class Rows:
    """Rows of expressions in brackets."""

    rows: tuple[tuple[Expression, ...], ...]


Expression = Table | Opaque | Colon | End | Name | Call | Operation | Rows


# Statements


@dataclass(frozen=True)
class Assign:
    """``target = value`` or ``target(index) = value``."""

    line: int
    target: str
    index: tuple[Expression, ...]
    value: Expression


@dataclass(frozen=True)
class Define:
    """Names for the outputs of one of MATPOWER's functions of constants; none for all of them."""

    line: int
    names: tuple[str, ...]
    function: str


@dataclass(frozen=True)
class Loop:
    """``for name = values``, with what is done for each."""

    line: int
    name: str
    values: Expression
    body: tuple[Statement, ...]


Statement = Assign | Define | Loop


@dataclass(frozen=True)
class Program:
    """The statements of a case, in order, and the name of the case in them."""

    case: str
    statements: tuple[Statement, ...]


def parse(text: str) -> Program:
    r"""The statements of a file.

    Raises
    ------
    ExceptionGroup
        Of :class:`Refused`, one for each statement that is not read.

    Examples
    --------
    >>> parse("function mpc = c\nmpc.baseMVA = 2 * 5;").statements[0].target
    'mpc.baseMVA'
    """
    if text.count("\n") > MOST_LINES:
        raise ExceptionGroup("", [Refused(MOST_LINES, f"has more than {MOST_LINES} lines")])
    return _Parser(list(_tokens(_without_comments(text)))).program()


# From text to tokens


@dataclass(frozen=True, slots=True)
class _Token:
    """``kind`` is ``number``, ``name``, ``text``, ``table``, ``line``, ``end`` or the operator."""

    kind: str
    text: str
    line: int
    blank_before: bool
    value: Floats | None = None


def _without_comments(text: str) -> str:
    """The same lines without comments; form feeds stand for the ends of continued lines."""
    found = []
    in_block = False
    for line in text.replace("\f", " ").split("\n"):
        word = line.strip()
        if word in ("%{", "#{"):
            in_block = True
        kept = "" if in_block else _code_of(line)
        if word in ("%}", "#}"):
            in_block = False
        code, dots, _ = kept.partition("...")
        found.append(f"{code}\f" if dots else f"{code}\n")
    return "".join(found)


def _code_of(line: str) -> str:
    """A line up to its comment; a quote after an operand transposes, any other opens a text."""
    if "%" not in line and "#" not in line:
        return line
    at = 0
    while at < len(line):
        if line[at] in "%#":
            return line[:at]
        text = _TEXT.match(line, at)
        transposes = line[at] == "'" and at and _BEFORE_TRANSPOSE.match(line[at - 1])
        at = text.end() if text and not transposes else at + 1
    return line


def _tokens(text: str) -> Iterator[_Token]:
    """The tokens of a text."""
    line = 1
    at = 0
    count = 0
    blank = False
    previous = ""
    while at < len(text):
        space = _BLANK.match(text, at)
        if space:
            line += space[0].count("\f")
            at = space.end()
            blank = True
            continue
        token = _token_at(text, at, line, blank, previous)
        count += 1
        if count > MOST_TOKENS:
            raise ExceptionGroup("", [Refused(line, f"has more than {MOST_TOKENS} words")])
        yield token
        line += text.count("\n", at, at + len(token.text)) + text.count(
            "\f", at, at + len(token.text)
        )
        at += len(token.text)
        blank = False
        previous = token.kind
    yield _Token("end", "", line, True)


def _token_at(text: str, at: int, line: int, blank: bool, previous: str) -> _Token:
    """The token that begins at a place."""
    sign = text[at]
    if sign == "\n":
        return _Token("line", sign, line, blank)
    if sign == "[":
        plain = _PLAIN.match(text, at)
        table = _plain_table(plain[1]) if plain else None
        if plain and table is not None:
            return _Token("table", plain[0], line, blank, table)
    after_operand = previous in ("number", "name", "table", "text", ")", "]", "}", "'", ".'")
    if sign == '"' or (sign == "'" and not (after_operand and not blank)):
        closing = _TEXT.match(text, at)
        if closing is None:
            raise ExceptionGroup("", [Refused(line, "has a quote that is not closed")])
        return _Token("text", closing[0], line, blank)
    for kind, pattern in (("number", _NUMBER), ("name", _NAME), ("", _OPERATOR)):
        found = pattern.match(text, at)
        if found:
            return _Token(kind or found[0], found[0], line, blank)
    shown = sign if sign.isprintable() else "?"
    raise ExceptionGroup("", [Refused(line, f"has the character '{shown}'")])


def _plain_table(content: str) -> Floats | None:
    """Rows of numbers; None where signs or words need a closer look."""
    if _SIGNS.search(content):
        return None
    rows = [row.replace(",", " ").split() for row in _ROWS.split(content)]
    filled = [row for row in rows if row]
    width = len(filled[0]) if filled else 0
    if any(len(row) != width for row in filled):
        return None
    try:
        return np.array(filled, dtype=float).reshape(len(filled), width)
    except ValueError:
        return None


# From tokens to statements

_LEVELS: tuple[tuple[str, ...], ...] = (
    ("||", "|"),
    ("&&", "&"),
    ("==", "~=", "!=", "<", "<=", ">", ">="),
    (":",),
    ("+", "-"),
    ("*", "/", ".*", "./"),
)
_SIGN_LEVEL = len(_LEVELS)


@dataclass
class _Parser:
    """Tokens and the place in them."""

    tokens: list[_Token]
    at: int = 0
    depth: int = 0
    brackets: int = 0
    case: str = "mpc"

    @property
    def next(self) -> _Token:
        return self.tokens[self.at]

    def take(self, kind: str = "") -> _Token:
        """The next token, which must be of a kind."""
        token = self.next
        if kind and token.kind != kind:
            raise Refused(token.line, f"has '{_shown(token)}' where '{kind}' is expected")
        self.at = min(self.at + 1, len(self.tokens) - 1)
        return token

    def program(self) -> Program:
        """All statements."""
        refused: list[Refused] = []
        found: list[Statement] = []
        while self._skip_ends() != "end" and len(refused) < MOST_REFUSED:
            try:
                if self.next.text == "function" and not found:
                    self._head()
                elif self.next.text == "return":
                    break
                elif self.next.text in ("end", "endfunction"):
                    self.take()
                else:
                    found += self._statement()
            except Refused as one:
                refused.append(one)
                self._to_next_line()
        if refused:
            raise ExceptionGroup("", refused)
        return Program(self.case, tuple(found))

    def _skip_ends(self) -> str:
        """Pass over the ends of statements; the kind of what comes then."""
        while self.next.kind in ("line", ";", ","):
            self.take()
        return self.next.kind

    def _to_next_line(self) -> None:
        """Give up the line at hand."""
        self.depth = 0
        self.brackets = 0
        while self.next.kind not in ("line", "end"):
            self.take()

    def _head(self) -> None:
        """``function mpc = name``."""
        line = self.take().line
        if self.next.kind == "[":
            raise Refused(line, "is a case of version 1")
        name = self.take("name").text
        if self.next.kind == "=":
            self.case = name
            self.take()
            self.take("name")
        if self.next.kind == "(":
            raise Refused(line, "is a case with arguments")

    def _statement(self) -> list[Statement]:
        """One statement; none for those without effect."""
        first = self.next
        if first.kind == "[":
            return [self._outputs()]
        if first.text == "for":
            return [self._loop()]
        if first.kind != "name" or first.text in _BLOCKS:
            raise Refused(first.line, f"has '{_shown(first)}', which is not evaluated")
        if first.text == "define_constants":
            self.take()
            return [Define(first.line, (), first.text)]
        return self._assignment()

    def _assignment(self) -> list[Statement]:
        """``name = value``, ``mpc.field = value`` and both with an index."""
        first = self.next
        name = self._dotted()
        if name == self.case and self.next.kind in ("line", ";", "end"):
            return []
        if name.count(".") > 1 or self.next.kind == "{":
            self._skip_value()  # structures and cells take no part in arithmetic
            return []
        index = self._arguments() if self.next.kind == "(" else ()
        if self.next.kind != "=":
            raise Refused(first.line, f"has '{first.text}', which is not an assignment")
        self.take()
        if name == self.case:
            raise Refused(first.line, f"builds {name} from something else than its tables")
        value = self._expression(0)
        if self.next.kind not in ("line", ";", ",", "end"):
            raise Refused(first.line, f"has '{_shown(self.next)}' after a value")
        return [Assign(first.line, name, index, value)]

    def _skip_value(self) -> None:
        """Pass over a statement, whatever it holds."""
        depth = 0
        while self.next.kind != "end" and (depth or self.next.kind not in ("line", ";")):
            depth += (self.next.kind in _OPENS) - (self.next.kind in _OPENS.values())
            self.take()

    def _outputs(self) -> Define:
        """``[A, B] = idx_bus``."""
        line = self.take().line
        names = []
        while self.next.kind != "]":
            token = self.take()
            if token.kind in ("name", "~", "!"):
                names.append(token.text)
            elif token.kind not in (",", "line"):
                raise Refused(line, f"has '{_shown(token)}' among the names of outputs")
        self.take()
        self.take("=")
        function = self.take("name").text
        if self.next.kind == "(":
            self._arguments()
        return Define(line, tuple(names), function)

    def _loop(self) -> Loop:
        """``for name = values ... end``."""
        line = self._deeper(self.take()).line
        wrapped = self.next.kind == "("
        if wrapped:
            self.take()
        name = self.take("name").text
        self.take("=")
        values = self._expression(0)
        if wrapped:
            self.take(")")
        body: list[Statement] = []
        while self._skip_ends() != "end" and self.next.text not in ("end", "endfor"):
            body += self._statement()
        if self.take().kind == "end":
            raise Refused(line, "has a loop without its end")
        self.depth -= 1
        return Loop(line, name, values, tuple(body))

    # Expressions

    def _deeper(self, token: _Token) -> _Token:
        """The token that opens a level."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise Refused(token.line, f"is nested more than {DEEPEST} deep")
        return token

    def _expression(self, level: int) -> Expression:
        """Operators of a level and all that bind closer, from the left."""
        if level == _SIGN_LEVEL:
            return self._signed()
        left = self._expression(level + 1)
        operands = [left]
        while self.next.kind in _LEVELS[level] and not self._begins_element():
            operator = self.take().kind
            right = self._expression(level + 1)
            if operator == ":":
                operands.append(right)
                continue
            left = Operation(operator, (left, right))
        if len(operands) > 3:
            raise Refused(self.next.line, "has a range of more than three parts")
        return Operation(":", tuple(operands)) if len(operands) > 1 else left

    def _begins_element(self) -> bool:
        """Whether a sign opens the next element of a row: ``[a -b]`` has two, ``[a - b]`` one."""
        if not self.brackets or self.next.kind not in ("+", "-") or not self.next.blank_before:
            return False
        return not self.tokens[self.at + 1].blank_before

    def _signed(self) -> Expression:
        """A sign or negation before a power."""
        if self.next.kind in ("+", "-", "~", "!"):
            token = self._deeper(self.take())
            found = Operation(token.kind.replace("!", "~"), (self._signed(),))
            self.depth -= 1
            return found
        return self._power()

    def _power(self) -> Expression:
        """Powers, from the left; a sign may stand before an exponent."""
        base = self._transposed()
        while self.next.kind in ("^", ".^"):
            operator = self.take().kind
            sign = self.take().kind if self.next.kind in ("+", "-") else ""
            exponent = self._transposed()
            base = Operation(operator, (base, Operation(sign, (exponent,)) if sign else exponent))
        return base

    def _transposed(self) -> Expression:
        found = self._operand()
        while self.next.kind in ("'", ".'"):
            self.take()
            found = Operation("'", (found,))
        return found

    def _operand(self) -> Expression:
        """A number, a name, a call, brackets or parentheses."""
        token = self.next
        if token.kind == "number":
            self.take()
            return Table(np.array([[float(token.text.lower().replace("d", "e"))]]))
        if token.kind == "table":
            self.take()
            assert token.value is not None
            return Table(token.value)
        if token.kind == "text":
            self.take()
            return Opaque()
        if token.kind == "[":
            return self._rows()
        if token.kind == "{":
            self._skip_cell()
            return Opaque()
        if token.kind == "(":
            return self._parenthesis()
        if token.kind == "name" and token.text == "end":
            self.take()
            return End()
        if token.kind == "name" and token.text not in _BLOCKS:
            name = self._dotted()
            calls = self.next.kind == "(" and not (self.brackets and self.next.blank_before)
            return Call(name, self._arguments()) if calls else Name(name)
        raise Refused(token.line, f"has '{_shown(token)}' where a value is expected")

    def _dotted(self) -> str:
        """A name with its fields."""
        name = self.take("name").text
        while self.next.kind == "." and not self.next.blank_before:
            self.take()
            name += f".{self.take('name').text}"
        return name

    def _parenthesis(self) -> Expression:
        self._deeper(self.take())
        outside, self.brackets = self.brackets, 0
        found = self._expression(0)
        self.take(")")
        self.brackets = outside
        self.depth -= 1
        return found

    def _arguments(self) -> tuple[Expression, ...]:
        """What stands in the parentheses of an index or a call."""
        self._deeper(self.take())
        outside, self.brackets = self.brackets, 0
        found: list[Expression] = []
        while self.next.kind != ")":
            whole = self.next.kind == ":" and self.tokens[self.at + 1].kind in (",", ")")
            found.append(Colon() if whole else self._expression(0))
            if whole:
                self.take()
            if self.next.kind != ")":
                self.take(",")
        self.take()
        self.brackets = outside
        self.depth -= 1
        return tuple(found)

    def _rows(self) -> Rows:
        """Brackets: elements part at commas and blanks, rows at semicolons and ends of lines."""
        opening = self._deeper(self.take())
        outside, self.brackets = self.brackets, 1
        rows: list[tuple[Expression, ...]] = []
        row: list[Expression] = []
        while self.next.kind != "]":
            if self.next.kind == "end":
                raise Refused(opening.line, "has a bracket that is not closed")
            if self.next.kind in (";", "line"):
                self.take()
                rows += [tuple(row)] if row else []
                row = []
            elif self.next.kind == ",":
                self.take()
            else:
                row.append(self._expression(0))
        rows += [tuple(row)] if row else []
        self.take()
        self.brackets = outside
        self.depth -= 1
        return Rows(tuple(rows))

    def _skip_cell(self) -> None:
        """Pass over a cell."""
        line = self.next.line
        depth = 0
        while True:
            depth += (self.next.kind == "{") - (self.next.kind == "}")
            if self.take().kind == "end":
                raise Refused(line, "has a brace that is not closed")
            if not depth:
                return


def _shown(token: _Token) -> str:
    """A token in a message."""
    return {"line": "end of line", "end": "end of file"}.get(token.kind, token.text[:40])
