"""A van that is plugged in at a charger of its own."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vppres.scenario.vehicles import Chargers, Sessions


def van(plug_in: pd.Timestamp, plug_out: pd.Timestamp) -> tuple[Chargers, Sessions]:
    """A charger at bus 4, and a van that comes with 18 kWh and needs 54."""
    charger = Chargers(
        id=["k0"],
        customer=[""],
        bus=[4],
        p_charge_kw=[7.4],
        p_charge_min_kw=[1.4],
        p_discharge_kw=[0.0],
        eta_charge=[0.92],
        eta_discharge=[0.92],
    )
    return charger, Sessions(
        charger=["k0"],
        vehicle=["van"],
        plug_in=[plug_in],
        plug_out=[plug_out],
        capacity_kwh=[60.0],
        soc_at_plug_in=[0.3],
        soc_needed=[0.9],
        energy_needed_kwh=[np.nan],
        v2g_soc_floor=[np.nan],
        tier=["low"],
        weight=[0.02],
        announced=[False],
    )
