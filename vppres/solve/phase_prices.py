"""Duals of a phased feeder's rows: what its voltages and its former's phases make of a price."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats
from vppres.model.phases import GRID, phased_model
from vppres.scenario.phases import PHASES
from vppres.solve.phases import HIGH, LOW, OF_FORMER, PER_PU2, SMALLEST_KVA
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
        For limits 0.001 pu further out at all nodes of each bus.
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
        if model.site.phases is None or model.data is None:
            return None
        phased = phased_model(model.site)
        net = model.site.feeder
        room = float(model.data.require_phased().room_kva[0])
        per_unit = {
            LOW: PER_PU2 * 2.0 * net.v_min_pu * 1e-3,
            HIGH: PER_PU2 * 2.0 * net.v_max_pu * 1e-3,
            OF_FORMER: 1.0 / max(room, SMALLEST_KVA),
        }
        sizes = {LOW: net.n_buses, HIGH: net.n_buses, OF_FORMER: len(PHASES)}
        value = {side: np.zeros(size) for side, size in sizes.items()}
        by_phase = np.zeros((2, len(PHASES), len(phased.flows[GRID].assets)))
        by_voltage = np.zeros((2, by_phase.shape[2]))
        first = len(model.duals) - sum(len(rows.steps) for rows in model.phase_rows)
        for rows in model.phase_rows:
            dual = np.maximum(model.duals[first : first + len(rows.steps)], 0.0)
            first += len(rows.steps)
            dual = np.where(rows.steps == 0, dual, 0.0)
            former = rows.side == OF_FORMER
            places = rows.places if former else phased.at_bus[rows.places]
            np.add.at(value[rows.side], places, dual * per_unit[rows.side])
            costs = -np.stack([rows.by_p, rows.by_q]) * dual[:, None]
            if former:
                np.add.at(by_phase.swapaxes(0, 1), rows.places, costs.swapaxes(0, 1))
            else:
                by_voltage += costs.sum(axis=1)
        return cls(
            value[OF_FORMER],
            active=by_phase[0],
            reactive=by_phase[1],
            by_voltage=by_voltage[0],
            by_voltage_kvar=by_voltage[1],
            floor=value[LOW],
            ceiling=value[HIGH],
        )
