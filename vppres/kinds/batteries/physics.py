"""Physics of batteries: powers that they can have, and the charge that these leave.

The plant, checks of plans, rules, the guard and the gate ask here; the rows of
:mod:`vppres.model.constraints` state the same apart. Numbers in brackets count the paper's
equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.scenario.assets import Batteries


class Charged(Protocol):
    """A moment at which charge and efficiencies are known."""

    @property
    def soc(self) -> Floats:
        """State of charge, (B,)."""

    @property
    def eta_charge(self) -> Floats:
        """Efficiency of charging, (B,)."""

    @property
    def eta_discharge(self) -> Floats:
        """Efficiency of discharging, (B,)."""


def cell_kw(
    charge_kw: Floats, discharge_kw: Floats, eta_charge: Floats, eta_discharge: Floats
) -> Floats:
    """Power that reaches the cells (2): what is charged less its losses, less what is drawn.

    >>> cell_kw(np.array([10.0, 0.0]), np.array([0.0, 9.0]), np.full(2, 0.9), np.full(2, 0.9))
    array([  9., -10.])
    """
    return np.asarray(eta_charge * charge_kw - discharge_kw / eta_discharge)


def power_beyond_kw(
    b: Batteries, charge_kw: Floats, discharge_kw: Floats, kvar: Floats, online: Flags | bool = True
) -> dict[str, Floats]:
    """Excess of powers beyond ratings, both directions at once, and inverters' discs.

    Batteries that are not ``online``, (B,), have no power.
    """
    rated_kw = b.p_max_kw * online
    power_kw = np.maximum(charge_kw, discharge_kw)
    return {
        "power": np.maximum(power_kw - rated_kw, np.maximum(-charge_kw, -discharge_kw)),
        "modes": np.minimum(charge_kw, discharge_kw),
        "inverter": np.hypot(charge_kw - discharge_kw, kvar) - b.s_max_kva,
    }


@dataclass(frozen=True, eq=False)
class BatteriesAhead:
    """Batteries over steps that begin with a state of charge, (B,) each."""

    units: Batteries  #: their ratings and limits
    #: State of charge and efficiencies, (B,).
    soc: Floats
    eta_charge: Floats
    eta_discharge: Floats
    dt_h: float  #: length of a step

    @classmethod
    def of(cls, units: Batteries, state: Charged, dt_h: float) -> Self:
        """The batteries from a state on."""
        return cls(units, state.soc, state.eta_charge, state.eta_discharge, dt_h)

    def path(self, charge_kw: Floats, discharge_kw: Floats) -> Floats:
        """State of charge before every step and after the last, limits left out, (W + 1, B)."""
        stored_kw = cell_kw(charge_kw, discharge_kw, self.eta_charge, self.eta_discharge)
        moved = np.cumsum(stored_kw, axis=0) * self.dt_h / self.units.energy_kwh
        return np.vstack([self.soc, self.soc + moved])

    def after(self, power_kw: Floats) -> Floats:
        """State of charge after a step of this power, charging positive, limits left out, (B,)."""
        parts = np.maximum(power_kw, 0.0), np.maximum(-power_kw, 0.0)
        return np.asarray(self.path(*(part[np.newaxis] for part in parts))[1])

    def soc_beyond(self, soc: Floats) -> tuple[Floats, Floats]:
        """Excess of a later state of charge over its upper and below its lower limit, (B,) each.

        A battery that is outside already may stay there, and come back.
        """
        over = soc - np.maximum(self.units.soc_max, self.soc)
        return over, np.minimum(self.units.soc_min, self.soc) - soc

    def charge_to_kw(self, level: Floats) -> Floats:
        """Charging power that reaches a state of charge in a step, 0 where it is there, (B,)."""
        missing_kwh = np.maximum(level - self.soc, 0.0) * self.units.energy_kwh
        return np.asarray(missing_kwh / (self.eta_charge * self.dt_h))

    def discharge_to_kw(self, level: Floats) -> Floats:
        """Discharging power that reaches a state of charge in a step, 0 where it is below, (B,)."""
        held_kwh = np.maximum(self.soc - level, 0.0) * self.units.energy_kwh
        return np.asarray(held_kwh * self.eta_discharge / self.dt_h)

    def most_kw(self) -> tuple[Floats, Floats]:
        """Largest charge and discharge over a step, by rating and state of charge, (B,) each."""
        rated_kw = self.units.active_max_kw
        return (
            np.minimum(rated_kw, self.charge_to_kw(self.units.soc_max)),
            np.minimum(rated_kw, self.discharge_to_kw(self.units.soc_min)),
        )
