"""A battery's constants where only its size matters: the paper's limits, ordinary heating."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

USUAL_BATTERY: Mapping[str, float] = MappingProxyType(
    {
        "soc_min": 0.15,
        "soc_max": 0.85,
        "eta_charge": 0.95,
        "eta_discharge": 0.95,
        "r_theta_c_per_kw": 3.5,
        "c_theta_kwh_per_c": 0.3,
        "alpha_charge_per_c2": 1e-4,
        "alpha_discharge_per_c2": 1e-4,
        "r_int_ohm": 0.0035,
        "beta_per_c": 0.003,
        "u_batt_v": 900.0,
        "t_ref_c": 25.0,
        "t_initial_c": 25.0,
    }
)
"""Columns of ``batteries.csv`` and their values."""
