"""Test modules stand by room and share helpers through ``tests.support``, never each other's."""

from __future__ import annotations

import re
from pathlib import Path

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
