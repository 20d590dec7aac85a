"""Every code block of README and docs runs: Python, commands with their output, and files.

The blocks of a page share names and an empty folder. In a block ``console`` a line after ``$`` is a
command and the lines below it are its output, in which ``...`` stands for anything; in a block
``sh`` every line is a command. A ``{code-block}`` with a caption is a file of that name.
"""

from __future__ import annotations

import doctest
import re
import shlex
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from sybil import Document, Example, Region, Sybil
from sybil.parsers.myst import CodeBlockParser, PythonCodeBlockParser
from sybil.parsers.myst.lexers import DirectiveLexer
from typer.testing import CliRunner

from vppres.cli import commands as cli

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE

# Commands that no test runs, each with its reason; nor are studies, which take minutes to hours.
NOT_RUN = {
    "vppres report results/first --pdf": "needs a browser",
    "vppres report results/first --figures svg,png": "needs the run of another page",
}

# Pages that take long, and whose commands are those of other pages or tests.
NIGHTLY = {
    "by-hand.md",
    "change.md",
    "compare.md",
    "cooling.md",
    "errors.md",
    "gensets.md",
    "islands.md",
    "networks.md",
    "outages.md",
    "own.md",
    "pandas.md",
    "priorities.md",
    "reproduce.md",
    "rolling.md",
    "solver.md",
    "step.md",
    "sweep.md",
    "tutorial.md",
    "uncertain-outages.md",
    "vehicles.md",
}

# The same command on another page; one of them runs it.
RUN_ON_ANOTHER_PAGE = {
    ("index.md", "vppres run uk-heatwave-2022 --out results/first"): "README.md",
    ("README.md", "vppres run my-feeder --out results/my-feeder"): "docs/tutorial.md",
}


def run_commands(example: Example) -> str | None:
    """Run a block of commands and compare their output."""
    for command, expected in commands_of(example):
        line = re.sub(r"^\.venv/bin/", "", command.partition(" #")[0].strip())
        page = Path(str(example.path)).name
        if not line or line in NOT_RUN or (page, line) in RUN_ON_ANOTHER_PAGE:
            continue
        line, _, file = line.partition(" > ")
        program, *arguments = shlex.split(line)
        if program != "vppres":
            assert is_study(program, arguments), f"is neither run nor a study: {line}"
            continue
        result = CliRunner().invoke(cli.app, arguments, prog_name="vppres", env={"COLUMNS": "80"})
        if file:
            Path(file).write_text(result.stdout, encoding="utf-8")
        if not expected:
            assert result.exit_code == 0, f"{line}: {result.output}"
        elif not doctest.OutputChecker().check_output(expected, result.output, FLAGS):
            return f"{line}\nexpected:\n{expected}\nbut was:\n{result.output}"
    return None


def is_study(program: str, arguments: list[str]) -> bool:
    """Whether a command is a target of the Makefile or a module to run."""
    if program == "make":
        makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
        return re.search(rf"^{arguments[0]}:", makefile, re.MULTILINE) is not None
    return program == "python" and find_spec(arguments[1]) is not None


def commands_of(example: Example) -> Iterator[tuple[str, str]]:
    """Commands of a block, each with the output that is shown below it."""
    text = re.sub(r" *\\\n *", " ", example.parsed)
    if example.region.lexemes["arguments"] == "sh":
        yield from ((line, "") for line in text.splitlines())
        return
    for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
        command, _, output = part.partition("\n")
        yield command, output


def files(document: Document) -> Iterator[Region]:
    """Blocks that are files."""
    for found in DirectiveLexer(directive="code-block", arguments="[a-z]+")(document):
        name = found.lexemes["options"].get("caption")
        if name:
            yield Region(found.start, found.end, (name, str(found.lexemes["source"])), write_file)


def write_file(example: Example) -> None:
    """Put the file of a block into the page's folder."""
    name, text = example.parsed
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


SYBIL = Sybil(
    [PythonCodeBlockParser(), CodeBlockParser("console", run_commands),
        CodeBlockParser("sh", run_commands), files],
)  # fmt: skip


RUN = [page for page in PAGES if any(SYBIL.parse(page).examples())]
LONG = [page for page in RUN if page.name in NIGHTLY]


@pytest.fixture
def run_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Runs the blocks of a page in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(page: Path) -> None:
        for example in SYBIL.parse(page).examples():
            example.evaluate()

    return run


@pytest.mark.daily
@pytest.mark.parametrize("page", sorted({*RUN} - {*LONG}), ids=lambda page: page.stem)
def test_blocks_of_the_page_run(page: Path, run_blocks: Callable[[Path], None]) -> None:
    run_blocks(page)


@pytest.mark.nightly
@pytest.mark.parametrize("page", LONG, ids=lambda page: page.stem)
def test_blocks_of_a_long_page_run(page: Path, run_blocks: Callable[[Path], None]) -> None:
    run_blocks(page)


def test_no_block_is_overlooked() -> None:
    known = {"python", "console", "sh", "toml", "text", ""}
    for page in PAGES:
        languages = re.findall(r"^```([^{\s]*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
        assert set(languages) <= known, page


def test_sections_that_are_named_are_there() -> None:
    """The code names sections of pages, and pages name labels of others."""
    docs = {
        page.relative_to(ROOT / "docs").as_posix(): page.read_text("utf-8") for page in PAGES[1:]
    }
    labels = {label for text in docs.values() for label in re.findall(r"^\((.+)\)=$", text, re.M)}
    named = {
        label.rpartition("<")[2].rstrip(">")
        for text in docs.values()
        for label in re.findall(r"{ref}`([^`]+)`", text)
    }
    assert named - labels == set()
    for module in sorted((ROOT / "vppres").rglob("*.py")):
        text = " ".join(module.read_text(encoding="utf-8").split())
        for page, section in re.findall(r"``docs/([\w/-]+\.md)``, (?:section )?\*([^*]+)\*", text):
            assert re.search(rf"^#+ {re.escape(section)}$", docs[page], re.M), (
                module.name,
                section,
            )
