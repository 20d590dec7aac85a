"""Sizes from which on a window has other stages."""

from __future__ import annotations

from vppres.model.site import Site

LARGE = 2000
"""Buses or customers, whichever are more, times steps beyond which a window is large: a search with
network rows does not end in minutes, and the tie-breakers take seconds to find no answer."""

WIDE = 200
"""Buses beyond which a network is wide: voltages by injections are no table of 1 MB any more, and a
large window enters the network before its schedule has a cheapest dispatch."""

HUGE = 1500
"""Buses beyond which a network is huge: compiling the cheapest dispatch takes longer than all the
rest, and the tie-breakers gigabytes."""


def is_large(site: Site, n_steps: int) -> bool:
    """Whether a window of so many steps is large."""
    return max(site.network.n_buses, len(site.customers)) * n_steps > LARGE


def is_wide(site: Site) -> bool:
    """Whether a site has a wide network."""
    return site.network.n_buses > WIDE


def is_huge(site: Site) -> bool:
    """Whether a site has a huge network."""
    return site.network.n_buses > HUGE
