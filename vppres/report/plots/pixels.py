"""Drawings as PNG, with resvg."""

from __future__ import annotations

from pathlib import Path

ZOOM = 1.5
"""Pixels for each px of a drawing: 1,290 across."""

FAMILY = "DejaVu Sans"
FONT = Path(__file__).parents[1] / "fonts" / "DejaVuSans.ttf"


def png_of(svg: str) -> bytes:
    """A drawing as PNG, with the same letters on every machine."""
    from resvg_py import svg_to_bytes

    return bytes(
        svg_to_bytes(
            svg_string=svg,
            zoom=ZOOM,
            background="#ffffff",
            skip_system_fonts=True,
            font_files=[str(FONT)],
            font_family=FAMILY,
            sans_serif_family=FAMILY,
        )
    )
