"""Islands as they really are: who balances them, what is cut, and when they are dark."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.frame.random_feeders import random_scenario
from tests.support.set_points import asked, decision, state
from tests.support.vans import chargers, plugged_in
from vppres.contract.decision import Decision
from vppres.physics import nose
from vppres.physics.newton import Newton
from vppres.physics.powerflow import ACPowerFlow
from vppres.plant.changes import curtailed
from vppres.plant.formers import share_out
from vppres.plant.island import (
    COLLAPSE,
    NO_BALANCE,
    NO_ENERGY,
    NO_FORMER,
    NO_SOLUTION,
    IslandPlant,
    Settled,
    shedding_order,
)
from vppres.plant.plant import BatteryState, Plant, Powers
from vppres.scenario.assets import Batteries
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario

T = 3
"""A step of the outage: 65, 45 and 46 kW of demand, 29 and 18.5 kW of sun."""


def settle(scenario: Scenario, plan: Decision, before: BatteryState, t: int = T) -> Settled:
    """What an island makes of a decision."""
    plant = Plant(scenario)
    island = IslandPlant(plant, ACPowerFlow(scenario.network))
    return island.settle(t, plant.apply(t, plan, before), before)


def both_form(scenario: Scenario) -> Scenario:
    """The tiny day with both batteries named."""
    named = replace(scenario.batteries, grid_forming=np.array([True, True]))
    return replace(scenario, batteries=named)


def generation_less_use_kw(scenario: Scenario, done: Settled, t: int = T) -> float:
    """Power that is made less power that is used or lost."""
    made = (done.pv_self_kw + done.pv_export_kw).sum() + (done.discharge_kw - done.charge_kw).sum()
    return float(made - scenario.load_kw[t] @ done.served - done.ac.losses_kw)


def test_largest_inverter_forms_the_grid_where_nobody_is_named(tiny: Scenario) -> None:
    assert tiny.batteries.formers.tolist() == [True, False]
    assert both_form(tiny).batteries.formers.tolist() == [True, True]
    none = {f: [] for f in Batteries.__dataclass_fields__}
    assert Batteries(**none).formers.tolist() == []


def test_reference_pays_for_mismatch_and_losses(tiny: Scenario) -> None:
    # 156 kW of demand, 47.5 kW of sun, 40 + 28 kW planned: 40.5 kW and the losses are missing,
    # of which the battery's rating leaves 10.
    small = replace(tiny, load_kw=tiny.load_kw * 0.75)
    done = settle(small, decision(small, battery_kw=[-30.0, -28.0]), state([0.85, 0.85]))
    missing = 117.0 - 47.5 - 58.0 + done.ac.losses_kw
    assert not done.dark
    assert done.mismatch_kw == pytest.approx([missing, 0.0], abs=1e-5)
    assert done.discharge_kw == pytest.approx([30.0 + missing, 28.0], abs=1e-5)
    drawn = (30.0 + missing) / 0.95 / 100.0
    assert done.soc_end[0] == pytest.approx(0.85 - drawn, abs=1e-7)
    assert done.ac.v_pu[1] == pytest.approx(1.0, abs=1e-12)
    assert generation_less_use_kw(small, done) == pytest.approx(0.0, abs=1e-5)
    assert (abs(done.ac.p_slack_kw), abs(done.ac.q_slack_kvar)) < (1e-6, 1e-6)


def test_mismatch_is_shared_by_rating(tiny: Scenario) -> None:
    day = both_form(replace(tiny, load_kw=tiny.load_kw * 0.6))
    done = settle(day, decision(day, battery_kw=[-10.0, -5.0]), state(0.6))
    assert done.mismatch_kw.sum() == pytest.approx(93.6 - 47.5 - 15.0 + done.ac.losses_kw, abs=1e-5)
    assert done.mismatch_kw[0] / done.mismatch_kw[1] == pytest.approx(60.0 / 35.0)


@pytest.mark.parametrize(("reference", "soc", "bus"), [(0, [0.6, 0.6], 1), (1, [0.15, 0.85], 3)])
def test_reactive_mismatch_is_that_of_the_largest_inverter_that_has_energy(
    tiny: Scenario, reference: int, soc: list[float], bus: int
) -> None:
    day = both_form(replace(tiny, load_kw=tiny.load_kw * 0.3))
    told_kvar = np.full(2, 2.0)
    told_kvar[reference] = 0.0
    done = settle(day, decision(day, batt_q_kvar=told_kvar), state(soc))
    lost = (done.ac.q_from_kvar - done.ac.q_to_kvar).sum()
    told_kvar[reference] = day.load_kvar[T].sum() + lost - 2.0
    assert done.batt_q_kvar == pytest.approx(told_kvar, abs=1e-5)
    assert done.ac.v_pu[bus] == pytest.approx(1.0, abs=1e-12)


def test_missing_power_sheds_the_least_weight_per_kw_of_the_lowest_tier(tiny: Scenario) -> None:
    # 47.5 + 50 kW planned, 30 kW more from the battery that holds the grid, 156 kW asked for.
    day = replace(tiny, customers=replace(tiny.customers, power_factor=np.ones(3)))
    done = settle(day, decision(day, battery_kw=[-20.0, -30.0]), state([0.85, 0.85]))
    assert done.shed.tolist() == [False, False, True]
    assert done.served.tolist() == [True, True, False]
    assert done.mismatch_kw[0] == pytest.approx(110.0 - 47.5 - 50.0 + done.ac.losses_kw, abs=1e-5)
    # The shed customer's PV system goes on feeding the island.
    assert done.pv_self_kw[1] == 0.0
    assert done.pv_export_kw[1] == pytest.approx(18.5)


def test_order_of_shedding(tiny: Scenario) -> None:
    assert shedding_order(tiny, T) == [2, 1, 0]
    # A large critical customer has less weight per kW than a small low one, and goes last still.
    heavy = replace(tiny, load_kw=tiny.load_kw * np.array([1000.0, 1.0, 0.001]))
    assert shedding_order(heavy, T) == [2, 1, 0]
    alike = replace(
        tiny, customers=replace(tiny.customers, tier=np.array(["low", "low", "low"], dtype=object))
    )
    assert shedding_order(alike, T) == [2, 1, 0]
    assert shedding_order(replace(alike, load_kw=np.full((6, 3), [1.0, 50.0, 2.0])), T) == [1, 2, 0]


def test_other_batteries_cover_a_need_before_a_customer_is_shed(tiny: Scenario) -> None:
    # 106 kW of demand less 47.5 kW of sun: the 50 kW of the former and 5 kW planned are too little.
    day = replace(tiny, load_kw=tiny.load_kw * 0.68)
    done = settle(day, decision(day, battery_kw=[-50.0, -5.0]), state([0.85, 0.85]))
    assert not done.shed.any()
    needed_kw = day.load_kw[T].sum() - 47.5 - done.discharge_kw[0] + done.ac.losses_kw
    assert done.discharge_kw[1] == pytest.approx(needed_kw, abs=5e-3)
    assert done.discharge_kw[1] > 5.0
    empty = settle(day, decision(day, battery_kw=[-50.0, 0.0]), state([0.85, 0.15]))
    assert empty.shed.tolist() == [False, False, True]


def test_charging_stops_before_anyone_is_shed(tiny: Scenario) -> None:
    small = replace(tiny, load_kw=tiny.load_kw * 0.5)
    done = settle(small, decision(small, battery_kw=[0.0, 30.0]), state([0.85, 0.2]))
    assert not done.shed.any()
    # 78 kW of demand less 47.5 kW of sun and 50 kW from the battery leave 19.5 for charging.
    assert done.charge_kw[1] == pytest.approx(19.5 - done.ac.losses_kw, abs=5e-3)


@pytest.mark.parametrize(("least_kw", "taken_kw"), [(0.0, 19.5), (19.0, 19.5), (19.6, 0.0)])
def test_a_charger_that_gives_way_takes_its_least_power_or_nothing(
    tiny: Scenario, least_kw: float, taken_kw: float
) -> None:
    small = replace(tiny, load_kw=tiny.load_kw * 0.5)
    charger = chargers(bus=[4], p_charge_kw=22.0, p_charge_min_kw=least_kw)
    now_h = T * small.grid.dt_h
    small = plugged_in(replace(small, chargers=charger), (now_h, now_h + 2.0))
    done = settle(small, asked(small, {"chargers": 22.0}), state([0.85, 0.2]))
    assert not done.shed.any() and not done.dark
    given_kw = taken_kw and taken_kw - done.ac.losses_kw
    assert done.taken_kw["chargers"] == pytest.approx([given_kw], abs=5e-3)


def test_surplus_is_curtailed(tiny: Scenario) -> None:
    # Nobody is served, and the battery that holds the grid has room for 5 kWh: 5.26 kW.
    done = settle(tiny, decision(tiny, served=False), state([0.80, 0.5]))
    assert done.charge_kw[0] == pytest.approx(5.0 / 0.95, abs=2e-3)
    assert done.soc_end[0] <= 0.85
    assert done.pv_curtailed_kw.sum() == pytest.approx(
        47.5 - 5.0 / 0.95 - done.ac.losses_kw, abs=2e-3
    )
    assert generation_less_use_kw(tiny, done) == pytest.approx(0.0, abs=1e-5)


def test_surplus_of_other_batteries_stops_their_discharge(tiny: Scenario) -> None:
    night = replace(tiny, pv_kw=np.zeros((6, 2)))
    done = settle(night, decision(night, served=False, battery_kw=[0.0, -25.0]), state([0.85, 0.8]))
    # The battery that holds the grid is full; what is left only pays the losses.
    assert done.discharge_kw[1] < 2e-3
    assert not done.dark


def test_what_is_exported_is_curtailed_before_what_customers_use() -> None:
    zeros = np.zeros(2)
    exporting = Powers(np.array([True]), np.array([4.0, 2.0]), np.array([6.0, 2.0]), *[zeros] * 4)
    left = curtailed(exporting, 4.0)
    assert (left.pv_self_kw == exporting.pv_self_kw).all()
    assert left.pv_export_kw == pytest.approx([3.0, 1.0])
    assert left.pv_curtailed_kw == pytest.approx([3.0, 1.0])
    used = curtailed(replace(exporting, pv_export_kw=zeros), 3.0)
    assert (used.pv_export_kw == 0.0).all()
    assert used.pv_self_kw == pytest.approx([2.0, 1.0])
    assert used.pv_curtailed_kw == pytest.approx([2.0, 1.0])


def dark_and_empty(scenario: Scenario, done: Settled) -> bool:
    """Nobody served, nothing generated, no voltage, and the batteries as they were."""
    return bool(
        done.dark
        and not done.served.any()
        and np.isnan(done.ac.v_pu).all()
        and np.isnan(done.ac.source_kva).all()
        and done.ac.v_pu.shape == (scenario.network.n_buses,)
        and not np.concatenate([np.r_[flow] for flow in astuple(done.ac)[1:8]]).any()
        and (done.mismatch_kw == 0.0).all()
        and (done.pv_curtailed_kw == scenario.pv_kw[T]).all()
        and not (done.charge_kw + done.discharge_kw + np.abs(done.p_injection_kw).sum()).any()
    )


def test_island_without_energy_is_dark(tiny: Scenario) -> None:
    done = settle(tiny, decision(tiny), state([0.15, 0.85]))
    assert done.dark_reason == NO_ENERGY
    assert dark_and_empty(tiny, done)
    assert done.shed.all()
    assert done.soc_end.tolist() == [0.15, 0.85]
    other = both_form(tiny)
    assert not settle(other, decision(other, served=False), state([0.15, 0.85])).dark


def test_island_without_a_battery_is_dark() -> None:
    day = next(
        d for d in (random_scenario(seed, n_steps=1) for seed in range(20)) if len(d.batteries) == 0
    )
    plan = decision(day, served=False)
    before = BatteryState(*(np.zeros(0) for _ in range(4)))
    assert settle(day, plan, before, 0).dark_reason == NO_FORMER


@pytest.mark.parametrize(("r_ohm", "reason"), [(1200.0, NO_SOLUTION), (600.0, COLLAPSE)])
def test_lines_that_cannot_carry_it_leave_the_island_dark(
    tiny: Scenario, r_ohm: float, reason: str
) -> None:
    weak = Network(
        [1, 2, 2], [2, 3, 4], [0.3, r_ohm, 0.5], [0.2, 0.3, 0.4], slack_bus=1, base_kv=11.0
    )
    night = replace(tiny, network=weak, pv_kw=np.zeros((6, 2)))
    plan = decision(night, served=[False, True, False])
    done = settle(night, plan, state(0.85))
    assert done.dark_reason == reason
    assert dark_and_empty(night, done)


def test_island_whose_lines_lose_more_than_its_batteries_have_is_dark(tiny: Scenario) -> None:
    # 1e-4 of a kWh is left, and no customer whose shedding could help.
    night = replace(tiny, pv_kw=np.zeros((6, 2)))
    plan = decision(night, served=False, batt_q_kvar=[0.0, 30.0])
    assert settle(night, plan, state([0.15 + 2e-6, 0.15])).dark_reason == NO_BALANCE
    assert not settle(night, plan, state([0.15 + 2e-6, 0.5])).dark


@settings(max_examples=100)
@given(power=st.floats(0.0, 1e4), rooms=st.lists(st.floats(0.0, 1e3), min_size=1, max_size=6))
def test_sharing_fills_up_to_the_room_and_no_further(power: float, rooms: list[float]) -> None:
    room = np.array(rooms)
    taken = share_out(power, room, np.linspace(1.0, 3.0, len(room)))
    assert (taken >= 0).all() and (taken <= room + 1e-9).all()
    assert taken.sum() == pytest.approx(min(power, room.sum()), abs=1e-6)


@pytest.mark.daily
@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), stressed=st.booleans(), size=st.sampled_from([0.1, 1.0, 3.0]))
def test_whatever_is_asked_for_the_island_balances_within_all_limits_or_is_dark(
    seed: int, stressed: bool, size: float
) -> None:
    day = random_scenario(seed, stressed, n_steps=1)
    rng, b, pv = np.random.default_rng(seed), day.batteries, day.pv
    plan = decision(
        day,
        rng.random(len(day.customers)) < 0.7,
        rng.uniform(0.0, 1.0, len(pv)) * size * pv.p_max_kw,
        rng.uniform(-size, size, len(b)) * b.p_max_kw,
        rng.uniform(-0.3, 0.3, len(pv)) * pv.s_max_kva,
        rng.uniform(-0.3, 0.3, len(b)) * b.s_max_kva,
    )
    before = Plant(day).initial_state()
    done = settle(day, plan, before, 0)
    kwh = day.grid.dt_h * (b.eta_charge * done.charge_kw - done.discharge_kw / b.eta_discharge)
    assert done.soc_end == pytest.approx(before.soc + kwh / b.energy_kwh, abs=1e-9)
    assert (done.soc_end >= b.soc_min).all() and (done.soc_end <= b.soc_max).all()
    apparent = np.hypot(done.charge_kw - done.discharge_kw, done.batt_q_kvar)
    assert (apparent <= b.s_max_kva * (1 + 1e-6)).all()
    assert done.pv_self_kw + done.pv_export_kw + done.pv_curtailed_kw == pytest.approx(day.pv_kw[0])
    assert np.min([done.pv_self_kw, done.pv_export_kw, done.pv_curtailed_kw], initial=0.0) >= -1e-9
    assert (done.shed & done.served).sum() == 0
    assert generation_less_use_kw(day, done, 0) == pytest.approx(0.0, abs=1e-4)
    if done.dark:
        assert not done.served.any()


# Power flows that Newton's method does not find.


@pytest.mark.parametrize("ohm", [1e-5, 1e-7, 1e-12])
def test_an_island_settles_over_a_line_that_is_almost_a_switch(tiny: Scenario, ohm: float) -> None:
    day = replace(tiny, load_kw=tiny.load_kw * 0.75)
    plan = decision(day, battery_kw=[-30.0, -28.0])
    weak = Network(
        [1, 2, 2], [2, 3, 4], [0.3, ohm, 0.5], [0.2, ohm, 0.4], slack_bus=1, base_kv=11.0
    )
    done = settle(replace(day, network=weak), plan, state([0.85, 0.85]))
    assert not done.dark
    assert not done.shed.any()
    assert done.ac_failed == ""
    assert generation_less_use_kw(day, done) == pytest.approx(0.0, abs=1e-4)


def test_an_island_whose_flow_is_not_found_keeps_its_customers(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    day = replace(tiny, load_kw=tiny.load_kw * 0.75)
    plan = decision(day, battery_kw=[-30.0, -28.0])
    monkeypatch.setattr(Newton, "solve", lambda *_: None)
    monkeypatch.setattr(nose, "MAX_POINTS", 0)
    done = settle(day, plan, state([0.85, 0.85]))
    assert not done.dark
    assert done.served.all()
    assert done.ac_failed.startswith("nobody shed: the AC power flow was not found: ")
    # The balance without losses holds: 117 kW of demand, 47.5 kW of sun, 58 kW planned.
    assert done.mismatch_kw == pytest.approx([117.0 - 47.5 - 58.0, 0.0], abs=1e-6)


def test_an_island_whose_flow_is_not_found_sheds_what_the_balance_shows(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    # 156 kW of demand against 47.5 kW of sun and 95 kW of the batteries: evidence without a flow.
    plan = decision(tiny, battery_kw=[-30.0, -28.0])
    monkeypatch.setattr(Newton, "solve", lambda *_: None)
    monkeypatch.setattr(nose, "MAX_POINTS", 0)
    done = settle(tiny, plan, state([0.85, 0.85]))
    assert done.shed.tolist() == [False, False, True]
    assert not done.dark
