"""Test modules share helpers through ``tests.support`` and never through each other."""

from __future__ import annotations

import re
from pathlib import Path

TESTS = Path(__file__).parent
ANOTHER_TEST = re.compile(
    r"^\s*(?:from|import) (?:tests\.(?!support\b)|tests import|test_|conftest|\.)", re.MULTILINE
)


def test_test_modules_import_no_test_module() -> None:
    assert all(map(ANOTHER_TEST.search, ("from tests.test_plant import x", "    import conftest")))
    modules = {path: path.read_text(encoding="utf-8") for path in TESTS.rglob("*.py")}
    assert [path for path, text in modules.items() if ANOTHER_TEST.search(text)] == []
