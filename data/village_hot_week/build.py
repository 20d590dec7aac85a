"""Build ``village-hot-week``; ``python -m data.village_hot_week.build`` writes it.

A village on a low-voltage feeder in a week of heat, with an outage of 30 hours that nobody knows
exactly. The feeder is real (Kerber's village network, as pandapower has it), and so is what homes
draw and roofs give (``data/homes``). Everything else is made up or drawn from :data:`SEED`;
``docs/data.md`` says what.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandapower.networks
import pandas as pd

import vppres
from vppres.core.arrays import Floats, Names
from vppres.feeders import import_network
from vppres.feeders.new.scenario import DAY_PRICE, EVENING, EVENING_PRICE, NIGHT, NIGHT_PRICE
from vppres.io import write_scenario
from vppres.kinds.cooling import ThermalLoads
from vppres.kinds.gensets import Gensets
from vppres.kinds.vehicles import Chargers, Sessions
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.outage_warnings import OutageWarning
from vppres.scenario.priority import STRICT
from vppres.scenario.scenario import ControllerDefaults, ObjectiveWeights, Priority, Scenario
from vppres.scenario.timegrid import TimeGrid

NAME = "village-hot-week"
TITLE = "A village in a hot week, and an outage of 30 hours that nobody knows exactly"
FOLDER = Path(vppres.__file__).parent / "scenarios" / NAME
SERIES = Path(__file__).parents[1] / "homes"

SEED = 0
ZONE = "Europe/London"
DAYS = 7
START = pd.Timestamp("2025-07-14T00:00", tz=ZONE)
# The homes' clocks are kept at UTC-8; each home lives one of these weeks, from Monday on.
WEEKS = tuple(
    pd.Timestamp(day, tz="Etc/GMT+8") for day in ("2017-06-19", "2017-07-10", "2017-07-17")
)
DIGITS = 3

HOMES = 60
BUSBAR = 1
"""Bus of the station at low voltage."""
HEALTH_CENTRE, WATERWORKS = "health-centre", "waterworks"
CARED_FOR = ("home-07", "home-41")
"""Homes of people who depend on a machine, which has a battery of its own."""
BACKUP_H, MAX_OFF_H = 4.0, 0.0
TIERS = {"critical": 1.0, "high": 0.1, "low": 0.02}
LAMBDA_GRID = 1e-7
"""Below the default, so that energy stays cheaper than the comfort of twenty homes may count."""
WATER_SHARE = 0.4
"""Share of its pumping that the waterworks can do with."""

PV_HOMES, COOLED_HOMES, CAR_HOMES = 24, 20, 15
HEALTH_KW = (6.0, 14.0)
"""Demand of the health centre at night and in its opening hours."""
OPEN = (8, 18)
WATER_KW = 8.0
SET_KW, SET_TANK_LITRES = 40.0, 132.0

# Lowest temperature at 05:00 and highest at 16:00 of each day: a week of heat, made up.
LOWEST_C = (16.0, 18.0, 20.0, 21.0, 22.0, 21.0, 18.0)
HIGHEST_C = (28.0, 32.0, 35.0, 37.0, 38.0, 35.0, 30.0)
COOLEST, HOTTEST = 5, 16

OUTAGE = (START + pd.Timedelta(days=2, hours=13), START + pd.Timedelta(days=3, hours=19))


def build(seed: int = SEED) -> Scenario:
    """The week.

    Parameters
    ----------
    seed : int
        Seed of homes, roofs, rooms and cars.

    Returns
    -------
    Scenario
        168 steps.
    """
    feeder = import_network(pandapower.networks.create_kerber_dorfnetz())
    grid = TimeGrid(START.tz_convert("UTC"), 60.0, 24 * DAYS, zone=ZONE)
    clock = grid.times.tz_convert(ZONE)
    draw_home, draw_place, draw_room, draw_car = (
        np.random.default_rng([seed, i]) for i in range(4)
    )
    metered, week = draw_home.integers(17, size=HOMES), draw_home.integers(len(WEEKS), size=HOMES)
    customers = _customers(feeder.loads.bus)
    homes = customers.id[:HOMES]
    roofs = np.sort(draw_place.choice(HOMES, PV_HOMES, replace=False))
    others_kw = np.column_stack([_health_kw(clock), np.full(len(clock), WATER_KW)])
    pv_kw = _homes_kw("pv_kw", metered[roofs], week[roofs])
    chargers, sessions = _cars(homes, draw_car)
    temperature_c = _temperature_c(len(clock))
    return Scenario(
        name=NAME,
        title=TITLE,
        grid=grid,
        network=feeder.network,
        customers=customers,
        pv=_pv(homes[roofs], pv_kw),
        batteries=_batteries(customers, roofs[::4]),
        load_kw=np.hstack([_homes_kw("load_kw", metered, week), others_kw]).round(DIGITS),
        pv_kw=pv_kw.round(DIGITS),
        price_gbp_per_kwh=_price(clock),
        temperature_c=temperature_c,
        grid_limit_kw=np.where((clock >= OUTAGE[0]) & (clock < OUTAGE[1]), 0.0, np.inf),
        tiers=tuple(TIERS),
        controller=ControllerDefaults(mode="physical", outages="belief"),
        objective=ObjectiveWeights(lambda_grid=LAMBDA_GRID),
        priority=Priority(STRICT),
        export_limit_kw=np.array(np.inf),
        warnings=_warnings(),
        chargers=chargers,
        sessions=sessions,
        thermal_loads=_rooms(homes, draw_room),
        gensets=_genset(),
    )


def write() -> None:
    """Write the packaged scenario anew."""
    scenario = build()
    shutil.rmtree(FOLDER, ignore_errors=True)
    write_scenario(scenario, FOLDER)


def _customers(load_buses: Names) -> Customers:
    """Homes at the feeder's connections in turn, then the health centre and the waterworks.

    These two are at the station's busbar and at the last connection.
    """
    names = [f"home-{i + 1:02d}" for i in range(HOMES)] + [HEALTH_CENTRE, WATERWORKS]
    n = len(names)
    cared = np.isin(names, CARED_FOR)
    tier = np.full(n, "low", dtype=object)
    tier[::3] = "high"
    tier[cared | np.isin(names, (HEALTH_CENTRE, WATERWORKS))] = "critical"
    buses = [load_buses[i % len(load_buses)] for i in range(HOMES)]
    return Customers(
        id=np.array(names, dtype=object),
        bus=np.array([*buses, BUSBAR, load_buses[-1]], dtype=object),
        tier=tier,
        weight=np.array([TIERS[t] for t in tier]),
        power_factor=np.where(np.array(names) == WATERWORKS, 0.9, 0.97),
        max_off_h=np.where(cared, MAX_OFF_H, np.nan),
        own_backup_h=np.where(cared, BACKUP_H, np.nan),
        share_min=np.where(np.array(names) == WATERWORKS, WATER_SHARE, 1.0),
    )


def _homes_kw(name: str, home: np.ndarray, week: np.ndarray) -> Floats:
    """Hours of the week of some homes, shape (T, len(home)), in the hour of their own clocks."""
    year = pd.read_parquet(SERIES / f"{name}.parquet").set_index("time")
    weeks = [year[first : first + pd.Timedelta(days=DAYS, hours=-1)].to_numpy() for first in WEEKS]
    return np.column_stack([weeks[w][:, h] for h, w in zip(home, week, strict=True)])


def _health_kw(clock: pd.DatetimeIndex) -> Floats:
    opened = (clock.hour >= OPEN[0]) & (clock.hour < OPEN[1])
    return np.where(opened, HEALTH_KW[1], HEALTH_KW[0])


def _temperature_c(steps: int) -> Floats:
    """Half waves of the cosine from each lowest temperature to the next highest and on, (T,)."""
    days = 24.0 * np.arange(DAYS)
    hours = np.append(np.column_stack([days + COOLEST, days + HOTTEST]), 24.0 * DAYS + COOLEST)
    ends_c = np.append(np.column_stack([LOWEST_C, HIGHEST_C]), LOWEST_C[-1])
    hour = np.arange(steps)
    # The wave is even: before the first lowest temperature it falls as it rises after it.
    leg = np.clip(np.searchsorted(hours, hour, side="right") - 1, 0, len(hours) - 2)
    share = 0.5 - 0.5 * np.cos(np.pi * (hour - hours[leg]) / (hours[leg + 1] - hours[leg]))
    return np.asarray(np.round(ends_c[leg] + share * (ends_c[leg + 1] - ends_c[leg]), 1))


def _price(clock: pd.DatetimeIndex) -> Floats:
    night = (clock.hour >= NIGHT[0]) & (clock.hour < NIGHT[1])
    evening = (clock.hour >= EVENING[0]) & (clock.hour < EVENING[1])
    return np.where(night, NIGHT_PRICE, np.where(evening, EVENING_PRICE, DAY_PRICE))


def _pv(owners: Names, pv_kw: Floats) -> PVSystems:
    """Roofs of 4 or 5 kW, as metered."""
    p_max_kw = np.ceil(pv_kw.max(axis=0))
    ids = np.array([f"roof-{owner[-2:]}" for owner in owners], dtype=object)
    return PVSystems(id=ids, customer=owners, p_max_kw=p_max_kw, s_max_kva=p_max_kw * 1.1)


def _batteries(customers: Customers, homes: np.ndarray) -> Batteries:
    """The village's battery at the busbar, which forms the island, and those of some homes."""
    at = np.array([HOMES, *homes])
    n = len(at)
    own = np.arange(n) > 0
    ids = np.array(["village", *(f"battery-{i + 1:02d}" for i in homes)], dtype=object)
    return Batteries(
        id=ids,
        bus=customers.bus[at],
        energy_kwh=np.where(own, 13.5, 400.0),
        p_max_kw=np.where(own, 5.0, 120.0),
        s_max_kva=np.where(own, 5.5, 150.0),
        soc_min=np.full(n, 0.1),
        soc_max=np.full(n, 0.95),
        soc_initial=np.full(n, 0.5),
        eta_charge=np.full(n, 0.95),
        eta_discharge=np.full(n, 0.95),
        r_theta_c_per_kw=np.full(n, 3.5),
        c_theta_kwh_per_c=np.full(n, 0.3),
        alpha_charge_per_c2=np.full(n, 1e-4),
        alpha_discharge_per_c2=np.full(n, 1e-4),
        r_int_ohm=np.full(n, 0.0035),
        beta_per_c=np.full(n, 0.003),
        u_batt_v=np.full(n, 900.0),
        t_ref_c=np.full(n, 25.0),
        t_initial_c=np.full(n, np.nan),
        grid_forming=~own,
    )


