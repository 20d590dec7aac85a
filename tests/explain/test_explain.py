"""Reasons and shadow prices: solved by hand, checked by perturbing and solving again."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import pytest

import vppres
from tests.support.made_up_runs import batteries, small_run
from tests.support.tiny_day import tiny_scenario
from vppres.day.faults import BatteryTrip, FaultPlan
from vppres.day.metrics import reason_figures
from vppres.day.options import RunOptions
from vppres.day.phases import phases
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day, steps_of
from vppres.explain.reason import DRIVERS, Driver
from vppres.explain.windows import Windows
from vppres.explain.words import figure, hours
from vppres.kinds.customer.physics import Owed
from vppres.model.data import WindowData
from vppres.model.parts import Parts
from vppres.model.site import Site
from vppres.report.finished import read_finished, rewrite_report
from vppres.report.run_folder import write_run
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.priority import Ranks
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.solve.shadow_prices import (
    FixedDecisions,
    PricedTerms,
    PricedWindow,
    ShadowPriceModel,
    price_window,
)

SERVICE = PricedTerms(1.0, 0.0, 0.1)


def island(
    energy_kwh: float = 40.0,
    power_kw: float = 100.0,
    inverter_kva: float = 200.0,
    r_ohm: float = 0.01,
    steps: int = 1,
) -> Scenario:
    """One battery at bus 2 with ``energy_kwh`` to give and no losses; two customers of 30 kW.

    "first" (weight 1) is at bus 2, "second" (weight 0.3) at bus 3, behind ``r_ohm``; pure active
    power; there is no grid.
    """
    store = replace(
        batteries([2], 200.0),
        p_max_kw=[power_kw],
        s_max_kva=[inverter_kva],
        soc_min=[0.1],
        soc_initial=[0.1 + energy_kwh / 200.0],
        eta_charge=[1.0],
        eta_discharge=[1.0],
    )
    return Scenario(
        name="island",
        title="One battery, two customers",
        controller=ControllerDefaults(mode="paper", voltage_limits=HARD, ratings=REPORT),
        grid=TimeGrid(pd.Timestamp("2022-07-19", tz="UTC"), 60.0, steps),
        network=Network([1, 2], [2, 3], [0.01, r_ohm], [0.01, 0.01], slack_bus=1, base_kv=1.0),
        customers=Customers(
            id=["first", "second"],
            bus=[2, 3],
            tier=["critical", "low"],
            weight=[1.0, 0.3],
            power_factor=[1.0, 1.0],
        ),
        pv=PVSystems(id=[], customer=[], p_max_kw=[], s_max_kva=[]),
        batteries=store,
        load_kw=np.full((steps, 2), 30.0),
        pv_kw=np.zeros((steps, 0)),
        price_gbp_per_kwh=np.full(steps, 0.3),
        temperature_c=np.full(steps, 25.0),
        grid_limit_kw=np.zeros(steps),
    )


def window(day: Scenario) -> WindowData:
    """The whole day as one window."""
    b = day.batteries
    return WindowData(
        day.load_kw,
        day.pv_kw,
        day.price_gbp_per_kwh,
        day.grid_limit_kw,
        b.soc_initial,
        b.eta_charge,
        b.eta_discharge,
        np.zeros((day.grid.n_steps, day.network.n_lines)),
        owed=Owed.of(day.customers, day.grid.dt_h),
        parts=Parts.one(day.network, len(b), day.grid.n_steps),
    )


def solved(
    day: Scenario, data: WindowData | None = None, priced: PricedTerms = SERVICE
) -> PricedWindow:
    """The pricing problem of the day with "first" served in its first step."""
    data = window(day) if data is None else data
    W, B = data.n_steps, len(day.batteries)
    lowest = np.zeros((W, len(day.customers)))
    lowest[0, 0] = 1.0
    held = FixedDecisions(lowest, np.ones_like(lowest), np.zeros(B), np.ones(B))
    answer = price_window(ShadowPriceModel(Site.of(day), W), data, held, priced)
    assert answer is not None
    return answer


def with_battery(day: Scenario, **values: float) -> Scenario:
    return replace(day, batteries=replace(day.batteries, **{n: [v] for n, v in values.items()}))


def test_every_driver_has_its_words() -> None:
    assert DRIVERS.keys() == {name for part in get_args(Driver) for name in get_args(part)}


def test_energy_by_hand() -> None:
    answer = solved(island(energy_kwh=40.0))
    # 10 kWh are left for the second, whose 30 kWh count 0.3.
    assert answer.served_share[0] == pytest.approx([1.0, 1 / 3], abs=1e-6)
    assert answer.prices.stored_energy == pytest.approx([0.01], rel=1e-5)
    assert answer.prices.energy_floor == pytest.approx([0.01], rel=1e-5)
    assert answer.prices.active == pytest.approx([0.01] * 3, rel=1e-5)
    assert answer.prices.battery_discharging == pytest.approx([0.0], abs=1e-7)
    # The second is at the margin; the first gains its weight less 30 kWh of that worth.
    assert answer.prices.service[1] == pytest.approx(0.0, abs=1e-6)


def test_one_more_kwh_of_an_empty_battery_of_megawatt_hours_gains_what_it_serves() -> None:
    empty = with_battery(
        island(energy_kwh=0.0, steps=3),
        energy_kwh=34_200.0,
        p_max_kw=48_613.0,
        s_max_kva=72_920.0,
        eta_charge=0.95,
        eta_discharge=0.7,
    )
    load_kw, limit_kw = np.tile([140.0, 23_410.0], (3, 1)), np.array([0.0, 0.0, np.inf])
    run = run_day(replace(empty, load_kw=load_kw, grid_limit_kw=limit_kw))
    _, prices = tables(explain_day(run))
    stored = prices.loc[prices["constraint"] == "stored_energy", "weighted_h"]
    assert stored.tolist()[:2] == pytest.approx([0.7 / 140.0] * 2, rel=0.02)


def test_energy_kept_for_later_by_hand() -> None:
    day = island(energy_kwh=60.0, steps=2)
    answer = solved(replace(day, load_kw=np.array([[30.0, 30.0], [60.0, 30.0]])))
    # The first comes first in both steps: 30 kWh now, 30 of 60 kWh then, worth 1 / 60 each.
    assert answer.prices.stored_energy == pytest.approx([1 / 60], rel=1e-5)
    assert answer.prices.service[1] == pytest.approx(0.3 - 30 / 60, rel=1e-5)


def test_power_by_hand() -> None:
    answer = solved(island(power_kw=35.0, energy_kwh=100.0))
    assert answer.prices.battery_discharging == pytest.approx([0.01], rel=1e-5)
    assert answer.prices.stored_energy == pytest.approx([0.0], abs=1e-7)


def test_inverter_by_hand() -> None:
    answer = solved(island(inverter_kva=35.0, energy_kwh=100.0))
    assert answer.prices.battery_inverter == pytest.approx([0.01], rel=1e-4)
    assert answer.prices.battery_discharging == pytest.approx([0.0], abs=1e-6)


def test_voltage_by_hand() -> None:
    # In squared pu at 1 kV a line of 3 ohm drops 2 * 3 * P / 1000; 0.947^2 is reached at 17.2 kW.
    answer = solved(island(r_ohm=3.0, energy_kwh=100.0))
    supplied_kw = (1.0 - 0.947**2) / 0.006
    assert answer.served_share[0, 1] == pytest.approx(supplied_kw / 30.0, rel=1e-4)
    per_milli_pu = 2 * 0.947 * 1e-3 / 0.006 * 0.01
    assert answer.prices.voltage_floor == pytest.approx(
        [0.0, 0.0, per_milli_pu], rel=1e-3, abs=1e-7
    )
    # What comes from the slack bus takes 0.02 / 1000 of the squared voltage on its way.
    assert answer.prices.active == pytest.approx([-0.01 / 300, 0.0, 0.01], rel=1e-4, abs=1e-6)


def test_cost_of_a_stored_kwh_by_hand() -> None:
    day = replace(
        island(energy_kwh=10.0, steps=2),
        grid_limit_kw=np.full(2, np.inf),
        price_gbp_per_kwh=np.array([0.2, 0.5]),
    )
    day = with_battery(day, eta_charge=0.9, eta_discharge=0.8, p_max_kw=20.0)
    data, everyone = window(day), np.ones((2, 2))
    held = FixedDecisions(everyone, everyone, np.zeros(1), np.ones(1))
    answer = price_window(ShadowPriceModel(Site.of(day), 2), data, held, PricedTerms(0.0, 1.0, 0.0))
    # The dear hour's discharge is at its 20 kW: what is left decides on the cheap hour's purchase.
    assert answer.prices.stored_energy == pytest.approx([0.2 / 0.9], rel=1e-5)
    assert answer.prices.active == pytest.approx([0.2] * 3, rel=1e-5)


# Which limit stops the supply, and the price of one more unit of it, by the test below.
LIMITS = {
    "energy": {"energy_kwh": 40.0},
    "energy and power": {"energy_kwh": 50.0, "power_kw": 35.0},
    "inverter": {"energy_kwh": 100.0, "inverter_kva": 40.0},
    "voltage": {"energy_kwh": 90.0, "r_ohm": 3.0},
    "power": {"energy_kwh": 140.0, "power_kw": 35.0},
}


UNITS = [
    ("stored_energy", "soc_initial", 1 / 200.0, 2, {"energy", "energy and power", "voltage"}),
    ("energy_floor", "soc_min", -1 / 200.0, 2, {"energy", "energy and power", "voltage"}),
    # A rating counts in every step, and its price is that of the first: one step alone.
    ("battery_discharging", "p_max_kw", 1.0, 1, {"energy and power", "power"}),
    ("battery_inverter", "s_max_kva", 1.0, 1, {"inverter"}),
]
BY_DAY = {("energy", "soc_initial"), ("voltage", "soc_min"), ("power", "p_max_kw")}
BY_DAY |= {("inverter", "s_max_kva"), ("inverter", "soc_initial")}


@pytest.mark.parametrize(
    ("limit", "name", "field", "step", "steps", "binding"),
    [
        pytest.param(limit, *unit, marks=() if (limit, unit[1]) in BY_DAY else pytest.mark.nightly)
        for limit in LIMITS
        for unit in UNITS
    ],
)
def test_one_more_unit_buys_its_shadow_price(
    limit: str, name: str, field: str, step: float, steps: int, binding: set[str]
) -> None:
    day = island(**LIMITS[limit], steps=steps)
    day = replace(day, customers=replace(day.customers, power_factor=[0.95, 0.9]))
    before = solved(day)
    value = float(getattr(day.batteries, field)[0])
    after = [
        solved(with_battery(day, **{field: value + sign * 0.01 * step})).value for sign in (1, -1)
    ]
    slope = (after[0] - after[1]) / 0.02
    price = float(getattr(before.prices, name)[0])
    assert price == pytest.approx(slope, rel=1e-2, abs=2e-6)
    assert (price > 1e-3) == (limit in binding)


def with_source(day: Scenario, bus: int, p_kw: float, s_kva: float) -> Scenario:
    """The day with a PV system of a customer without demand or weight."""
    c = day.customers
    return replace(
        day,
        customers=Customers(
            [*c.id, "none"],
            [*c.bus, bus],
            [*c.tier, "low"],
            [*c.weight, 0.0],
            [*c.power_factor, 1.0],
        ),
        pv=PVSystems(["source"], ["none"], [s_kva], [s_kva]),
        pv_kw=np.full((1, 1), p_kw),
        load_kw=np.append(day.load_kw, [[0.0]], axis=1),
    )


@pytest.mark.parametrize("bus", [3, *(pytest.param(n, marks=pytest.mark.nightly) for n in (1, 2))])
def test_power_put_into_a_bus_buys_its_shadow_price(bus: int) -> None:
    # Reactive demand, a small inverter and a long line: power factor, rating and voltage matter.
    day = island(energy_kwh=100.0, inverter_kva=45.0, r_ohm=2.0)
    day = replace(day, customers=replace(day.customers, power_factor=[0.9, 0.85]))
    priced = PricedTerms(1.0, 0.0, 0.0)

    def gain(p_kw: float, s_kva: float) -> float:
        values = [
            solved(with_source(day, bus, size * p_kw, size * s_kva + 1e-6), priced=priced).value
            for size in (0.1, 0.3)
        ]
        return (values[1] - values[0]) / 0.2

    prices = solved(day, priced=priced).prices
    active, reactive = prices.active[bus - 1], prices.reactive[bus - 1]
    assert active > 1e-3 and reactive > 1e-3
    assert gain(0.0, 1.0) == pytest.approx(reactive, rel=2e-2)
    # A full inverter gives one kVA in the best direction.
    assert gain(1.0, 1.0) == pytest.approx(np.hypot(active, reactive), rel=2e-2)


@pytest.mark.parametrize(
    "t", [6, 9, *(pytest.param(t, marks=pytest.mark.nightly) for t in (2, 7, 12))]
)
def test_one_more_kwh_on_the_heatwave_day(heatwave: Trajectory, t: int) -> None:
    windows = Windows(heatwave)
    data = windows.seen(t)
    held = windows.held(t, data.n_steps)
    model = ShadowPriceModel(windows.site, data.n_steps)
    before = price_window(model, data, held, SERVICE)
    for battery in (0, 17):
        per_kwh = np.zeros(len(data.soc))
        per_kwh[battery] = 1.0 / windows.site.batteries.energy_kwh[battery]
        values = []
        for kwh in (0.1, -0.1):
            after = price_window(model, replace(data, soc=data.soc + kwh * per_kwh), held, SERVICE)
            values.append(np.nan if after is None else after.value)
        low, high = sorted([(before.value - values[1]) / 0.1, (values[0] - before.value) / 0.1])
        price = float(before.prices.stored_energy[battery])
        assert np.isnan(low) or low - 2e-5 <= price <= high + 2e-5


@pytest.fixture(scope="module")
def heatwave() -> Trajectory:
    """The packaged day from 05:00 to 20:00, with its outage from 12:00 to 18:00."""
    return run_day(vppres.load_scenario("uk-heatwave-2022").between(5, 20))


@pytest.fixture(scope="module")
def explained(heatwave: Trajectory) -> Trajectory:
    return explain_day(heatwave)


def test_at_the_end_of_an_outage_no_energy_is_said_to_have_a_later_use(
    explained: Trajectory,
) -> None:
    reasons = explained.explanations
    at = {h: reasons[reasons["time"].dt.hour == h]["words"].str.cat(sep=" ") for h in (16, 17)}
    assert "a kWh kept for later" in at[16]
    assert "kept for later" not in at[17]
    assert "Discharges: supplies customers with all that it may give; one more stored" in at[17]


def tables(run: Trajectory) -> tuple[pd.DataFrame, pd.DataFrame]:
    assert run.explanations is not None and run.shadow_prices is not None
    return run.explanations, run.shadow_prices


def test_every_action_of_the_heatwave_day_has_a_reason(explained: Trajectory) -> None:
    reasons, _ = tables(explained)
    served = explained.customers["served"].astype(bool)
    moved = (explained.batteries["charge_kw"] - explained.batteries["discharge_kw"]).abs() > 1.0
    assert (reasons["item"] == "customer").sum() == (~served).sum() > 50
    assert (reasons["item"] == "battery").sum() == moved.sum() > 50
    assert (reasons["item"] == "step").sum() == 15
    figures = reason_figures(reasons)
    assert figures["explained_share"] == 1.0
    assert sum(figures["drivers"]["not_served"].values()) == (~served).sum()
    assert reasons["words"].str.endswith(".").all()


def test_the_heatwave_day_is_told_as_it_was(explained: Trajectory) -> None:
    assert explained.steps["phase"].tolist() == (
        ["normal"] * 2 + ["preparation"] * 5 + ["island"] * 6 + ["recovery"] + ["normal"]
    )
    reasons, _ = tables(explained)
    out = reasons[reasons["action"] == "not_served"]
    assert set(out["driver"]) <= {"priority", "energy"} and set(out["binding"]) == {"energy"}
    charged = reasons[reasons["action"] == "charge"].groupby("phase")["driver"].unique()
    assert list(charged["preparation"]) == ["preparation"]
    assert list(charged["normal"]) == ["price"]


def test_a_kwh_is_worth_service_in_the_island_and_money_elsewhere(explained: Trajectory) -> None:
    _, prices = tables(explained)
    stored = prices[prices["constraint"] == "stored_energy"].merge(
        explained.steps[["time", "phase", "price_gbp_per_kwh"]], on="time"
    )
    island_rows = stored[stored["phase"] == "island"].groupby("time")
    assert (island_rows["weighted_h"].max() > 1e-3).all()
    assert island_rows["gbp"].max().isna().all()
    elsewhere = stored[stored["phase"] != "island"]
    assert elsewhere["gbp"].between(0.15, 0.6).all()
    assert elsewhere["weighted_h"].fillna(0.0).eq(0.0).all()


def test_customers_with_priority_count_less_per_kw(explained: Trajectory) -> None:
    reasons, _ = tables(explained)
    table = explained.customers.assign(
        per_kw=explained.customers["weight"] / explained.customers["p_load_kw"]
    )
    best = table[table["served"].astype(bool)].groupby("time")["per_kw"].max()
    behind = reasons[reasons["driver"] == "priority"].merge(table, on=["time", "id"])
    assert (behind["per_kw"] < behind["time"].map(best)).all()


def test_a_second_explanation_is_the_same(tiny_run: Trajectory) -> None:
    first, second = (tables(explain_day(tiny_run)) for _ in range(2))
    for before, after in zip(first, second, strict=True):
        pd.testing.assert_frame_equal(before, after)


@pytest.mark.daily
def test_the_run_folder_keeps_the_explanation_and_the_report_tells_it(
    explained: Trajectory, tmp_path: Path
) -> None:
    summary = write_run(explained, tmp_path / "run")
    assert summary["explained_share"] == 1.0
    back = read_finished(tmp_path / "run")
    for before, after in zip(tables(explained), tables(back.trajectory), strict=True):
        pd.testing.assert_frame_equal(before, after, check_dtype=False)
    rewrite_report(back, tmp_path / "again.html")
    for file in (tmp_path / "run" / "report.html", tmp_path / "again.html"):
        page = file.read_text(encoding="utf-8")
        assert "Decisions and reasons" in page
        assert "19 Jul 12:00 to 19 Jul 18:00: island" in page
        assert "11 to 19 of 32 customers were supplied" in page


def test_a_report_without_explanation_has_no_such_section(tmp_path: Path) -> None:
    write_run(small_run(), tmp_path / "run")
    assert "and why" not in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert not (tmp_path / "run" / "explanations.parquet").exists()


@pytest.fixture(scope="module")
def tiny_run() -> Trajectory:
    return run_day(tiny_scenario(), RunOptions(horizon_h=2.0))


def changed(run: Trajectory, table: str, **columns: Any) -> Trajectory:
    kept: pd.DataFrame = getattr(run, table)
    return replace(run, **{table: kept.assign(**columns)})  # type: ignore[arg-type]


def test_a_dark_island_and_a_fallback_come_first(tiny_run: Trajectory) -> None:
    nobody = changed(tiny_run, "customers", served=False)
    dark = changed(
        nobody,
        "steps",
        dark=[False, False, False, True, False, False],
        fallback=["", "", "", "rule", "rule", ""],
        fallback_reason=["", "", "", "no answer", "no answer", ""],
    )
    reasons, _ = tables(explain_day(dark))
    out = reasons[reasons["action"] == "not_served"]
    by_step = out.groupby("time")["driver"].unique().tolist()
    assert [list(found) for found in by_step[3:5]] == [["dark"], ["fallback"]]
    words = out.loc[out["driver"] == "fallback", "words"].iloc[0]
    assert words == "Not supplied: the step was decided by a fallback (rule: no answer)."


def test_prices_that_take_too_long_are_asked_for_once_and_told(
    tiny_run: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def slow(*given: Any) -> PricedWindow | None:
        asked.append(given)
        return price_window(*given, time_s=0.0)

    monkeypatch.setattr("vppres.explain.prices.price_window", slow)
    reasons, shadow = tables(explain_day(changed(tiny_run, "customers", served=False)))
    assert len(asked) == len(tiny_run.steps) and shadow.empty
    late = "o shadow prices were found in time"
    assert reasons.loc[reasons["item"] == "step", "words"].str.contains(late).all()
    off = reasons[reasons["action"] == "not_served"]
    assert off["words"].str.contains(late).any()


def test_a_switching_rule_is_named_where_service_would_have_paid(tiny_run: Trajectory) -> None:
    served = tiny_run.customers["served"].astype(bool).to_numpy().copy()
    served[-1] = False  # with grid, nothing is scarce, and the homes stay off
    run = changed(tiny_run, "customers", served=served)
    rules = replace(run, options={**run.options, "switching": {"min_unserved_h": 2.0}})
    for given, driver in ((rules, "switching_rule"), (run, "unexplained")):
        reasons, _ = tables(explain_day(given))
        last = reasons[(reasons["item"] == "customer") & (reasons["id"] == "homes")].iloc[-1]
        assert last["driver"] == driver
    assert reason_figures(reasons)["explained_share"] < 1.0


def test_a_rule_that_leaves_somebody_out_is_named() -> None:
    # The battery could carry both customers, and rests.
    reasons, _ = tables(explain_day(run_day(island(energy_kwh=100.0), RunOptions("idle"))))
    out = reasons[reasons["action"] == "not_served"].set_index("id")
    assert out["driver"].to_dict() == {"first": "rule", "second": "rule"}
    assert out.loc["first", "words"] == (
        "Not supplied: the fixed rule of controller idle leaves it off; supplying it would be worth 1 "
        "weighted customer hours."
    )


def test_a_battery_that_settles_the_mismatch_says_so(tiny_run: Trajectory) -> None:
    power = tiny_run.batteries["charge_kw"] - tiny_run.batteries["discharge_kw"]
    run = changed(tiny_run, "batteries", mismatch_kw=power)
    reasons, _ = tables(explain_day(run))
    assert set(reasons.loc[reasons["item"] == "battery", "driver"]) == {"mismatch"}


@pytest.mark.daily
def test_an_owner_whose_inverter_is_too_small(tiny: Scenario) -> None:
    # The roof's 20 kW would all be consumed, but its inverter passes 10 kVA.
    pv = replace(tiny.pv, s_max_kva=[10.0, 30.0])
    run = run_day(replace(tiny, pv=pv).between(2, 5), RunOptions(horizon_h=1.0))
    reasons, _ = tables(explain_day(run))
    hospital = reasons[reasons["id"] == "hospital"]
    assert len(hospital) == 3 and set(hospital["driver"]) == {"inverter"}


def test_surplus_is_curtailed_and_stored_for_what_it_is(tiny: Scenario) -> None:
    day = replace(tiny, pv_kw=tiny.pv_kw * 0 + [30.0, 20.0], load_kw=tiny.load_kw * 0.1)
    run = run_day(day, RunOptions(horizon_h=2.0))
    reasons, _ = tables(explain_day(run))
    assert set(reasons.loc[reasons["action"] == "charge", "driver"]) == {"surplus"}
    assert set(reasons.loc[reasons["action"] == "curtail", "driver"]) == {"surplus"}


@pytest.mark.parametrize(("limits", "binding", "constraint"), [
    ({"energy_kwh": 40.0}, "energy", "energy_floor"),
    ({"energy_kwh": 100.0, "r_ohm": 3.0}, "voltage", "voltage_floor"),
    pytest.param({"energy_kwh": 100.0, "power_kw": 35.0}, "power", "battery_discharging",
        marks=pytest.mark.nightly),
    pytest.param({"energy_kwh": 100.0, "inverter_kva": 35.0}, "inverter", "battery_inverter",
        marks=pytest.mark.nightly),
])  # fmt: skip
def test_what_is_scarce_in_an_island_is_named(
    limits: dict[str, float], binding: str, constraint: str
) -> None:
    reasons, prices = tables(explain_day(run_day(island(**limits), RunOptions(horizon_h=0.0))))
    out = reasons[reasons["action"] == "not_served"]
    assert out["id"].tolist() == ["second"] and out["driver"].tolist() == [binding]
    bound = prices[prices["constraint"] == constraint]
    assert bound["item"].tolist() == (["3"] if binding == "voltage" else ["b2"])
    words = {
        "energy": "one more stored kWh would add 0.01 weighted",
        "power": "one more kW of battery b2 would add 0.01 weighted",
        "inverter": "one more kVA of battery b2 would add 0.01 weighted",
        "voltage": "a voltage limit 0.001 pu lower at bus 3 would add 0.0032 weighted",
    }
    assert words[binding] in out["words"].iloc[0]
    assert reasons.loc[reasons["item"] == "step", "driver"].tolist() == [binding]


def test_energy_goes_to_who_counts_more() -> None:
    # 45 kWh in two hours serve the first once; the other 15 kWh reach for nobody as a whole.
    day = replace(island(energy_kwh=45.0, steps=2), load_kw=np.array([[30.0, 30.0], [50.0, 30.0]]))
    run = run_day(day, RunOptions(horizon_h=1.0))
    reasons, _ = tables(explain_day(run))
    served = run.customers[run.customers["served"].astype(bool)]
    assert served["id"].tolist() == ["first"]
    out = reasons[reasons["action"] == "not_served"].set_index(["time", "id"])
    behind = out.loc[(served["time"].iloc[0], "second")]
    assert (behind["driver"], behind["binding"]) == ("priority", "energy")
    whole = out.xs("first", level="id").iloc[0]
    assert whole["driver"] == "energy"
    assert whole["words"].startswith("Not supplied: not enough stored energy")


@pytest.mark.parametrize(("rule", "end"), [("weights", 3), ("strict", 4)])
def test_energy_that_is_kept_for_more_of_them_later_says_for_whom(rule: str, end: int) -> None:
    """72 kWh: both of a tier now, or the second now and both twice later."""
    day = island(energy_kwh=72.0, steps=end)
    customers = replace(day.customers, tier=["critical", "critical"], weight=[1.0, 0.9])
    load_kw = np.array([[60.0, 10.0], [20.0, 10.0], [20.0, 10.0], [5.0, 5.0]])[:end]
    limits_kw = np.where(np.arange(end) < 3, 0.0, np.inf)
    day = replace(day, customers=customers, load_kw=load_kw, grid_limit_kw=limits_kw)
    run = explain_day(run_day(day, RunOptions(horizon_h=end - 1.0, priority=rule)))
    reasons, _ = tables(run)
    out = reasons[reasons["action"] == "not_served"].iloc[0]
    assert out["id"] == "first" and out["time"] == day.grid.start
    grid = "before which no grid is expected" if end == 3 else "when the grid is expected"
    kept = f"kept for later hours of first, second (critical) up to 03:00, {grid}"
    assert kept in out["words"]


def test_a_battery_that_holds_the_voltage_says_so() -> None:
    # The second hour is dear, but in the first the line to the second carries 17 of its 30 kW.
    day = island(energy_kwh=30.0, inverter_kva=25.0, r_ohm=3.0, steps=2)
    day = replace(
        day,
        batteries=replace(day.batteries, bus=[3]),
        grid_limit_kw=np.full(2, np.inf),
        price_gbp_per_kwh=np.array([0.1, 0.5]),
    )
    reasons, prices = tables(explain_day(run_day(day, RunOptions(horizon_h=1.0))))
    first = reasons[reasons["time"] == reasons["time"].iloc[0]]
    move = first[first["item"] == "battery"]
    assert move["action"].tolist() == ["discharge"] and move["driver"].tolist() == ["voltage"]
    assert (prices["constraint"] == "voltage_floor").any()


def test_a_partial_grid_limit_is_named() -> None:
    day = replace(island(energy_kwh=1e-6, steps=2), grid_limit_kw=np.full(2, 40.0))
    run = run_day(day, RunOptions(horizon_h=0.0))
    reasons, prices = tables(explain_day(run))
    out = reasons[reasons["action"] == "not_served"]
    assert out["id"].tolist() == ["second"] * 2 and set(out["binding"]) == {"grid"}
    grid = prices[prices["constraint"] == "grid"]
    assert grid["weighted_h"].tolist() == pytest.approx([0.01, 0.01], rel=1e-4)


@pytest.mark.parametrize("options", [
    RunOptions(horizon_h=2.0, errors=vppres.ForecastErrors(0.2, 0.1, -0.2, 0.1), seed=3),
    RunOptions("full-horizon", 2.0, errors=vppres.ForecastErrors(0.2, 0.1, -0.2, 0.1), seed=3),
    pytest.param(RunOptions("full-horizon", horizon_h=2.0), marks=pytest.mark.nightly),
    pytest.param(RunOptions(horizon_h=0.0), marks=pytest.mark.nightly),
])  # fmt: skip
def test_every_controller_is_explained_in_full(options: RunOptions) -> None:
    reasons, _ = tables(explain_day(run_day(tiny_scenario(), options)))
    assert reason_figures(reasons)["explained_share"] in (1.0, None)
    assert "unexplained" not in set(reasons["driver"])


def test_a_made_up_run_is_explained_by_its_record_alone() -> None:
    # Batteries idle and nobody balanced: no problem of the model has this answer.
    reasons, _ = tables(explain_day(small_run()))
    assert len(reasons) >= 4 + 4


def test_steps_without_batteries_and_pv(tiny: Scenario) -> None:
    bare = replace(
        tiny, pv=PVSystems([], [], [], []), batteries=batteries([], 1.0), pv_kw=np.zeros((6, 0))
    )
    reasons, prices = tables(explain_day(run_day(bare, RunOptions(horizon_h=1.0))))
    out = reasons[reasons["action"] == "not_served"]
    assert len(out) == 6 and set(out["binding"]) == {"power"}
    assert set(prices["constraint"]) <= {"active", "reactive", "grid"}


def test_phases_between_two_outages() -> None:
    outage = np.array([0, 1, 0, 0, 0, 0, 1, 0], bool)
    returning = np.array([0, 1, 1, 1, 0, 0, 1, 0], bool)
    assert phases(outage, returning, 2) == [
        "preparation", "island", "recovery", "recovery", "normal", "preparation", "island",
        "normal",
    ]  # fmt: skip


def test_figures_have_two_digits_that_count() -> None:
    assert [figure(v) for v in (0.0, 0.00122, -0.5, 99.4, 1268.0, float("nan"))] == [
        "0", "0.0012", "-0.5", "99", "1270", "0",
    ]  # fmt: skip


@pytest.mark.nightly
def test_a_day_is_explained_quickly(heatwave: Trajectory) -> None:
    solver_s = [step.levels.solver_s for step in steps_of(heatwave)]
    assert len(solver_s) == 15
    # The bar is 60 ms a step on a quiet core; the median stands a busy machine.
    assert float(np.median(solver_s)) < 0.3
    assert [step.phase for step in steps_of(heatwave)][7] == "island"


def test_a_battery_that_is_out_is_worth_nothing_and_helps_nobody() -> None:
    day = tiny_scenario()
    options = RunOptions(horizon_h=1.0, mode="paper")
    tripped = run_day(day, options, faults=FaultPlan(trips=(BatteryTrip(0, 0, 6, silent=False),)))
    alone = {f.name: getattr(day.batteries, f.name)[1:] for f in fields(Batteries)}
    without = run_day(replace(day, batteries=Batteries(**alone)), options)
    found = explain_day(tripped).shadow_prices.set_index(["time", "constraint", "item"])
    expected = explain_day(without).shadow_prices.set_index(["time", "constraint", "item"])
    out = found.index.get_level_values("item") == "big"
    assert not np.nan_to_num(found.loc[out, ["weighted_h", "gbp"]]).any()
    pd.testing.assert_frame_equal(found[~out], expected, rtol=1e-5, atol=1e-7)
    assert (found[~out].xs("stored_energy", level="constraint")["weighted_h"] > 1e-4).any()


def test_the_supply_of_an_owner_takes_what_its_panels_do_not_give() -> None:
    # 40 kWh for the first's 30 and 10 of the second's 30 kW. Its own panels give 12 kW more.
    day = island(energy_kwh=20.0)
    day = replace(
        day,
        pv=PVSystems(["roof"], ["second"], [12.0], [20.0]),
        pv_kw=np.array([[12.0]]),
        customers=replace(day.customers, weight=[1.0, 0.3]),
    )
    answer = solved(day, priced=PricedTerms(1.0, 0.0, 0.0))
    # The first needs 30 kWh: 20 from the battery, 10 from the panels. 2 kWh are left.
    assert answer.served_share[0] == pytest.approx([1.0, 2.0 / 30.0], abs=1e-5)
    assert answer.prices.service[1] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("sun_kw", [0.0, 5.0, 10.0])
def test_the_cost_of_a_supply_to_others_by_hand(sun_kw: float) -> None:
    # 30 kWh and the sun serve the first, now, and half of a third of 60 kW that counts 1.2.
    day = island(energy_kwh=60.0, steps=2)
    day = replace(
        day,
        load_kw=np.array([[30.0, 30.0], [60.0, 0.0]]),
        pv=PVSystems(["roof"], ["second"], [10.0], [20.0]),
        pv_kw=np.array([[sun_kw], [0.0]]),
    )
    answer = solved(day, priced=PricedTerms(1.0, 0.0, 0.0))
    assert answer.served_share[0, 1] == pytest.approx(0.0, abs=1e-5)
    # What the second takes, its own sun included, is 30 kWh less for the first's 60 kWh later.
    assert answer.prices.service[1] == pytest.approx(0.3 - 30.0 / 60.0, rel=1e-4)


def test_a_value_in_strict_order_is_in_hours_of_the_tier_that_is_rationed() -> None:
    """A kWh is 0.0027 h of a critical customer of 365 kW: as a weight that is 0.33 of the low tier.

    A tier that is supplied whole has no demand here, and loses no part of a customer hour.
    """
    ranks = Ranks(
        ("critical", "low"), np.array([0, 1]), np.ones(2, dtype=int), np.array([120.0, 1.0])
    )
    kwh = 120.0 / 365.0
    assert (
        hours(kwh, ranks, np.array([[365.0, 0.0]]))
        == "9.9 s of supply for a customer of tier critical"
    )
    assert (
        hours(kwh, ranks, np.array([[365.0, 50.0]]))
        == "9.9 s of supply for a customer of tier critical"
    )
    assert (
        hours(kwh, ranks, np.array([[0.0, 3.0]])) == "20 min of supply for a customer of tier low"
    )
    assert (
        hours(0.02, ranks, np.array([[365.0, 50.0]]))
        == "1.2 min of supply for a customer of tier low"
    )
    taken = hours(240.0, ranks, np.array([[365.0, 50.0]]), kwh=730.0)
    assert taken == "2 h of supply for a customer of tier critical"
