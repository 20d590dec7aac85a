"""State of charge by reckoning: the energy that moved since the reading last did."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.model.site import Site

SOC_TOLERANCE = 0.02
"""A reading that stands still is frozen once the measured power has moved more than this.

Telemetry in whole per cent stands still while nearly 0.01 moves; as much again is left for what
efficiencies and meters are off by.
"""

SOC_MARGIN = 0.05
"""A state of charge further outside the battery's limits than this is no measurement."""


@dataclass(frozen=True, eq=False)
class SocReckoning:
    """Readings of the state of charge beside what the batteries' power says; (B,) each.

    Parameters
    ----------
    site : Site
        Fixed data.
    reading : array
        Last plausible reading, NaN before the first.
    reckoned : array
        State of charge when the reading last moved, and what was stored since.
    evident : array of bool
        Whether all power since then was measured: what was only commanded proves nothing.
    soc : array
        What is taken for true.
    trusted, frozen : array of bool
        Whether the reading is; whether it is not because it stands still.
    """

    site: Site
    reading: Floats
    reckoned: Floats
    evident: Flags
    soc: Floats
    trusted: Flags
    frozen: Flags

    @classmethod
    def start(cls, site: Site) -> SocReckoning:
        """Before the first reading: the scenario's initial state."""
        b = site.batteries
        none = np.zeros(len(b), dtype=bool)
        return cls(site, np.full(len(b), np.nan), b.soc_initial, none, b.soc_initial, none, none)

    def after(self, seen: Floats, stored: Floats, measured: Flags) -> SocReckoning:
        """The state after one more reading.

        Parameters
        ----------
        seen : array, shape (B,)
            Readings; NaN where there is none.
        stored : array, shape (B,)
            Share of capacity that was stored since the last reading.
        measured : array of bool, shape (B,)
            Whether the power behind it was measured.
        """
        b = self.site.batteries
        reckoned = np.clip(self.reckoned + stored, b.soc_min, b.soc_max)
        evident = self.evident & measured
        plausible = (
            np.isfinite(seen) & (seen >= b.soc_min - SOC_MARGIN) & (seen <= b.soc_max + SOC_MARGIN)
        )
        # A reading just outside would leave a window without any feasible dispatch.
        inside = np.clip(seen, b.soc_min, b.soc_max)
        still = plausible & (seen == self.reading)
        moved = plausible & ~still
        frozen = still & evident & (np.abs(inside - reckoned) > SOC_TOLERANCE)
        trusted = plausible & ~frozen
        return replace(
            self,
            reading=np.where(plausible, seen, self.reading),
            reckoned=np.where(moved, inside, reckoned),
            evident=evident | moved,
            soc=np.where(trusted, inside, reckoned),
            trusted=trusted,
            frozen=frozen,
        )
