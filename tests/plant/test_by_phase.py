"""Plant and islands of feeders with phases: every device on its own phases, sets that form them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_scenario
from tests.support.homes import homes, with_random_homes
from tests.support.set_points import asked, state
from tests.support.sets import gensets, random_sets
from tests.support.three_phases import three_phases
from tests.support.vans import chargers, plugged_in, with_random_vehicles
from vppres.contract.decision import Decision
from vppres.kinds.cooling.physics import Climate
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.table import KINDS, units_of
from vppres.physics.feeder import power_flows
from vppres.plant.changes import CUT_MARGIN_KW
from vppres.plant.collapse import realise
from vppres.plant.island import IslandPlant, Settled
from vppres.plant.plant import BatteryState, Plant
from vppres.scenario.assets import Batteries
from vppres.scenario.scenario import Scenario

CONNECTED, DARK = 0, 3
"""Steps of the tiny day with grid, and of its outage: 65, 45 and 46 kW of demand."""

POWERS = (
    *("pv_self_kw", "pv_export_kw", "pv_curtailed_kw", "pv_q_kvar", "charge_kw", "discharge_kw"),
    *("batt_q_kvar", "soc_end", "load_kw"),
)


def played(day: Scenario, plan: Decision, before: BatteryState, t: int, plant: Plant) -> Settled:
    """What a step makes of a decision, in an island that holds itself or with grid."""
    grid, island = power_flows(day)
    if not day.outage[t]:
        return realise(plant, grid, t, plan, before)
    return IslandPlant(plant, island).settle(t, plant.apply(t, plan, before), before)


def alike(one: Settled, other: Settled, within: float = 1e-6) -> None:
    """Powers, states, voltages and losses of two steps are equal."""
    assert (one.dark_reason, one.former) == (other.dark_reason, other.former)
    assert (one.shed == other.shed).all()
    for name in POWERS:
        found, expected = getattr(one, name), getattr(other, name)
        assert found == pytest.approx(expected, abs=within)
    for kind, taken_kw in one.taken_kw.items():
        assert taken_kw == pytest.approx(other.taken_kw[kind], abs=within)
        assert (one.running[kind] == other.running[kind]).all()
    assert one.mismatch_kw == pytest.approx(other.mismatch_kw, abs=within)
    assert one.by_set_kw == pytest.approx(other.by_set_kw, abs=within)
    for name in ("v_pu", "losses_kw", "p_slack_kw", "q_slack_kvar"):
        found, expected = getattr(one.ac, name), getattr(other.ac, name)
        assert found == pytest.approx(expected, rel=1e-6, abs=within, nan_ok=True)


def outcomes(seed: int) -> Iterator[tuple[Settled, Settled]]:
    """Steps of a random island by phase, with three equal phases, and balanced."""
    rng = np.random.default_rng([seed, 60])
    day = with_random_homes(with_random_vehicles(random_scenario(seed), seed), rng)
    sets, b = random_sets(rng, day), day.batteries
    forms = rng.random(len(sets)) < 0.5
    sets = replace(sets, grid_forming=forms, power_factor=np.full(len(sets), 0.8))
    day = replace(day, gensets=sets)
    days = day, three_phases(day)
    plants = [Plant(each, rules=SwitchingRules(cold_load_factor=2.0)) for each in days]
    for t in range(min(day.grid.n_steps, 6)):
        taken_kw = {
            kind: rng.uniform(0.0, units.largest_kw) * (-1.0 if KINDS[kind].gives else 1.0)
            for kind, units in units_of(day).items()
        }
        plan = asked(
            day,
            taken_kw,
            served=rng.random(len(day.customers)) < 0.8,
            battery_kw=rng.uniform(-1.0, 1.0, len(b)) * b.p_max_kw,
            batt_q_kvar=rng.uniform(-0.2, 0.2, len(b)) * b.s_max_kva,
        )
        soc, eta = rng.uniform(b.soc_min, b.soc_max), np.full(len(b), 0.95)
        before = BatteryState(soc, eta, eta, np.full(len(b), 25.0))
        balanced, by_phase = (
            played(each, plan, before, t, plant) for each, plant in zip(days, plants, strict=True)
        )
        yield by_phase, balanced
        for plant in plants:
            plant.advance(t, before, balanced)


@pytest.mark.parametrize("seed", [*range(12), 31, 97])
def test_three_equal_phases_are_the_balanced_feeder(seed: int) -> None:
    for by_phase, balanced in outcomes(seed):
        alike(by_phase, balanced)


@pytest.mark.parametrize("seed", [18, 50, 86, 131, 136])
def test_three_equal_phases_are_the_balanced_feeder_by_the_margin_of_a_cut(seed: int) -> None:
    """A flow by phase may miss a watt, and another round of cuts begins at as much."""
    for by_phase, balanced in outcomes(seed):
        alike(by_phase, balanced, within=2.0 * CUT_MARGIN_KW)


def test_a_former_that_reactive_power_leaves_no_room_holds_its_island() -> None:
    """A lack of a watt was answered by 2 kW of help, then the surplus by curtailment, by turns."""
    for step in outcomes(86):
        assert [each.dark_reason for each in step] == ["", ""]


def on_phases(day: Scenario, **changed: Any) -> Scenario:
    """The tiny day without sun, whose three customers are on a phase each; most batteries rest."""
    coils = {"hospital": "a", "shop": "b", "homes": "c", "k0": "b", "h0": "c", "small": "c"}
    unit = np.ones(3)
    customers = replace(day.customers, power_factor=unit)
    dark = replace(day, customers=customers, pv_kw=0.0 * day.pv_kw, **changed)
    return three_phases(dark, coils)


def settled(day: Scenario, plan: Decision, soc: list[float], t: int = DARK) -> Settled:
    """A step of the tiny day."""
    return played(day, plan, state(soc), t, Plant(day))


EMPTY, FULL = 0.15, 0.85


def test_a_set_forms_an_island_and_gives_what_each_phase_lacks(tiny: Scenario) -> None:
    sets = gensets(p_max_kw=210.0, grid_forming=True, power_factor=0.8)
    day = on_phases(tiny, gensets=sets)
    done = settled(day, asked(day, {"gensets": -30.0}), [EMPTY, EMPTY])
    assert (done.dark, done.former, done.served.all()) == (False, "g0", True)
    given_kw = done.ac.source_kva.real
    assert given_kw == pytest.approx(day.load_kw[DARK], rel=2e-3)
    assert given_kw.sum() == pytest.approx(day.load_kw[DARK].sum() + done.ac.losses_kw, abs=1e-3)
    assert -done.taken_kw["gensets"].sum() == pytest.approx(given_kw.sum(), abs=1e-3)
    assert done.by_set_kw == pytest.approx(given_kw.sum() - 30.0, abs=1e-3)


def test_a_set_takes_over_when_the_battery_that_forms_is_empty(tiny: Scenario) -> None:
    batteries = replace(tiny.batteries, grid_forming=np.array([True, False]))
    sets = gensets(p_max_kw=210.0, grid_forming=True, power_factor=0.8)
    day = on_phases(tiny, gensets=sets, batteries=batteries, load_kw=0.3 * tiny.load_kw)
    plan = asked(day, {"gensets": -30.0})
    assert settled(day, plan, [FULL, EMPTY]).former == "big"
    assert settled(day, plan, [EMPTY, EMPTY]).former == "g0"


def test_a_phase_of_a_set_beyond_its_part_sheds_a_customer_there(tiny: Scenario) -> None:
    """A set of 175 kVA has 58 kVA a phase; the 129 kW in all are within its 140 kW."""
    sets = gensets(p_max_kw=140.0, grid_forming=True, power_factor=0.8)
    day = on_phases(tiny, gensets=sets, load_kw=tiny.load_kw * np.array([1.0, 0.7, 0.7]))
    done = settled(day, asked(day, {}), [EMPTY, EMPTY])
    assert done.shed.tolist() == [True, False, False]
    assert (np.abs(done.ac.source_kva) <= 175.0 / 3.0 + 1e-3).all()


def test_a_vehicle_charges_on_its_phase(tiny: Scenario) -> None:
    day = on_phases(plugged_in(replace(tiny, chargers=chargers()), (0.0, 6.0)))
    idle, charging = (
        settled(day, asked(day, {"chargers": kw}), [EMPTY, EMPTY], CONNECTED) for kw in (0.0, 7.4)
    )
    more_kw = (charging.ac.source_kva - idle.ac.source_kva).real
    assert more_kw == pytest.approx([0.0, 7.4, 0.0], abs=0.02)
    assert charging.ac.v_node_pu.min() < idle.ac.v_node_pu.min() + 1e-6


def test_a_room_holds_its_temperature_on_a_phase(tiny: Scenario) -> None:
    """The machine takes what its room needs through outage and grid."""
    rooms = homes("homes", p_max_kw=10.0, t_initial_c=24.0)
    sets = gensets(p_max_kw=400.0, p_min_kw=0.0, grid_forming=True, power_factor=0.8)
    day = on_phases(replace(tiny, thermal_loads=rooms), gensets=sets)
    plant = Plant(day)
    climate = plant.of(Climate)
    before = state([EMPTY, EMPTY])
    for t in range(day.grid.n_steps):
        kw = climate.thermostat_kw(t, np.array([24.0]), np.ones(3, dtype=bool))
        done = played(day, asked(day, {"thermal_loads": kw}), before, t, plant)
        assert not done.dark and done.taken_kw["thermal_loads"] == pytest.approx(kw)
        assert done.ac.source_kva[2].real == pytest.approx(day.load_kw[t, 2] + kw[0], rel=5e-3)
        before = plant.advance(t, before, done)
        assert climate.state == pytest.approx([24.0], abs=1e-9)


def test_machines_on_an_overloaded_phase_take_less_before_a_customer_is_shed(
    tiny: Scenario,
) -> None:
    """A phase of 160 kVA has 53.3: the homes on it take 46 kW, and their machine 10 kW."""
    sets = gensets(p_max_kw=128.0, grid_forming=True, power_factor=0.8)
    load_kw = tiny.load_kw * np.array([0.5, 0.5, 1.0])
    rooms = homes("homes", p_max_kw=10.0)
    day = on_phases(replace(tiny, thermal_loads=rooms), gensets=sets, load_kw=load_kw)
    done = settled(day, asked(day, {"thermal_loads": 10.0}), [EMPTY, EMPTY])
    assert not done.shed.any()
    assert done.taken_kw["thermal_loads"][0] == pytest.approx(7.3, abs=0.2)


def test_a_set_that_follows_stops_where_it_feeds_a_phase_back(tiny: Scenario) -> None:
    """A battery forms; a set on phase a gives more there than the hospital takes."""
    sets = gensets(p_max_kw=100.0, p_min_kw=60.0)
    load_kw = tiny.load_kw * np.array([0.1, 0.1, 0.4])
    day = replace(tiny, gensets=sets, load_kw=load_kw, batteries=former_alone(tiny))
    day = on_phases(day)
    assert day.phases
    rows = tuple(
        replace(row, coils="a") if row.id == "g0" else row for row in day.phases.connections
    )
    day = replace(day, phases=replace(day.phases, connections=rows))
    done = settled(day, asked(day, {"gensets": -60.0}), [0.5, EMPTY])
    assert (done.dark, done.shed.any()) == (False, False)
    assert not done.running["gensets"].any()


def former_alone(day: Scenario) -> Batteries:
    """The batteries, of which the larger forms the grid."""
    return replace(day.batteries, grid_forming=np.array([True, False]))


def test_customers_just_restored_draw_more_on_their_phase(tiny: Scenario) -> None:
    day = on_phases(tiny)
    cold = Plant(day, rules=SwitchingRules(cold_load_factor=2.0))
    before = state([EMPTY, EMPTY])
    on, off = (asked(day, {}, served=[True, True, served]) for served in (True, False))
    first = played(day, off, before, 0, cold)
    cold.advance(0, before, first)
    done = played(day, on, before, 1, cold)
    drawn_kw = done.ac.source_kva.real
    assert drawn_kw == pytest.approx(day.load_kw[1] * np.array([1.0, 1.0, 2.0]), rel=5e-3)
