"""Drawings as PNG, with resvg."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

ZOOM = 1.5
"""Pixels for each px of a drawing: 1,290 across."""

FAMILY = "DejaVu Sans"


def png_of(svg: str) -> bytes:
    """A drawing as PNG, with the same letters on every machine."""
    from resvg_py import svg_to_bytes

    return bytes(
        svg_to_bytes(
            svg_string=svg,
            zoom=ZOOM,
            background="#ffffff",
            skip_system_fonts=True,
            font_files=_fonts(),
            font_family=FAMILY,
            sans_serif_family=FAMILY,
        )
    )


def _fonts() -> list[str]:
    """Files of the font that comes with matplotlib, which is not loaded for it."""
    found = find_spec("matplotlib")
    assert found is not None
    assert found.origin is not None
    folder = Path(found.origin).parent / "mpl-data" / "fonts" / "ttf"
    return [str(folder / name) for name in ("DejaVuSans.ttf", "DejaVuSans-Bold.ttf")]
