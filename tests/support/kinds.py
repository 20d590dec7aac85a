"""Example of each kind for the laws of all kinds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tests.support.builders import HERE
from tests.support.homes import homes, hot, with_random_homes
from tests.support.sets import gensets, random_sets
from tests.support.small_windows import DARK, OPEN, battery, full_of, two_buses, with_pv
from tests.support.vans import chargers, plugged_in, with_random_vehicles
from vppres import RunOptions
from vppres.core.arrays import Floats
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.gensets import Refuels
from vppres.kinds.kind import UnitPlan
from vppres.kinds.vehicles.physics import Plugged
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True)
class Example:
    """Example of a kind: a small site, and the statements that hold for it."""

    kind: str
    day: Scenario  # one customer and one unit, with grid and without
    draw: Callable[[Scenario, int], Scenario]  # a day with random units, by a seed
    # What units hold at the end of each step, as a window reckons it, and in a state of the plant.
    stored: Callable[[Any, Scenario, Floats, Any], Floats]
    state: Callable[[Any], Floats]
    limit: tuple[Scenario, Scenario]  # a site with a unit that is the other's battery or load
    crowd: Scenario  # many units beside a customer who needs all that there is
    wrong: Sequence[
        tuple[int, float, str]
    ]  # a first step, what a unit takes, and the guard's words
    beyond: Sequence[tuple[dict[str, Any], str]]  # columns of a set-point, the last check's words
    told: Sequence[tuple[dict[str, Any], str]]  # readings step by step, and what is said of them
    default: Mapping[str, Any]  # set-point without a decision
    by_rule: Mapping[str, float]  # set-point where no plan was found in an outage
    figures: Mapping[str, Any]  # of a run of the site
    why: Mapping[str, str]  # actions of it, and the first reason of each
    caution: str
    event: str
    # A file, what is replaced in it and by what (a row is added where nothing is), the message.
    mistakes: Sequence[tuple[str, str, str, str]]
    refused: Sequence[tuple[Scenario, RunOptions, str]]  # a day, options, the message
    # A window in which some units that are yet to come are expected and not known.
    expected: Callable[[Any, np.random.Generator], Any] = lambda ahead, _: ahead


IDLE = RunOptions(controller="idle", isolate=False)
COLD = RunOptions(isolate=False, switching=SwitchingRules(cold_load_factor=2.0, cold_load_h=1.0))


def _not_told(plugged: Plugged, rng: np.random.Generator) -> Plugged:
    """The window with half of the vehicles that are yet to come expected."""
    told = rng.random(plugged.here.shape[1]) < 0.5
    return replace(plugged, known=plugged.here & (plugged.here[0] | told))


def _in_parts(day: Scenario) -> Scenario:
    """The day with customers that are switched in two parts."""
    return replace(day, customers=replace(day.customers, shed_steps=[2] * len(day.customers)))


def _drawn_homes(day: Scenario, seed: int) -> Scenario:
    """The day with rooms and tanks whose machines do better or worse in the heat."""
    rng = np.random.default_rng([seed, 42])
    loads = with_random_homes(day, rng)
    cop_per_c = rng.uniform(-0.08, 0.02, len(loads.thermal_loads))
    return replace(loads, thermal_loads=replace(loads.thermal_loads, cop_per_c=cop_per_c))


def _cooling() -> Example:
    """A home that is cooled before an outage."""
    day = hot([OPEN] * 2 + [DARK] * 8 + [OPEN], t_max_c=25.0)
    held = hot([OPEN] * 4, t_max_c=24.0)
    warm = two_buses([[20.0, 0.01]] * 3, [1.0, 1000.0], [20.01] * 3)
    many = homes(*["c1"] * 100, t_initial_c=40.0)
    dear = replace(day, objective=replace(day.objective, lambda_grid=1.0))
    return Example(
        kind="thermal_loads",
        day=day,
        draw=_drawn_homes,
        stored=lambda rooms, day, taken_kw, running: rooms.t_c(taken_kw),
        state=lambda t_c: t_c,
        limit=(held, two_buses([[1.0 + 2.5 / 3.5]] * 4, [1.0], [OPEN] * 4)),
        crowd=replace(warm, temperature_c=np.full(3, 45.0), thermal_loads=many),
        wrong=[
            (0, 2.5, "thermal load power: h0 by 0.5 kW"),
            (3, 0.5, "thermal load power: h0 by 0.5 kW"),
        ],
        beyond=[({"setpoint_c": 19.9}, "cooled below its comfort band")],
        told=[
            ({}, ""),
            ({}, ""),
            ({"indoor_c": {"h0": 24.5}}, ""),
            ({}, "indoor_c h0 24.8 (missing)"),  # 36.5 - 12 exp(-1 / 40)
            ({"indoor_c": {"h0": 77.0}}, "more than 40 K above its comfort band"),
            ({"indoor_c": {"h0": 26.0}}, ""),
        ],
        default={"setpoint_c": 25.0},
        by_rule={"setpoint_c": 100.0},
        figures={
            "loads": 1,
            "missed_k_h": 3.068,
            "hours_outside_band": 5.0,
            "hours_above_band_by_tier": {"critical": 5.0},
        },
        why={"prepared": "Cooled to 23.7 °C because the grid goes at 02:00."},
        caution="1 of 1 room or tank outside the comfort band, for ",
        event="1 room or tank leaves its comfort band: h0 (25.2 °C).",
        mistakes=[
            (
                "thermal_loads.csv",
                ",20.0,25.0",
                ",30.0,25.0",
                "row 2, t_min_c = 30.0: must be less than t_max_c (25)",
            ),
            ("thermal_loads.csv", ",c0,", ",nobody,", "row 2, customer = nobody"),
        ],
        refused=[
            (_in_parts(day), HERE, "shed_steps"),
            (day, IDLE, "plans no thermal loads"),
            (dear, HERE, r"lambda_grid.*energy dearer.*comfort of 1 rooms"),
            (day, COLD, "twice"),
        ],
    )


def _gensets() -> Example:
    """A set with fuel for an hour of an outage, and for one more once it is delivered."""
    day = two_buses([[50.0]] * 7, [1.0], [OPEN] + [DARK] * 5 + [OPEN], r_ohm=1e-6)
    refuels = Refuels(["g0"], [day.grid.times[4]], [20.0])
    day = replace(day, gensets=gensets(fuel_level_litres=30.0), refuels=refuels)
    dark = two_buses([[100.0]] * 10, [1.0], [DARK] * 10, r_ohm=1e-6)
    endless = gensets(
        p_min_kw=0.0, litres_per_h_idle=0.0, litres_per_kwh=0.25, fuel_price_gbp_per_litre=0.0
    )
    stored = replace(full_of(800.0), p_max_kw=[100.0])
    # 33.015 l in an hour at full power, which cost 49.52 GBP.
    dearest = replace(dark, gensets=gensets(), objective=replace(dark.objective, lambda_grid=0.02))
    dear = replace(day, objective=replace(day.objective, lambda_grid=0.03))
    return Example(
        kind="gensets",
        day=day,
        draw=lambda day, seed: replace(
            day, gensets=random_sets(np.random.default_rng([seed, 43]), day)
        ),
        stored=lambda sets, day, taken_kw, running: sets.fuel_litres(
            UnitPlan(taken_kw, running, running)
        ),
        state=lambda state: state.fuel_litres,
        limit=(replace(dark, gensets=endless), replace(dark, batteries=stored)),
        crowd=dearest.between(0, 5),
        wrong=[
            (5, -120.0, "genset power: g0 by 32.3 kW"),  # its fuel gives 87.7 kW
            (5, -20.0, "genset power: g0 by 10 kW"),  # its least power
            (0, -50.0, "genset power: g0 by 50 kW"),  # it stands still
        ],
        beyond=[
            ({"running": True, "p_kw": 101.0}, "power above its rating"),
            ({"running": True, "p_kw": 29.0}, "power below its least"),
            ({"running": False, "p_kw": 5.0}, "power without running"),
            ({"p_kw": np.nan}, "no number"),
        ],
        told=[
            ({"fuel_litres": {"g0": 95.0}}, ""),
            ({}, "fuel_litres g0 95 at least (missing)"),
            ({"fuel_litres": {"g0": 95.0}}, "fuel_litres g0 74 at least (frozen)"),
            ({"running": {"g0": 0}, "start_fault": {"g0": 1}}, "genset g0 is out (start fault)"),
        ],
        default={"running": False, "p_kw": 0.0},
        by_rule={},
        figures={
            "hours_on": 2.0,
            "starts": 2,
            "given_kwh": 100.0,
            "burnt_litres": 2 * 20.715,
            "left_litres": 50.0 - 2 * 20.715,
            "cost_gbp": 1.5 * 2 * 20.715,
        },
        why={
            "ran": "Generator g0 runs because the grid is away",
            "stopped": "Generator g0 stopped: ",
        },
        caution="Generator g0 without fuel in the outage, for 1 h in all.",
        event="Generator g0 starts, with 30 l of fuel.",
        mistakes=[
            (
                "gensets.csv",
                ",100.0,30.0,",
                ",100.0,150.0,",
                "row 2, p_min_kw = 150.0: must not exceed p_max_kw (100). Correct one of the two.",
            ),
            (
                "gensets.csv",
                ",30.0,yes",
                ",300.0,yes",
                "row 2, fuel_level_litres = 300.0: must not exceed tank_litres (200). "
                "Correct one of the two.",
            ),
            ("gensets.csv", "g0,2,", "g0,9,", "row 2, bus = 9"),
            ("refuel.csv", "g0,", "g9,", "row 2, genset = g9: is not a set of gensets.csv."),
        ],
        refused=[
            (day, IDLE, r"plans no generating sets\. Use mpc, or remove gensets\.csv"),
            (
                dear,
                HERE,
                r"^scenario\.toml, objective\.lambda_grid = 0\.03: makes fuel and starts of sets count "
                r"as much as a customer of the first tier\. Give less than 2\.0e-02\.$",
            ),
        ],
    )


def _vehicles() -> Example:
    """A car at a home, which leaves inside an outage."""
    day = two_buses([[1.0]] * 6, [1.0], [OPEN] * 2 + [DARK] * 4)
    day = replace(day, tiers=("critical",), batteries=battery(20.0, 20.0, 100.0))
    own = chargers(customer="c0", bus=None)
    day = plugged_in(replace(day, chargers=own), (0, 5))
    crowd = replace(two_buses([[20.0]] * 5, [1.0], [20.0] * 5), chargers=chargers(200))
    return Example(
        kind="chargers",
        day=day,
        draw=with_random_vehicles,
        expected=_not_told,
        stored=lambda plugged, day, taken_kw, running: plugged.energy_kwh(taken_kw),
        state=lambda held_kwh: held_kwh,
        limit=_stays(),
        crowd=plugged_in(crowd, *[(0, 5)] * 200, weight=1000.0, soc_needed=0.8),
        wrong=[
            (0, 8.4, "charger power: k0 by 1 kW"),
            (0, -1.0, "charger power: k0 by 1.09 kW"),  # one way, and below its floor
            (5, 7.4, "charger power: k0 by 7.4 kW"),  # gone
        ],
        beyond=[
            ({"p_kw": 7.5}, "power above its rating"),
            ({"p_limit_kw": 7.5}, "power above its rating"),
            ({"p_kw": -1.0}, "discharge above its rating"),
        ],
        told=[
            ({}, ""),
            (
                {"energy_needed_kwh": {"k0": 90.0}},
                "vehicle car0 at k0 needs 90 kWh, and holds 60 kWh",
            ),
            ({"ev_soc": {"k0": 0.4}}, ""),
            ({"plugged": {"k0": 0.0}}, "vehicle car0 is not at k0"),
        ],
        default={"p_kw": 7.4, "p_limit_kw": 7.4},
        by_rule={"p_kw": 0.0, "p_limit_kw": 0.0},
        figures={  # 14.8 kWh with grid, and of 13.3 stored what the home leaves in four hours
            "departures": 1,
            "left_short": 1,
            "charged_kwh": 24.1,
            "given_back_kwh": 0.0,
            "missed_kwh": 30.0 - 0.92 * 24.1,
            "missed_kwh_by_tier": {"critical": 30.0 - 0.92 * 24.1},
        },
        why={
            "charged": "Charges 7.4 kW: it leaves at 05:00 and needs 30.0 kWh more.",
            "left_short": "Leaves 7.8 kWh short: it left inside the outage, and customers come first.",
        },
        caution="1 of 1 vehicles left short of 7.8 kWh in all: car0 7.8 kWh.",
        event="1 vehicle leaves short: car0 (critical, 7.8 kWh).",
        mistakes=[
            ("ev_chargers.csv", "k0,c0,", "k0,nobody,", "row 2, customer = nobody"),
            ("ev_chargers.csv", "k0,c0,", "k0,,", "neither a customer nor a bus"),
            (
                "ev_chargers.csv",
                "7.4,0.0",
                "7.4,9.0",
                "p_charge_min_kw = 9.0: must not exceed p_charge_kw (7.4)",
            ),
            ("ev_sessions.csv", "k0,car0", "k7,car0", "row 2, charger = k7"),
            ("ev_sessions.csv", ",0.8,", ",,", "energy_needed_kwh"),
            ("ev_sessions.csv", "T05:00", "T00:00", "does not come after plug_in"),
            ("ev_sessions.csv", "critical", "none", "row 2, tier = none: is not a tier"),
            (
                "ev_sessions.csv",
                "",
                "k0,car1,2022-07-19T03:00Z,2022-07-19T06:00Z,60,0.3,0.8,critical,1,yes\n",
                "before the vehicle of row 2 has left",
            ),
            (
                "ev_sessions.csv",
                "soc_at_plug_in,soc_needed,tier,weight,announced\n"
                "k0,car0,2022-07-19T00:00:00Z,2022-07-19T05:00:00Z,60.0,0.3,0.8,",
                "energy_needed_kwh,tier,weight,announced\n"
                "k0,car0,2022-07-19T00:00:00Z,2022-07-19T05:00:00Z,60.0,90,",
                "more than the vehicle holds",
            ),
        ],
        refused=[
            (day, IDLE, r"controller.*idle.*plans no vehicles.*Use mpc"),
            (
                replace(day, price_gbp_per_kwh=np.full(6, 1e4)),
                HERE,
                r"lambda_grid.*makes energy dearer than.*at most",
            ),
            (_in_parts(day), HERE, r"customer.*c0.*switched in parts.*charger k0"),
        ],
    )


def _stays() -> tuple[Scenario, Scenario]:
    """A car that stays, and a battery: a sunny noon, an outage and prices that pay for storing."""
    limits = [OPEN] * 4 + [DARK] * 4
    day = two_buses([[6.0, 5.0]] * 8, [1.0, 2.0], limits, [0.1, 0.3, 0.1, 0.3] + [0.3] * 4)
    day = with_pv(day, [0, 5, 20, 30, 20, 0, 0, 0])
    b = replace(battery(energy_kwh=40.0, p_max_kw=9.0, s_max_kva=1e3), soc_initial=[0.5])
    usable = float((b.soc_max - b.soc_min)[0])
    two_way = chargers(
        p_charge_kw=9.0, p_discharge_kw=9.0, eta_charge=b.eta_charge, eta_discharge=b.eta_discharge
    )
    car = plugged_in(
        replace(day, chargers=two_way),
        (-1, 8),
        capacity_kwh=40.0 * usable,
        soc_at_plug_in=float((0.5 - b.soc_min[0]) / usable),
        soc_needed=0.0,
        v2g_soc_floor=0.0,
    )
    return car, replace(day, batteries=b)


EXAMPLES = {each.kind: each for each in (_vehicles(), _cooling(), _gensets())}
"""By kind, in the order of :data:`vppres.kinds.table.KINDS`."""
