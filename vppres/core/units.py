"""The only place that converts units.

Powers are kW and kvar, energies kWh, impedances ohm, voltages pu (squared inside the model), and
times h everywhere else in the package.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vppres.core.arrays import Floats

KW_PER_MW = 1000.0
W_PER_KW = 1000.0
VA_PER_KVA = 1000.0
V_PER_KV = 1000.0
A_PER_KA = 1000.0
US_PER_S = 1e6


def kw_to_mw(p_kw: ArrayLike) -> Floats:
    """Power from kW (kvar, kVA) to MW (Mvar, MVA).

    >>> float(kw_to_mw(3715.0))
    3.715
    """
    return np.asarray(p_kw, dtype=float) / KW_PER_MW


def mw_to_kw(p_mw: ArrayLike) -> Floats:
    """Power from MW (Mvar, MVA) to kW (kvar, kVA)."""
    return np.asarray(p_mw, dtype=float) * KW_PER_MW


def kva_to_a(s_kva: ArrayLike, v_kv: ArrayLike) -> Floats:
    """Line current in A of a balanced apparent power in kVA at a line-to-line voltage in kV.

    >>> round(float(kva_to_a(100.0, 11.0)), 4)
    5.2486
    """
    return np.asarray(np.asarray(s_kva, dtype=float) / (np.sqrt(3.0) * np.asarray(v_kv)))


def a_to_kva(current_a: ArrayLike, v_kv: ArrayLike) -> Floats:
    """Balanced apparent power in kVA of a line current in A, the other way round.

    >>> round(float(a_to_kva(5.2486, 11.0)), 2)
    100.0
    """
    return np.asarray(np.sqrt(3.0) * np.asarray(current_a, dtype=float) * np.asarray(v_kv))


def ohm_to_pu2_per_kw(z_ohm: ArrayLike, base_kv: float) -> Floats:
    """Impedance to the coefficient of LinDistFlow: change of V² (pu²) for each kW of flow.

    With the voltage in kV and the power in kW, ``r P / V²`` is dimensionless after a factor 1000.

    >>> float(ohm_to_pu2_per_kw(1.0, 10.0))
    1e-05
    """
    return np.asarray(z_ohm, dtype=float) / (KW_PER_MW * base_kv**2)


def us_to_kw_at_1_pu(y_us: ArrayLike, base_kv: float) -> Floats:
    """Admittance in microsiemens to the power in kW (kvar) that it takes at nominal voltage.

    >>> float(us_to_kw_at_1_pu(100.0, 10.0))
    10.0
    """
    return np.asarray(y_us, dtype=float) * base_kv**2 / W_PER_KW


def kw_at_1_pu_to_us(p_kw: ArrayLike, base_kv: float) -> Floats:
    """Power at nominal voltage in kW (kvar) to the admittance in microsiemens that takes it."""
    return np.asarray(p_kw, dtype=float) * W_PER_KW / base_kv**2


def joule_loss_kw(power_kw: ArrayLike, resistance_ohm: ArrayLike, voltage_v: ArrayLike) -> Floats:
    """Joule loss in kW of a DC power (kW) through a resistance (ohm) at a voltage (V).

    >>> float(joule_loss_kw(90.0, 0.0035, 900.0))
    0.035
    """
    current_a = np.asarray(power_kw, dtype=float) * W_PER_KW / np.asarray(voltage_v, dtype=float)
    return np.asarray(current_a**2 * np.asarray(resistance_ohm, dtype=float) / W_PER_KW)


def h_to_minutes(hours: float) -> float:
    """Hours to minutes.

    >>> h_to_minutes(0.5)
    30.0
    """
    return 60.0 * hours


def minutes_to_h(minutes: float) -> float:
    """Minutes to hours."""
    return minutes / 60.0
