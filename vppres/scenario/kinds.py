"""Kinds of flexible power that a site may have: what each is called in files and records.

Everywhere else a kind is the name of its field in the scenario. Power by kind is that which its
units take, negative where they give.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from vppres.scenario.gensets import Gensets
from vppres.scenario.thermal_loads import ThermalLoads
from vppres.scenario.vehicles import Chargers

Units = Chargers | ThermalLoads | Gensets


@dataclass(frozen=True)
class Kind:
    """Names of a kind.

    Parameters
    ----------
    file : str
        File of its units in a scenario's folder.
    what : str
        What a controller plans, in words.
    table, item : str
        Table of a run, and its column of units.
    gives : bool
        Whether the column ``p_kw`` of that table is what units give.
    """

    file: str
    what: str
    table: str
    item: str
    gives: bool = False

    @property
    def word(self) -> str:
        """A unit in a sentence."""
        return self.item.replace("_", " ")


KINDS = {
    "chargers": Kind("ev_chargers.csv", "vehicles", "vehicles", "charger"),
    "thermal_loads": Kind("thermal_loads.csv", "thermal loads", "thermal_loads", "thermal_load"),
    "gensets": Kind("gensets.csv", "generating sets", "gensets", "genset", gives=True),
}


def units_of(site: Any) -> dict[str, Units]:
    """Units of each kind that a scenario or site has any of."""
    found: dict[str, Units] = {name: getattr(site, name) for name in KINDS}
    return {name: units for name, units in found.items() if len(units)}
