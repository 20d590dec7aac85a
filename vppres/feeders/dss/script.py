"""An OpenDSS script taken apart: its commands, without the text that OpenDSS would read itself.

Files are read here, within the folder of the master, and OpenDSS reads none. Each command is split
into words by OpenDSS's own rules. Verbs are an allow list. Classes, properties and options are held
against those of the engine where it is loaded (:mod:`vppres.feeders.dss.commands`), and every word
is written again by its full name there.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from vppres.core.errors import InputError, Problem
from vppres.core.text import named
from vppres.feeders.dss.refused import RefusedLine, cut
from vppres.feeders.strangers.confined import TIME_LIMIT_S
from vppres.feeders.strangers.files import MOST_PROBLEMS, read_bytes, read_text

MOST_FILES = 100
DEEPEST = 10
LARGEST_BYTES = 32 * 2**20
"""Of all files together. The largest published test feeders have some 6 MB."""

LARGEST_SIZE = 1e15
"""Of powers, voltages, lengths and impedances in any unit; scripts write 1e10 for no limit."""

MOST_COMMANDS = 200_000
MOST_REFUSED = 500  # a file with that many is not a network with a line too much
LONGEST_LINE = 1_000_000

_LINES = re.compile(r"\r\n|\n|\r")
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f]")
_BLANK = re.compile(r"[\s,]+")
_COMMENT = re.compile(r"!|//")
_PLAIN = re.compile(r"(?:(?!//)[^\s,=!])+")
_EQUALS = re.compile(r"\s*=")
_FILE = re.compile(r"[\w.+\-/ ()]{1,200}")  # no drive, no home folder, no URL
_SIZE = re.compile(
    r"k|mva|pmpp|[rxcb]\d|[rxcb]matrix|r$|x$|length|normamps|emergamps", re.IGNORECASE
)
_NUMBER = re.compile(r"(?<![\w.+-])[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?(?![\w.])", re.IGNORECASE)
QUOTES = {'"': '"', "'": "'", "(": ")", "[": "]", "{": "}"}

READS = ("redirect", "compile")
CLEARS = ("clear", "clearall")
ELEMENTS = ("new", "edit")
CONTINUES = ("~", "more", "m")
SWITCHES = ("open", "close", "enable", "disable")
SEVERAL = "batchedit"
PLAIN = ("calcvoltagebases", "makebuslist")
"""Verbs that are carried out, beside ``set``, ``setkvbase`` and ``solve``."""

CARRIED_OUT = (
    *READS, *CLEARS, *ELEMENTS, *CONTINUES, *SWITCHES, *PLAIN, SEVERAL, "set", "setkvbase", "solve",
)  # fmt: skip

_LEFT_OUT = """
save show plot reset dump help quit ? panel sample about buildy get init export fileedit
voltages currents powers seqvoltages seqcurrents seqpowers losses phaselosses cktlosses
formedit totals capacity classes userclasses zsc zsc10 zscrefresh ysc puvoltages
varvalues  varnames buscoords interpolate alignfile top rotate vdiff summary di_plot
comparecases  yearlycurves cd visualize closedi doscmd estimate addbusmarker uuids
nodediff setbusxy  latlongcoords giscoords pstcalc clearbusmarkers relcalc nodelist
calcincmatrix  calcincmatrix_o refine_buslevels calclaplacian exportoverloads
exportvviolations zsc012  allpceatbus allpdeatbus totalpowers comhelp wait
"""
LEFT_OUT = tuple(_LEFT_OUT.split())
"""Verbs that show, write, plot or ask, and change no element: they are named and not done."""

SHAPES = ("loadshape", "tshape", "priceshape", "growthshape", "xycurve", "spectrum")
"""Classes whose values may stand in a file."""

COMMANDS_PER_S = 50.0
"""Commands of a large feeder that a busy machine builds, solves and tells in a second."""

LIBRARIES = frozenset(
    {"linecode", "linegeometry", "linespacing", "wiredata", "cndata", "tsdata", "xfmrcode"}
)
"""Classes that a file beside the master's folder may define: data sheets, no elements."""

Job = dict[str, Any]


class Value(NamedTuple):
    """A value of a command.

    ``name`` is empty where it was written without one, ``quote`` is the character that the text was
    opened with, empty without.
    """

    name: str
    text: str
    quote: str


@dataclass(frozen=True)
class Command:
    """A command, and where it comes from."""

    file: str
    row: int
    verb: str
    target: str = ""
    values: tuple[Value, ...] = ()


