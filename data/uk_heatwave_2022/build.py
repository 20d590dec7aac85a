"""Build the scenario ``uk-heatwave-2022``; ``python -m data.uk_heatwave_2022.build`` writes it."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pandapower.networks
import pandas as pd

import vppres
from data.uk_heatwave_2022 import published
from data.uk_heatwave_2022.assets import draw_batteries, draw_customers, draw_pv
from data.uk_heatwave_2022.series import load_and_pv_kw, price_gbp_per_kwh, temperature_c
from vppres.core.arrays import Floats, freeze
from vppres.core.errors import InputError, Problem
from vppres.core.units import mw_to_kw
from vppres.io import write_scenario
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, ObjectiveWeights, Scenario
from vppres.scenario.timegrid import TimeGrid

NAME = "uk-heatwave-2022"
TITLE = "UK heatwave of 19 July 2022 on the IEEE 33-bus feeder"
FOLDER = Path(vppres.__file__).parent / "scenarios" / NAME

# Options of the packaged scenario.
SEED = 0
CRITICAL_SHARE = 0.36
ZONE_PAIRING = (1, 0, 3, 2)

SERIES_DIGITS = 3


def build(
    seed: int = SEED,
    critical_share: float = CRITICAL_SHARE,
    price: str = "B",
    outage_steps: int = 6,
    zone_pairing: tuple[int, ...] = ZONE_PAIRING,
) -> Scenario:
    """The paper's day, with the unpublished per-bus data drawn from a seed.

    Parameters
    ----------
    seed : int
        Seed of tiers, power factors, and places and sizes of PV systems and batteries. Every
        published aggregate holds for every seed.
    critical_share : float
        Share of the load that the critical customers have, met within 0.001.
    price : {"A", "B"}
        Rebuild of the price; see :func:`data.uk_heatwave_2022.series.price_gbp_per_kwh`.
    outage_steps : int
        Hours without grid from 12:00 on: 6 (half-open reading of "12:00-18:00") or 7.
    zone_pairing : tuple of int
        Which thermal capacity goes with which resistance; see
        :func:`data.uk_heatwave_2022.assets.zone_constants`.

    Returns
    -------
    Scenario
        24 steps, 33 buses, 32 customers, 28 PV systems, 32 batteries.
    """
    network, nominal_kw = feeder()
    customers = draw_customers(nominal_kw, critical_share, seed)
    pv = draw_pv(nominal_kw, seed)
    total_load_kw, total_pv_kw = load_and_pv_kw()
    return Scenario(
        name=NAME,
        title=TITLE,
        network=network,
        customers=customers,
        pv=pv,
        grid=TimeGrid(pd.Timestamp(published.START), 60.0, published.STEPS),
        batteries=draw_batteries(nominal_kw, zone_pairing, seed),
        load_kw=_divide(total_load_kw, nominal_kw),
        pv_kw=_divide(total_pv_kw, pv.p_max_kw),
        price_gbp_per_kwh=price_gbp_per_kwh(price),
        temperature_c=temperature_c(),
        grid_limit_kw=_grid_limit_kw(outage_steps),
        tiers=tuple(published.TIER_COUNTS),
        objective=ObjectiveWeights(
            published.LAMBDA_GRID, published.LAMBDA_CURT, published.LAMBDA_L, published.LAMBDA_Q
        ),
        controller=ControllerDefaults(
            "mpc", published.HORIZON_H, mode="paper", voltage_limits=HARD, ratings=REPORT
        ),
    )


@cache
def feeder() -> tuple[Network, Floats]:
    """The IEEE 33-bus feeder without its tie lines, and the nominal load of buses 2 to 33 in kW.

    Buses are numbered from 1, as Baran and Wu do; pandapower numbers them from 0.
    """
    case = pandapower.networks.case33bw()
    lines = case.line[case.line["in_service"]]
    network = Network(
        lines["from_bus"].to_numpy() + 1,
        lines["to_bus"].to_numpy() + 1,
        (lines["r_ohm_per_km"] * lines["length_km"]).to_numpy(),
        (lines["x_ohm_per_km"] * lines["length_km"]).to_numpy(),
        slack_bus=1,
        base_kv=float(case.bus["vn_kv"].iloc[0]),
        v_min_pu=published.V_MIN_PU,
        v_max_pu=published.V_MAX_PU,
        v_min_ac_pu=published.V_MIN_AC_PU,
    )
    nominal_mw = case.load.set_index("bus")["p_mw"].sort_index()
    return network, freeze(np.round(mw_to_kw(nominal_mw), SERIES_DIGITS))


def write() -> None:
    """Write the packaged scenario anew."""
    scenario = build()
    shutil.rmtree(FOLDER, ignore_errors=True)
    write_scenario(scenario, FOLDER)


def _divide(total_kw: Floats, size: Floats) -> Floats:
    """A total series divided in proportion to size, shape (T, len(size))."""
    divided = total_kw[:, None] * (size / size.sum())
    return np.asarray(np.round(divided, SERIES_DIGITS), dtype=np.float64)


def _grid_limit_kw(outage_steps: int) -> Floats:
    """No limit, and zero in the outage."""
    first = published.OUTAGE_START_HOUR
    if not 1 <= outage_steps <= published.STEPS - first:
        raise InputError(
            Problem(
                "build",
                "does not fit into the day",
                f"Give 1 to {published.STEPS - first} steps.",
                field="outage_steps",
                value=outage_steps,
            )
        )
    limit_kw = np.full(published.STEPS, np.inf)
    limit_kw[first : first + outage_steps] = 0.0
    return limit_kw


if __name__ == "__main__":
    write()
