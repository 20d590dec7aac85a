"""The folder of each kind has what the layers ask of it."""

from __future__ import annotations

import inspect
from types import SimpleNamespace
from typing import Any, get_args

import pytest

from vppres.kinds.folder import PARTS
from vppres.kinds.kind import UnitsAhead
from vppres.kinds.table import KINDS, parts
from vppres.model.beyond_paper.addition import Addition
from vppres.service.of_kind import Direction, OfKind


def lacking(part: Any, wanted: type[Any]) -> list[str]:
    """Names that a module lacks, and functions that take another number of values."""
    names = [name for name in wanted.__annotations__ if not hasattr(part, name)]
    for name, asked in inspect.getmembers(wanted, inspect.isfunction):
        if name.startswith("_"):
            continue
        has = getattr(part, name, None)
        values = len(inspect.signature(asked).parameters) - 1  # without self
        if not inspect.isfunction(has) or len(inspect.signature(has).parameters) != values:
            names.append(f"{name} of {values} values")
    return names


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_module_of_a_kind_has_what_is_asked_of_it(kind: str, name: str) -> None:
    assert lacking(parts(name)[kind], PARTS[name]) == []


@pytest.mark.parametrize("kind", KINDS)
def test_classes_of_a_kind_are_of_their_interfaces(kind: str) -> None:
    window = parts("physics")[kind].WINDOW
    assert issubclass(window, UnitsAhead) and issubclass(parts("rows")[kind].ROWS, Addition)
    assert len(inspect.signature(window.of).parameters) == 4  # the last one need not be given
    service = parts("service")[kind].SERVICE
    assert isinstance(service, OfKind) and service.kind == kind
    assert service.direction in get_args(Direction)


def test_what_is_lacking_is_named() -> None:
    part = SimpleNamespace(KIND=None, contents=lambda: "")
    assert lacking(part, PARTS[""]) == ["contents of 1 values"]
    assert lacking(SimpleNamespace(contents=lambda content: ""), PARTS[""]) == ["KIND"]