@dataclass(frozen=True)
class Script:
    """Commands of a master and of all files that it reads, what is left out, and series in files.

    ``files`` has the bytes of each file that a shape may have its values in, as Latin-1 text by the
    name that the script gives.
    """

    commands: tuple[Command, ...]
    notes: tuple[str, ...]
    files: dict[str, str] = field(default_factory=dict)

    def job(self) -> Job:
        """Commands from which the engine builds the circuit."""
        return {
            "commands": [[c.verb, c.target, [*c.values]] for c in self.commands],
            "files": self.files,
        }


def limit_s(job: Job) -> float:
    """How long the engine may take for a job."""
    return TIME_LIMIT_S + len(job["commands"]) / COMMANDS_PER_S


def read_script(master: Path) -> Script:
    """Take a script apart, and everything that it redirects to, in its folder and below.

    A file one level above may hold line codes and other data sheets. Every line that cannot be read
    is named, by file, row and cure.
    """
    reader = _Reader(master.resolve().parent)
    reader.read(master.name, master.resolve(), library=False)
    if reader.problems:
        raise InputError(folded_lines(reader.problems, master.name))
    return Script(tuple(reader.commands), tuple(reader.notes()), reader.files)


def folded_lines(problems: list[Problem], master: str) -> list[Problem]:
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
    """State of reading: each file is read once, and only below the root."""

    root: Path
    commands: list[Command] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, int] = field(default_factory=dict)
    seen: set[Path] = field(default_factory=set)
    depth: int = 0
    bytes_left: int = LARGEST_BYTES
    kind: str = ""
    refused: bool = False
    """Whether the last element was refused, so that what continues it is not told again."""

    def notes(self) -> Iterator[str]:
        """Sentence on the commands that are left out."""
        if self.left_out:
            words = [f"{what} ({n})" if n > 1 else what for what, n in self.left_out.items()]
            yield f"Commands that build nothing are left out: {named(words)}."

    def read(self, shown: str, path: Path, library: bool) -> None:
        """Take the lines of a file apart."""
        self.seen.add(path)
        text = read_text(path, self.bytes_left, shown)
        self.bytes_left -= len(text)
        base = [path.parent]
        comment = False
        for row, line in enumerate(_LINES.split(text), start=1):
            if comment or line.lstrip().startswith("/*"):
                comment, line = _after_comment(line)
            try:
                for verb, target, values in self._checked(line, base, library):
                    _check_sizes(values)
                    self.commands.append(Command(shown, row, verb, target, tuple(values)))
            except RefusedLine as refused:
                self.problems.append(Problem(shown, refused.message, refused.cure, row=row))
            if len(self.problems) == MOST_REFUSED:
                raise InputError(folded_lines(self.problems, shown))
            if len(self.commands) > MOST_COMMANDS:
                raise InputError.of(
                    shown,
                    f"has more than {MOST_COMMANDS} commands",
                    "Give the feeder alone.",
                    row=row,
                )

    def _checked(
        self, line: str, base: list[Path], library: bool
    ) -> Iterator[tuple[str, str, list[Value]]]:
        """Verb, element and values of a line; none of one that redirects or is left out."""
        values = _values(line)
        if not values:
            return
        first, *rest = values
        verb = _verb(first)
        known = ("", *CONTINUES, *ELEMENTS, *READS)
        if verb not in known and library:  # nothing of it is shown: it may be any file
            raise RefusedLine(
                "is not a data sheet",
                f"A file above the master's folder may only define {', '.join(sorted(LIBRARIES))}.",
            )
        if verb is None:
            raise RefusedLine(
                f"'{cut(first.text)}' is not a command that a network needs",
                "Remove the line: only commands that build the network are read.",
            )
        if verb in CONTINUES:
            if not self.kind and not self.refused:
                raise RefusedLine(
                    "continues nothing", "Put it after the element that it belongs to."
                )
            if not self.refused:
                self._attach(rest, base[0])
                yield "~", self.kind, rest
        elif verb in ("", *ELEMENTS):
            self.refused, self.kind = True, ""
            if verb:
                yield self._element(verb, rest, base[0], library)
            else:
                yield self._property_line(values, base[0], library)
            self.refused = False
        elif verb in READS:
            self._redirect(verb, rest, base, library)
        elif verb in LEFT_OUT or (verb == "solve" and rest):
            words = verb if verb in LEFT_OUT else f"{verb} {cut(rest[0].name or rest[0].text)}"
            self.left_out[words] = self.left_out.get(words, 0) + 1
        elif verb in CLEARS:
            if self.commands:
                yield "clear", "", []
        elif verb in SWITCHES:
            yield _switched(verb, rest)
        elif verb == SEVERAL:
            if not rest or rest[0].name:
                raise RefusedLine(
                    "names no elements", "Write: batchedit class.names property=value."
                )
            yield verb, _target(rest[0].text), rest[1:]
        else:
            yield verb, "", rest

    def _redirect(self, verb: str, rest: list[Value], base: list[Path], library: bool) -> None:
        """Read another file instead of the line; ``compile`` stays in that file's folder."""
        if len(rest) != 1 or rest[0].name:
            raise RefusedLine("does not name one file", "Write: redirect file.dss.")
        name = rest[0].text.strip().replace("\\", "/")
        path, above = self._inside(name, base[0])
        if path in self.seen:
            raise RefusedLine(
                f"redirects to {cut(name)}, which is read already",
                "Each file is read once: remove the line.",
            )
        if self.depth >= DEEPEST or len(self.seen) >= MOST_FILES:
            raise RefusedLine(
                f"redirects to {cut(name)}, but files are read {DEEPEST} deep and "
                f"{MOST_FILES} in all at most",
                "Put them into fewer files.",
            )
        if not path.is_file():
            raise RefusedLine(
                f"redirects to {cut(name)}: there is no such file", "Correct the path."
            )
        self.depth += 1
        # Continued lines belong to the file that they are in, as they do in OpenDSS.
        self.kind, self.refused = "", False
        label = f"../{path.name}" if above else path.relative_to(self.root).as_posix()
        self.read(label, path, library or above)
        self.depth -= 1
        if verb == "compile" and not above:
            base[0] = path.parent

    def _inside(self, name: str, base: Path) -> tuple[Path, bool]:
        """A file that may be read, and whether it lies beside the root."""
        given = PurePosixPath(name)
        if given.is_absolute() or not _FILE.fullmatch(name):
            raise RefusedLine(
                f"names the file {cut(name)}",
                "Name a file below the master's folder, relative to the file that names it.",
            )
        path = _resolved(base, given)
        if path.is_relative_to(self.root):
            return path, False
        if path.parent == self.root.parent and path.suffix.lower() == ".dss":
            return path, True
        raise RefusedLine(
            f"leads out of the master's folder: {cut(name)}",
            "Copy the file into the folder, and name it from there.",
        )

    def _property_line(
        self, values: list[Value], base: Path, library: bool
    ) -> tuple[str, str, list[Value]]:
        """``class.name.property=value``, as an edit of the element."""
        kind, _, rest = values[0].name.partition(".")
        element, _, name = rest.rpartition(".")
        if not element:
            raise RefusedLine(
                f"'{cut(values[0].name)}' names no element", "Write class.name.property=value."
            )
        target = Value("", f"{kind}.{element}", "")
        first = Value(name, values[0].text, values[0].quote)
        return self._element("edit", [target, first, *values[1:]], base, library)

    def _element(
        self, verb: str, values: list[Value], base: Path, library: bool
    ) -> tuple[str, str, list[Value]]:
        """``new`` and ``edit``."""
        if not values or values[0].name.lower() not in ("", "object"):
            raise RefusedLine(
                f"'{verb}' names no element", f"Write: {verb} class.name property=value."
            )
        target = _target(values[0].text)
        kind = target.partition(".")[0].lower()
        if library and kind not in LIBRARIES:
            raise RefusedLine(
                f"defines a {cut(kind)} above the master's folder",
                "Copy the file into the folder: from above it only data sheets are read.",
            )
        self.kind = kind
        self._attach(values[1:], base)
        return verb, target, values[1:]

    def _attach(self, values: list[Value], base: Path) -> None:
        """Read the files that a shape may have its values in; which are, the engine says."""
        if self.kind not in SHAPES:
            return
        for value in values:
            for word in _words(value.text):
                name = word.replace("\\", "/")
                try:
                    path, above = self._inside(name, base)
                except RefusedLine:
                    continue
                if not above and path.is_file() and word not in self.files:
                    content = read_bytes(path, self.bytes_left, name)
                    self.bytes_left -= len(content)
                    self.files[word] = content.decode("latin-1")


