"""An OpenDSS script checked before OpenDSS sees it, and written anew.

OpenDSS never gets the text of a file. Each command is taken apart, held against the words that a
network needs (:mod:`vppres.feeders.dss.words`), and written again with values that are numbers or
names and nothing else. What OpenDSS and this module might read differently, comments, quotes and
continued lines, is gone from what it gets.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from vppres.core.errors import InputError, Problem
from vppres.feeders.dss.words import (
    IDLE,
    IDLE_OPTIONS,
    IDLE_PROPERTIES,
    LIBRARIES,
    MATHS,
    NETWORK,
    OPTIONS,
    SKIPPED,
)
from vppres.feeders.strangers.files import MOST_PROBLEMS, read_text
from vppres.io.messages import did_you_mean

MOST_FILES = 100
DEEPEST = 10
LARGEST_BYTES = 5 * 2**20
"""Of all files together. The largest published test feeders have some 3 MB."""

MOST_COMMANDS = 200_000
MOST_REFUSED = 500  # a file with that many is not a network with a line too much
SHOWN = 40  # characters of a refused word: enough to find it

_LINES = re.compile(r"\r\n|\n|\r")
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f]")
_BLANK = re.compile(r"[\s,]+")
_TOKEN = re.compile(
    r"""(?:"(?P<a>[^"]*)"|'(?P<b>[^']*)'|\((?P<c>[^)]*)\)|\[(?P<d>[^\]]*)\]
                        |\{(?P<e>[^}]*)\}|(?P<plain>[^\s,="'()\[\]{}]+))(?P<end>\s*=|[\s,]|$)""",
    re.VERBOSE,
)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?%?")
# No blank, quote, comma, equals sign or @: nothing that ends a value or stands for another.
_NAME = re.compile(r"[\w.+\-#$%:&*/;]{1,200}", re.ASCII)
_FILE = re.compile(r"[\w.+\-/ ()]{1,200}")  # no drive, no home folder, no URL
_IN_FILE = re.compile(r"\s*(?:file|csvfile|sngfile|dblfile|pqcsvfile)\s*=", re.IGNORECASE)

_CLEARS = ("clear", "clearall")
_READS = ("redirect", "compile")
_SWITCHES = ("open", "close", "enable", "disable")
_CONTINUES = ("~", "more", "m")


@dataclass(frozen=True)
class Command:
    """A command that OpenDSS gets, and where it comes from."""

    file: str
    row: int
    text: str


@dataclass(frozen=True)
class Script:
    """The checked commands of a master and of all files that it reads, and what was left out."""

    commands: tuple[Command, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Value:
    """A value of a command; ``name`` is empty where it was written without one."""

    name: str
    text: str
    quoted: bool


class _Refused(Exception):
    """Why a line is refused, and the cure."""

    def __init__(self, message: str, cure: str) -> None:
        super().__init__(message)
        self.message = message
        self.cure = cure


def read_script(master: Path) -> Script:
    """Check a script and everything that it redirects to, in its folder and below.

    A file one level above may hold line codes and other data sheets. Every line that a network does
    not need is told, by file, row and cure.
    """
    reader = _Reader(master.resolve().parent)
    reader.read(master.name, master.resolve(), library=False)
    if reader.problems:
        raise InputError(_folded(reader.problems, master.name))
    return Script(tuple(reader.commands), tuple(f"{words}." for words in reader.notes))


def _folded(problems: list[Problem], master: str) -> list[Problem]:
    """The first problems, and how many there are beyond."""
    if len(problems) <= MOST_PROBLEMS:
        return problems
    return [
        *problems[:MOST_PROBLEMS],
        Problem(
            master,
            f"has {len(problems) - MOST_PROBLEMS} more lines like these",
            "Keep the commands that build the network, and remove the others.",
        ),
    ]


@dataclass
class _Reader:
    """What is known while files are read: each is read once, and only below the root."""

    root: Path
    commands: list[Command] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    notes: dict[str, None] = field(default_factory=dict)
    seen: set[Path] = field(default_factory=set)
    depth: int = 0
    bytes_left: int = LARGEST_BYTES
    kind: str = ""

    def read(self, shown: str, path: Path, library: bool) -> None:
        """Check the lines of a file."""
        self.seen.add(path)
        text = read_text(path, self.bytes_left, shown)
        self.bytes_left -= len(text)
        comment = False
        for row, line in enumerate(_LINES.split(text), start=1):
            if comment or line.lstrip().startswith("/*"):
                comment, line = _after_comment(line)
            try:
                for command in self._checked(line, shown, library):
                    self.commands.append(Command(shown, row, command))
            except _Refused as refused:
                self.problems.append(Problem(shown, refused.message, refused.cure, row=row))
            if len(self.problems) == MOST_REFUSED:
                raise InputError(_folded(self.problems, shown))
            if len(self.commands) > MOST_COMMANDS:
                raise InputError.of(
                    shown,
                    f"has more than {MOST_COMMANDS} commands",
                    "Give the feeder alone.",
                    row=row,
                )

    def _checked(self, line: str, shown: str, library: bool) -> Iterator[str]:
        """The commands that a line becomes: one, none, or those of the file it redirects to."""
        values = _values(line)
        if not values:
            return
        first = values[0]
        verb = first.text.lower()
        if first.name:
            yield from self._property_line(values, library)
        elif verb in ("new", "edit"):
            yield from self._element(verb, values[1:], library)
        elif verb in _CONTINUES:
            if not self.kind:
                raise _Refused("continues nothing", "Put it after the element that it belongs to.")
            yield from self._edited("~", values[1:])
        elif verb in _READS:
            self._redirect(values, shown, library)
        elif library:
            raise _Refused(
                "is not a data sheet",
                f"A file above the master's folder may only define {', '.join(sorted(LIBRARIES))}.",
            )
        else:
            yield from self._command(verb, values[1:], shown)

    def _command(self, verb: str, values: list[_Value], shown: str) -> Iterator[str]:
        """Commands that build no element."""
        if verb in _CLEARS:
            if self.commands:
                yield "clear"
        elif verb == "set":
            yield from _options(values)
        elif verb == "setkvbase":
            yield _setkvbase(values)
        elif verb in _SWITCHES:
            yield _switched(verb, values)
        else:
            self._skip(verb, values, shown)

    def _skip(self, verb: str, values: list[_Value], shown: str) -> None:
        """Commands that need not be carried out; all others are refused."""
        full = next(
            (
                name
                for name in SKIPPED
                if verb == name or (len(verb) >= 5 and name.startswith(verb))
            ),
            "",
        )
        if not full:
            raise _Refused(
                f"'{_cut(verb)}' is not a command that a network needs",
                "Remove the line: only commands that build the network are read.",
            )
        if full == "solve" and values:
            raise _Refused(
                f"'solve' with '{_cut(values[0].name or values[0].text)}' is not a "
                "command that a network needs",
                "Remove the line, or what follows 'solve': the network is read, not solved.",
            )
        if full.endswith("coords"):
            self.notes[f"{shown}: '{full}' {SKIPPED[full]}"] = None

    def _redirect(self, values: list[_Value], shown: str, library: bool) -> None:
        """Read another file instead of the line."""
        if len(values) != 2 or values[1].name:
            raise _Refused("does not name one file", "Write: redirect file.dss.")
        name = values[1].text.strip().replace("\\", "/")
        path, above = self._inside(name, self._base(shown))
        if path in self.seen:
            raise _Refused(
                f"redirects to {_cut(name)}, which is read already",
                "Each file is read once: remove the line.",
            )
        if self.depth >= DEEPEST or len(self.seen) >= MOST_FILES:
            raise _Refused(
                f"redirects to {_cut(name)}, but files are read {DEEPEST} deep and "
                f"{MOST_FILES} in all at most",
                "Put them into fewer files.",
            )
        if not path.is_file():
            raise _Refused(f"redirects to {_cut(name)}: there is no such file", "Correct the path.")
        self.depth += 1
        # Continued lines belong to the file that they are in, as they do in OpenDSS.
        self.kind = ""
        label = f"../{path.name}" if above else path.relative_to(self.root).as_posix()
        self.read(label, path, library or above)
        self.depth -= 1

    def _base(self, shown: str) -> Path:
        """Folder of a file that is shown relative to the root."""
        return (self.root / shown).parent

    def _inside(self, name: str, base: Path) -> tuple[Path, bool]:
        """A file that may be read, and whether it lies beside the root."""
        given = PurePosixPath(name)
        if given.is_absolute() or not _FILE.fullmatch(name):
            raise _Refused(
                f"names the file {_cut(name)}",
                "Name a file below the master's folder, relative to the file that names it.",
            )
        try:
            path = (base / given).resolve()
        except (OSError, RuntimeError):  # too long a name, or links in a circle
            path = Path(given)
        if path.is_relative_to(self.root):
            return path, False
        if path.parent == self.root.parent and path.suffix.lower() == ".dss":
            return path, True
        raise _Refused(
            f"leads out of the master's folder: {_cut(name)}",
            "Copy the file into the folder, and name it from there.",
        )

    def _property_line(self, values: list[_Value], library: bool) -> Iterator[str]:
        """``class.name.property=value``, as an edit of the element."""
        kind, _, rest = values[0].name.partition(".")
        element, _, name = rest.rpartition(".")
        if not element:
            raise _Refused(
                f"'{_cut(values[0].name)}' names no element", "Write class.name.property=value."
            )
        target = _Value("", f"{kind}.{element}", False)
        first = _Value(name, values[0].text, values[0].quoted)
        yield from self._element("edit", [target, first, *values[1:]], library)

    def _element(self, verb: str, values: list[_Value], library: bool) -> Iterator[str]:
        """``new`` and ``edit``."""
        if not values or values[0].name.lower() not in ("", "object"):
            raise _Refused(
                f"'{verb}' names no element", f"Write: {verb} class.name property=value."
            )
        kind, _, name = values[0].text.partition(".")
        kind = kind.lower()
        known = {*NETWORK, *IDLE}
        if kind not in known:
            raise _Refused(
                f"'{_cut(kind)}' is not a class that a network needs",
                did_you_mean(_cut(kind), sorted(known), "Remove the element."),
            )
        if library and kind not in LIBRARIES:
            raise _Refused(
                f"defines a {kind} above the master's folder",
                "Copy the file into the folder: from above it only data sheets are read.",
            )
        self.kind = kind
        head = verb if kind in IDLE else f"{verb} {kind}.{_name(name, 'name')}"
        yield from self._edited(head, values[1:])

    def _edited(self, head: str, values: list[_Value]) -> Iterator[str]:
        """The properties of the element at hand; nothing of what is left out."""
        if self.kind in IDLE:
            for value in values:
                if _IN_FILE.match(value.text):
                    name = value.name.lower()
                    self.notes[f"Series in files are left out, {self.kind} {name}"] = None
            return
        kinds = NETWORK[self.kind]
        words = [head]
        for value in values:
            name = value.name.lower()
            if not name:
                raise _Refused(f"{self.kind} has a value without its name", "Write name=value.")
            if name in kinds:
                words.append(f"{name}={_written(kinds[name], value, name)}")
            elif name not in IDLE_PROPERTIES:
                raise _Refused(
                    f"{self.kind} has '{_cut(name)}', which is not a property that a network needs",
                    did_you_mean(_cut(name), sorted({*kinds, *IDLE_PROPERTIES}), "Remove it."),
                )
        if len(words) > 1 or not head.startswith("~"):
            yield " ".join(words)


def _after_comment(line: str) -> tuple[bool, str]:
    """Whether the comment goes on, and what OpenDSS might still read of the line."""
    _, end, rest = line.partition("*/")
    return not end, rest


def _values(line: str) -> list[_Value]:
    """Names and values of a line up to its comment."""
    if _CONTROL.search(line):
        raise _Refused("has a control character", "Remove it.")
    found: list[_Value] = []
    name = ""
    at = 0
    while at < len(line):
        blank = _BLANK.match(line, at)
        at = blank.end() if blank else at
        if at == len(line) or line.startswith(("!", "//"), at):
            break
        token = _TOKEN.match(line, at)
        if token is None:
            raise _Refused(
                "has a quote that is not closed, or two values without a blank between them",
                "Close it, or put a blank between them.",
            )
        plain = token["plain"]
        quoted = plain is None
        text = (
            plain if plain is not None else next(token[g] for g in "abcde" if token[g] is not None)
        )
        at = token.end()
        if not quoted and ("!" in text or "//" in text):
            raise _Refused(
                "has a comment that follows a value without a blank",
                "Put a blank before the comment.",
            )
        if "@" in text:
            raise _Refused("has '@', which stands for a variable", "Write the value.")
        if token["end"].strip() == "=":
            if name:
                raise _Refused(f"'{_cut(name)}' has no value", "Give it one.")
            name = text.strip()
            continue
        found.append(_Value(name, text, quoted))
        name = ""
    if name:
        raise _Refused(f"'{_cut(name)}' has no value", "Give it one.")
    return found


def _written(kind: str, value: _Value, name: str) -> str:
    """A value as OpenDSS gets it."""
    if kind == "w":
        return _name(value.text.strip(), name)
    parts = value.text.replace("|", " | ").replace(",", " ").split()
    if kind == "ws":
        return f"[{' '.join(_name(part, name) for part in parts)}]"
    for part in parts:
        if part != "|" and not _NUMBER.fullmatch(part) and part.lower() not in MATHS:
            raise _Refused(f"{name} = {_cut(part)} is not a number", "Write a number.")
    if kind == "n" and len(parts) == 1:
        return parts[0]
    if kind == "n" and (not value.quoted or "|" in parts):
        raise _Refused(f"{name} = {_cut(value.text)} is not a number", "Write a number.")
    # Arithmetic is written in parentheses, rows of numbers in brackets.
    return f"({' '.join(parts)})" if kind == "n" else f"[{' '.join(parts)}]"


def _name(text: str, field_name: str) -> str:
    """A name that cannot be anything else."""
    if not _NAME.fullmatch(text) or "//" in text:
        raise _Refused(
            f"{field_name} = {_cut(text)} is not a name",
            "Use letters, digits and - . _ + # $ % : & * / ; without blanks.",
        )
    return text


def _options(values: list[_Value]) -> Iterator[str]:
    """``set`` with its options, one at a time."""
    for value in values:
        name = value.name.lower()
        if name in OPTIONS:
            yield f"set {name}={_written(OPTIONS[name], value, name)}"
        elif name not in IDLE_OPTIONS:
            shown = _cut(value.name or value.text)
            raise _Refused(
                f"'set {shown}' is not an option that a network needs",
                did_you_mean(_cut(name), sorted({*OPTIONS, *IDLE_OPTIONS}), "Remove it."),
            )


def _setkvbase(values: list[_Value]) -> str:
    """``setkvbase bus=b kvll=11``."""
    known = _named(values, ("bus", "kvll", "kvln"))
    words = [
        f"{name}={_written('w' if name == 'bus' else 'n', value, name)}"
        for name, value in known.items()
    ]
    return " ".join(["setkvbase", *words])


def _switched(verb: str, values: list[_Value]) -> str:
    """``open``, ``close``, ``enable`` and ``disable`` an element."""
    known = _named(
        [_Value("term", v.text, v.quoted) if v.name.lower() == "terminal" else v for v in values],
        ("object", "term", "cond"),
    )
    if "object" not in known:
        raise _Refused(f"'{verb}' names no element", f"Write: {verb} line.name.")
    words = [verb, _name(known["object"].text, "element")]
    words += [
        f"{name}={_written('n', known[name], name)}" for name in ("term", "cond") if name in known
    ]
    return " ".join(words)


def _named(values: list[_Value], names: tuple[str, ...]) -> dict[str, _Value]:
    """Values by name; those without one in the order of the names."""
    found = {}
    for position, value in enumerate(values):
        name = value.name.lower() or (names[position] if position < len(names) else "")
        if name not in names:
            raise _Refused(
                f"'{_cut(name or value.text)}' is not known here", f"Known: {', '.join(names)}."
            )
        found[name] = value
    return found


def _cut(text: str) -> str:
    """A word of a stranger as far as it is needed to find it, without control characters."""
    shown = "".join(c if c.isprintable() else "?" for c in text)
    return shown if len(shown) <= SHOWN else f"{shown[:SHOWN]}..."
