"""Each kind of asset has a page on one frame, whose names are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.pages import frame_of
from vppres.kinds.table import FOLDERS, KINDS, parts

DOCS = Path(__file__).parents[2] / "docs"
FRAME = ["What is planned", "The problem", "What a run says", "Limits", "Live"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_of_a_kind_has_the_frame(kind: str) -> None:
    page = (DOCS / f"{FOLDERS[kind]}.md").read_text(encoding="utf-8")
    assert frame_of(kind) in page
    headings = re.findall(r"^## (.+)$", page, re.MULTILINE)
    assert [heading for heading in headings if heading in FRAME] == FRAME


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_of_a_kind_explains_each_reading(kind: str) -> None:
    page = (DOCS / f"{FOLDERS[kind]}.md").read_text(encoding="utf-8")
    live = page.split("## Live\n")[1]
    named = set(re.findall(r"`(\w+)`", live))
    assert {*parts("live")[kind].QUANTITIES, *parts("live")[kind].NUMBERS} <= named
