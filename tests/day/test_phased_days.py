"""Days of a feeder with phases on which customers, vehicles, machines and sets have their rules.

A battery of 36 kVA forms the grid of the street's islands: a phase of it has 10.8 kW beside its
headroom, which each of these days would exceed on one phase.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.homes import homes
from tests.support.phased_feeder import DARK, NONE_KW, OPEN, STREET, day_of, served, street_day
from tests.support.sets import gensets
from tests.support.vans import chargers, plugged_in
from vppres import RunOptions, run_day
from vppres.core.arrays import Floats
from vppres.day.faults import FaultPlan, SolverOutage
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day
from vppres.explain.phased import PhasedStep
from vppres.explain.prices import step_prices
from vppres.explain.windows import Windows
from vppres.kinds.customer.data import SwitchingRules
from vppres.scenario.phases import PhaseConnection
from vppres.scenario.scenario import Scenario
from vppres.solve import shadow_prices

pytest.importorskip("opendssdirect")

PHASE_KW = 10.8
"""What a phase of the former carries in plans: a third of 36 kVA, less a tenth."""


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    return day_of(STREET, tmp_path_factory.mktemp("street"))


FORMER_KVA = ["former_a_kva", "former_b_kva", "former_c_kva"]
FORMING = {
    "bus": "m", "p_max_kw": 28.8, "p_min_kw": 1.0, "power_factor": 0.8, "grid_forming": True,
    "tank_litres": 900.0, "fuel_level_litres": 900.0,
}  # fmt: skip
"""A set with a rating of 36 kVA that forms islands."""


def on_phase_a(street: Scenario, kw: Floats | list[float], limits_kw: list[float]) -> Scenario:
    """Hours in which the customer of phase a draws this, and the others next to nothing."""
    load_kw = np.full((len(limits_kw), 4), NONE_KW)
    load_kw[:, 0] = kw
    day = street_day(street, load_kw, limits_kw, [0], p_max_kw=34.0)
    b = day.batteries
    return replace(day, batteries=replace(b, energy_kwh=np.where(b.grid_forming, 400.0, 0.1)))


def connected(day: Scenario, coils: str, **units: Any) -> Scenario:
    """The day with units of a kind on phases of bus m."""
    assert day.phases
    names = [str(name) for each in units.values() for name in each.id]
    rows = tuple(PhaseConnection(name, "m", coils, 0.4 / np.sqrt(3.0)) for name in names)
    phases = replace(day.phases, connections=(*day.phases.connections, *rows))
    return replace(day, phases=phases, **units)


def run_of(day: Scenario, **options: Any) -> Trajectory:
    """The day as it went; no phase of an island's former was beyond its rating."""
    run = run_day(day, RunOptions(**{"horizon_h": 2.0, "isolate": False} | options))
    kva = run.steps[FORMER_KVA].to_numpy(float)
    assert np.nanmax(kva, initial=0.0) <= 12.0 + 1e-3
    assert (run.steps["dark_reason"] == "").all() and not run.steps["shed_kw"].any()
    assert (run.steps["fallback"] == "none").all()
    return run


def test_a_vehicle_charges_with_what_its_phase_has_left(street: Scenario) -> None:
    """Of 22 kW a car of phase a gets what the former has beside the customer's 2 kW."""
    day = on_phase_a(street, [2.0] * 3, [DARK] * 3)
    day = connected(day, "a", chargers=chargers(customer="ca", bus=None, p_charge_kw=22.0))
    run = run_of(plugged_in(day, (0.0, 3.0), capacity_kwh=100.0, soc_needed=0.9))
    kw = run.vehicles["p_kw"].to_numpy(float)
    assert kw == pytest.approx(PHASE_KW - 2.0, abs=0.3)
    assert served(run)[:, 0].all()


def test_a_machine_that_cools_has_what_its_phase_has_left(street: Scenario) -> None:
    day = on_phase_a(street, [2.0] * 2, [DARK] * 2)
    hot = homes("ca", p_max_kw=20.0, t_initial_c=40.0, c_kwh_per_c=50.0)
    run = run_of(connected(day, "a", thermal_loads=hot))
    assert run.thermal_loads["p_kw"].to_numpy(float) == pytest.approx(PHASE_KW - 2.0, abs=0.3)


