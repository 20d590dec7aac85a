"""The documentation's diagrams name what exists, and are drawn from the present script."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from pkgutil import resolve_name
from types import ModuleType
from xml.etree import ElementTree

import pytest

DOCS = Path(__file__).parents[2] / "docs"


def load() -> ModuleType:
    """The script as a module: the documentation's folder is no package."""
    spec = importlib.util.spec_from_file_location("diagrams", DOCS / "diagrams.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["diagrams"] = module
    spec.loader.exec_module(module)
    return module


DIAGRAMS = load().DIAGRAMS


@pytest.mark.parametrize("name", DIAGRAMS)
def test_every_name_of_code_exists(name: str) -> None:
    names = DIAGRAMS[name].code_names()
    assert len(names) >= 5
    for code in names:
        assert resolve_name(code) is not None


@pytest.mark.parametrize("name", DIAGRAMS)
def test_file_is_up_to_date(name: str) -> None:
    drawn = (DOCS / "_static" / f"{name}.svg").read_text(encoding="utf-8")
    assert drawn == DIAGRAMS[name].svg(), "run: python docs/diagrams.py"


@pytest.mark.parametrize("name", DIAGRAMS)
def test_drawing_is_xml_and_stays_on_its_canvas(name: str) -> None:
    root = ElementTree.fromstring(DIAGRAMS[name].svg())
    width, height = float(root.attrib["width"]), float(root.attrib["height"])
    for line in root.iter("{http://www.w3.org/2000/svg}polyline"):
        for point in line.attrib["points"].split():
            x, y = map(float, point.split(","))
            assert 0 <= x <= width and 0 <= y <= height


@pytest.mark.parametrize("name", DIAGRAMS)
def test_arrows_join_nodes(name: str) -> None:
    diagram = DIAGRAMS[name]
    ends = {end for arrow in diagram.arrows for end in (arrow.start, arrow.end)}
    assert ends == set(diagram.nodes)
