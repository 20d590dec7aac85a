"""Duals of a phased feeder's rows: what voltages, ratings and its former make of a price."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats
from vppres.model.phases import GRID, phased_model
from vppres.scenario.assets import NO_POWER_KW
from vppres.scenario.phases import PHASES
from vppres.solve.network.rows import PER_PU2
from vppres.solve.phases import HIGH, LOW, OF_FORMER, OF_RATING, PhaseRows
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
    rating : array, shape (k,)
        For 1 kVA more through each phase of a line, or pair of coils, that has a rating.
    rated_active, rated_reactive : array, shape (k, D)
        What ratings make of the price of 1 kW or 1 kvar at each asset.
    by_voltage, by_voltage_kvar : array, shape (D,)
        What voltage limits make of it.
    floor, ceiling : array, shape (N,)
        For limits 0.001 pu further out at all nodes of each bus.
    """

    former: Floats
    active: Floats
    reactive: Floats
    rating: Floats
    rated_active: Floats
    rated_reactive: Floats
    by_voltage: Floats
    by_voltage_kvar: Floats
    floor: Floats
    ceiling: Floats

    @classmethod
    def of(cls, model: ShadowPriceModel) -> PhasePrices | None:
        """Prices of the first step; None for a balanced feeder."""
        if model.site.phases is None or model.data is None:
            return None
        duals, costs = _by_side(model)
        value = {side: duals[side] * per_unit for side, per_unit in _units(model).items()}
        by_voltage = costs[LOW].sum(axis=0) + costs[HIGH].sum(axis=0)
        of_former, of_rating = (costs[side].swapaxes(0, 1) for side in (OF_FORMER, OF_RATING))
        return cls(
            value[OF_FORMER],
            active=of_former[0],
            reactive=of_former[1],
            rating=value[OF_RATING],
            rated_active=of_rating[0],
            rated_reactive=of_rating[1],
            by_voltage=by_voltage[0],
            by_voltage_kvar=by_voltage[1],
            floor=value[LOW],
            ceiling=value[HIGH],
        )


def _units(model: ShadowPriceModel) -> dict[int, Floats | float]:
    """Move of a row of each side for 0.001 pu or 1 kVA: the rows are in squares and shares."""
    assert model.data is not None
    net = model.site.feeder
    room_kva = float(model.data.require_phased().room_kva[0])
    return {
        LOW: PER_PU2 * 2.0 * net.v_min_pu * 1e-3,
        HIGH: PER_PU2 * 2.0 * net.v_max_pu * 1e-3,
        OF_FORMER: 1.0 / max(room_kva, NO_POWER_KW),
        OF_RATING: 1.0 / phased_model(model.site).rated_kva,
    }


def _by_side(model: ShadowPriceModel) -> tuple[dict[int, Floats], dict[int, Floats]]:
    """Duals of the first step by side, added up by place; and by place, kW or kvar, and asset."""
    phased = phased_model(model.site)
    n_buses = model.site.feeder.n_buses
    n_rated = len(phased.rated_kva)
    sizes = {LOW: n_buses, HIGH: n_buses, OF_FORMER: len(PHASES), OF_RATING: n_rated}
    assets = len(phased.flows[GRID].assets)
    duals = {side: np.zeros(size) for side, size in sizes.items()}
    costs = {side: np.zeros((size, 2, assets)) for side, size in sizes.items()}
    found = [rows for rows in model.phase_rows if isinstance(rows, PhaseRows)]
    first = len(model.duals) - sum(len(rows.steps) for rows in found)
    for rows in found:
        dual = np.maximum(model.duals[first : first + len(rows.steps)], 0.0)
        first += len(rows.steps)
        dual = np.where(rows.steps == 0, dual, 0.0)
        places = phased.at_bus[rows.places] if rows.side in (LOW, HIGH) else rows.places
        np.add.at(duals[rows.side], places, dual)
        by_asset = -np.stack([rows.by_p, rows.by_q], axis=1) * dual[:, None, None]
        np.add.at(costs[rows.side], places, by_asset)
    return duals, costs
