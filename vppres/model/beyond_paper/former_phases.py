"""Power of the assets of a feeder with phases, and of an island's former on each phase."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Floats
from vppres.model.beyond_paper.addition import Addition, Taken
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import ANY_KW, write
from vppres.model.phases import REACH, SupplyKey, phased_model
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

Own = tuple[SupplyKey, slice]
"""A supply, and the phases of a former among those of its sources."""


class FormerPhases(Addition):
    """Active power of each former within its rating on each phase, (W, 3) one after another.

    It follows from the discs of its phases, whose rows are made with those of the network, and a
    relaxation without the network has it instead: there customers would crowd a phase.

    ``rest_kw`` is what the phases carry with nothing drawn; ``room_kw`` has what reactive power of
    PV systems and batteries may take off a phase.
    """

    apart = True
    for_network = ("former_phase_most", "former_phase_least")

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        assert isinstance(shape, tuple)
        of_islands = ((None, ((0, former),)) for former in phased_model(site).formers)
        self.formers: list[Own] = [
            (key, slice(3 * at, 3 * at + 3))
            for key in (*of_islands, *shape)
            for at, (_, former) in enumerate(key[1])
            if former
        ]
        size = (v.u.shape[0] * len(self.formers), 3)
        self.rest_kw = cp.Parameter(size, name="former_rest_kw")
        self.room_kw = cp.Parameter(size, name="former_room_kw")

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """Supplies of parts in the window, None if nothing can form a step without grid."""
        if not data.phased:
            return None
        model = phased_model(site)
        if not (model.formers and model.formed(data).any()):
            return None
        return tuple(model.parts_in(data))

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data."""
        phased = data.phased
        ratings = np.concatenate([site.pv.s_max_kva, site.batteries.s_max_kva])
        model = phased_model(site)
        sources = model.sources(data)
        rest, rooms = [], []
        for former in self.formers:
            key, own = former
            kvar = _per_unit(site, former, reactive=True)[len(site.customers) :]
            rating = np.zeros(len(kvar))
            rating[: len(ratings)] = ratings
            room_kw = REACH * phased.room_kva[:, own] + np.abs(kvar).T @ rating
            there = sources == model.source_of(key)
            rooms.append(np.where(there[:, None], room_kw, ANY_KW))
            rest.append(phased.former_offset.real[:, own])
        write(self.rest_kw, np.vstack(rest))
        write(self.room_kw, np.vstack(rooms))

    def implied(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Limits in both directions on the power of assets, and the reactive power of customers."""
        assert p.by_asset is not None
        drawn_kw, _ = p.by_asset
        customers = slice(len(site.customers))
        given = []
        for former in self.formers:
            per_kw = _per_unit(site, former, reactive=False)
            of_kvar = _per_unit(site, former, reactive=True)[customers]
            per_kw[customers] += site.customers.q_per_p[:, None] * of_kvar
            given.append(drawn_kw @ per_kw)
        given_kw = self.rest_kw + cp.vstack(given)
        most, least = self.for_network
        return {most: given_kw <= self.room_kw, least: -given_kw <= self.room_kw}


def _per_unit(site: Site, former: Own, reactive: bool) -> Floats:
    """Active power of a former's phases for each kW or kvar that an asset draws, (D, 3).

    The former itself, a supply and its phases there, is the source.
    """
    key, own = former
    model = phased_model(site)
    one = model.supplies[model.source_of(key)]
    per = np.real(one.slopes.former_q if reactive else one.slopes.former_p)[own].T.copy()
    per[one.devices] = 0.0
    return per


def drawn_by_assets(
    site: Site, v: Variables, p: Parameters, taken: Sequence[Mapping[str, Taken]]
) -> tuple[cp.Expression, cp.Expression]:
    """Active and reactive power that each asset of a feeder with phases draws, (W, D) each.

    ``taken`` is what additions take. PV systems draw what they curtail less all that they have.
    """
    W = v.x_served.shape[0]
    tables = {"customers": site.customers, "pv": site.pv, "batteries": site.batteries}
    drawn: dict[str, list[Any]] = {
        "customers": [cp.multiply(load, v.x_served) for load in (p.P_load, p.Q_load)],
        "pv": [v.P_curt - p.P_pv, -v.Q_pv],
        "batteries": [v.P_ch - v.P_dch, -v.Q_batt],
    }
    drawn |= {
        kind: [np.zeros((W, len(each))) for _ in range(2)] for kind, each in site.kinds.items()
    }
    for name, each in (item for addition in taken for item in addition.items()):
        drawn[name] = [
            known if more is None else known + more
            for known, more in zip(drawn[name], each, strict=True)
        ]
    there = [each for name, each in drawn.items() if len(tables.get(name, "kind"))]
    kw, kvar = (cp.hstack(parts) for parts in zip(*there, strict=True))
    return kw, kvar
