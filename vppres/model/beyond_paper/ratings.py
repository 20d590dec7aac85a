"""Ratings of lines and transformers as limits of the flows in a window, and as rows.

Plans make such rows by hand where a solution exceeds a rating (``solve/limits.py``). Shadow prices
need those of all lines, for their duals, so they alone state this family.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.core.units import a_to_kva
from vppres.model.beyond_paper.addition import Addition
from vppres.model.constraints import Named, disc
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.own_state import flows_without_control, u_without_sun_pu2
from vppres.model.phases import phased_model
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

FAMILY = "line_rating"


class LineRatings(Addition):
    """Largest apparent power of each line that has a rating, shape (W, rated lines)."""

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        self.lines = rated_lines(site)
        size = (v.P_flow.shape[0], len(self.lines))
        self.S_line = cp.Parameter(size, name="S_line", nonneg=True)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether flows are limited."""
        return True if len(data.flow_max_kva) else None

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Cones of active and reactive flow."""
        return {FAMILY: disc(v.P_flow[:, self.lines], v.Q_flow[:, self.lines], self.S_line)}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        write(self.S_line, data.flow_max_kva[:, self.lines])


def rated_lines(site: Site) -> Wholes:
    """Lines that have a rating."""
    return np.flatnonzero(np.isfinite(site.network.i_max_a))


KEPT_SHARE = 1e-3
"""Share of a rating that plans leave free: what passes that agree may still be off by."""

GIVEN = (0.0, 0.0625, 0.25, 0.5, 0.75)
"""Shares by which ratings give way to a dispatch, of what it has beyond them: the first that leaves
an answer holds, and the dispatch itself where none does."""

MOVED_SHARE = 0.05
"""Share of a rating by which losses and voltages of another pass may move a flow that kept it."""


def with_ratings(site: Site, data: WindowData, give_way: bool = True) -> WindowData:
    """A window whose flows keep the currents of its lines within their ratings.

    A current is larger the lower the voltage: what counts is the voltage at the sending end with
    all customers supplied and no PV power, and in an island the lowest that plans allow. Currents
    of phases are linear themselves.

    Soft ratings that may ``give_way`` are never less than the flows without control while the grid
    is on.
    """
    own_share = (1.0 + KEPT_SHARE) * (site.soft_ratings and give_way)
    if data.phased:
        most = np.maximum(1.0 - KEPT_SHARE, own_share * data.phased.current_own)
        return replace(data, phased=replace(data.phased, current_max=most))
    net = site.network
    v_pu = net.v_pu(u_without_sun_pu2(site, data))
    v_pu = np.where(data.dark[:, None], net.v_min_pu, v_pu)
    most_kva = a_to_kva(net.i_max_a, v_pu[:, net.parent] * net.base_kv)
    most_kva = (1.0 - KEPT_SHARE) * most_kva
    if own_share:
        own_kva = own_share * np.hypot(*flows_without_control(site, data))
        most_kva = np.where(data.with_grid[:, 1:], np.maximum(most_kva, own_kva), most_kva)
    return replace(data, flow_max_kva=most_kva)


def with_ratings_given(site: Site, data: WindowData, to: Dispatch, share: float) -> WindowData:
    """A window whose ratings give way to a dispatch, by a share of what it has beyond them.

    Only currents of which the dispatch has too much give way, each in its own steps.
    """
    limited = with_ratings(site, data)
    size, most = _flows(site, limited, to)
    given = most + share * np.maximum(size - most, 0.0)
    if limited.phased:
        return replace(limited, phased=replace(limited.phased, current_max=given))
    return replace(limited, flow_max_kva=given)


def overloaded(site: Site, data: WindowData, dispatch: Dispatch, by: float = 0.0) -> Flags:
    """Lines whose flow is above what the window allows by more than a share of it, (W, L).

    Of a phased feeder, currents of the phases of its lines and of its transformers, (W, k).
    """
    size, most = _flows(site, data, dispatch)
    return np.asarray(size > most * (1.0 + by))


def _flows(site: Site, data: WindowData, dispatch: Dispatch) -> tuple[Floats, Floats | float]:
    """Flows of lines in kVA and what the window allows; with phases currents as shares."""
    if not data.phased:
        return np.hypot(dispatch.p_flow_kw, dispatch.q_flow_kvar), limit_kva(data)
    drawn = phased_model(site).drawn(data.for_service(dispatch.served), dispatch)
    return loading_of_phases(site, data, *drawn), data.phased.current_max


def loading_of_phases(site: Site, data: WindowData, p_kw: Floats, q_kvar: Floats) -> Floats:
    """Currents of a phased feeder as shares of their ratings, (W, k), of what assets draw."""
    offset = data.phased.current_offset
    return np.abs(offset + phased_model(site).currents(data, p_kw, q_kvar))


def has_ratings(data: WindowData) -> bool:
    """Whether currents of a window are limited."""
    if data.phased:
        return bool(np.isfinite(data.phased.current_max).any())
    return len(data.flow_max_kva) > 0


def limit_kva(data: WindowData) -> Floats | float:
    """Largest flow of each line, (W, L); infinite where nothing limits it."""
    return data.flow_max_kva if len(data.flow_max_kva) else np.inf
