"""Generating sets of a new scenario: those of the source, with what it does not say assumed.

No format has fuel. A set of the source with a power gets the line of fuel that diesel sets usually
have, and a tank; all of it is stated, and may be edited.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags
from vppres.core.text import named
from vppres.feeders.feeder import PhasedSource
from vppres.feeders.new.connections import generator_in
from vppres.feeders.new.kinds import GENSET, runs_on_a_tank
from vppres.io import schema
from vppres.kinds.gensets import Gensets

LITRES_PER_KWH = 0.246
LITRES_PER_H_PER_KW = 0.08415
"""The usual fuel line of diesel sets, for each kWh, and for each rated kW and hour."""

FUEL_GBP_PER_LITRE = 1.5
LEAST_SHARE = 0.3
"""Least power of a set of which the source gives none, as a share of its largest."""

TANK_H = 8.0
"""Hours that a full tank lasts at full power."""


ALIKE = {
    **dict.fromkeys(("ramp_up_kw_per_h", "ramp_down_kw_per_h"), np.inf),
    **dict.fromkeys(("min_on_h", "min_off_h", "on_before_h", "start_cost_gbp"), 0.0),
    "fuel_price_gbp_per_litre": FUEL_GBP_PER_LITRE,
    "litres_per_kwh": LITRES_PER_KWH,
    "only_in_outage": True,
}
"""Columns that are the same of all sets."""


def sets_of(table: pd.DataFrame, source: PhasedSource | None) -> pd.DataFrame:
    """Rows of the generators that become sets: those with an engine and a power.

    A source with phases has one connection of each; a set that lacks a phase forms no island.
    """
    sized = table["kind"].map(runs_on_a_tank).astype(bool) & (table["p_max_kw"] >= schema.MIN_KW)
    rows = table[sized]
    if source is None:
        return rows
    found = [generator_in(source, str(label)) for label in rows["id"]]
    whole = np.array([row is not None and row.three_coils for row in found], dtype=bool)
    rows = rows.assign(grid_forming=rows["grid_forming"].where(whole, other=False))
    return rows[np.array([row is not None for row in found], dtype=bool)]


def gensets_of(rows: pd.DataFrame, ids: list[str]) -> Gensets:
    """Sets of some generators, with these identifiers."""
    p_max_kw, given_kw = (rows[name].to_numpy(float) for name in ("p_max_kw", "p_min_kw"))
    least_kw = np.where(_unsaid(rows), LEAST_SHARE * p_max_kw, given_kw)
    idle = LITRES_PER_H_PER_KW * p_max_kw
    tank_litres = np.round(TANK_H * (idle + LITRES_PER_KWH * p_max_kw), 1)
    said = zip(rows["grid_forming"], rows["kind"] == GENSET, strict=True)
    alike: dict[str, Any] = {name: np.full(len(rows), value) for name, value in ALIKE.items()}
    return Gensets(
        id=np.array(ids, dtype=object),
        bus=rows["bus"].to_numpy(dtype=object),
        p_max_kw=p_max_kw,
        p_min_kw=np.minimum(least_kw, p_max_kw),
        litres_per_h_idle=np.round(idle, 3),
        tank_litres=tank_litres,
        fuel_level_litres=tank_litres,
        grid_forming=np.array([own if own is not None else is_set for own, is_set in said]),
        **alike,
    )


def _unsaid(rows: pd.DataFrame) -> Flags:
    """Generators of which the source gives no least power."""
    return ~(rows["p_min_kw"].to_numpy(float) > 0.0)


def told_sets(sets: Gensets, rows: pd.DataFrame) -> Iterator[str]:
    """Sentences on the sets that are made of some generators, and on what is assumed of them."""
    if not len(sets):
        return
    pairs = zip(sets.id, sets.p_max_kw, strict=True)
    sizes = named(f"{name}, {p_kw:.4g} kW" for name, p_kw in pairs)
    yield f"Generating sets of the source: {sizes}. They run in outages only."
    forming, following = sets.id[sets.grid_forming], sets.id[~sets.grid_forming]
    if len(forming):
        yield (
            f"Generating sets that form the grid of an island that no battery forms: "
            f"{named(forming)}. Write no in grid_forming of gensets.csv for a set that cannot."
        )
    if len(following):
        yield f"Generating sets that only follow what forms the grid: {named(following)}."
    assumed = sets.id[_unsaid(rows)]
    least = f" a least power of {LEAST_SHARE:.0%} ({named(assumed)})," if len(assumed) else ""
    yield (
        f"Assumed for generating sets:{least} {LITRES_PER_KWH:g} l/kWh and "
        f"{LITRES_PER_H_PER_KW:g} l/h for each kW of their size, {FUEL_GBP_PER_LITRE:g} GBP/l, "
        f"and a full tank for {TANK_H:g} h at full power. Correct gensets.csv."
    )
