"""What every addition to the paper's problem says of itself.

An addition states parameters, families of rows and parts of the objective. No method of solving
knows it: what it adds reaches all of them through the one statement of the window.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import ClassVar, Self

import cvxpy as cp

from vppres.contract.dispatch import Dispatch
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


class Addition:
    """Something that a window's problem may have beyond the paper.

    Attributes
    ----------
    replaces : tuple of str
        Families of the paper that it states anew, or that do not hold with it.
    rules : bool
        Whether all of its families limit service alone: a known service meets them or does not.
    """

    replaces: ClassVar[tuple[str, ...]] = ()
    rules: ClassVar[bool] = False

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """What a problem is compiled for; None for a window without it."""
        return True

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """Its variables and parameters, for the window of these variables."""
        return cls()

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """What it sets of :class:`vppres.model.variables.Parameters`; what is added is summed."""
        return {}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Its rows by the names of their families."""
        return {}

    def implied(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Rows that follow from its families and the paper's, for relaxations without modes."""
        return {}

    def terms(self) -> dict[str, cp.Expression]:
        """What it adds to the terms of the objective, by their names.

        ``own`` is a term of F with weight 1, in weighted customer hours.
        """
        return {}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data into its parameters."""

    def read(self, found: Dispatch) -> Dispatch:
        """A dispatch that was read from the paper's letters, with what its own say."""
        return found
