"""Rooms and tanks that a machine cools or heats: a frozen table.

A site without such loads has a table of length 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats, Names, no_items
from vppres.core.text import counted
from vppres.kinds.kind import Kind, KindTable
from vppres.scenario.assets import Owned

OF_A_STEP = 0.5
"""Part of what vehicles may count that rooms and tanks may: with them, less than a step."""


@dataclass(frozen=True, eq=False)
class ThermalLoads(Owned, KindTable):
    """Rooms and tanks, shape (H,) each.

    Each is behind the switch of its ``customer`` and has its bus, tier and weight. It loses heat
    through ``r_c_per_kw`` and stores it in ``c_kwh_per_c``. ``around_c`` is NaN where the outside
    air is around it. The coefficient of performance ``cop`` is a line over the temperature outside,
    and at least 1. Machines have a power factor of 1.
    """

    key = "thermal_loads"
    model = "ThermalLoadRow"
    about = "A room or tank that is cooled or heated."
    references = (("customer", "customers", "customer"),)
    limits = (("t_min_c", "t_max_c", ""),)
    may_be_nan = ("t_initial_c", "around_c")

    id: Names = field(default_factory=no_items)
    customer: Names = field(default_factory=no_items)
    heats: Flags = field(default_factory=no_items)
    p_max_kw: Floats = field(default_factory=no_items)
    cop: Floats = field(default_factory=no_items)
    cop_at_c: Floats = field(default_factory=no_items)
    cop_per_c: Floats = field(default_factory=no_items)
    r_c_per_kw: Floats = field(default_factory=no_items)
    c_kwh_per_c: Floats = field(default_factory=no_items)
    t_min_c: Floats = field(default_factory=no_items)
    t_max_c: Floats = field(default_factory=no_items)
    t_initial_c: Floats = field(default_factory=no_items)
    gain_kw: Floats = field(default_factory=no_items)
    around_c: Floats = field(default_factory=no_items)

    def most_taken_kw(self, scenario: Any) -> Floats:
        """Largest power of each machine in every step, (T, H)."""
        return np.tile(self.p_max_kw, (scenario.grid.n_steps, 1))

    @property
    def largest_kw(self) -> Floats:
        """Largest power of each machine."""
        return self.p_max_kw

    @property
    def held_c(self) -> Floats:
        """The end of the comfort band that a thermostat holds by itself, (H,)."""
        return np.where(self.heats, self.t_min_c, self.t_max_c)


KIND = Kind(
    {"thermal_loads": ThermalLoads},
    what="thermal loads",
    table="thermal_loads",
    item="thermal_load",
    subject="thermal_load",
    sign="cooling or heat",
    element=("load", "machine"),
    takes_less=True,
    recovers_by="temperatures",
)


def contents(content: Mapping[str, Any]) -> str:
    """Rooms and tanks in words, from the numbers of what a scenario holds."""
    return counted(content["thermal_loads"], "thermal load")
