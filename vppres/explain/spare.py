"""Limits that the batteries of a step reached, and the power and energy that they had left."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from vppres.control.converged import physics_of
from vppres.core.arrays import Flags, Floats
from vppres.explain.recorded import Recorded
from vppres.model.data import WindowData
from vppres.scenario.formers import forming_batteries


class Spare:
    """Batteries of a recorded step beside their limits; ``window`` is what its controller saw."""

    def __init__(self, recorded: Recorded, t: int, window: WindowData) -> None:
        self.recorded = recorded
        self.t = t
        self.window = window
        self.site = recorded.site
        self.outage = bool(recorded.scenario.outage[t])
        self.battery_kw = recorded.battery_kw[t]

    @property
    def at_power(self) -> Flags:
        """Batteries at their power rating, to 0.1%, (B,)."""
        return np.asarray(np.abs(self.battery_kw) >= 0.999 * self.site.batteries.p_max_kw)

    @property
    def at_inverter(self) -> Flags:
        """Batteries at their inverter rating, to 0.1%, (B,)."""
        apparent = np.hypot(self.battery_kw, self.recorded.done.batt_q_kvar[self.t])
        return np.asarray(apparent >= 0.999 * self.site.batteries.s_max_kva)

    @cached_property
    def power_kw(self) -> float:
        """Power that batteries, curtailed PV and grid could have given besides.

        The headroom of physical mode is left free.
        """
        if not self.outage:
            return np.inf
        return float(self._more_kw.sum() + self.recorded.done.pv_curtailed_kw[self.t].sum())

    @property
    def now_kw(self) -> float:
        """Spare power now, of each battery no more than what it keeps at the end of the step."""
        if not self.dark_steps:
            return np.inf
        more_kw = np.minimum(self._more_kw, self.kept_kwh[0] / self.site.dt_h)
        return float(more_kw.sum() + self.recorded.done.pv_curtailed_kw[self.t].sum())

    @property
    def _more_kw(self) -> Floats:
        """Power that each battery could have given besides, (B,), its headroom left free."""
        b = self.site.batteries
        share = float(self.recorded.options.get("headroom") or 0.0)
        kept = share if self.recorded.options.get("mode") == "physical" else 0.0
        most_kw = b.active_max_kw - np.where(forming_batteries(self.site), kept * b.s_max_kva, 0.0)
        return np.asarray(np.maximum(most_kw + self.battery_kw, 0.0))

    @property
    def energy_kwh(self) -> float:
        """Energy that batteries keep beyond their reserve, in the outage's step with the least."""
        return float(self.kept_kwh.sum(axis=1).min(initial=np.inf))

    @cached_property
    def kept_kwh(self) -> Floats:
        """Energy that each battery keeps beyond its reserve at the end of steps, (dark_steps, B).

        The first is this step.
        """
        b = self.site.batteries
        lowest = np.broadcast_to(b.soc_min, (self.window.n_steps, len(b)))
        if self.recorded.options.get("mode") == "physical":
            headroom = float(self.recorded.options["headroom"])
            lowest = lowest + physics_of(self.site, self.window, headroom).soc_reserve
        steps = np.arange(self.dark_steps)
        kept = np.maximum(self.recorded.done.soc[1 + self.t + steps] - lowest[steps], 0.0)
        return np.asarray(kept * b.energy_kwh * self.window.eta_discharge)

    @property
    def dark_steps(self) -> int:
        """Steps of the window without grid, from this one on until it is back."""
        dark = self.window.grid_limit_kw <= 0.0
        return int(np.logical_and.accumulate(dark).sum()) if self.outage else 0
