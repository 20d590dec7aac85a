"""Docs, README, CHANGELOG, report, web page and docstrings keep to the terms of the field."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GLOSSARY = ROOT / "docs" / "glossary.md"
TEXTS = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "docs").glob("**/*.md")),
    *sorted((ROOT / "vppres" / "report" / "templates").glob("**/*.j2")),
    *sorted((ROOT / "vppres" / "service" / "page").glob("*.js")),
    *sorted((ROOT / "vppres" / "service" / "page").glob("*.html")),
]
MOST_TERMS = 40
MOST_WORDS = 45_000

# Everyday words for technical things, each with what to write.
BANNED = {
    r"in place of|takes? the place of|took the place of": "instead of; replaces",
    r"nobody|somebody|anybody|everybody|everyone": "no customer, a customer, all customers",
    r"whoever|whom": "customers that ...",
    r"customers? who": "customers that ...",
    r"lets? go of|(?:is|are|was|were) let go": "disconnect, shed",
    r"(?:is|are|was|were) told|told of": "knows, gets, receives",
    r"(?:was|were|ever) heard": "received; no data from",
    r"in store": "stored",
    r"one's own|of one's": "your own",
    r"of the house|the house|eighteen rooms|ladder|rungs?": "package, layer; stages",
    r"in the dark|(?:is|was|be|goes) dark": "in an outage step; blacked out",
    r"the sun": "PV power",
    r"(?:is|was|were) believed": "probability, forecast",
    r"of a processor": "CPU time",
    r"\d %": "10% without a space",
}
# What is not prose: code, equations, links and directives.
NOT_PROSE = re.compile(
    r"^```.*?^```|`[^`]*`|\$\$.*?\$\$|\$[^$\n]*\$|\]\([^)]*\)|\{%.*?%\}|\{\{.*?\}\}",
    re.MULTILINE | re.DOTALL,
)
ALLOWED = {
    "docs/service.md": {"anybody"},  # the actor in the audit without tokens: `anybody here`
}


def prose(text: str) -> str:
    """A text without code and equations, its lines kept."""
    return NOT_PROSE.sub(lambda found: "\n" * found[0].count("\n"), text)


def words_of_code(path: Path) -> str:
    """Docstrings and comments of a module, each at its line; names of parameters are none."""
    code = path.read_text(encoding="utf-8")
    lines = code.splitlines()
    words = ["" for _ in lines]
    for node in docstrings(ast.parse(code)):
        for number in range(node.lineno - 1, node.end_lineno or node.lineno):
            words[number] = re.sub(r"^ *\w+(?:, \w+)* : .*", "", lines[number])
    for token in tokenize.generate_tokens(io.StringIO(code).readline):
        if token.type == tokenize.COMMENT:
            words[token.start[0] - 1] += token.string
    return "\n".join(words).replace("``", "`")


def docstrings(tree: ast.AST) -> Iterator[ast.Expr]:
    """Texts that stand by themselves."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield node


def everyday_words(path: Path) -> list[str]:
    """Banned words of a text, each with its line and what to write."""
    name = str(path.relative_to(ROOT))
    code = path.suffix == ".py"
    text = words_of_code(path) if code else path.read_text(encoding="utf-8")
    return [
        f"{name}:{number}: {found[0]!r}: {better}"
        for number, line in enumerate(prose(text).splitlines(), 1)
        for words, better in BANNED.items()
        for found in re.finditer(rf"(?<!\w)(?:{words})(?!\w)", line, re.IGNORECASE)
        if found[0] not in ALLOWED.get(name, ())
    ]


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_texts_use_the_terms_of_the_field(path: Path) -> None:
    assert everyday_words(path) == []


@pytest.mark.nightly
def test_docstrings_use_the_terms_of_the_field() -> None:
    modules = sorted((ROOT / "vppres").glob("**/*.py"))
    assert [found for module in modules for found in everyday_words(module)] == []


def test_a_banned_word_is_found_in_a_docstring(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    page = tmp_path / "page.py"
    page.write_text(
        'nobody = 1  # whoever\n"""Of ``everyone`` and\nnobody.\n"""\n', encoding="utf-8"
    )
    assert [found.split(": ")[1] for found in everyday_words(page)] == ["'whoever'", "'nobody'"]


def test_a_banned_word_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("Three\ncustomers who are off, `in store`.\n", encoding="utf-8")
    assert everyday_words(page) == ["page.md:2: 'customers who': customers that ..."]


def test_the_glossary_is_short_sorted_and_linked() -> None:
    terms = re.findall(r"^\*\*(.+)\*\*$", GLOSSARY.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(terms) <= MOST_TERMS
    assert terms == sorted(terms, key=str.lower)
    assert "{doc}`glossary`" in (ROOT / "docs" / "index.md").read_text(encoding="utf-8")


def test_the_pages_are_short_enough_to_be_read() -> None:
    pages = [path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("**/*.md")]
    # Bars of tables are no words.
    assert len("\n".join(pages).replace("|", "").split()) <= MOST_WORDS
