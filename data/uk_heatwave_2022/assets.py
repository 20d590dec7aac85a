"""Per-bus data that the paper does not publish, drawn so that its aggregates hold for every seed.

Each quantity has its own random stream: a change of one option leaves the others' draws alone.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from data.uk_heatwave_2022 import published
from vppres.core.arrays import Floats, Names, Wholes
from vppres.core.errors import InputError, Problem
from vppres.scenario.assets import Batteries, Customers, PVSystems

STREAMS = ("tiers", "power_factors", "pv_places", "pv_sizes", "battery_sizes")
# How far a size may stray from the customer's load: standard deviation of the logarithm.
SIZE_SCATTER = 0.5
# Shares come in steps of 5 kW of 3715 kW, 0.0013: what is nearest lies within this.
SHARE_TOLERANCE = 0.001
SHARE_TRIALS = 200

# Feeder sections by their last bus: the main feeder 2-18 and the laterals 19-22, 23-25 and 26-33.
ZONE_LAST_BUS = (18, 22, 25, 33)


def draw_customers(nominal_kw: Floats, critical_share: float, seed: int) -> Customers:
    """One customer for each load bus 2, 3, ...

    Parameters
    ----------
    nominal_kw : array, shape (C,)
        Nominal load of each bus of the feeder.
    critical_share : float
        Share of the load that the critical customers have.
    seed : int
        Seed of the tiers and power factors.
    """
    buses = np.arange(len(nominal_kw)) + 2
    tier = draw_tiers(nominal_kw, critical_share, _stream(seed, "tiers"))
    rng = _stream(seed, "power_factors")
    factors = spread_sizes(
        (published.POWER_FACTOR_MIN, published.POWER_FACTOR_MAX),
        published.POWER_FACTOR_MEAN * len(buses),
        len(buses),
        3,
        rng,
    )
    return Customers(
        id=_ids("c", buses),
        bus=buses.astype(object),
        tier=tier,
        weight=np.array([published.TIER_WEIGHTS[t] for t in tier]),
        power_factor=rng.permutation(factors),
    )


def draw_pv(nominal_kw: Floats, seed: int) -> PVSystems:
    """PV systems of 28 customers: larger loads tend to have the larger systems."""
    buses = np.arange(len(nominal_kw)) + 2
    owners = np.sort(
        _stream(seed, "pv_places").choice(len(buses), published.PV_COUNT, replace=False)
    )
    rng = _stream(seed, "pv_sizes")
    sizes_kw = spread_sizes(
        (published.PV_MIN_KW, published.PV_MAX_KW), published.PV_TOTAL_KW, len(owners), 2, rng
    )
    p_max_kw = match_to_load(sizes_kw, nominal_kw[owners], rng)
    return PVSystems(
        id=_ids("pv", buses[owners]),
        customer=_ids("c", buses[owners]),
        p_max_kw=p_max_kw,
        s_max_kva=smallest_rating(p_max_kw, published.PV_INVERTERS_KVA),
    )


def draw_batteries(nominal_kw: Floats, zone_pairing: tuple[int, ...], seed: int) -> Batteries:
    """One battery for each load bus: larger loads tend to have the larger batteries."""
    buses = np.arange(len(nominal_kw)) + 2
    rng = _stream(seed, "battery_sizes")
    sizes_kwh = spread_sizes(
        (published.BATTERY_ENERGY_MIN_KWH, published.BATTERY_ENERGY_MAX_KWH),
        published.BATTERY_ENERGY_KWH,
        len(buses),
        2,
        rng,
    )
    energy_kwh = match_to_load(sizes_kwh, nominal_kw, rng)
    p_max_kw = np.round(energy_kwh * published.BATTERY_POWER_KW / published.BATTERY_ENERGY_KWH, 2)
    r_theta, c_theta = zone_constants(buses, zone_pairing)
    constants = {
        "soc_min": published.SOC_MIN,
        "soc_max": published.SOC_MAX,
        "soc_initial": published.SOC_INITIAL,
        "eta_charge": published.EFFICIENCY,
        "eta_discharge": published.EFFICIENCY,
        "alpha_charge_per_c2": published.ALPHA_PER_C2,
        "alpha_discharge_per_c2": published.ALPHA_PER_C2,
        "r_int_ohm": published.R_INT_OHM,
        "beta_per_c": published.BETA_PER_C,
        "u_batt_v": published.U_BATT_V,
        "t_ref_c": published.T_REF_C,
        "t_initial_c": np.nan,
    }
    return Batteries(
        id=_ids("b", buses),
        bus=buses.astype(object),
        energy_kwh=energy_kwh,
        p_max_kw=p_max_kw,
        s_max_kva=smallest_rating(p_max_kw, published.BATTERY_INVERTERS_KVA),
        r_theta_c_per_kw=r_theta,
        c_theta_kwh_per_c=c_theta,
        **{name: np.full(len(buses), value) for name, value in constants.items()},
    )


def draw_tiers(nominal_kw: Floats, critical_share: float, rng: np.random.Generator) -> Names:
    """Tiers at random, then exchanged until the critical customers have their share of the load.

    Returns
    -------
    array of str, shape (C,)
        Tier of each customer.
    """
    share = nominal_kw / nominal_kw.sum()
    counts = published.TIER_COUNTS
    for _ in range(SHARE_TRIALS):
        order = _exchange(share, rng.permutation(len(share)), critical_share)
        if abs(share[order[: counts["critical"]]].sum() - critical_share) <= SHARE_TOLERANCE:
            tier = np.empty(len(share), dtype=object)
            tier[order] = np.repeat(list(counts), list(counts.values()))
            return tier
    ranked = np.sort(share)
    low = ranked[: counts["critical"]].sum()
    high = ranked[-counts["critical"] :].sum()
    raise InputError(
        Problem(
            "build",
            f"no {counts['critical']} customers have this share of the load",
            f"Choose a share between {low:.3f} and {high:.3f}.",
            field="critical_share",
            value=critical_share,
        )
    )


def _exchange(share: Floats, order: Wholes, goal: float) -> Wholes:
    """Exchange the pair that brings the first 12 nearest to their share, while one does."""
    count = published.TIER_COUNTS["critical"]
    miss = share[order[:count]].sum() - goal
    while True:
        after = miss - share[order[:count], None] + share[None, order[count:]]
        inside, outside = np.unravel_index(np.abs(after).argmin(), after.shape)
        if abs(after[inside, outside]) >= abs(miss):
            return order
        miss = after[inside, outside]
        order[[inside, outside + count]] = order[[outside + count, inside]]


def spread_sizes(
    ends: tuple[float, float], total: float, count: int, digits: int, rng: np.random.Generator
) -> Floats:
    """Rising sizes with given ends and total, both ends attained.

    The places between the ends are spread evenly with a random shift of less than half a step;
    one exponent bends them so that the total holds.
    """
    low, high = ends
    place = (np.arange(count) + rng.uniform(-0.4, 0.4, count)) / (count - 1)
    place[[0, -1]] = 0.0, 1.0
    goal = (total / count - low) / (high - low)
    exponent = brentq(lambda k: (place**k).mean() - goal, 0.05, 20.0)
    sizes: Floats = np.round(low + (high - low) * place**exponent, digits)
    # What rounding leaves over is a few units of the last digit: one middle size takes it.
    sizes[count // 2] = round(sizes[count // 2] + total - sizes.sum(), digits)
    return sizes


def match_to_load(sizes: Floats, load_kw: Floats, rng: np.random.Generator) -> Floats:
    """Deal rising sizes out by load, with scatter."""
    wish = load_kw * np.exp(SIZE_SCATTER * rng.standard_normal(len(load_kw)))
    return sizes[wish.argsort().argsort()]


def smallest_rating(p_max_kw: Floats, ratings_kva: tuple[float, ...]) -> Floats:
    """The smallest inverter of a range that carries each power."""
    return np.array(ratings_kva)[np.searchsorted(ratings_kva, p_max_kw)]


def zone_constants(buses: Wholes, zone_pairing: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Thermal resistance (°C/kW) and capacity (kWh/°C) of the battery at each bus.

    Both ranges are divided evenly over the zones. The resistance rises with the zone's number;
    ``zone_pairing[z]`` is the rank of zone ``z``'s capacity, 0 the smallest.
    """
    n_zones = len(ZONE_LAST_BUS)
    if sorted(zone_pairing) != list(range(n_zones)):
        raise InputError(
            Problem(
                "build",
                "does not name each rank once",
                f"Give a permutation of {tuple(range(n_zones))}.",
                field="zone_pairing",
                value=zone_pairing,
            )
        )
    zone = np.searchsorted(ZONE_LAST_BUS, buses)
    r_theta = np.round(np.linspace(*published.R_THETA_C_PER_KW, n_zones), 3)
    c_theta = np.round(np.linspace(*published.C_THETA_KWH_PER_C, n_zones), 3)
    return r_theta[zone], c_theta[np.array(zone_pairing)][zone]


def _stream(seed: int, name: str) -> np.random.Generator:
    return np.random.default_rng([seed, STREAMS.index(name)])


def _ids(prefix: str, buses: Wholes) -> Names:
    return np.array([f"{prefix}{bus:02d}" for bus in buses], dtype=object)
