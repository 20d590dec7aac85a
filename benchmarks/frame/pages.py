"""Reports of studies and benchmarks: text as Markdown and HTML, numbers as JSON, figures."""

from __future__ import annotations

import base64
import csv
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markdown_it import MarkdownIt
from matplotlib.figure import Figure

from vppres.core.plain import json_safe
from vppres.io.atomic import atomic_write_text

DPI = 150
SVG_HASH_SALT = "vppres"
"""A fixed salt keeps two SVG files equal if their data are."""
PAGE = """<!DOCTYPE html>
<html lang="en-GB">
<head>
<meta charset="utf-8">
<title>{title}</title>
<style>
body {{ font: 15px/1.45 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ padding: .2rem 1rem .2rem 0; text-align: left; border-bottom: 1px solid #ddd; }}
img {{ width: 100%; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown.

    >>> print(markdown_table(("kind", "steps"), [("rule", 3)]))
    | kind | steps |
    | --- | --- |
    | rule | 3 |
    """
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def write_pages(folder: Path, name: str, title: str, text: str, record: Mapping[str, Any]) -> Path:
    """Write ``name.md``, ``name.html`` and ``name.json`` into a folder; the Markdown's path."""
    folder.mkdir(parents=True, exist_ok=True)
    markdown = f"# {title}\n\n{text}\n"
    body = MarkdownIt().enable("table").render(markdown)
    atomic_write_text(folder / f"{name}.html", PAGE.format(title=title, body=body))
    atomic_write_text(folder / f"{name}.json", json.dumps(json_safe(record), indent=2) + "\n")
    atomic_write_text(folder / f"{name}.md", markdown)
    return folder / f"{name}.md"


def template_environment(templates: Path, figures: Path, escape: bool) -> Environment:
    """Templates of a report; ``embedded(name)`` is a figure's SVG as a data URI.

    Parameters
    ----------
    templates, figures : Path
        Folders of the templates and of the figures.
    escape : bool
        Whether what is filled in is escaped, as HTML wants it.
    """
    environment = Environment(
        loader=FileSystemLoader(templates),
        autoescape=escape,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )

    def embedded(name: str) -> str:
        image = base64.b64encode((figures / f"{name}.svg").read_bytes()).decode("ascii")
        return f"data:image/svg+xml;base64,{image}"

    environment.globals["embedded"] = embedded
    return environment


def put_into(page: Path, text: str, begin: str, end: str) -> None:
    """Replace what stands between two marks of a page."""
    before, begun, rest = page.read_text("utf-8").partition(begin)
    _, ended, after = rest.partition(end)
    assert begun and ended, f"{page} has no place for the table"
    atomic_write_text(page, f"{before}{begin}\n\n{text}\n\n{end}{after}")


def put_table(page: Path, table: str, begin: str, end: str) -> None:
    """Keep a table as CSV beside a page, and show it between two marks of the page.

    Parameters
    ----------
    page : Path
        A page of the documentation.
    table : str
        Rows of Markdown, the heads first.
    begin, end : str
        The marks; the table's file has the first one's name.
    """
    name = re.sub(r"\W+", "-", begin.partition(":")[0].strip("<!- "))
    head, _, *rows = [
        [cell.strip() for cell in line.strip().strip("|").split("|")] for line in table.splitlines()
    ]
    put_into(page, csv_table(page, name, head, rows), begin, end)


def csv_table(page: Path, name: str, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a table to ``_static`` beside a page; returns the directive that shows it."""
    file = page.parent / "_static" / page.stem / f"{name}.csv"
    file.parent.mkdir(parents=True, exist_ok=True)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    atomic_write_text(file, text.getvalue())
    path = file.relative_to(page.parent).as_posix()
    return f"```{{csv-table}}\n:file: {path}\n:header-rows: 1\n```"


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write one figure as PNG and SVG; equal figures give equal files.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    stem : Path
        File without its ending, in an existing folder.

    Returns
    -------
    list of Path
        The files written.
    """
    png = stem.with_name(f"{stem.name}.png")
    svg = stem.with_name(f"{stem.name}.svg")
    with matplotlib.rc_context({"svg.hashsalt": SVG_HASH_SALT}):
        figure.savefig(svg, metadata={"Date": None})
    # The places are found; to find them again would take half of the time.
    figure.set_layout_engine("none")
    figure.savefig(png, dpi=DPI)
    return [png, svg]
