"""Tests stand by room and share helpers through ``tests.support``; imported names exist."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
PACKAGE = TESTS.parent / "vppres"
BESIDE_THE_PACKAGE = {"docs", "experiments", "kinds", "nightly", "tree"}
ANOTHER_TEST = re.compile(
    r"^\s*(?:from|import) (?:tests\.(?!support\b)|tests import|test_|conftest|\.)", re.MULTILINE
)


def test_test_modules_import_no_test_module() -> None:
    assert all(map(ANOTHER_TEST.search, ("from tests.test_plant import x", "    import conftest")))
    modules = {path: path.read_text(encoding="utf-8") for path in TESTS.rglob("*.py")}
    assert [path for path, text in modules.items() if ANOTHER_TEST.search(text)] == []


def test_tests_stand_in_the_folder_of_the_package_that_they_test() -> None:
    folders = {path.parent.relative_to(TESTS).as_posix() for path in TESTS.rglob("test_*.py")}
    rooms = {path.name for path in PACKAGE.iterdir() if path.is_dir()}
    assert len(folders) > 20
    assert folders - rooms - BESIDE_THE_PACKAGE == set()


@pytest.mark.parametrize("folder", ["experiments", "benchmarks", "tests"])
def test_names_that_are_imported_from_the_package_exist(folder: str) -> None:
    missing = [
        f"{path}: {node.module}.{alias.name}"
        for path in (PACKAGE.parent / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] == "vppres"
        for alias in node.names
        if not is_in(str(node.module), alias.name)
    ]
    assert missing == []


def is_in(module: str, name: str) -> bool:
    """Whether a module has a name, or a module of that name."""
    try:
        return hasattr(import_module(module), name) or bool(find_spec(f"{module}.{name}"))
    except ModuleNotFoundError:
        return False