@pytest.mark.parametrize("coils", ["a", "b"])
def test_a_set_supplies_what_is_on_its_own_phase(street: Scenario, coils: str) -> None:
    """14 kW on phase a are too much for the former, unless a set of that phase gives 5 of them."""
    day = on_phase_a(street, [14.0] * 2, [DARK] * 2)
    one = gensets(bus="m", p_max_kw=6.0, p_min_kw=1.0, tank_litres=900.0, fuel_level_litres=900.0)
    run = run_of(connected(day, coils, gensets=one))
    assert served(run)[:, 0].tolist() == [int(coils == "a")] * 2


def formed_by_a_set(street: Scenario, kw: list[float]) -> Scenario:
    """Dark hours with 5 kW on phase b, formed by a set; batteries are small and form nothing."""
    day = on_phase_a(street, kw, [DARK] * len(kw))
    b = day.batteries
    none = replace(b, grid_forming=np.zeros(len(b), dtype=bool), energy_kwh=np.full(len(b), 0.1))
    load_kw = day.load_kw + np.array([0.0, 5.0, 0.0, 0.0])
    day = replace(day, batteries=none, load_kw=load_kw)
    return connected(day, "a b c", gensets=gensets(**FORMING))


@pytest.mark.parametrize(("kw", "on"), [(8.0, 1), (14.0, 0)])
def test_a_set_alone_forms_an_island_and_gives_each_phase_what_it_lacks(
    street: Scenario, kw: float, on: int
) -> None:
    """A phase of the set carries 12 kVA, less its headroom; what it gives at least goes to phase b."""
    run = run_of(formed_by_a_set(street, [kw] * 2))
    assert (run.steps["former"] == "g0").all()
    assert served(run)[:, 0].tolist() == [on] * 2
    assert run.steps["former_a_kva"].to_numpy(float) == pytest.approx(kw * on, abs=0.3)
    assert run.nodes["v_model_pu"].to_numpy() == pytest.approx(
        run.nodes["v_ac_pu"].to_numpy(), abs=1e-4
    )


def test_a_set_forms_the_island_while_the_battery_is_empty(street: Scenario) -> None:
    """The battery, which comes first, forms the second outage: the grid has charged it before."""
    day = on_phase_a(street, [9.0] * 4, [DARK, DARK, OPEN, DARK])
    empty = replace(day.batteries, soc_initial=day.batteries.soc_min)
    day = connected(replace(day, batteries=empty), "a b c", gensets=gensets(**FORMING))
    run = run_of(day, horizon_h=3.0)
    assert run.steps["former"].tolist() == ["g0", "g0", "", "bd"]
    assert served(run)[:, 0].all()
    assert run.gensets["running"].tolist() == [True, True, False, False]


@pytest.mark.parametrize(("kw", "on"), [(8.0, 1), (13.0, 0)])
def test_a_set_that_forms_gives_each_phase_what_it_lacks_without_a_solver_too(
    street: Scenario, kw: float, on: int
) -> None:
    run = failed(formed_by_a_set(street, [kw]))
    assert (run.steps["former"][0], run.steps["dark_reason"][0]) == ("g0", "")
    assert served(run)[0, :2].tolist() == [on, 1]
    assert run.steps["shed_kw"].tolist() == [0.0]
    given_kw = run.steps[FORMER_KVA].to_numpy(float).sum()
    assert run.gensets["p_kw"].tolist() == pytest.approx([given_kw], abs=0.2)


