"""Test modules share helpers through ``tests.support`` and never through each other."""

from __future__ import annotations

import ast
from pathlib import Path

TESTS = Path(__file__).parent
OWN = {path.stem for path in TESTS.rglob("*.py")} - {"__init__"}


def imported(path: Path) -> set[str]:
    """Absolute names of everything that a file imports, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = f"{'.' * node.level}{node.module or ''}"
            names.update(f"{source}.{alias.name}" for alias in node.names)
    return names


def is_another_test(name: str) -> bool:
    """Whether a name leads to a test module, a conftest or a helper outside ``tests.support``."""
    parts = name.split(".")
    relative = parts[0] == ""
    below_tests = parts[0] == "tests" and parts[1:2] != ["support"]
    return relative or below_tests or parts[0] in OWN


def test_test_modules_import_no_test_module() -> None:
    wrong = [
        f"{path.relative_to(TESTS)}: {name}"
        for path in sorted(TESTS.rglob("*.py"))
        for name in sorted(imported(path))
        if is_another_test(name)
    ]
    assert wrong == []


def test_imports_of_test_modules_are_recognised() -> None:
    assert all(
        map(
            is_another_test,
            [
                "tests.test_plant.decision",
                "tests.conftest",
                "test_plant.decision",
                "conftest.tiny",
                ".test_plant.decision",
                "tiny_day.tiny_scenario",
            ],
        )
    )
    assert not any(
        map(
            is_another_test,
            ["tests.support.set_points.decision", "vppres.plant.plant.Plant", "pytest"],
        )
    )
