"""Tables of the documentation, as the tables of options and of attributes have them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Annotated, Any, Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import AwareDatetime, BaseModel
from pydantic.fields import FieldInfo

from vppres.io.schema import TABLES, unit
from vppres.kinds.table import KINDS, parts
from vppres.scenario.option_table import Option


def page_row(option: Option) -> str:
    """An option of the table as a row of ``docs/command-line.md``.

    What a choice means stands in brackets, which ``--help`` has and the page leaves out.

    >>> page_row(next(option for option in OPTIONS if option.name == "notice"))
    '| `--notice` | 6 | notice of an outage for the controller reserve (h) |'
    """
    unit = f" ({option.unit})" if option.unit not in ("", "share") else ""
    words = re.sub(r" \([^)]*\)", "", option.words)
    for choice in option.choices:
        words = re.sub(rf"(?<!`)\b{choice}\b", f"`{choice}`", words, count=1)
    text = option.meaning + unit
    text += f": {words}" if words else ""
    text += f"; {option.page.removeprefix('see ')}" if option.page else ""
    default = f"{_page_default(option)} ".lstrip()
    return f"| `--{option.name}` | {default}| {text} |"


def _page_default(option: Option) -> str:
    """Default of an option as the documentation writes it."""
    if option.scenario_key:
        return ""
    if option.default is None:
        return option.unset
    if isinstance(option.default, bool):
        return "on" if option.default else "off"
    return f"`{option.default}`" if option.kind is str else f"{option.default:g}"


@dataclass(frozen=True)
class Attribute:
    """One column or key, in the words of the documentation."""

    name: str
    values: str
    default: str
    meaning: str


def attributes(model: type[BaseModel]) -> Iterator[Attribute]:
    """The attributes of one table, in the order of its columns."""
    for name, field in model.model_fields.items():
        yield Attribute(
            field.alias or name, _values(field), _default(field), field.description or ""
        )


def attribute_table_markdown() -> str:
    """All tables of attributes as Markdown, one section per file or section of scenario.toml."""
    return "\n\n".join(_table_markdown(title, model) for title, model in TABLES.items()) + "\n"


STEP_TIME = "beginning of the step, ISO 8601 with time zone"
"""The column of every series, which the page explains once, under *Rules*."""


def _table_markdown(title: str, model: type[BaseModel]) -> str:
    head = "| name | values | default | meaning |\n|---|---|---|---|"
    shown = [attribute for attribute in attributes(model) if attribute.meaning != STEP_TIME]
    rows = [_row(list(alike)) for _, alike in groupby(shown, _alike)]
    return "\n".join([f"### {title}", "", f"{model.__doc__}", "", head, *rows])


def _row(alike: list[Attribute]) -> str:
    """One attribute as a row, or attributes of one kind with what they have in common."""
    first = alike[0]
    names = ", ".join(f"`{attribute.name}`" for attribute in alike)
    default, meaning = first.default, first.meaning
    if len(alike) > 1:
        kind = _alike(first)
        default = "the name with `.csv`" if kind == "file" else default
        meaning = WORDS_OF_MANY.get(kind, f"{meaning}; {alike[1].meaning}; and so on")
    cells = (names, first.values, default, meaning)
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"


WORDS_OF_MANY = {"file": "files of tables and series", "table": "the tables below"}


def _alike(attribute: Attribute) -> str:
    """Key of attributes that share a row: files, tables and matrices of phases, else the name."""
    if attribute.default == f"{attribute.name}.csv":
        return "file"
    if attribute.default != "required" and re.match(r"(list of )?tables? \[", attribute.meaning):
        return "table"
    return re.sub(r"_[abc]{2}_", "_", attribute.name)


def _values(field: FieldInfo) -> str:
    """Allowed values of a field: its range and unit, or its kind."""
    limits, kind = _bounds(field), _kind(field)
    if kind == "whole number" or not limits:
        return f"{kind} {limits}".rstrip() if not unit(field) else unit(field)
    if unit(field) in ("", "1"):
        return limits
    return f"{limits}, {unit(field)}" if unit(field)[0].isdigit() else f"{limits} {unit(field)}"


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
    words = {Gt: "above ", Ge: "", Lt: "below ", Le: ""}
    found = {
        kind: f"{sign}{getattr(m, kind.__name__.lower()):g}"
        for kind, sign in words.items()
        for m in field.metadata
        if isinstance(m, kind)
    }
    if set(found) == {Ge}:
        return f"from {found[Ge]}"
    return " or ".join(choices) or " to ".join(found.values())


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
