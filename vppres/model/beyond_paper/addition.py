"""Interface of an addition to the paper's problem.

An addition states parameters, families of rows and parts of the objective. No method of solving
knows it: what it adds reaches all of them through the one statement of the window.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import ClassVar, Self

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

Taken = tuple[cp.Expression, cp.Expression | None]
"""Active and reactive power that is taken, (W, n) each; None where no reactive power is."""


@dataclass(frozen=True, eq=False)
class AdditionDispatch:
    """Part of a dispatch that an addition holds, with its cost, for the tie-breakers.

    ``values`` are those of its letters of :attr:`Addition.by_dispatch`, ``ranges`` the least and
    the most of other letters, and ``gbp`` the part of the cost that goes with it.
    """

    values: dict[str, Floats | float] = field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    gbp: float = 0.0


class Addition:
    """Addition to a window's problem beyond the paper."""

    #: Families of the paper that it states anew, or that do not hold with it.
    replaces: ClassVar[tuple[str, ...]] = ()
    draws: ClassVar[bool] = False  #: whether it takes power at the buses whatever is decided
    #: Whether its rows tell one PV system or battery from another: no relaxation lumps them then.
    apart: ClassVar[bool] = False
    #: Whether all of its families limit service alone: a known service meets them or does not.
    rules: ClassVar[bool] = False
    #: Its binaries of which relaxations without modes take shares.
    directions: ClassVar[tuple[str, ...]] = ()
    #: Its letters that a relaxation without the network has not.
    of_network: ClassVar[tuple[str, ...]] = ()
    #: Its implied families that stand for what such a relaxation leaves out.
    for_network: ClassVar[tuple[str, ...]] = ()
    #: Its letters with a column for each battery: a lumped fleet has their sum.
    of_batteries: ClassVar[tuple[str, ...]] = ()
    #: Its letters that are 0 once service is known, since the data have what they add then.
    by_service: ClassVar[tuple[str, ...]] = ()
    #: Its letters that the tie-breakers hold and those that they bound, by :meth:`of_dispatch`; its
    #: families that hold by that.
    by_dispatch: ClassVar[tuple[str, ...]] = ()
    in_range: ClassVar[tuple[str, ...]] = ()
    met: ClassVar[tuple[str, ...]] = ()
    #: Its letters between 0 and 1 of which the tie-breakers minimise the squares, as kW of loss.
    calm: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """Key for which a problem is compiled; None for a window without the addition."""
        return True

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        """Make its variables and parameters, for the window of these variables."""

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """The addition for the window of these variables."""
        return cls(site, v, shape)

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """Expressions for :class:`vppres.model.variables.Parameters`; those added are summed."""
        return {}

    def taken(self, site: Site) -> dict[str, Taken]:
        """Power that ``customers`` take besides, or the units of a kind, by its name."""
        return {}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Rows of the addition by the names of their families."""
        return {}

    def implied(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Rows that follow from its families and the paper's, for relaxations without modes."""
        return {}

    def terms(self) -> dict[str, cp.Expression]:
        """Additions to the terms of the objective, by their names.

        ``own`` is a term of F with weight 1, in weighted customer hours.
        """
        return {}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data into its parameters."""

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Additions to the terms of a dispatch, recomputed from its arrays."""
        return {}

    @classmethod
    def cost_range(
        cls, site: Site, data: WindowData, least_gbp: Floats, dearest_gbp: Floats
    ) -> tuple[Floats, Floats]:
        """The least and the most that each step can cost, (W,) each, with what it adds."""
        return least_gbp, dearest_gbp

    def of_dispatch(self, site: Site, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """Part of a dispatch that the tie-breakers hold."""
        return AdditionDispatch()

    def both_ways_kw(self, P_grid_kw: Floats) -> Floats:
        """Power that the last solution both imports and exports, (W,)."""
        return np.zeros_like(P_grid_kw)

    def read(self, found: Dispatch) -> Dispatch:
        """A dispatch that was read from the paper's letters, with what its own say."""
        return found