@pytest.mark.parametrize(("soc", "on"), [(0.5, 1), (0.85, 0)])
def test_what_a_set_gives_at_least_charges_a_battery_without_a_solver(
    street: Scenario, soc: float, on: int
) -> None:
    """Of the 9 kW of the set a customer takes 4; a full battery has no room for the others."""
    day = on_phase_a(street, [4.0], [DARK])
    b = day.batteries
    resting = replace(b, grid_forming=np.zeros(4, dtype=bool), soc_initial=np.full(4, soc))
    sets = gensets(**FORMING | {"p_min_kw": 9.0})
    run = failed(connected(replace(day, batteries=resting), "a b c", gensets=sets))
    assert served(run)[0, 0] == on
    assert (run.steps["former"][0] == "g0") == bool(on)
    assert run.gensets["p_kw"].tolist() == pytest.approx([9.2 * on], abs=0.3)


def failed(day: Scenario) -> Trajectory:
    """The day whose first answer fails."""
    options = RunOptions(horizon_h=0.0, isolate=False)
    run = run_day(day, options, faults=FaultPlan({0: SolverOutage("killed")}))
    assert run.steps["fallback"][0] == "rule"
    return run


def test_a_customer_is_dimmed_to_what_its_phase_carries(street: Scenario) -> None:
    day = on_phase_a(street, [14.0] * 2, [DARK] * 2)
    customers = replace(day.customers, share_min=np.where(day.customers.id == "ca", 0.5, 1.0))
    run = run_of(replace(day, customers=customers))
    one = run.customers[run.customers["id"] == "ca"]
    assert one["share"].to_numpy(float) == pytest.approx(PHASE_KW / 14.0, abs=0.03)


def test_as_many_parts_of_homes_are_on_as_their_phase_carries(street: Scenario) -> None:
    day = on_phase_a(street, [16.0] * 2, [DARK] * 2)
    parts = np.where(day.customers.id == "ca", 4, 1)
    run = run_of(replace(day, customers=replace(day.customers, shed_steps=parts)))
    of_a = run.customers[run.customers["id"].str.startswith("ca")]
    assert of_a.groupby("time")["served"].sum().tolist() == [2, 2]


def two_on_phase_a(street: Scenario, hours: int) -> Scenario:
    """Two alike of 8 kW on phase a, of which the island carries one."""
    day = on_phase_a(street, [8.0] * hours, [DARK] * hours)
    load_kw = day.load_kw.copy()
    load_kw[:, 1] = 8.0
    assert day.phases
    rows = [replace(row, coils="a") if row.id == "cb" else row for row in day.phases.connections]
    moved = [replace(row, bus="m") if row.id == "cb" else row for row in rows]
    bus = np.where(day.customers.id == "cb", "m", day.customers.bus).astype(object)
    alike = replace(
        day.customers, bus=bus, weight=np.full(4, 0.02), tier=np.full(4, "low", dtype=object)
    )
    phases = replace(day.phases, connections=tuple(moved))
    return replace(day, phases=phases, customers=alike, load_kw=load_kw)


@pytest.mark.daily
def test_longest_times_off_change_who_is_on_supply_of_a_phase(street: Scenario) -> None:
    day = two_on_phase_a(street, 4)
    limit = np.where(np.isin(day.customers.id, ["ca", "cb"]), 1.0, np.nan)
    run = run_of(replace(day, customers=replace(day.customers, max_off_h=limit)))
    on = served(run)[:, :2]
    assert (on.sum(axis=1) == 1).all() and (on[1:] != on[:-1]).all()


@pytest.mark.daily
def test_those_who_share_supply_take_turns_on_their_phase(street: Scenario) -> None:
    run = run_of(two_on_phase_a(street, 4), rotation=0.5, turn_h=1.0, horizon_h=0.0)
    assert served(run)[:, :2].sum(axis=0).min() >= 1
    alone = run_of(two_on_phase_a(street, 4), horizon_h=0.0)
    assert served(alone)[:, :2].sum(axis=0).min() == 0


@pytest.mark.parametrize(("factor", "hour"), [(1.0, 1), (2.0, 0)])
def test_a_restored_customer_draws_more_on_its_phase(
    street: Scenario, factor: float, hour: int
) -> None:
    """14 kW are too much, and then 8 kW are not, unless they are twice as much at first."""
    day = on_phase_a(street, [14.0, 8.0], [DARK] * 2)
    rules = SwitchingRules(cold_load_factor=factor, cold_load_h=1.0)
    run = run_of(day, horizon_h=0.0, switching=rules)
    assert served(run)[:, 0].tolist() == [0, hour]


