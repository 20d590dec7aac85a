"""Build ``two-outages-cigre-mv``; ``python -m data.two_outages_cigre_mv.build`` writes it.

The feeder is real (CIGRE medium voltage with DER, as pandapower has it); the days are made up. The
rules are those of ``vppres new``. On top of them every customer's load and the clouds vary from
quarter hour to quarter hour, and after the first outage the grid comes back in part.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandapower.networks
import pandas as pd

import vppres
from vppres.core.arrays import Floats
from vppres.feeders import import_network
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario
from vppres.io import write_scenario
from vppres.scenario.network import Network
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.scenario.source import Source

NAME = "two-outages-cigre-mv"
TITLE = "Two outages in two days on the CIGRE medium-voltage feeder, in quarter hours"
FOLDER = Path(vppres.__file__).parent / "scenarios" / NAME

SEED = 0
START = pd.Timestamp("2025-07-01T00:00Z")
STEP_MINUTES = 15.0
OUTAGES = (
    (pd.Timestamp("2025-07-01T12:00Z"), pd.Timestamp("2025-07-01T16:00Z")),
    (pd.Timestamp("2025-07-02T17:30Z"), pd.Timestamp("2025-07-02T20:00Z")),
)
# After the first outage the grid gives a part for two hours.
PARTIAL = (pd.Timestamp("2025-07-01T16:00Z"), pd.Timestamp("2025-07-01T18:00Z"))
PARTIAL_KW = 2000.0
OTHER_FEEDER_MW = 2.0

# Relative standard deviation of a quarter hour, and share that is kept from one to the next.
LOAD_NOISE = 0.06
LOAD_MEMORY = 0.8
# Clouds take this share of the PV power on average and at most, on the first and the second day.
CLOUDS = ((0.05, 0.20), (0.40, 0.75))
CLOUD_MEMORY = 0.9
DIGITS = 1


def build(seed: int = SEED) -> Scenario:
    """The two days.

    Parameters
    ----------
    seed : int
        Seed of tiers, PV buses, load noise and clouds.

    Returns
    -------
    Scenario
        192 steps.
    """
    net = pandapower.networks.create_cigre_network_mv(with_der="pv_wind")
    # Loads of 5 to 15 MW at two buses stand for other feeders of the transformers: no customers.
    net.load["in_service"] = net.load["p_mw"] < OTHER_FEEDER_MW
    # The feeder's own PV, 240 kW for 4.7 MW of load, would not show: PV is sized by the rule.
    net.sgen["in_service"] = False
    feeder = import_network(net)
    options = NewScenarioOptions(
        start=START,
        step_minutes=STEP_MINUTES,
        days=2,
        outages=OUTAGES,
        draw_tiers=True,
        pv="sized",
        add_batteries=True,
        seed=seed,
    )
    day = new_scenario(feeder, options)
    times = day.grid.times
    draw_load, draw_clouds = (np.random.default_rng([seed, i]) for i in (2, 3))
    noise = 1.0 + LOAD_NOISE * _drift(draw_load, day.load_kw.shape, LOAD_MEMORY)
    back = (times >= PARTIAL[0]) & (times < PARTIAL[1])
    return replace(
        day,
        name=NAME,
        title=TITLE,
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        network=_series_only(day.network),
        customers=replace(day.customers, power_factor=np.round(day.customers.power_factor, 6)),
        export_limit_kw=np.zeros(()),
        source=Source(),
        load_kw=np.round(day.load_kw * np.clip(noise, 0.5, 1.5), DIGITS),
        pv_kw=np.round(day.pv_kw * _clear(draw_clouds, times)[:, np.newaxis], DIGITS),
        grid_limit_kw=np.where(back, PARTIAL_KW, day.grid_limit_kw),
    )


def _series_only(network: Network) -> Network:
    """The feeder as the days were made for it: without charging and shunts, as in the paper."""
    none = np.zeros(network.n_lines)
    nowhere = np.zeros(network.n_buses)
    return replace(
        network,
        b_us=none,
        g_us=none,
        p_shunt_kw=nowhere,
        q_shunt_kvar=nowhere,
        p_fixed_kw=nowhere,
        q_fixed_kvar=nowhere,
        island=np.ones(network.n_buses, dtype=bool),
    )


def write() -> None:
    """Write the packaged scenario anew."""
    scenario = build()
    shutil.rmtree(FOLDER, ignore_errors=True)
    write_scenario(scenario, FOLDER)


def _clear(draw: np.random.Generator, times: pd.DatetimeIndex) -> Floats:
    """Share of the PV power that the clouds let through, one sky for all systems, shape (T,)."""
    swing = _drift(draw, (len(times), 1), CLOUD_MEMORY)[:, 0]
    mean, most = np.array([CLOUDS[int(day)] for day in (times - START).days]).T
    return np.asarray(1.0 - np.clip(mean * (1.0 + 0.5 * swing), 0.0, most))


def _drift(draw: np.random.Generator, shape: tuple[int, ...], memory: float) -> Floats:
    """Noise of unit variance along the first axis that keeps a share of its last value."""
    noise = draw.standard_normal(shape)
    for t in range(1, shape[0]):
        noise[t] = memory * noise[t - 1] + np.sqrt(1 - memory**2) * noise[t]
    return noise


if __name__ == "__main__":
    write()
