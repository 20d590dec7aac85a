"""The one table of what a window may have beyond the paper."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from functools import cache
from itertools import chain

from vppres.kinds.customer.rows import DimmedDemand, LongestTimeOff, SwitchingModel
from vppres.kinds.export.rows import ExportToGrid
from vppres.kinds.table import parts
from vppres.model.beyond_paper.addition import Addition
from vppres.model.beyond_paper.at_end import HeldAtEnd, ValueAtEnd
from vppres.model.beyond_paper.drawn import BeyondLimit, DrawnByNetwork
from vppres.model.beyond_paper.former_phases import FormerPhases
from vppres.model.beyond_paper.lines_out import LinesOut
from vppres.model.beyond_paper.physical import PhysicalMode
from vppres.model.beyond_paper.ratings import LineRatings
from vppres.model.beyond_paper.unspent import StoredIsKept
from vppres.model.data import WindowData
from vppres.model.site import Site

OF_WINDOWS: tuple[type[Addition], ...] = (
    SwitchingModel,
    LongestTimeOff,
    PhysicalMode,
    ExportToGrid,
    DrawnByNetwork,
    BeyondLimit,
    FormerPhases,
    HeldAtEnd,
    ValueAtEnd,
    StoredIsKept,
    LinesOut,
)
"""Additions for which the stages that were made for the paper's problem have a proof."""

PROVEN: tuple[type[Addition], ...] = (*OF_WINDOWS, LineRatings)
"""Additions of windows and of shadow prices: line ratings, whose rows windows make by hand."""


@cache
def additions() -> tuple[type[Addition], ...]:
    """All of the package's; of others those stages know nothing, and are left out."""
    return (*OF_WINDOWS, DimmedDemand, *(part.ROWS for part in parts("rows").values()))


_OWN: list[type[Addition]] = []


@contextmanager
def own_parts(*parts: type[Addition]) -> Iterator[None]:
    """Add your own parts to the problem of every window while the block runs.

    They reach every method of this process. A part that the decomposed method cannot bound is
    refused there, by its name.

    Examples
    --------
    >>> with own_parts(Addition):
    ...     [part.__name__ for part in own_additions()]
    ['Addition']
    """
    _OWN.extend(parts)
    try:
        yield
    finally:
        del _OWN[len(_OWN) - len(parts) :]


def own_additions() -> tuple[type[Addition], ...]:
    """Your own parts."""
    return tuple(_OWN)


Beyond = tuple[tuple[type[Addition], Hashable], ...]
"""Additions of a window, each with the key that a problem is compiled for; () for the paper."""


def beyond_paper(site: Site, data: WindowData) -> Beyond:
    """The additions of a window."""
    shapes = ((each, each.shape(site, data)) for each in chain(additions(), _OWN))
    return tuple((each, shape) for each, shape in shapes if shape is not None)
