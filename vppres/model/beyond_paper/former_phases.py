"""Active power on each phase of the battery that forms an island, within its rating."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import ClassVar, Self

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Floats
from vppres.model.beyond_paper.addition import Addition
from vppres.model.constraints import Named, of_served
from vppres.model.data import WindowData
from vppres.model.numerics import ANY_KW, write
from vppres.model.phases import ISLAND, REACH, phased_model
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


@dataclass(frozen=True, eq=False)
class FormerPhases(Addition):
    """Active power of an island's former within its rating on each phase, (W, 3).

    It follows from the discs of its phases, whose rows are made with those of the network, and a
    relaxation without the network has it instead: there customers would crowd a phase.

    ``by_pv`` and ``by_batteries`` are shares of a kW that the phases carry, ``rest_kw`` what they
    carry with nothing served and all PV power; ``room_kw`` has what reactive power of PV systems
    and batteries may take off a phase.
    """

    for_network: ClassVar[tuple[str, ...]] = ("former_phase_most", "former_phase_least")

    by_pv: cp.Parameter
    by_batteries: cp.Parameter
    rest_kw: cp.Parameter
    room_kw: cp.Parameter

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether a battery forms an island of phases in some step."""
        formed = data.phased is not None and phased_model(site).former is not None
        return bool(formed and data.dark.any()) or None

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """Parameters of a window."""
        W = v.u.shape[0]
        return cls(
            cp.Parameter((len(site.pv), 3), name="former_by_pv"),
            cp.Parameter((len(site.batteries), 3), name="former_by_batteries"),
            cp.Parameter((W, 3), name="former_rest_kw"),
            cp.Parameter((W, 3), name="former_room_kw"),
        )

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        phased = data.require_phased()
        _, by_pv, by_batteries = _by_kind(site, reactive=False)
        _, *kvar = _by_kind(site, reactive=True)
        ratings = site.pv.s_max_kva, site.batteries.s_max_kva
        taken = sum(np.abs(each).T @ rating for each, rating in zip(kvar, ratings, strict=True))
        room_kw = REACH * phased.room_kva[:, None] + taken
        write(self.by_pv, by_pv)
        write(self.by_batteries, by_batteries)
        write(self.rest_kw, phased.former_offset.real - data.pv_kw @ by_pv)
        write(self.room_kw, np.where(data.dark[:, None], room_kw, ANY_KW))

    def implied(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Limits in both directions on the power of customers and batteries less PV power."""
        kw, kvar = (_by_kind(site, reactive)[0] for reactive in (False, True))
        drawn = of_served(p.P_load, v) @ (kw + site.customers.q_per_p[:, None] * kvar)
        if len(site.pv):
            drawn = drawn + v.P_curt @ self.by_pv
        given_kw = self.rest_kw + drawn + (v.P_ch - v.P_dch) @ self.by_batteries
        most, least = self.for_network
        return {most: given_kw <= self.room_kw, least: -given_kw <= self.room_kw}


def _by_kind(site: Site, reactive: bool) -> list[Floats]:
    """Active power of the former's phases for each kW or kvar that assets draw, (n, 3) by kind.

    The kinds are customers, PV systems and batteries; the former itself is the source.
    """
    model = phased_model(site)
    slopes = model.slopes[ISLAND]
    per = np.real(slopes.former_q if reactive else slopes.former_p).T.copy()
    per[model.former_device] = 0.0
    return np.split(per, np.cumsum([len(site.customers), len(site.pv)]))