def _words(text: str) -> Iterator[str]:
    """A value, or the words of ``file=name, column=2`` in it."""
    yield text.strip()
    if "=" in text:
        yield from (each.text.strip() for each in _values(text))


def _resolved(base: Path, given: PurePosixPath) -> Path:
    """The path without links, with the letters of the files that there are.

    Most feeders are written on a system that does not tell capitals from small letters.
    """
    try:
        path = (base / given).resolve()
        if path.exists():
            return path
        found = base
        for part in given.parts:
            names = [] if part == ".." else [each.name for each in found.iterdir()]
            alike = [name for name in names if name.lower() == part.lower()]
            found = found / (alike[0] if alike and part not in names else part)
        return found.resolve()
    except (OSError, RuntimeError):  # too long a name, links in a circle, or no such folder
        return Path(given)


def _after_comment(line: str) -> tuple[bool, str]:
    """Whether the comment goes on, and what OpenDSS might still read of the line."""
    _, end, rest = line.partition("*/")
    return not end, rest


def _values(line: str) -> list[Value]:
    """Names and values of a line up to its comment, split where OpenDSS splits them."""
    line = line.rstrip("\0\x1a")  # what some editors and systems end a line or a file with
    if _CONTROL.search(line):
        raise RefusedLine("has a control character", "Remove it.")
    if len(line) > LONGEST_LINE:
        raise RefusedLine(f"has more than {LONGEST_LINE} characters", "Divide it with ~.")
    found: list[Value] = []
    name = ""
    at = 0
    while True:
        blank = _BLANK.match(line, at)
        at = blank.end() if blank else at
        if at == len(line) or _COMMENT.match(line, at):
            break
        text, quote, at = _token(line, at)
        equals = _EQUALS.match(line, at)
        if equals is not None and not name:
            name, at = text.strip(), equals.end()
            if not name:
                raise RefusedLine("has a value without its name", "Write name=value.")
            continue
        found.append(Value(name, text, quote))
        name = ""
    if name:
        raise RefusedLine(f"'{cut(name)}' has no value", "Give it one.")
    return found


