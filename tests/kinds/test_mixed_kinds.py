"""Mixes of all kinds of assets: random windows beside the whole problem, networks, charts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandapower.networks
import pandas as pd
import pytest

from benchmarks.frame.random_feeders import random_window
from tests.support.agreement import both_methods
from tests.support.builders import known, solved
from tests.support.carried_out import carried_out
from tests.support.homes import homes
from tests.support.kinds import EXAMPLES
from tests.support.sets import gensets
from tests.support.small_windows import two_buses
from tests.support.vans import chargers, plugged_in
from vppres import (
    Controller,
    Measurement,
    NewScenarioOptions,
    RunOptions,
    import_network,
    new_scenario,
    run_day,
)
from vppres.contract.ahead import KindsAhead
from vppres.core.errors import InfeasibleError
from vppres.feeders.closeness import extreme_steps
from vppres.feeders.cross_check import cross_check
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import SwitchingState
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.report.plots.figures import import_load_pv, indoor
from vppres.scenario.scenario import Scenario

OFTEN = 0.7
"""Share of windows that have a kind or a rule; most have three or more of the five."""


def mixed(seed: int) -> tuple[Scenario, WindowData]:
    """A window with each kind, dimmed customers and longest times off, or not.

    Some units that are yet to come are expected and not known.
    """
    day, data = random_window(seed, stressed=seed % 2 > 0)
    rng = np.random.default_rng([seed, 51])
    dimmed, limited = rng.random(2) < OFTEN
    count, dt_h = len(day.customers), day.grid.dt_h
    for it in EXAMPLES.values():
        if rng.random() < OFTEN:
            day = it.draw(day, seed)
    if dimmed:
        share_min = np.where(rng.random(count) < 0.5, rng.choice([0.1, 0.3, 0.7], count), 1.0)
        day = replace(day, customers=replace(day.customers, share_min=share_min))
    if limited:
        longest_h = np.where(rng.random(count) < 0.6, dt_h * rng.integers(0, 3, count), np.nan)
        day = replace(day, customers=replace(day.customers, max_off_h=longest_h))
    data = known(day, data)
    ahead = {kind: EXAMPLES[kind].expected(of, rng) for kind, of in data.ahead.by_kind.items()}
    data = replace(data, ahead=KindsAhead(ahead))
    state = SwitchingState.of(SwitchingRules(), day.customers, dt_h)
    rules = state.window(data.n_steps).priced(Site.of(day).hour_beyond, dt_h)
    return day, replace(data, switching=None if rules.idle else rules)


@pytest.mark.monolith
@pytest.mark.parametrize("seed", range(200))
def test_random_mixes_are_sound_and_no_worse_than_the_whole_problem(seed: int) -> None:
    """No bound is wrong, no row broken, and what the whole problem certifies is certified."""
    day, data = mixed(seed)
    site = Site.of(day)
    try:
        one, other = both_methods(site, data)
    except InfeasibleError:  # duties of a set leave nothing, and controllers drop them
        data = replace(data, ahead=data.ahead.without_duties())
        one, other = both_methods(site, data)
    gap = 1e-4 * max(abs(other.objective), 0.01) + 1e-6
    assert min(one.bound, other.bound) >= max(one.objective, other.objective) - gap
    assert one.objective >= other.objective - 2.0 * gap
    assert one.status == "optimal" or other.status != "optimal"
    assert not broken(site, data, one.dispatch)


def test_cars_homes_and_shares_together_never_outweigh_one_customer() -> None:
    """The kW that there are go to a hospital of weight 1, whatever the weight of all others."""
    day = two_buses([[20.0, 0.01]] * 3, [1.0, 1000.0], [20.01] * 3)
    day = replace(day, customers=replace(day.customers, share_min=np.array([1.0, 0.1])))
    day = replace(day, chargers=chargers(1000))
    day = plugged_in(day, *[(0, 3)] * 1000, weight=1000.0, soc_needed=0.8)
    hot = homes(*["c1"] * 100, t_initial_c=40.0)
    day = replace(day, temperature_c=np.full(3, 45.0), thermal_loads=hot)
    answer = solved(day).dispatch
    assert answer.served.all()
    assert answer.share[:, 0] == pytest.approx(1.0)


@pytest.mark.daily
def test_cars_machines_and_sets_are_in_networks_and_in_charts() -> None:
    """A power flow of the network that a feeder came from is that of the run, and of set-points."""
    net = pandapower.networks.simple_four_bus_system()
    feeder = import_network(net)
    outage = tuple(pd.Timestamp(f"2025-07-01T{hour}:00Z") for hour in ("12", "20"))
    made = NewScenarioOptions(step_minutes=240.0, add_batteries=True, outages=(outage,))
    day = new_scenario(feeder, made)
    day = replace(day, load_kw=0.3 * day.load_kw)  # voltages within limits
    two_way = chargers(bus=day.network.buses[-1], p_discharge_kw=7.4)
    day = plugged_in(replace(day, chargers=two_way), (0, 4), soc_at_plug_in=0.5)
    alone = max(-p_kw.sum() for p_kw, _ in extreme_steps(day))
    assert alone == pytest.approx(day.load_kw[0].sum() + 7.4)
    rooms = homes(day.customers.id[-1], t_initial_c=27.0, c_kwh_per_c=2.0)
    day = replace(day, thermal_loads=rooms, temperature_c=np.full(day.grid.n_steps, 34.0))
    assert max(-p_kw.sum() for p_kw, _ in extreme_steps(day)) == pytest.approx(alone + 2.0)
    free = {"fuel_price_gbp_per_litre": 0.0, "tank_litres": 9e3, "fuel_level_litres": 9e3}
    free |= {"p_max_kw": 20.0, "p_min_kw": 20.0, "only_in_outage": False}
    day = replace(day, gensets=gensets(bus=[day.customers.bus[0]], **free))
    options = RunOptions(horizon_h=0.0, isolate=False)
    run = run_day(day.between(0, 2), options)
    cooled_kw = run.thermal_loads["p_kw"].iloc[0]
    assert run.vehicles["p_kw"].iloc[0] > 1.0 and cooled_kw > 0.5
    step = Controller.of(day, options).step(Measurement(day.grid.times[0]))
    for _ in carried_out(net, feeder, run, step):
        charger = net.storage[net.storage["name"] == "charger k0"]
        assert 1000 * charger["p_mw"].item() == pytest.approx(18.0 / 0.92 / 4.0, abs=1e-4)
        given = net.sgen[net.sgen["name"] == "set g0"]
        assert given["p_mw"].item() == pytest.approx(0.02) and given["in_service"].all()
        machine = net.load[net.load["name"] == "machine h0"]
        assert 1000 * machine["p_mw"].item() == pytest.approx(cooled_kw, abs=1e-6)
    names = [curve["name"] for curve in import_load_pv(run).data()["curves"]]
    assert any(name.endswith("vehicles") for name in names)
    assert any(name.endswith("thermal loads") for name in names)
    assert any(name.endswith("generating sets") for name in names)
    assert [curve["name"] for curve in indoor(run).data()["curves"]][-1].endswith("median")
    assert cross_check(day).agrees
