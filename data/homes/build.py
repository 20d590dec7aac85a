"""The homes on a feeder: days of their year as scenarios, with what was measured before.

Demand, PV power and tariff are the data's. Network, priorities and batteries are not: two cables of
a street behind a transformer of 100 kVA, with the values of their data sheets; tiers by a list; a
battery of the data set's size in every third home, and one of the street.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.history import History
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, ObjectiveWeights, Scenario
from vppres.scenario.timegrid import TimeGrid

FOLDER = Path(__file__).parent
ZONE = "Etc/GMT+8"
HISTORY_DAYS = 100
HELD_OUT = pd.Timestamp("2017-04-01T08:00Z")
"""The first midnight of the months that nothing was chosen on."""

HOMES = [f"h{number:02d}" for number in range(1, 18)]
CRITICAL = ("h04", "h11")
HIGH = ("h02", "h05", "h09", "h13", "h16")
WEIGHTS = {"critical": 1.0, "high": 0.1, "low": 0.02}
PV_KW = 5.0
STREET_KWH, STREET_KW = 24.0, 12.0
HOME_KWH, HOME_KW = 6.4, 5.0

# NAYY 4x150: 0.206 ohm/km and 0.080 ohm/km, 35 m from home to home. A transformer of 100 kVA with
# 4 % of short-circuit voltage and 1.5 % of losses, on its low-voltage side of 0.4 kV.
CABLE_OHM = (0.206 * 0.035, 0.080 * 0.035)
TRANSFORMER_OHM = (0.024, 0.059)
EXPORT_PRICE = 0.05
LAMBDA_CURT = 1e-4
"""Supply before sun: with the paper's 0.1 per kW, 10 kW of sun are worth a critical home."""


@cache
def measured(name: str) -> pd.DataFrame:
    """A series of the year by time."""
    return pd.read_parquet(FOLDER / f"{name}.parquet").set_index("time").astype(float)


def homes(start: pd.Timestamp, hours: int = 24, outage: tuple[int, int] | None = None) -> Scenario:
    """Hours of the year.

    Parameters
    ----------
    start : pandas.Timestamp
        Beginning of an hour.
    hours : int
        Number of hours.
    outage : tuple of int, optional
        First hour without grid, and first one with it again, counted from the start.

    Returns
    -------
    Scenario
        With up to 100 days of history.
    """
    load, pv, price = (measured(name) for name in ("load_kw", "pv_kw", "price"))
    row = int(load.index.get_indexer(pd.DatetimeIndex([start]))[0])
    if row < 0 or row + hours > len(load):
        raise ValueError(f"the year has no {hours} h from {start}")
    rows = slice(row, row + hours)
    before = slice(max(row - 24 * HISTORY_DAYS, 0), row)
    limit_kw = np.full(hours, np.inf)
    if outage is not None:
        limit_kw[slice(*outage)] = 0.0
    return Scenario(
        name="homes",
        title="17 homes of a street",
        grid=TimeGrid(start, 60.0, hours, ZONE),
        network=_street(),
        customers=_homes(),
        pv=PVSystems(
            id=_names(f"pv-{home}" for home in HOMES),
            customer=_names(HOMES),
            p_max_kw=np.full(len(HOMES), PV_KW),
            s_max_kva=np.full(len(HOMES), PV_KW),
        ),
        batteries=_batteries(),
        load_kw=load.to_numpy()[rows],
        pv_kw=pv.to_numpy()[rows],
        price_gbp_per_kwh=price.to_numpy()[rows, 0],
        temperature_c=np.full(hours, 20.0),
        grid_limit_kw=limit_kw,
        objective=ObjectiveWeights(lambda_curt=LAMBDA_CURT),
        controller=ControllerDefaults(
            mode="paper", soc_end=0.5, voltage_limits=HARD, ratings=REPORT
        ),
        export_limit_kw=np.asarray(np.inf),
        export_price_gbp_per_kwh=np.full(hours, EXPORT_PRICE),
        history=History(
            load.index[before.start], 60.0, load.to_numpy()[before], pv.to_numpy()[before], ZONE
        ),
    )


def _names(values: Iterable[object]) -> Names:
    """Identifiers as an array."""
    return np.array(list(values), dtype=object)


def _street() -> Network:
    """Bus 1 is the grid, 2 the low-voltage side; homes 1 to 9 and 10 to 17 have a cable each."""
    buses = np.arange(3, 3 + len(HOMES))
    from_bus = np.where((buses == 3) | (buses == 12), 2, buses - 1)
    return Network(
        from_bus=_names([1, *from_bus.tolist()]),
        to_bus=_names([2, *buses.tolist()]),
        r_ohm=np.append(TRANSFORMER_OHM[0], np.full(len(HOMES), CABLE_OHM[0])),
        x_ohm=np.append(TRANSFORMER_OHM[1], np.full(len(HOMES), CABLE_OHM[1])),
        slack_bus=1,
        base_kv=0.4,
    )


def _homes() -> Customers:
    """Priorities by the lists above."""
    tier = ["critical" if home in CRITICAL else "high" if home in HIGH else "low" for home in HOMES]
    return Customers(
        id=_names(HOMES),
        bus=_names(range(3, 3 + len(HOMES))),
        tier=_names(tier),
        weight=np.array([WEIGHTS[name] for name in tier]),
        power_factor=np.full(len(HOMES), 0.97),
    )


def _batteries() -> Batteries:
    """One of the street at the transformer, and one in every third home."""
    bus = [2, *range(3, 3 + len(HOMES), 3)]
    street = np.arange(len(bus)) == 0
    energy_kwh = np.where(street, STREET_KWH, HOME_KWH)
    power_kw = np.where(street, STREET_KW, HOME_KW)

    def each(value: float) -> Floats:
        return np.full(len(bus), value)

    return Batteries(
        id=_names(["street", *(f"b-{home}" for home in HOMES[::3])]),
        bus=_names(bus),
        energy_kwh=energy_kwh,
        p_max_kw=power_kw,
        s_max_kva=np.where(street, 1.2, 1.0) * power_kw,
        soc_min=each(0.1),
        soc_max=each(0.9),
        soc_initial=each(0.5),
        eta_charge=each(0.95),
        eta_discharge=each(0.95),
        r_theta_c_per_kw=each(3.5),
        c_theta_kwh_per_c=each(0.3),
        alpha_charge_per_c2=each(1e-4),
        alpha_discharge_per_c2=each(1e-4),
        r_int_ohm=each(0.0035),
        beta_per_c=each(0.003),
        u_batt_v=each(400.0),
        t_ref_c=each(25.0),
        t_initial_c=each(np.nan),
    )
