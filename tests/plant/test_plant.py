"""The plant: what really happens with set-points, good or wild."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from benchmarks.frame.random_feeders import random_scenario
from tests.support.set_points import decision, state
from vppres.contract.decision import Decision
from vppres.kinds.customer.data import SwitchingRules
from vppres.plant.plant import Plant, Powers, Realised
from vppres.scenario.scenario import Scenario


def happened(scenario: Scenario, t: int, soc: ArrayLike, given_: Decision) -> Realised:
    """What the plant makes of a decision."""
    return Plant(scenario).apply(t, given_, state(soc))


def test_set_points_within_limits_are_carried_out(tiny: Scenario) -> None:
    done = happened(tiny, 0, 0.5, decision(tiny, battery_kw=[20.0, -10.0]))
    assert done.charge_kw.tolist() == [20.0, 0.0]
    assert done.discharge_kw.tolist() == [0.0, 10.0]
    assert done.soc_end == pytest.approx([0.5 + 0.95 * 20 / 100, 0.5 - 10 / 0.95 / 60])
    assert done.clipped_kw == 0.0


def test_charging_stops_when_full(tiny: Scenario) -> None:
    # Room for 5 kWh and 3 kWh in the cells, 5 / 0.95 and 3 / 0.95 kW at the terminals.
    done = happened(tiny, 0, 0.80, decision(tiny, battery_kw=[50.0, 30.0]))
    assert done.charge_kw == pytest.approx([5.0 / 0.95, 3.0 / 0.95])
    assert done.soc_end == pytest.approx([0.85, 0.85])
    assert done.clipped_kw == pytest.approx(50.0 - 5.0 / 0.95)


def test_discharging_stops_when_empty(tiny: Scenario) -> None:
    done = happened(tiny, 0, [0.15, 0.25], decision(tiny, battery_kw=[-50.0, -30.0]))
    assert done.discharge_kw == pytest.approx([0.0, 6.0 * 0.95])
    assert done.soc_end == pytest.approx([0.15, 0.15])


def test_worse_efficiency_than_planned_shortens_the_discharge(tiny: Scenario) -> None:
    plan = decision(tiny, battery_kw=[-50.0, 0.0])
    done = Plant(tiny).apply(0, plan, state(0.65, eta=0.8))
    assert done.discharge_kw[0] == pytest.approx(50.0 * 0.8)
    assert done.soc_end[0] == pytest.approx(0.15)


def test_power_rating_holds(tiny: Scenario) -> None:
    done = happened(tiny, 0, 0.5, decision(tiny, battery_kw=[80.0, -80.0]))
    assert (done.charge_kw[0], done.discharge_kw[1]) == (pytest.approx(35.0 / 0.95), 19.95)
    shorter = replace(tiny, grid=replace(tiny.grid, step_minutes=15.0))
    done = happened(shorter, 0, 0.5, decision(shorter, battery_kw=[80.0, -80.0]))
    assert (done.charge_kw[0], done.discharge_kw[1]) == (50.0, 30.0)


def test_inverter_rating_holds_where_it_is_below_the_power_rating(tiny: Scenario) -> None:
    small = replace(tiny, batteries=replace(tiny.batteries, s_max_kva=np.array([20.0, 20.0])))
    done = happened(small, 0, 0.5, decision(small, battery_kw=[30.0, -19.0], batt_q_kvar=5.0))
    apparent = np.hypot(done.charge_kw - done.discharge_kw, done.batt_q_kvar)
    assert (apparent <= 20.0 + 1e-9).all()


def test_charge_against_discharge_is_netted(tiny: Scenario) -> None:
    plan = decision(tiny, battery_kw=[20.0, 0.0])
    both = replace(plan, dispatch=replace(plan.dispatch, discharge_kw=np.array([[5.0, 0.0]])))
    done = happened(tiny, 0, 0.5, both)
    assert (done.charge_kw[0], done.discharge_kw[0]) == (15.0, 0.0)


def test_reactive_power_gives_way_to_active_power(tiny: Scenario) -> None:
    # 60 kVA with 48 kW leave 36 kvar; 35 kVA with 21 kW leave 28 kvar.
    plan = decision(tiny, battery_kw=[-48.0, -21.0], batt_q_kvar=[50.0, -50.0])
    done = happened(tiny, 0, [0.85, 0.85], plan)
    assert done.discharge_kw.tolist() == [48.0, 21.0]
    assert done.batt_q_kvar == pytest.approx([36.0, -28.0])


def test_reactive_limit_follows_the_active_power_that_is_left(tiny: Scenario) -> None:
    # The empty battery delivers nothing, so its whole rating is free for reactive power.
    done = happened(tiny, 0, 0.15, decision(tiny, battery_kw=-30.0, batt_q_kvar=60.0))
    assert done.discharge_kw.tolist() == [0.0, 0.0]
    assert done.batt_q_kvar == pytest.approx([60.0, 35.0])


def test_pv_of_a_served_owner_feeds_the_owner_first(tiny: Scenario) -> None:
    done = happened(tiny, 1, 0.5, decision(tiny))
    assert done.pv_self_kw == pytest.approx([28.0, 19.0])
    sunny = replace(tiny, load_kw=np.full_like(tiny.load_kw, 10.0))
    done = happened(sunny, 1, 0.5, decision(sunny, curtailed_kw=[3.0, 0.0]))
    assert done.pv_self_kw == pytest.approx([10.0, 10.0])
    assert done.pv_curtailed_kw == pytest.approx([3.0, 0.0])
    assert done.pv_export_kw == pytest.approx([15.0, 9.0])


def test_pv_of_an_owner_that_is_not_served_is_exported_or_curtailed(tiny: Scenario) -> None:
    done = happened(
        tiny, 1, 0.5, decision(tiny, served=[False, True, True], curtailed_kw=[8.0, 0.0])
    )
    assert (done.pv_self_kw[0], done.pv_export_kw[0], done.pv_curtailed_kw[0]) == (0.0, 20.0, 8.0)


def test_self_consumption_is_never_curtailed(tiny: Scenario) -> None:
    done = happened(tiny, 1, 0.5, decision(tiny, curtailed_kw=100.0))
    assert done.pv_self_kw == pytest.approx([28.0, 19.0])
    assert done.pv_curtailed_kw == pytest.approx([0.0, 0.0])
    assert done.clipped_kw == pytest.approx(100.0)


def test_inverter_curtails_what_it_cannot_pass(tiny: Scenario) -> None:
    small = replace(tiny, pv=replace(tiny.pv, s_max_kva=np.array([21.0, 30.0])))
    done = happened(small, 1, 0.5, decision(small, served=False))
    assert done.pv_curtailed_kw == pytest.approx([7.0, 0.0])
    assert done.pv_export_kw == pytest.approx([21.0, 19.0])


def test_inverter_below_the_owners_demand_neither_overloads_nor_makes_energy(
    tiny: Scenario,
) -> None:
    # 28 kW of sun, 62 kW of demand, 21 kVA between them.
    small = replace(tiny, pv=replace(tiny.pv, s_max_kva=np.array([21.0, 30.0])))
    done = happened(small, 1, 0.5, decision(small))
    assert (done.pv_self_kw + done.pv_export_kw)[0] <= 21.0 + 1e-9
    assert (done.pv_self_kw + done.pv_export_kw + done.pv_curtailed_kw)[0] == pytest.approx(28.0)


def test_reactive_limit_counts_what_passes_the_inverter(tiny: Scenario) -> None:
    # 28 kW of sun, 20 kW for the owner and 8 kW exported: 40 kVA leave sqrt(40^2 - 28^2) kvar.
    low = replace(tiny, load_kw=np.tile([20.0, 40.0, 50.0], (6, 1)))
    plan = decision(low, battery_kw=[30.0, -15.0], pv_q_kvar=[35.0, 0.0], batt_q_kvar=[60.0, 35.0])
    done = happened(low, 1, 0.5, plan)
    assert (done.pv_self_kw[0], done.pv_export_kw[0]) == (20.0, 8.0)
    assert done.pv_q_kvar == pytest.approx([np.sqrt(40.0**2 - 28.0**2), 0.0])
    # Charging and discharging take their share of 60 and 35 kVA alike.
    assert done.batt_q_kvar == pytest.approx(
        [np.sqrt(60.0**2 - 30.0**2), np.sqrt(35.0**2 - 15.0**2)]
    )


@pytest.mark.parametrize(
    ("change", "clipped_kw"),
    [({"battery_kw": [0.0, -30.0]}, 30.0 - 21.0 * 0.95), ({"curtailed_kw": [9.0, 30.0]}, 11.0)],
)
def test_largest_move_of_a_set_point_is_named(
    tiny: Scenario, change: dict[str, list[float]], clipped_kw: float
) -> None:
    # 21 kWh above the lower limit give 19.95 kW; of 19 kW nothing is used where nobody is served.
    done = happened(tiny, 1, 0.5, decision(tiny, served=False, **change))
    assert done.clipped_kw == pytest.approx(clipped_kw)


def test_demand_after_a_restoration_is_drawn_and_recorded(tiny: Scenario) -> None:
    plant = Plant(tiny, rules=SwitchingRules(cold_load_factor=2.0, cold_load_h=1.0))
    off = plant.apply(0, decision(tiny, served=[False, True, True]), state(0.5))
    plant.advance(0, state(0.5), off)
    done = plant.apply(1, decision(tiny), state(0.5))
    assert done.load_kw.tolist() == [2 * 62.0, 41.0, 48.0]
    assert done.p_injection_kw == pytest.approx([0.0, -2 * 62.0 + 28.0, -41.0, -48.0 + 19.0])


def test_rounding_cannot_lift_the_charge_above_its_limit(tiny: Scenario) -> None:
    powers = Powers(
        np.ones(3, bool),
        np.zeros(2),
        np.zeros(2),
        np.zeros(2),
        np.zeros(2),
        np.array([50.0, -30.0]),
        np.zeros(2),
    )
    done = Plant(tiny).realise(0, powers, state([0.8, 0.2]))
    assert done.soc_end.tolist() == [0.85, 0.15]
    assert done.clipped_kw == 0.0


def test_injections_are_the_sum_at_each_bus(tiny: Scenario) -> None:
    plan = decision(
        tiny,
        served=[True, False, True],
        battery_kw=[10.0, -5.0],
        pv_q_kvar=[4.0, 0.0],
        batt_q_kvar=[1.0, 2.0],
    )
    done = happened(tiny, 1, 0.5, plan)
    q_hospital, _, q_homes = tiny.load_kw[1] * np.tan(np.arccos(tiny.customers.power_factor))
    assert done.p_injection_kw == pytest.approx([0.0, -62.0 + 28.0 - 10.0, 0.0, -48.0 + 19.0 + 5.0])
    assert done.q_injection_kvar == pytest.approx(
        [0.0, -q_hospital + 4.0 + 1.0, 0.0, -q_homes + 2.0]
    )


def test_state_follows_the_steps(tiny: Scenario) -> None:
    plant = Plant(tiny)
    before = plant.initial_state()
    assert before.soc.tolist() == [0.15, 0.5]
    done = plant.apply(0, decision(tiny, battery_kw=[20.0, 0.0]), before)
    after = plant.advance(0, before, done)
    assert after.soc == pytest.approx([0.15 + 0.95 * 20.0 / 100.0, 0.5])
    assert after.eta_charge.tolist() == [0.95, 0.95]


def test_hot_cells_lose_efficiency_in_the_next_step(tiny: Scenario) -> None:
    plant = Plant(tiny, "exact")
    before = plant.initial_state()
    assert before.t_cell_c.tolist() == [28.0, 28.0]
    done = plant.apply(0, decision(tiny, battery_kw=[50.0, 0.0]), before)
    after = plant.advance(0, before, done)
    assert after.t_cell_c[0] > after.t_cell_c[1] == pytest.approx(28.0)
    assert after.eta_charge[0] < after.eta_charge[1] < 0.95


def test_idle_cells_follow_the_ambient_of_their_own_step(tiny: Scenario) -> None:
    # T = T_amb + (T_0 - T_amb) exp(-dt / (R C)), with R C = 3.5 C/kW x 0.3 kWh/C = 1.05 h. The
    # hours have 28, 30, 32 and 34 C: an ambient of another step gives another temperature.
    plant = Plant(tiny, "exact")
    now = plant.initial_state()
    expected_c = 28.0
    for t in range(4):
        now = plant.advance(t, now, plant.apply(t, decision(tiny), now))
        ambient_c = tiny.temperature_c[t]
        expected_c = ambient_c + (expected_c - ambient_c) * np.exp(-1.0 / 1.05)
        assert now.t_cell_c == pytest.approx([expected_c, expected_c], abs=1e-12)


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), stressed=st.booleans(), size=st.sampled_from([0.1, 1.0, 5.0]))
def test_limits_hold_whatever_is_asked_for(seed: int, stressed: bool, size: float) -> None:
    """Energy, ratings and the PV split hold for set-points that no plan would contain."""
    day = random_scenario(seed, stressed)
    rng, b, pv = np.random.default_rng(seed), day.batteries, day.pv
    scale = b.p_max_kw * size
    plan = decision(
        day,
        rng.random(len(day.customers)) < 0.7,
        rng.uniform(0.0, 1.0, len(pv)) * size * pv.p_max_kw,
        np.clip(rng.uniform(-scale, scale), -b.s_max_kva, b.s_max_kva),
        rng.uniform(-size, size, len(pv)) * pv.s_max_kva,
        rng.uniform(-size, size, len(b)) * b.s_max_kva,
    )
    plant = Plant(day)
    before = plant.initial_state()
    done = plant.apply(0, plan, before)
    net = done.charge_kw - done.discharge_kw
    kwh = day.grid.dt_h * (b.eta_charge * done.charge_kw - done.discharge_kw / b.eta_discharge)
    assert done.soc_end == pytest.approx(before.soc + kwh / b.energy_kwh, abs=1e-12)
    assert (done.soc_end >= b.soc_min).all() and (done.soc_end <= b.soc_max).all()
    assert (np.minimum(done.charge_kw, done.discharge_kw) == 0.0).all()
    assert (np.hypot(net, done.batt_q_kvar) <= b.s_max_kva * (1 + 1e-12)).all()
    split = done.pv_self_kw + done.pv_export_kw + done.pv_curtailed_kw
    assert split == pytest.approx(day.pv_kw[0], abs=1e-9)
    owner = [day.customers.id.tolist().index(c) for c in pv.customer]
    assert (done.pv_self_kw <= day.load_kw[0, owner] * done.served[owner] + 1e-9).all()
    assert (done.pv_self_kw + done.pv_export_kw <= pv.s_max_kva + 1e-9).all()
    served_kw = day.load_kw[0] @ done.served
    assert done.p_injection_kw.sum() == pytest.approx(
        (day.pv_kw[0] - done.pv_curtailed_kw).sum() - served_kw - net.sum(), abs=1e-8
    )
