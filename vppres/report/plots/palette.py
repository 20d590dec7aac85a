"""Colours and lines: told apart by colour-blind eyes, and in a grey print."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

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


def cividis(share: float) -> str:
    """Colour of a share of the scale.

    >>> cividis(0.0), cividis(0.55)
    ('#00224e', '#888578')
    """
    red, green, blue = blend(CIVIDIS, np.array([share]))[0]
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
