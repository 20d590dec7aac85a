"""Duals of a phased feeder's rows: what its voltages and its former's phases make of a price."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.model.beyond_paper.phases import SIDES, ThreePhases
from vppres.model.phases import GRID, ISLAND, PhasedModel, phased_model
from vppres.scenario.phases import PHASES
from vppres.solve.shadow_price_model import ShadowPriceModel


@dataclass(frozen=True, eq=False)
class PhasePrices:
    """Gain of the objective, in its unit, by phase; D assets draw power.

    Parameters
    ----------
    former : array, shape (3,)
        For 1 kVA more on each phase of the former.
    active, reactive : array, shape (3, D)
        What phases of the former make of the price of 1 kW or 1 kvar at each asset.
    by_voltage, by_voltage_kvar : array, shape (D,)
        What voltage limits make of it.
    floor, ceiling : array, shape (N,)
        For limits 0.001 pu further out at the most valuable node of each bus.
    """

    former: Floats
    active: Floats
    reactive: Floats
    by_voltage: Floats
    by_voltage_kvar: Floats
    floor: Floats
    ceiling: Floats

    @classmethod
    def of(cls, model: ShadowPriceModel) -> PhasePrices | None:
        """Prices of the first step; None for a balanced feeder."""
        if model.site.phases is None:
            return None
        phased = phased_model(model.site)
        shape: Any = dict(model.beyond)[ThreePhases]
        watched: tuple[int, ...] = shape[0]
        low, high = (_of_nodes(model, phased, list(watched), end) for end in ("min", "max"))
        former, active, reactive = _of_former(model, phased)
        net = model.site.feeder
        return cls(
            former,
            active,
            reactive,
            high[1] - low[1],
            high[2] - low[2],
            _at_buses(phased, low[0] * 2.0 * net.v_min_pu * 1e-3),
            _at_buses(phased, high[0] * 2.0 * net.v_max_pu * 1e-3),
        )


def _of_nodes(
    model: ShadowPriceModel, phased: PhasedModel, watched: list[int], end: str
) -> tuple[Floats, Floats, Floats]:
    """Value of a limit of each node, (m,), and what its voltages cost per kW and kvar, (D,)."""
    value = np.zeros(phased.n_measured)
    n_assets = len(phased.flows[GRID].assets)
    kw, kvar = np.zeros(n_assets), np.zeros(n_assets)
    for source, slopes in enumerate(phased.slopes):
        name = f"node_voltage_{end}_{source}"
        if name not in model.rows_of:
            continue
        worth = np.maximum(model.dual(name)[0], 0.0)
        value[watched] += worth
        kw += worth @ slopes.u_p[watched]
        kvar += worth @ slopes.u_q[watched]
    return value, kw, kvar


def _of_former(model: ShadowPriceModel, phased: PhasedModel) -> tuple[Floats, Floats, Floats]:
    """Value of 1 kVA on each phase, and what they cost per kW and kvar of each asset, (3, D)."""
    n_assets = len(phased.flows[GRID].assets)
    if "former_phases" not in model.rows_of:
        nothing = np.zeros((len(PHASES), n_assets))
        return np.zeros(len(PHASES)), nothing, nothing
    worth = np.maximum(model.dual("former_phases")[0].reshape(len(PHASES), SIDES), 0.0)
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    turned = (worth @ np.exp(-1j * angles))[:, None]
    slopes = phased.slopes[ISLAND]
    active, reactive = ((turned * by).real for by in (slopes.former_p, slopes.former_q))
    return worth.sum(axis=1) * np.cos(np.pi / SIDES), active, reactive


def _at_buses(phased: PhasedModel, values: Floats) -> Floats:
    """The largest value of the nodes of each bus of the network, (N,)."""
    found = np.zeros(phased.site.network.n_buses)
    np.maximum.at(found, phased.at_bus, values)
    return found
