"""Random windows whose connection exports, from the random feeders that import only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.frame.random_feeders import Window, random_window
from vppres.kinds.export.physics import Export


def exporting_window(seed: int, stressed: bool = False) -> Window:
    """A random window with an export limit and price of every kind.

    Twice in three there is four times as much sun. No limit, one that binds, or one of each step with zeros; a price of nothing, below the import
    price, above it, equal to it, or negative; sometimes a negative import price.
    """
    scenario, data = random_window(seed, stressed)
    rng = np.random.default_rng([seed, int(stressed), 4])
    steps = data.n_steps
    sun = rng.choice([1.0, 4.0, 4.0])
    pv = replace(
        scenario.pv, p_max_kw=sun * scenario.pv.p_max_kw, s_max_kva=sun * scenario.pv.s_max_kva
    )
    scenario = replace(scenario, pv=pv, pv_kw=sun * scenario.pv_kw)
    data = replace(data, pv_kw=sun * data.pv_kw)
    peak_kw = float(data.pv_kw.sum(axis=1).max() + scenario.batteries.p_max_kw.sum() + 1.0)
    limits = (
        np.full(steps, np.inf),
        np.full(steps, peak_kw * rng.uniform(0.05, 0.5)),
        peak_kw * rng.choice([0.0, 0.2, 0.6], steps),
    )
    price = data.price_gbp_per_kwh - (0.35 if rng.random() < 0.25 else 0.0)
    earned = (
        np.zeros(steps),
        price * rng.uniform(0.2, 0.9, steps),
        price + rng.uniform(-0.1, 0.3, steps),
        price.copy(),
        np.full(steps, -0.05),
    )
    limit_kw = limits[int(rng.integers(len(limits)))]
    export = Export(limit_kw, earned[int(rng.integers(len(earned)))])
    scenario = replace(
        scenario,
        price_gbp_per_kwh=price,
        export_limit_kw=limit_kw,
        export_price_gbp_per_kwh=export.price_gbp_per_kwh,
    )
    seen = replace(data, price_gbp_per_kwh=price, export=export.within(data.grid_limit_kw))
    return Window(scenario, seen)
