"""Colours, SVG elements with texts from others made harmless in them, and pixels.

Colours and lines differ for colour-blind eyes, and in a grey print.
"""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from markupsafe import escape

from vppres.core.arrays import Floats, Wholes

# Okabe and Ito's palette: distinct for the common kinds of colour blindness.
BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#E69F00",
    "#CC79A7",
    "#56B4E9",
)
BLACK, GREY, WHITE = "#000000", "#666666", "#FFFFFF"
OUTAGE_COLOUR, RULE_COLOUR = "#E4E4E4", "#D0D0D0"
SERVED, UNSERVED = "#D6E6F2", VERMILLION

CIVIDIS = (
    "#00224E",
    "#083370",
    "#35456C",
    "#4F576C",
    "#666970",
    "#7D7C78",
    "#948E77",
    "#AEA371",
    "#C8B866",
    "#E5CF52",
    "#FEE838",
)
"""Nuñez, Anderton and Renslow's colour map, dark to light, at every tenth."""


@dataclass(frozen=True)
class Style:
    """How a curve is drawn: colour, lengths of dashes and gaps in px, and width in px."""

    color: str
    dash: str = ""
    width: float = 1.8

    def thin(self) -> Style:
        """A companion of the same run: what was planned or modelled."""
        return replace(self, dash="1.5 3", width=1.3)


# Where lines coincide, the later and thinner ones leave the earlier ones to be seen.
RUN_STYLES = (
    Style(BLUE, "", 2.4),
    Style(VERMILLION, "8 4", 2.0),
    Style(GREEN, "9 3 2 3", 1.8),
    Style(PURPLE, "3 3", 1.8),
    Style(BLACK, "10 3 2 3 2 3", 1.4),
)
# Vermillion is left to the tiles that were not served.
TIER_STYLES = (
    Style(BLACK, "", 3.2),
    Style(SKY, "8 4", 2.4),
    Style(GREEN, "9 3 2 3", 1.8),
    Style(PURPLE, "3 3", 1.5),
)


def coloured(colours: tuple[str, ...], share: float) -> str:
    """Colour of a share of a scale.

    >>> coloured(CIVIDIS, 0.0), coloured(CIVIDIS, 0.55)
    ('#00224e', '#888578')
    """
    red, green, blue = blend(colours, np.array([share]))[0]
    return f"#{red:02x}{green:02x}{blue:02x}"


def blend(colours: tuple[str, ...], shares: Floats) -> Wholes:
    """Red, green and blue (0 to 255) of shares of a scale of colours, shape (..., 3).

    What is not defined is white.
    """
    known = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in colours])
    at = np.linspace(0.0, 1.0, len(colours))
    found = np.stack([np.interp(shares, at, known[:, channel]) for channel in range(3)], axis=-1)
    found[np.isnan(shares)] = 255.0
    pixels: Wholes = np.rint(found).astype(np.uint8)
    return pixels


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
        moves: str = "",
        hint: str = "",
    ) -> None:
        """A text whose lines are centred on a height; turned, they are read from the right.

        A page's script moves it where it ``moves`` with the time axis; the hint is shown when it is
        pointed at.
        """
        lines = str(text).split("\n")
        first = y - 0.6 * size * (len(lines) - 1) + 0.36 * size
        turn = f' transform="rotate(-90 {_n(x)} {_n(y)})"' if turned else ""
        weight = ' font-weight="bold"' if bold else ""
        moved = f' class="{moves}"' if moves else ""
        look = f'text-anchor="{anchor}" font-size="{_n(size)}" fill="{color}"{weight}{turn}{moved}'
        whole = f"<title>{escape(hint)}</title>" if hint else ""
        for number, line in enumerate(lines):
            height = first + 1.2 * size * number
            self.parts.append(
                f'<text x="{_n(x)}" y="{_n(height)}" {look}>{escape(line)}{whole}</text>'
            )

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
        # Short lines with round ends stay round where the axis is stretched.
        path = "".join(f"M{_n(x)} {_n(y)}h.1" for x, y in points if y == y)
        self.parts.append(
            f'<path d="{path}" stroke="{color}" stroke-width="6" stroke-linecap="round"/>'
        )

    @contextmanager
    def over_time(self, left: float, right: float, top: float, bottom: float) -> Iterator[None]:
        """Group of marks that a page's script stretches and moves with the axis."""
        x, y, wide, high = map(_n, (left, top - 2, right - left, bottom - top + 6))
        self.parts.append(
            f'<svg class="time" x="{x}" y="{y}" width="{wide}" height="{high}" '
            f'viewBox="{x} {y} {wide} {high}" preserveAspectRatio="none">'
        )
        yield
        self.parts.append("</svg>")

    @contextmanager
    def group(self, name: str, width: float = 0.0) -> Iterator[None]:
        """Group of marks that move together; a page's script reads its width in px."""
        wide = f' data-px="{_n(width)}"' if width else ""
        self.parts.append(f'<g class="{name}"{wide}>')
        yield
        self.parts.append("</g>")

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


def shortened(text: str, letters: int) -> str:
    """A text of at most so many letters, with dots for what is left out.

    >>> shortened("St Anne's Hospital", 10)
    "St Anne's\N{HORIZONTAL ELLIPSIS}"
    """
    return (
        text if len(text) <= letters else f"{text[: letters - 1].rstrip()}\N{HORIZONTAL ELLIPSIS}"
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


ZOOM = 1.5
"""Pixels for each px of a drawing: 1,290 across."""

FONT_NAME = "DejaVu Sans"
FONT_FILE = Path(__file__).parents[1] / "fonts" / "DejaVuSans.ttf"


def png_of(svg: str) -> bytes:
    """A drawing as PNG, with the same letters on every machine."""
    from resvg_py import svg_to_bytes

    return bytes(
        svg_to_bytes(
            svg_string=svg,
            zoom=ZOOM,
            background="#ffffff",
            skip_system_fonts=True,
            font_files=[str(FONT_FILE)],
            font_family=FONT_NAME,
            sans_serif_family=FONT_NAME,
        )
    )
