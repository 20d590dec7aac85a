"""HTML for notebooks: small tables, nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape


def facts_html(title: str, facts: Mapping[str, object]) -> str:
    """A heading and a table of names and values.

    >>> facts_html("A & B", {"steps": 24})
    '<b>A &amp; B</b><table><tr><th>steps</th><td>24</td></tr></table>'
    """
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in facts.items()
    )
    return f"<b>{escape(title)}</b><table>{rows}</table>"
