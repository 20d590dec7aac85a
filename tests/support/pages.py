"""Tables of the documentation, as the tables of options and of attributes have them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import AwareDatetime, BaseModel
from pydantic.fields import FieldInfo

from vppres.io.schema import TABLES, unit
from vppres.kinds.table import KINDS, parts
from vppres.scenario.option_table import Option


def page_row(option: Option) -> str:
    """An option of the table as a row of ``docs/command-line.md``.

    >>> page_row(next(option for option in OPTIONS if option.name == "notice"))
    '| `--notice` | 6 | notice of an outage for the controller reserve (h) |'
    """
    unit = f" ({option.unit})" if option.unit not in ("", "share") else ""
    words = option.words
    for choice in option.choices:
        words = re.sub(rf"(?<!`)\b{choice}\b", f"`{choice}`", words, count=1)
    text = option.meaning + unit
    text += f": {words}" if words else ""
    text += f"; {option.page}" if option.page else ""
    return f"| `--{option.name}` | {_page_default(option)} | {text} |"


def _page_default(option: Option) -> str:
    """Default of an option as the documentation writes it."""
    if option.scenario_key:
        return "the scenario's"
    if option.default is None:
        return option.unset
    if isinstance(option.default, bool):
        return "on" if option.default else "off"
    return f"`{option.default}`" if option.kind is str else f"{option.default:g}"


@dataclass(frozen=True)
class Attribute:
    """One column or key, in the words of the documentation."""

    name: str
    kind: str
    unit: str
    bounds: str
    default: str
    meaning: str


def attributes(model: type[BaseModel]) -> Iterator[Attribute]:
    """The attributes of one table, in the order of its columns."""
    for name, field in model.model_fields.items():
        yield Attribute(
            field.alias or name,
            _kind(field),
            unit(field),
            _bounds(field),
            _default(field),
            field.description or "",
        )


def attribute_table_markdown() -> str:
    """All tables of attributes as Markdown, one section per file or section of scenario.toml."""
    return "\n\n".join(_table_markdown(title, model) for title, model in TABLES.items()) + "\n"


def _table_markdown(title: str, model: type[BaseModel]) -> str:
    head = ["name", "type", "unit", "range", "default", "meaning"]
    rows = [
        [f"`{a.name}`", a.kind, a.unit, a.bounds, a.default, a.meaning] for a in attributes(model)
    ]
    table = [f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows]]
    return "\n".join([f"### {title}", "", f"{model.__doc__}", "", *table])


def _kind(field: FieldInfo) -> str:
    """Type of a field in plain words."""
    words: dict[Any, str] = {
        str: "text",
        float: "number",
        int: "whole number",
        bool: "true or false",
        AwareDatetime: "date and time",
    }
    kind = field.annotation
    choices = get_args(kind)
    if type(None) in choices:
        kind = choices[0]
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    return "text" if get_origin(kind) is Literal else words.get(kind, "table")


def _bounds(field: FieldInfo) -> str:
    """Permitted range of a field."""
    choices = [str(a) for a in get_args(field.annotation) if isinstance(a, str)]
    words = {Gt: "> ", Ge: "≥ ", Lt: "< ", Le: "≤ "}
    found = [
        f"{sign}{getattr(m, kind.__name__.lower()):g}"
        for kind, sign in words.items()
        for m in field.metadata
        if isinstance(m, kind)
    ]
    return " or ".join(choices) or ", ".join(found)


def _default(field: FieldInfo) -> str:
    """Default as it would be written in the file."""
    if field.is_required():
        return "required"
    value = field.default
    if isinstance(value, bool):
        return str(value).lower()
    simple = isinstance(value, (int, float, str)) and value != ""
    return f"{value:g}" if isinstance(value, float) else str(value) if simple else ""


def frame_of(kind: str) -> str:
    """Names of a kind in files, records and readings, as its page begins."""
    names = KINDS[kind]
    live = parts("live")[kind]
    files = {f"{table.key}.csv" for table in names.tables.values()}
    rows = [
        (
            f"needed in {title}",
            [a.name for a in attributes(TABLES[title]) if a.default == "required"],
        )
        for title in TABLES
        if title in files
    ]
    rows += [
        ("table of a run, key of its summary", [names.table]),
        ("readings", live.QUANTITIES),
        ("set-point", live.NUMBERS),
    ]
    lines = [f"| {what} | {', '.join(f'`{word}`' for word in words)} |" for what, words in rows]
    return "\n".join(["| part | names |", "| --- | --- |", *lines])
