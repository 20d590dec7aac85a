"""Battery temperature and efficiency: the paper's electro-thermal model as pure functions.

One lumped thermal mass per battery, heated by its losses and cooled to the ambient. All functions
take and return one value per battery, shape (B,), and hold the heat constant over a step.

The heat balance is ``C_theta dT/dt = Q - (T - T_amb) / R_theta``. The paper writes its explicit
Euler step (:func:`step_euler`). At a step of 1 h and the published constants that step is unstable:
the time constant ``R_theta C_theta`` goes down to 0.29 h, and Euler grows without bound for steps
longer than twice that. The default is therefore the exact solution (:func:`step_exact`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from vppres.core.arrays import Floats
from vppres.core.errors import InputError
from vppres.core.units import W_PER_KW, joule_loss_kw
from vppres.scenario.assets import Batteries

JouleUnit = Literal["w", "kw"]
ThermalScheme = Literal["off", "exact", "euler", "exact-joule-kw", "euler-joule-kw"]
Step = Callable[[Floats, Floats, ArrayLike, Floats, Floats, float], Floats]

ETA_FLOOR = 0.5
"""Smallest efficiency as a share of the nominal one. The paper's parabola has its top at ``T_ref``
and crosses zero 100 °C away from it; the floor is met at 71 °C away, far outside the range in which
a parabola describes a cell."""


class Power(NamedTuple):
    """Charging and discharging power at the terminals in kW, shape (B,) each, not negative."""

    charge_kw: Floats
    discharge_kw: Floats


class ThermalState(NamedTuple):
    """Cell temperature in °C and efficiencies, shape (B,) each."""

    t_cell_c: Floats
    eta_charge: Floats
    eta_discharge: Floats


class HasThermalState(Protocol):
    """Anything that carries the three arrays of :class:`ThermalState`."""

    @property
    def t_cell_c(self) -> Floats:
        """Cell temperature in °C."""

    @property
    def eta_charge(self) -> Floats:
        """Charging efficiency."""

    @property
    def eta_discharge(self) -> Floats:
        """Discharging efficiency."""


def initial_state(batteries: Batteries, t_ambient_c: float) -> ThermalState:
    """State at the beginning of the day: nominal efficiencies, as the paper starts from.

    ``t_initial_c`` that is NaN means the ambient temperature.
    """
    given = batteries.t_initial_c
    t_cell_c = np.where(np.isnan(given), t_ambient_c, given)
    return ThermalState(t_cell_c, batteries.eta_charge, batteries.eta_discharge)


def advance(
    batteries: Batteries,
    scheme: ThermalScheme,
    state: HasThermalState,
    power: Power,
    t_ambient_c: float,
    dt_h: float,
) -> ThermalState:
    """State at the end of a step.

    The power and the ambient temperature are held over the step. The scheme ``off`` keeps the
    state; ``exact-joule-kw`` and ``euler-joule-kw`` read the Joule term in the wrong unit
    (:func:`heat_kw`), to show what that mistake does.

    Raises
    ------
    InputError
        If the scheme is not known.
    """
    if scheme == "off":
        return ThermalState(state.t_cell_c, state.eta_charge, state.eta_discharge)
    if scheme not in _SCHEMES:
        raise InputError.of(
            "options",
            "is not known",
            f"Use one of: off, {', '.join(_SCHEMES)}.",
            field="thermal",
            value=scheme,
        )
    step, joule_unit = _SCHEMES[scheme]
    heat = heat_kw(batteries, power, state, joule_unit)
    t_cell_c = step(
        state.t_cell_c,
        heat,
        t_ambient_c,
        batteries.r_theta_c_per_kw,
        batteries.c_theta_kwh_per_c,
        dt_h,
    )
    return ThermalState(t_cell_c, *efficiencies(batteries, t_cell_c))


def internal_resistance_ohm(batteries: Batteries, t_cell_c: ArrayLike) -> Floats:
    """Internal resistance in ohm, ``R_int,0 (1 + beta (T_ref - T))``, never below zero.

    The linear law reaches zero at ``T_ref + 1 / beta``, 358 °C with the published constants.
    """
    warming_c = np.asarray(t_cell_c, dtype=float) - batteries.t_ref_c
    return batteries.r_int_ohm * np.maximum(1.0 - batteries.beta_per_c * warming_c, 0.0)


def heat_kw(
    batteries: Batteries, power: Power, state: HasThermalState, joule_unit: JouleUnit = "w"
) -> Floats:
    """Heat of a battery in kW: conversion losses of both directions and the Joule loss.

    ``Q = P_ch (1 - eta_ch) + P_dch (1 / eta_dch - 1) + P_batt² R_int(T) / U_batt²``

    The power is that at the terminals. ``P² R / U²`` gives watts for a power in watts; the
    ``joule_unit`` ``"kw"`` takes that number as kW, a factor 1000 too much: a sensitivity, not a
    model.
    """
    conversion = power.charge_kw * (1.0 - state.eta_charge) + power.discharge_kw * (
        1.0 / state.eta_discharge - 1.0
    )
    joule = joule_loss_kw(
        power.charge_kw - power.discharge_kw,
        internal_resistance_ohm(batteries, state.t_cell_c),
        batteries.u_batt_v,
    )
    return conversion + joule * (W_PER_KW if joule_unit == "kw" else 1.0)


def step_exact(
    t_cell_c: ArrayLike,
    heat: ArrayLike,
    t_ambient_c: ArrayLike,
    r_theta_c_per_kw: ArrayLike,
    c_theta_kwh_per_c: ArrayLike,
    dt_h: float,
) -> Floats:
    """Temperature in °C after a step of constant heat (kW) and ambient: the exact solution.

    ``T(t + dt) = T(t) + (T_amb + R Q - T(t)) (1 - exp(-dt / (R C)))``, stable for every step.
    """
    r = np.asarray(r_theta_c_per_kw, dtype=float)
    settled_c = np.asarray(t_ambient_c, dtype=float) + r * np.asarray(heat, dtype=float)
    # expm1 keeps the digits of a short step, where 1 - exp(-x) would lose them.
    share = -np.expm1(-dt_h / (r * np.asarray(c_theta_kwh_per_c, dtype=float)))
    t_before_c = np.asarray(t_cell_c, dtype=float)
    return np.asarray(t_before_c + (settled_c - t_before_c) * share)


def step_euler(
    t_cell_c: ArrayLike,
    heat: ArrayLike,
    t_ambient_c: ArrayLike,
    r_theta_c_per_kw: ArrayLike,
    c_theta_kwh_per_c: ArrayLike,
    dt_h: float,
) -> Floats:
    """Temperature in °C after an explicit Euler step, the paper's formula.

    ``T(t + dt) = T(t) + (Q - (T(t) - T_amb) / R) dt / C``. It overshoots for ``dt > R C`` and is
    unstable for ``dt > 2 R C``.
    """
    t_before_c = np.asarray(t_cell_c, dtype=float)
    cooling_kw = (t_before_c - np.asarray(t_ambient_c, dtype=float)) / np.asarray(r_theta_c_per_kw)
    rise_c = (np.asarray(heat, dtype=float) - cooling_kw) * dt_h / np.asarray(c_theta_kwh_per_c)
    return np.asarray(t_before_c + rise_c)


def efficiencies(
    batteries: Batteries, t_cell_c: ArrayLike, eta_floor: float = ETA_FLOOR
) -> tuple[Floats, Floats]:
    """Charging and discharging efficiency at a temperature, ``eta_0 (1 - alpha (T - T_ref)²)``.

    Neither falls below ``eta_floor`` times its nominal value.
    """
    off_reference_c2 = (np.asarray(t_cell_c, dtype=float) - batteries.t_ref_c) ** 2
    charge = np.maximum(1.0 - batteries.alpha_charge_per_c2 * off_reference_c2, eta_floor)
    discharge = np.maximum(1.0 - batteries.alpha_discharge_per_c2 * off_reference_c2, eta_floor)
    return batteries.eta_charge * charge, batteries.eta_discharge * discharge


_SCHEMES: dict[str, tuple[Step, JouleUnit]] = {
    "exact": (step_exact, "w"),
    "euler": (step_euler, "w"),
    "exact-joule-kw": (step_exact, "kw"),
    "euler-joule-kw": (step_euler, "kw"),
}