def _genset() -> Gensets:
    """The health centre's set: a fuel line of usual diesel sets, a tank for ten hours at most."""
    return Gensets(
        id=np.array(["diesel"], dtype=object),
        bus=np.array([BUSBAR], dtype=object),
        p_max_kw=np.array([SET_KW]),
        p_min_kw=np.array([0.3 * SET_KW]),
        ramp_up_kw_per_h=np.array([np.inf]),
        ramp_down_kw_per_h=np.array([np.inf]),
        min_on_h=np.array([1.0]),
        min_off_h=np.array([0.0]),
        on_before_h=np.array([-24.0]),
        start_cost_gbp=np.array([2.0]),
        fuel_price_gbp_per_litre=np.array([1.5]),
        litres_per_kwh=np.array([0.246]),
        litres_per_h_idle=np.array([0.08415 * SET_KW]),
        tank_litres=np.array([SET_TANK_LITRES]),
        fuel_level_litres=np.array([SET_TANK_LITRES]),
        only_in_outage=np.array([True]),
    )


def _rooms(homes: Names, draw: np.random.Generator) -> ThermalLoads:
    """Homes that a heat pump cools to 20 to 26 °C, of different walls and sizes."""
    cooled = np.sort(draw.choice(HOMES, COOLED_HOMES, replace=False))
    n = COOLED_HOMES
    return ThermalLoads(
        id=np.array([f"rooms-{i + 1:02d}" for i in cooled], dtype=object),
        customer=homes[cooled],
        heats=np.zeros(n, dtype=bool),
        p_max_kw=np.full(n, 2.0),
        cop=np.full(n, 3.5),
        cop_at_c=np.full(n, 35.0),
        cop_per_c=np.full(n, -0.06),
        r_c_per_kw=draw.uniform(4.0, 7.0, n).round(1),
        c_kwh_per_c=draw.uniform(5.0, 10.0, n).round(1),
        t_min_c=np.full(n, 20.0),
        t_max_c=np.full(n, 26.0),
        t_initial_c=np.full(n, 24.0),
        gain_kw=draw.uniform(0.3, 0.7, n).round(2),
        around_c=np.full(n, np.nan),
    )


