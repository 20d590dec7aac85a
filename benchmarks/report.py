"""The report of a benchmark run: bars, tables and figures as Markdown and HTML."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment
from matplotlib.figure import Figure

from benchmarks.frame import pages
from benchmarks.frame.pages import csv_table, save_figure, template_environment
from vppres.core.errors import InputError, Problem
from vppres.day.metrics import versions
from vppres.io.atomic import atomic_write_text

TEMPLATES = Path(__file__).with_name("templates")
MARKDOWN = "report.md"
HTML = "report.html"
FIGURES = "_static/benchmarks"
BEGIN = "<!-- results begin -->"
END = "<!-- results end -->"


@dataclass(frozen=True)
class Section:
    """A heading, a sentence, tables, and figures by name."""

    title: str
    text: str
    tables: Sequence[pd.DataFrame] = ()
    figures: dict[str, Figure] = field(default_factory=dict)


@dataclass(frozen=True)
class Bar:
    """What must be shown, what was measured, and whether it holds; None where nothing was."""

    claim: str
    measured: str
    met: bool | None

    @property
    def verdict(self) -> str:
        """The verdict in a word."""
        return {True: "yes", False: "no", None: "not measured"}[self.met]


def bar_table(bars: Sequence[Bar]) -> pd.DataFrame:
    """Bars as a table."""
    return pd.DataFrame([{"bar": b.claim, "measured": b.measured, "met": b.verdict} for b in bars])


def write_report(sections: Sequence[Section], folder: Path, effort: str) -> Path:
    """Write ``report.md``, ``report.html`` and ``figures/``; returns the Markdown file."""
    figures = folder / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    for section in sections:
        for name, figure in section.figures.items():
            save_figure(figure, figures / name)
    values = {
        "sections": sections,
        "effort": effort,
        "machine": machine(),
        "versions": {k: v for k, v in versions().items() if v},
    }
    for file in (MARKDOWN, HTML):
        environment = _environment(figures, escape=file == HTML)
        atomic_write_text(folder / file, environment.get_template(f"{file}.j2").render(values))
    return folder / MARKDOWN


def machine() -> str:
    """Cores and memory."""
    memory_gb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    return f"{os.cpu_count()} cores, {memory_gb:.0f} GB"


def publish(sections: Sequence[Section], document: Path, effort: str) -> None:
    """Put tables and figures between the marks of a document, in place of what is there.

    Figures become SVG files, and tables CSV files, under ``_static`` beside the document.

    Raises
    ------
    InputError
        If the document has no marks.
    """
    text = document.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise InputError(
            Problem(
                document.name,
                "has no marks for the results",
                f"Write {BEGIN} and {END} around them.",
            )
        )
    parts = [f"{effort} {_packages()}"]
    for section in sections:
        parts += [f"### {section.title}", section.text, *_tables(section, document)]
        parts += [_published(name, figure, document) for name, figure in section.figures.items()]
    body = "\n\n".join(part for part in parts if part)
    pattern = re.escape(BEGIN) + ".*?" + re.escape(END)
    new = re.sub(pattern, lambda _: f"{BEGIN}\n{body}\n\n{END}", text, flags=re.DOTALL)
    atomic_write_text(document, new)


def _tables(section: Section, document: Path) -> list[str]:
    """Write the tables of a section beside a page; returns what shows them."""
    name = re.sub(r"\W+", "-", section.title.lower())
    return [
        csv_table(
            document,
            f"{name}-{number}",
            list(table.columns),
            [list(map(cell, row)) for row in table.itertuples(index=False)],
        )
        for number, table in enumerate(section.tables, 1)
    ]


def _published(name: str, figure: Figure, document: Path) -> str:
    """Save a figure beside a document; returns the Markdown that shows it."""
    folder = document.parent / FIGURES
    folder.mkdir(parents=True, exist_ok=True)
    _, svg = save_figure(figure, folder / name)
    svg.with_suffix(".png").unlink()
    return f"![{name.replace('_', ' ')}]({FIGURES}/{name}.svg)"


def markdown_table(table: pd.DataFrame) -> str:
    """A table as Markdown, numbers with four digits.

    Examples
    --------
    >>> print(markdown_table(pd.DataFrame({"steps": [6], "ratio": [25.12345]})))
    | steps | ratio |
    | --- | --- |
    | 6 | 25.12 |
    """
    rows = [
        [cell(value).replace("|", "\\|") for value in row] for row in table.itertuples(index=False)
    ]
    return pages.markdown_table(list(map(str, table.columns)), rows)


def cell(value: Any) -> str:
    """A value as text: floats with four significant digits, "n/a" for none."""
    if isinstance(value, float):
        return "n/a" if pd.isna(value) else f"{value:.4g}"
    return str(value)


def _packages() -> str:
    wanted = ("highspy", "pyscipopt", "clarabel", "cvxpy")
    return ", ".join(f"{name} {versions()[name]}" for name in wanted if versions().get(name)) + "."


def _environment(figures: Path, escape: bool) -> Environment:
    environment = template_environment(TEMPLATES, figures, escape)
    helpers: dict[str, Callable[..., str]] = {"cell": cell, "markdown_table": markdown_table}
    environment.globals.update(helpers)
    return environment
