"""Fields that a scenario, a run and its set-points have for each kind: bases of their classes.

They follow from the table of kinds; a type checker sees those that there are.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, make_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.kinds.table import KINDS, SERIES, TABLES


def class_of(name: str, fields: Iterable[str]) -> type:
    """A frozen class of fields that are None where they are not given."""
    unsaid = [(each, Any, field(default=None)) for each in fields]
    return make_dataclass(name, unsaid, frozen=True, eq=False, kw_only=True)


def _no_series() -> Floats:
    """The series of a site that has nothing of a kind."""
    return np.empty((0, 0))


if TYPE_CHECKING:
    import pandas as pd

    from vppres.kinds.cooling import ThermalLoads
    from vppres.kinds.gensets import Gensets, Refuels
    from vppres.kinds.vehicles import Chargers, Sessions

    @dataclass(frozen=True, eq=False, kw_only=True)
    class OfKinds:
        """Tables of all kinds in a scenario, of length 0 where a site has nothing of a kind.

        Their series, (T, n), are fields too.
        """

        chargers: Chargers = field(default_factory=Chargers)
        sessions: Sessions = field(default_factory=Sessions)
        thermal_loads: ThermalLoads = field(default_factory=ThermalLoads)
        gensets: Gensets = field(default_factory=Gensets)
        refuels: Refuels = field(default_factory=Refuels)

    @dataclass(frozen=True, eq=False, kw_only=True)
    class RunsOfKinds:
        """Tables of all kinds in a run, None where a site has nothing of a kind."""

        vehicles: pd.DataFrame | None = None
        thermal_loads: pd.DataFrame | None = None
        gensets: pd.DataFrame | None = None

    @dataclass(frozen=True, eq=False, kw_only=True)
    class SetPointsOfKinds:
        """Set-points of all kinds, None where a site has nothing of a kind."""

        chargers: pd.DataFrame | None = None
        thermal_loads: pd.DataFrame | None = None
        gensets: pd.DataFrame | None = None

else:
    OfKinds = make_dataclass(
        "OfKinds",
        [
            *((name, rows, field(default_factory=rows)) for name, rows in TABLES.items()),
            *((name, "Floats", field(default_factory=_no_series)) for name in SERIES),
        ],
        frozen=True,
        eq=False,
        kw_only=True,
    )
    RunsOfKinds = class_of("RunsOfKinds", (kind.table for kind in KINDS.values()))
    SetPointsOfKinds = class_of("SetPointsOfKinds", KINDS)