def _check_sizes(values: list[Value]) -> None:
    """Refuse numbers beyond all equipment: what they do elsewhere in the circuit hides them."""
    for value in values:
        if not _SIZE.match(value.name):
            continue
        for word in _NUMBER.findall(value.text):
            if abs(float(word)) > LARGEST_SIZE:
                raise RefusedLine(
                    f"has {cut(value.name)} = {cut(word)}, a size that no equipment has",
                    "Correct the number.",
                )


def _token(line: str, at: int) -> tuple[str, str, int]:
    """The word that begins here, the quote that opens it, and where it ends."""
    quote = line[at] if line[at] in QUOTES else ""
    if quote:
        end = line.find(QUOTES[quote], at + 1)
        if end < 0:
            raise RefusedLine("has a quote that is not closed", "Close it.")
        text, after = line[at + 1 : end], end + 1
    else:
        plain = _PLAIN.match(line, at)
        if plain is None:
            raise RefusedLine("has an '=' without a name before it", "Write name=value.")
        text, after = plain.group(), plain.end()
    if "@" in text:
        raise RefusedLine("has '@', which stands for a variable", "Write the value.")
    return text, quote, after


def _verb(first: Value) -> str | None:
    """The full name of a command's verb; empty for ``class.name.property=value``, None for none."""
    if first.name:
        return ""
    verb = first.text.strip().lower()
    known = (*CARRIED_OUT, *LEFT_OUT)
    if verb in known:
        return verb
    return next((name for name in known if len(verb) >= 3 and name.startswith(verb)), None)


def _target(text: str) -> str:
    """The name of an element."""
    if not text.strip() or any(quote in text for quote in ('"', "=")):
        raise RefusedLine(f"'{cut(text)}' is not a name", "Give the element another name.")
    return text.strip()


def _switched(verb: str, values: list[Value]) -> tuple[str, str, list[Value]]:
    """``open``, ``close``, ``enable`` and ``disable`` an element, by name or by place."""
    names = ("object", "term", "cond")
    found: dict[str, Value] = {}
    for position, value in enumerate(values):
        name = value.name.lower() or (names[position] if position < len(names) else "")
        full = next((each for each in names if name and each.startswith(name)), "")
        full = "term" if name == "terminal" else full
        if not full or (full != "object" and not value.text.strip().isdecimal()):
            raise RefusedLine(
                f"'{cut(name or value.text)}' is not known here", f"Known: {', '.join(names)}."
            )
        found[full] = Value(full, value.text.strip(), "")
    if "object" not in found:
        raise RefusedLine(f"'{verb}' names no element", f"Write: {verb} line.name.")
    target = _target(found.pop("object").text)
    return verb, target, [*found.values()]
