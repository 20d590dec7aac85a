"""What the pages of studies draw with matplotlib: figures that are not over the time of a run."""

from __future__ import annotations

import base64
from io import BytesIO
from pathlib import Path
from typing import Literal

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vppres.report.plots.palette import RULE_COLOUR

DPI = 150

# A fixed salt keeps two SVG files equal if their data are.
SVG_HASH_SALT = "vppres"


def plain(text: object) -> str:
    r"""Others' words for a figure: matplotlib reads what stands between two dollars as a formula.

    >>> print(plain("$x$"))
    \$x\$
    """
    return str(text).replace("$", r"\$")


def draw_grid(ax: Axes, axis: Literal["both", "x"] = "both") -> None:
    """Light rules behind the curves, and no frame above and at the right."""
    ax.grid(True, axis=axis, color=RULE_COLOUR, linewidth=0.5)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def embedded(figure: Figure) -> str:
    """A figure as a data URI of an SVG image; equal figures give equal text."""
    image = BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": SVG_HASH_SALT}):
        figure.savefig(image, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(image.getvalue()).decode("ascii")


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write one figure as PNG and SVG; equal figures give equal files.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    stem : Path
        File without its ending, in an existing folder.

    Returns
    -------
    list of Path
        The files written.
    """
    png = stem.with_name(f"{stem.name}.png")
    svg = stem.with_name(f"{stem.name}.svg")
    with matplotlib.rc_context({"svg.hashsalt": SVG_HASH_SALT}):
        figure.savefig(svg, metadata={"Date": None})
    # The places are found; to find them again would take half of the time.
    figure.set_layout_engine("none")
    figure.savefig(png, dpi=DPI)
    return [png, svg]
