"""State of charge: the newest reading and what was stored since, with a band that grows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.control.guard.moved import Moved
from vppres.core.arrays import Flags, Floats
from vppres.model.site import Site

SOC_TOLERANCE = 0.02
"""A reading that stands still is frozen once the measured power has moved more than this.

Telemetry in whole per cent stands still while nearly 0.01 moves; as much again is left for what
efficiencies and meters are off by.
"""

SOC_JUMP = 0.05
"""A reading further than this from what measured power explains is not believed at once.

A battery's own gauge may be set right, and then goes on from there. It counts if the next
reading bears it out; that of another battery, or one that drifts, does not.
"""

JUMPED = "(jumped)"
"""How an estimate ends of a state of charge whose reading is not believed yet."""

SAME_MOMENT_H = 1.0 / 3600.0
"""Readings less apart than a second are the same one: times since the first step are rounded."""


@dataclass(frozen=True, eq=False)
class SocReckoning:
    """Estimated state of charge; (B,) each."""

    site: Site  #: fixed data
    at_h: float  #: the time, in h since the beginning of the controller's first step
    reading: Floats  #: last plausible reading, NaN before the first
    read_h: Floats  #: when it was read
    #: What is taken for true: the newest reading that is trusted, and what was stored since.
    soc: Floats
    band: Floats  #: by how much that may be off, as a share of capacity
    reckoned: Floats  #: what it would be by the power since the reading last moved
    #: Whether all power since then was measured: what was only ordered proves nothing.
    evident: Flags
    #: Whether there is a new reading that is trusted; whether it is not as it stands still, or as
    #: it jumped.
    trusted: Flags
    frozen: Flags
    jumped: Flags

    @classmethod
    def start(cls, site: Site) -> SocReckoning:
        """Before the first reading nothing is known."""
        n = len(site.batteries)
        unknown = np.full(n, np.nan)
        none = np.zeros(n, dtype=bool)
        return cls(
            site, 0.0, unknown, unknown, unknown, np.zeros(n), unknown, none, none, none, none
        )

    @property
    def unknown(self) -> Flags:
        """Batteries without a reading, or with one so long ago that they may be empty or full."""
        b = self.site.batteries
        return np.isnan(self.soc) | (self.band >= 0.5 * (b.soc_max - b.soc_min))

    def after(self, seen: Floats, read_h: Floats, now_h: float, moved: Moved) -> SocReckoning:
        """The state at a later time, with one more reading each.

        Readings were made at ``read_h``, (B,), and are NaN where there is none; ``moved`` is what
        was ordered and measured up to now.
        """
        b = self.site.batteries
        lately = moved.since(np.full(len(b), self.at_h), now_h, b)
        since = moved.since(read_h, now_h, b)
        reckoned = np.clip(self.reckoned + lately.share, b.soc_min, b.soc_max)
        evident = self.evident & lately.evident
        # Beyond the limits of its use a battery is still there: plans take it for empty or full.
        plausible = (seen >= 0.0) & (seen <= 1.0)
        newer = plausible & ~(read_h <= self.read_h + SAME_MOMENT_H)  # also before the first
        # A reading outside would leave a window without any feasible dispatch.
        inside = np.clip(np.clip(seen, b.soc_min, b.soc_max) + since.share, b.soc_min, b.soc_max)
        on_from_reading = np.abs(inside - self.reading - lately.share) <= SOC_TOLERANCE
        borne_out = newer & self.jumped & on_from_reading
        still = newer & (seen == self.reading) & ~borne_out
        leaps = np.abs(inside - self.soc - lately.share) > SOC_JUMP
        jumped = newer & ~still & ~borne_out & lately.evident & leaps
        turned = newer & ~still & ~jumped
        frozen = still & evident & (np.abs(inside - reckoned) > SOC_TOLERANCE)
        trusted = newer & ~frozen & ~jumped
        carried = np.clip(self.soc + lately.share, b.soc_min, b.soc_max)
        return replace(
            self,
            at_h=now_h,
            reading=np.where(newer, seen, self.reading),
            read_h=np.where(newer, read_h, self.read_h),
            soc=np.where(trusted, inside, np.where(frozen, reckoned, carried)),
            band=np.where(trusted, since.loose, self.band + lately.loose),
            reckoned=np.where(turned, inside, reckoned),
            evident=evident | turned,
            trusted=trusted,
            frozen=frozen,
            jumped=jumped,
        )