def _cars(homes: Names, draw: np.random.Generator) -> tuple[Chargers, Sessions]:
    """Cars that are home in the evening and leave in the morning; every third gives back too."""
    owners = homes[np.sort(draw.choice(HOMES, CAR_HOMES, replace=False))]
    two_way = np.arange(CAR_HOMES) % 3 == 0
    chargers = Chargers(
        id=np.array([f"charger-{owner[-2:]}" for owner in owners], dtype=object),
        bus=np.full(CAR_HOMES, None, dtype=object),
        customer=owners,
        p_charge_kw=np.full(CAR_HOMES, 7.4),
        p_charge_min_kw=np.full(CAR_HOMES, 1.4),
        p_discharge_kw=np.where(two_way, 7.4, 0.0),
        eta_charge=np.full(CAR_HOMES, 0.92),
        eta_discharge=np.full(CAR_HOMES, 0.92),
    )
    of, day = (x.ravel() for x in np.meshgrid(np.arange(CAR_HOMES), np.arange(DAYS - 1)))
    n = len(of)
    midnight = pd.DatetimeIndex([START + pd.Timedelta(days=int(d)) for d in day])
    plug_in = midnight + pd.to_timedelta(draw.integers(16 * 4, 20 * 4, n) * 15, "min")
    plug_out = midnight + pd.to_timedelta(24 * 60 + draw.integers(6 * 4, 9 * 4, n) * 15, "min")
    return chargers, Sessions(
        charger=chargers.id[of],
        vehicle=np.array([f"car-{chargers.id[i][-2:]}" for i in of], dtype=object),
        plug_in=plug_in.tz_convert("UTC").astype(object).to_numpy(),
        plug_out=plug_out.tz_convert("UTC").astype(object).to_numpy(),
        capacity_kwh=draw.choice([40.0, 52.0, 64.0, 77.0], CAR_HOMES)[of],
        soc_at_plug_in=draw.uniform(0.35, 0.75, n).round(2),
        soc_needed=np.full(n, 0.8),
        energy_needed_kwh=np.full(n, np.nan),
        v2g_soc_floor=np.where(two_way[of], 0.4, np.nan),
        tier=np.full(n, "low", dtype=object),
        weight=np.full(n, TIERS["low"]),
        announced=np.zeros(n, dtype=bool),
    )


def _warnings() -> tuple[OutageWarning, ...]:
    """What the network operator says, and when."""

    def at(day: int, hour: int) -> pd.Timestamp:
        return (START + pd.Timedelta(days=day, hours=hour)).tz_convert("UTC")

    heat = OutageWarning(
        at(1, 17),
        onset_earliest=at(2, 9),
        onset_likely=at(2, 14),
        onset_latest=at(2, 20),
        probability=0.6,
        duration_p10_h=4.0,
        duration_p50_h=12.0,
        duration_p90_h=36.0,
    )
    evening = OutageWarning(at(2, 15), restored_likely=at(2, 23))
    night = OutageWarning(at(2, 22), restored_not_before=at(3, 8), restored_likely=at(3, 14))
    crew = OutageWarning(at(3, 17), restored_by=at(3, 19))
    return heat, evening, night, crew


if __name__ == "__main__":
    write()