def test_a_restored_customer_is_on_with_the_voltage_that_it_brings_about(street: Scenario) -> None:
    """With grid nobody is off for a voltage that the feeder has without control."""
    day = on_phase_a(street, [14.0, 120.0], [DARK, OPEN])
    run = run_of(day, horizon_h=0.0, switching=SwitchingRules(cold_load_factor=2.0))
    assert served(run)[:, 0].tolist() == [0, 1]


@pytest.mark.parametrize(("limits", "on"), [("soft", 1), ("hard", 0)])
def test_hard_limits_switch_a_customer_off_for_a_voltage_of_its_phase(
    street: Scenario, limits: str, on: int
) -> None:
    day = on_phase_a(street, [220.0], [OPEN])
    run = run_of(day, horizon_h=0.0, voltage_limits=limits)
    assert served(run)[:, 0].tolist() == [on]
    lowest = run.nodes["v_model_pu"].min()
    assert (lowest >= day.network.v_min_pu - 1e-6) == (limits == "hard")


@pytest.mark.daily
def test_explanations_begin_at_the_power_of_every_device(street: Scenario) -> None:
    """The former's phases as they are reckoned from a record are those of the plant.

    A vehicle charges, a set follows, a customer is dimmed, and then a set forms the island.
    """
    day = on_phase_a(street, [14.0, 18.0], [DARK] * 2)
    customers = replace(day.customers, share_min=np.where(day.customers.id == "ca", 0.5, 1.0))
    fuel = {"tank_litres": 90.0, "fuel_level_litres": 90.0}
    following = gensets(bus="m", p_max_kw=4.0, p_min_kw=1.0, **fuel)
    cars = chargers(customer="ca", bus=None, p_charge_kw=3.0)
    day = connected(replace(day, customers=customers), "a", gensets=following, chargers=cars)
    day = plugged_in(day, (0.0, 2.0), capacity_kwh=100.0, soc_needed=0.9)
    for each in (day, formed_by_a_set(street, [8.0, 13.0])):
        run = run_day(each, RunOptions(horizon_h=0.0, isolate=False))
        windows = Windows(run)
        kva = run.steps[FORMER_KVA].to_numpy(float)
        for t in range(2):
            assert np.abs(PhasedStep(windows.recorded, t).former_kva) == pytest.approx(
                kva[t], abs=1e-3
            )
            window = windows.seen(t).phased
            assert np.abs(window.former_kva[0]) == pytest.approx(kva[t], abs=1e-3)
    words = explain_day(run).explanations
    assert "one more kVA on phase a of g0 would add" in " ".join(words["words"])


@pytest.mark.daily
def test_the_tree_of_a_feeder_with_phases_has_no_part_in_its_prices(
    street: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    day = on_phase_a(street, 12.0, [np.inf, DARK])
    run = run_of(day, horizon_h=1.0)

    def prices(t: int, letters: int) -> dict[str, Floats]:
        windows = Windows(run)
        found, model = step_prices(windows, t), windows.model(t, windows.seen(t).n_steps)
        assert len({"u", "P_flow", "Q_flow"} & model.first.keys()) == letters
        level = found.service if found.cost is None else found.cost
        names = ("stored_energy", "active", "reactive", "former_phase", "battery_inverter")
        return {name: getattr(level.prices, name) for name in names}

    own = [prices(t, letters=0) for t in (0, 1)]
    for name in ("VOLTAGES", "FLOWS"):
        monkeypatch.setattr(shadow_prices, name, frozenset())
    with_tree = [prices(t, letters=3) for t in (0, 1)]
    assert any(each["active"].any() for each in own)
    for one, other in zip(own, with_tree, strict=True):
        for name, values in one.items():
            np.testing.assert_allclose(values, other[name], atol=1e-6, err_msg=name)
