"""A type checker sees the fields that the kinds have."""

from __future__ import annotations

import ast
import inspect
from dataclasses import fields
from types import ModuleType

import pytest

from vppres.kinds import fields as kinds_fields
from vppres.kinds import live_fields

WRITTEN: tuple[tuple[ModuleType, str], ...] = (
    (kinds_fields, "OfKinds"),
    (kinds_fields, "RunsOfKinds"),
    (kinds_fields, "SetPointsOfKinds"),
    (live_fields, "ReadOfKinds"),
    (live_fields, "ForeseenOfKinds"),
)


def written(source: str, name: str) -> list[str]:
    """Fields of a class as the half of a module says them that a type checker reads."""
    (found,) = (
        each
        for each in ast.walk(ast.parse(source))
        if isinstance(each, ast.ClassDef) and each.name == name
    )
    return [
        each.target.id
        for each in found.body
        if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name)
    ]


@pytest.mark.parametrize(("module", "name"), WRITTEN, ids=[name for _, name in WRITTEN])
def test_what_a_type_checker_sees_of_kinds_is_what_they_have(module: ModuleType, name: str) -> None:
    """Without this, mypy refuses each use of a new kind and does not say where it is to be named."""
    has = [field.name for field in fields(getattr(module, name))]
    found = written(inspect.getsource(module), name)
    assert found == has, (
        f"Write the fields of {name} under TYPE_CHECKING in {module.__name__} as the folders of "
        f"kinds have them: {', '.join(has)}."
    )
    without = inspect.getsource(module).replace(f"        {has[-1]}: ", "        another: ")
    assert written(without, name) != has
