"""Fields that a measurement and a foreseen plan have for each kind: bases of their classes.

They follow from the live parts of the kinds; a type checker sees those that there are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from vppres.kinds.fields import class_of
from vppres.kinds.table import parts

if TYPE_CHECKING:
    import pandas as pd

    Values = Mapping[str, float] | pd.Series

    @dataclass(frozen=True, eq=False, kw_only=True)
    class ReadOfKinds:
        """Readings of the units of all kinds by identifier, None where there are none."""

        plugged: Values | None = None
        ev_soc: Values | None = None
        energy_needed_kwh: Values | None = None
        departure: Mapping[str, Any] | pd.Series | None = None
        charger_ordered_kw: Values | None = None
        indoor_c: Values | None = None
        thermostat_ordered_c: Values | None = None
        running: Values | None = None
        genset_kw: Values | None = None
        genset_ordered_kw: Values | None = None
        fuel_litres: Values | None = None
        start_fault: Values | None = None

    @dataclass(frozen=True, eq=False, kw_only=True)
    class ForeseenOfKinds:
        """Tables of what a plan foresees of all kinds, None where a site has nothing of a kind."""

        left_short: pd.DataFrame | None = None
        indoor_c: pd.DataFrame | None = None
        genset_kw: pd.DataFrame | None = None
        fuel_litres: pd.DataFrame | None = None

else:
    LIVE = parts("live").values()
    ReadOfKinds = class_of("ReadOfKinds", (name for live in LIVE for name in live.RANGES))
    ForeseenOfKinds = class_of("ForeseenOfKinds", (name for live in LIVE for name in live.FORESEEN))
