"""Vehicles at chargers as they really are: their energy, and what chargers can do.

Arithmetic of its own, apart from the model; the sessions are data of the scenario.
"""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.scenario.scenario import Scenario

NEGLIGIBLE_KW = 1e-3
"""Power that counts as none: what is left of a plan when a vehicle is full."""


class Garage:
    """Energy of the vehicles at all chargers from step to step.

    Parameters
    ----------
    scenario : Scenario
        Chargers, sessions and steps.
    kwh : array, shape (K,), optional
        Energy of the vehicles that are plugged in before the first step; as the sessions say where
        it is NaN, or not given.

    Attributes
    ----------
    kwh : array, shape (K,)
        Energy of each vehicle at the end of the last step, 0 without one.
    """

    def __init__(self, scenario: Scenario, kwh: Floats | None = None) -> None:
        self.scenario = scenario
        self.kwh = np.full(len(scenario.chargers), np.nan) if kwh is None else kwh
        self._alone = scenario.chargers.alone
        self._owner = scenario.chargers.owner(scenario.customers)

    def here(self, t: int) -> Flags:
        """Chargers with a vehicle in a step, (K,)."""
        return np.asarray(self.scenario.session_at[t] >= 0)

    def held_kwh(self, t: int) -> Floats:
        """Energy of each vehicle at the beginning of a step, 0 without one, (K,)."""
        now = self.scenario.session_at[t]
        stays = now == self.scenario.session_at[t - 1] if t else ~np.isnan(self.kwh)
        arrives_kwh = self._of(self.scenario.sessions.held_kwh, t)
        return np.where(stays & self.here(t), self.kwh, arrives_kwh)

    def _of(self, by_session: Floats, t: int) -> Floats:
        """A number of the sessions of a step by charger, 0 without one, (K,)."""
        found = np.zeros(len(self.kwh))
        here = self.here(t)
        found[here] = by_session[self.scenario.session_at[t][here]]
        return found

    def on(self, served: Flags) -> Flags:
        """Chargers that are connected: their customers are served, or they stand alone, (K,)."""
        return self._alone | served[self._owner]

    def possible_kw(self, t: int, wanted_kw: Floats, served: Flags) -> Floats:
        """Power of each charger nearest to what is wanted, negative to discharge, (K,).

        A charger below its least power charges with that; in an outage it stops.
        """
        chargers = self.scenario.chargers
        dt_h = self.scenario.grid.dt_h
        held_kwh = self.held_kwh(t)
        wanted_kw = np.where(self.here(t) & self.on(served), wanted_kw, 0.0)
        room_kw = (self._of(self.scenario.sessions.full_kwh, t) - held_kwh) / dt_h
        above_kwh = held_kwh - self._of(self.scenario.sessions.floor_kwh, t)
        most = np.minimum(chargers.p_charge_kw, np.maximum(room_kw, 0.0) / chargers.eta_charge)
        back = np.maximum(above_kwh, 0.0) / dt_h * chargers.eta_discharge
        least = chargers.p_charge_min_kw
        charge = np.where(wanted_kw > NEGLIGIBLE_KW, wanted_kw, 0.0)
        little = (charge > 0.0) & (charge < least * (1.0 - 1e-9))
        charge = np.where(little, 0.0 if self.scenario.outage[t] else least, charge)
        discharge = np.minimum(np.maximum(-wanted_kw, 0.0), chargers.p_discharge_kw)
        return np.minimum(charge, most) - np.minimum(discharge, back)

    def follow(
        self, t: int, wanted_kw: Floats, running: Flags, served: Flags
    ) -> tuple[Floats, Flags]:
        """:meth:`possible_kw`; chargers are not started."""
        return self.possible_kw(t, wanted_kw, served), running

    def spare_kw(self, taken_kw: Floats, running: Flags) -> Floats:
        """What each gives back, (K,)."""
        return np.maximum(-taken_kw, 0.0)

    def after_kwh(self, t: int, power_kw: Floats) -> Floats:
        """Energy of each vehicle at the end of a step with these powers, (K,)."""
        chargers = self.scenario.chargers
        into_kw = np.where(
            power_kw > 0.0, power_kw * chargers.eta_charge, power_kw / chargers.eta_discharge
        )
        full_kwh = self._of(self.scenario.sessions.full_kwh, t)
        return np.clip(self.held_kwh(t) + into_kw * self.scenario.grid.dt_h, 0.0, full_kwh)

    def advance(self, t: int, taken_kw: Floats, running: Flags | None = None) -> None:
        """The state at the end of a step."""
        self.kwh = self.after_kwh(t, taken_kw)
