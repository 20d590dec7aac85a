"""SVG elements, and texts from others made harmless in them."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterable

from markupsafe import escape

from vppres.core.arrays import Wholes
from vppres.report.plots.palette import BLACK

FONT_PX = 11.0
LETTER = 0.56
"""Mean width of a letter as a share of its height, in the common fonts without serifs."""

FAMILY = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"


def text_px(text: object, size: float = FONT_PX) -> float:
    """Width that a text takes, nearly; that of its longest line."""
    return max((len(line) for line in str(text).split("\n")), default=0) * LETTER * size


class Canvas:
    """Elements one after the other; later ones lie above.

    Ids of a drawing begin with its ``key``: they must be its own in a page with others.
    """

    def __init__(self, key: str) -> None:
        self.key = key
        self.parts: list[str] = []
        self._hatches: dict[tuple[str, str], str] = {}

    def svg(self, width: float, height: float, label: str) -> str:
        """The drawing as an SVG document that needs nothing beside it."""
        hatches = "".join(self._hatches.values())
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{_n(width)}" height="{_n(height)}" '
            f'viewBox="0 0 {_n(width)} {_n(height)}" role="img" aria-label="{escape(label)}" '
            f'font-family="{FAMILY}" font-size="{_n(FONT_PX)}">'
            f"<defs>{hatches}</defs>{''.join(self.parts)}</svg>"
        )

    def text(
        self,
        x: float,
        y: float,
        text: object,
        *,
        anchor: str = "start",
        size: float = FONT_PX,
        color: str = BLACK,
        bold: bool = False,
        turned: bool = False,
    ) -> None:
        """A text whose lines are centred on a height; turned, they are read from the right."""
        lines = str(text).split("\n")
        first = y - 0.6 * size * (len(lines) - 1) + 0.36 * size
        turn = f' transform="rotate(-90 {_n(x)} {_n(y)})"' if turned else ""
        weight = ' font-weight="bold"' if bold else ""
        look = f'text-anchor="{anchor}" font-size="{_n(size)}" fill="{color}"{weight}{turn}'
        for number, line in enumerate(lines):
            height = first + 1.2 * size * number
            self.parts.append(f'<text x="{_n(x)}" y="{_n(height)}" {look}>{escape(line)}</text>')

    def line(
        self,
        points: Iterable[tuple[float, float]],
        color: str,
        width: float = 1.0,
        dash: str = "",
    ) -> None:
        """Points joined by straight lines; a point that is not a number interrupts them."""
        path = path_of(points)
        if path:
            dashes = f' stroke-dasharray="{dash}"' if dash else ""
            self.parts.append(
                f'<path d="{path}" fill="none" stroke="{color}" stroke-width="{_n(width)}"'
                f'{dashes} stroke-linejoin="round"/>'
            )

    def dots(self, points: Iterable[tuple[float, float]], color: str) -> None:
        """A dot at each point that is a number."""
        self.parts += [
            f'<circle cx="{_n(x)}" cy="{_n(y)}" r="3" fill="{color}"/>' for x, y in points if y == y
        ]

    def area(self, points: Iterable[tuple[float, float]], fill: str, opacity: float = 1.0) -> None:
        """A closed area."""
        self.parts.append(f'<path d="{path_of(points)}Z" fill="{fill}" opacity="{_n(opacity)}"/>')

    def box(
        self, x: float, y: float, width: float, height: float, fill: str, edge: str = "none"
    ) -> None:
        """A rectangle."""
        self.parts.append(
            f'<rect x="{_n(x)}" y="{_n(y)}" width="{_n(max(width, 0.0))}" '
            f'height="{_n(max(height, 0.0))}" fill="{fill}" stroke="{edge}" stroke-width="0.6"/>'
        )

    def hatched(self, color: str, kind: str = "lines") -> str:
        """A fill of lines or dots in a colour."""
        name = f"{self.key}-{kind}-{color[1:]}"
        mark = (
            f'<path d="M-1 7l8-8M5 9l4-4" stroke="{color}" stroke-width="1.3"/>'
            if kind == "lines"
            else f'<circle cx="2" cy="2" r="1.1" fill="{color}"/>'
        )
        self._hatches[kind, color] = (
            f'<pattern id="{name}" width="6" height="6" patternUnits="userSpaceOnUse">'
            f"{mark}</pattern>"
        )
        return f"url(#{name})"

    def image(self, x: float, y: float, width: float, height: float, pixels: Wholes) -> None:
        """Pixels of shape (rows, columns, 3) over a rectangle, with sharp edges."""
        data = base64.b64encode(png(pixels)).decode("ascii")
        self.parts.append(
            f'<image x="{_n(x)}" y="{_n(y)}" width="{_n(width)}" height="{_n(height)}" '
            f'preserveAspectRatio="none" style="image-rendering: pixelated" '
            f'href="data:image/png;base64,{data}"/>'
        )


def path_of(points: Iterable[tuple[float, float]]) -> str:
    """Points as the commands of a path."""
    commands = []
    command = "M"
    for x, y in points:
        if y == y:  # not NaN
            commands.append(f"{command}{_n(x)} {_n(y)}")
            command = "L"
        else:
            command = "M"
    return "".join(commands)


def png(pixels: Wholes) -> bytes:
    """An image of shape (rows, columns, 3) as PNG, the same bytes every time.

    >>> import numpy as np
    >>> png(np.zeros((2, 3, 3), dtype=np.uint8))[1:4]
    b'PNG'
    """
    rows, columns, _ = pixels.shape
    lines = b"".join(b"\x00" + row.tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(lines, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )


def _n(value: float) -> str:
    """A number with a tenth of a pixel, as short as it can be."""
    return f"{value:.1f}".removesuffix(".0")
