"""Compiled problems, kept: compiling one costs more than a day of solving it again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

from vppres.model.site import Site
from vppres.solve.turns import one_at_a_time

P = ParamSpec("P")
M = TypeVar("M")

SITES_KEPT = 3
"""Sites whose problems a process keeps: a study has one, a guard adds parts of its fleet."""


class ModelCache:
    """Compiled problems of a site, each made once.

    The cache knows no problem: the caller says what makes it. A problem is filled
    completely before every solve, so nothing leaks from one window into the next.
    """

    def __init__(self, site: Site) -> None:
        self.site = site
        self._problems: dict[Hashable, Any] = {}
        self._tables: dict[Hashable, Any] = {}

    @property
    def compilations(self) -> int:
        """Problems made so far."""
        return len(self._problems)

    @property
    def problems(self) -> list[Any]:
        """The problems that are kept, in the order in which they were made."""
        return list(self._problems.values())

    def problem(
        self, make: Callable[Concatenate[Site, P], M], *args: P.args, **shape: P.kwargs
    ) -> M:
        """The problem that ``make`` makes of the site for a shape, made where it is not there yet.

        ``make`` makes it: ``(site, **shape) -> problem``. The shape, such as a number of steps and
        a mode, is hashable.

        Examples
        --------
        ``cache.problem(Sheet, n_steps=6, beyond=())``
        """
        key = (make, args, frozenset(shape.items()))
        if key not in self._problems:
            self._problems[key] = make(self.site, *args, **shape)
        return cast(M, self._problems[key])

    def table(self, make: Callable[[Site], M]) -> M:
        """Table that ``make`` computes of the site once and for all; nothing is compiled for it."""
        if make not in self._tables:
            self._tables[make] = make(self.site)
        return cast(M, self._tables[make])


_SHARED: OrderedDict[str, ModelCache] = OrderedDict()


@one_at_a_time
def shared_cache(site: Site) -> ModelCache:
    """The process's compiled problems of a site, shared by all runs; only the last few are kept.

    A study of many days on one site compiles once.
    """
    cache = _SHARED.pop(site.key, None) or ModelCache(site)
    _SHARED[site.key] = cache
    while len(_SHARED) > SITES_KEPT:
        _SHARED.popitem(last=False)
    return cache
