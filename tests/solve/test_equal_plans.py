"""Which of plans that are worth the same is carried out, and what is kept for later."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.phased_feeder import NONE_KW, STREET, day_of, served, street_day
from tests.support.sets import gensets
from tests.support.small_windows import DARK, OPEN, battery, two_buses, window, with_pv
from tests.support.vans import chargers, plugged_in
from vppres import RunOptions, Trajectory, run_day
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    pytest.importorskip("opendssdirect")
    return day_of(STREET, tmp_path_factory.mktemp("street"))


def hours(limits_kw: list[float], load_kw: float = 3.0) -> Scenario:
    """Two customers of two tiers with a battery of 12 kVA that holds 6.65 kWh for them."""
    day = two_buses([[load_kw] * 2] * len(limits_kw), [1.0, 0.1], limits_kw)
    ranked = replace(day.customers, tier=["critical", "high"])
    b = battery(energy_kwh=10.0, p_max_kw=10.0, s_max_kva=12.0, soc=0.85)
    return replace(day, tiers=("critical", "high"), customers=ranked, batteries=b)


def alone(limits_kw: list[float]) -> Scenario:
    """One customer of 2 kW with the same battery."""
    day = two_buses([[2.0]] * len(limits_kw), [1.0], limits_kw)
    return replace(day, tiers=("critical",), batteries=hours([DARK]).batteries)


@pytest.mark.parametrize("priority", ["strict", "weights"])
@pytest.mark.parametrize("controller", ["mpc", "full-horizon"])
def test_nothing_is_kept_behind_an_outage_that_ends_with_the_run(
    priority: str, controller: str
) -> None:
    """Both need 6 kWh in the last hour; a tenth of 12 kVA for an hour more is not there."""
    day = hours([OPEN, OPEN, DARK])
    options = RunOptions(priority=priority, controller=controller, mode="physical")
    assert run_day(day, options).customers["served"].all()


@pytest.mark.parametrize("priority", ["strict", "weights"])
def test_nothing_is_kept_behind_an_outage_that_ends_before_the_run(priority: str) -> None:
    day = hours([OPEN, OPEN, DARK, OPEN])
    run = run_day(day, RunOptions(priority=priority, mode="physical"))
    assert run.customers["served"].all()


@pytest.mark.parametrize("controller", ["mpc", "full-horizon"])
def test_headroom_that_moves_on_with_the_window_puts_nobody_off(controller: str) -> None:
    """7 kWh are stored; two hours take 4.2, and 1.3 stay in the battery for a tenth of 12 kVA."""
    day = alone([DARK] * 8 + [OPEN])
    options = RunOptions(horizon_h=5, mode="physical", outages="none", controller=controller)
    assert run_day(day, options).customers["served"].tolist() == [1, 1, *[0] * 6, 1]


@pytest.mark.parametrize(("outages", "served"), [("known", 2), ("none", 1)])
def test_only_who_knows_that_the_outage_ends_keeps_nothing(outages: str, served: int) -> None:
    run = run_day(hours([DARK]), RunOptions(priority="strict", mode="physical", outages=outages))
    assert run.customers["served"].sum() == served


# Of equal service the earlier one.


@pytest.mark.parametrize("options", [
    {"mode": "physical", "outages": "none", "priority": "strict"},
    {"mode": "physical", "outages": "known", "priority": "strict"},
    {"mode": "physical", "outages": "known", "headroom": 0.0},
    {"mode": "physical", "outages": "none", "priority": "strict", "method": "monolithic"},
    {"mode": "physical", "outages": "none", "controller": "full-horizon", "headroom": 0.0},
    {"mode": "paper", "outages": "none"},
    {"mode": "paper", "outages": "none", "controller": "full-horizon"},
], ids=lambda options: "-".join(str(value) for value in options.values()))  # fmt: skip
def test_a_lone_customer_is_not_put_off(options: dict[str, Any]) -> None:
    """6.65 kWh are enough for three of nine dark hours of 2 kW: for the first three."""
    run = run_day(alone([DARK] * 9), RunOptions(horizon_h=5, **options))
    assert run.customers["served"].tolist() == [1] * 3 + [0] * 6


@pytest.mark.parametrize("who", range(4))
@pytest.mark.parametrize(
    ("outages", "priority"), [("none", "strict"), ("known", "strict"), ("none", "weights")]
)
def test_a_lone_customer_of_any_phase_is_not_put_off(
    street: Scenario, who: int, outages: str, priority: str
) -> None:
    """6.65 kWh are enough for three of nine dark hours of 2 kW: for the first three."""
    load_kw = np.full((9, 4), NONE_KW)
    load_kw[:, who] = 2.0
    day = street_day(street, load_kw, [DARK] * 9, [who])
    headroom = {"headroom": 0.0} if priority == "weights" else {}
    options = RunOptions(
        horizon_h=5, mode="physical", outages=outages, priority=priority, **headroom
    )
    assert served(run_day(day, options))[:, who].tolist() == [1] * 3 + [0] * 6


@pytest.mark.parametrize("kind", ["set", "vehicle"])
@pytest.mark.parametrize("outages", ["none", "known"])
def test_a_lone_customer_is_not_put_off_beside(kind: str, outages: str) -> None:
    """The same three hours, beside a set of 100 W or a vehicle that gets nothing in them."""
    day = alone([DARK] * 9)
    if kind == "set":
        day = replace(day, gensets=gensets(p_max_kw=0.1, p_min_kw=0.0))
    else:
        of_customer = chargers(customer=[day.customers.id[0]], bus=[None])
        day = plugged_in(replace(day, chargers=of_customer), (0, 9))
    options = RunOptions(horizon_h=5, mode="physical", outages=outages, headroom=0.0)
    assert run_day(day, options).customers["served"].tolist() == [1] * 3 + [0] * 6


def test_higher_tiers_come_first_and_then_sooner() -> None:
    """Energy for six customer hours of 1 kW: four of the first tier, the others at once."""
    day = hours([DARK] * 4, load_kw=1.0)
    run = run_day(day, RunOptions(horizon_h=3, priority="strict", mode="physical", headroom=0.0))
    served = run.customers.pivot(index="time", columns="id", values="served")
    assert served.to_numpy(dtype=int).tolist() == [[1, 1], [1, 1], [1, 0], [1, 0]]


# Nobody is switched for nothing.


@pytest.mark.parametrize("on", [0, 1])
@pytest.mark.parametrize("method", ["decomposed", "monolithic"])
def test_of_equal_customers_the_one_that_is_on_stays_on(on: int, method: str) -> None:
    """The battery's 4 kW are enough for one of two customers of 3 kW."""
    day = two_buses([[3.0, 3.0]] * 2, [1.0, 1.0], [DARK, DARK])
    day = replace(day, batteries=battery(p_max_kw=4.0, soc=0.85))
    data = replace(window(day), open_ended=True, on_before=np.arange(2) == on)
    found = WindowSolver(Site.of(day), method).solve(data)
    assert found.dispatch.served.sum(axis=1).tolist() == [1, 1]
    assert found.dispatch.served[0, on]


@pytest.mark.parametrize("priority", ["strict", "weights"])
def test_of_equal_customers_on_different_phases_the_same_one_stays_on(
    street: Scenario, priority: str
) -> None:
    """4 kW are enough for one of two customers of 3 kW, on different phases."""
    load_kw = np.tile([1.5, 1.5, NONE_KW, NONE_KW], (4, 1))
    day = street_day(street, load_kw, [OPEN, DARK, DARK, DARK], [0, 1], p_max_kw=2.0)
    options = RunOptions(horizon_h=1, mode="physical", outages="none", priority=priority)
    on = served(run_day(day, replace(options, headroom=0.0)))[1:, :2]
    assert on.sum(axis=1).tolist() == [1, 1, 1]
    assert (on == on[0]).all()


# Nothing stored is spent beside curtailed sun.


def spent_kw(run: Trajectory) -> float:
    """Most power that batteries gave beside as much curtailed sun."""
    powers = run.batteries.groupby("time")[["charge_kw", "discharge_kw"]].sum()
    curtailed_kw = run.pv.groupby("time")["curtailed_kw"].sum()
    given_kw = powers["discharge_kw"] - powers["charge_kw"]
    return float(np.minimum(given_kw, curtailed_kw).max())


@pytest.mark.parametrize("priority", ["strict", "weights"])
@pytest.mark.parametrize("outages", ["known", "none"])
@pytest.mark.parametrize(
    ("limits_kw", "sun_kw", "soc"),
    [
        ([DARK] * 6, [8.0] * 6, 0.85),  # more than enough in every hour
        ([DARK] * 6, [8.0] * 4 + [0.0] * 2, 0.4),  # it is filled while there is sun
        ([DARK] * 6, [8.0, 1.0] * 3, 0.6),  # every other hour needs it
        ([OPEN, *[DARK] * 4, OPEN], [8.0] * 6, 0.85),  # and with a grid that takes nothing back
    ],
)
def test_nothing_stored_is_spent_beside_curtailed_sun(
    limits_kw: list[float], sun_kw: list[float], soc: float, outages: str, priority: str
) -> None:
    day = with_pv(hours(limits_kw, load_kw=1.0), sun_kw)
    day = replace(
        day,
        batteries=replace(day.batteries, soc_initial=[soc]),
        export_limit_kw=np.zeros(len(limits_kw)),
    )
    options = RunOptions(horizon_h=4, mode="physical", outages=outages, priority=priority)
    run = run_day(day, options)
    assert spent_kw(run) <= 2e-3
    assert run.customers["served"].all()
    assert (run.steps["status"] == "optimal").all()


@pytest.mark.parametrize("outages", ["known", "none"])
@pytest.mark.parametrize(("limits_kw", "sun_kw", "soc"), [
    ([DARK] * 6, [8.0] * 6, 0.85),
    ([DARK] * 6, [8.0, 1.0] * 3, 0.6),
    ([OPEN, *[DARK] * 4, OPEN], [8.0] * 6, 0.85),
])  # fmt: skip
def test_nothing_stored_is_spent_beside_curtailed_sun_of_phases(
    street: Scenario, limits_kw: list[float], sun_kw: list[float], soc: float, outages: str
) -> None:
    """The former gives a few watts of losses."""
    day = street_day(street, np.full((6, 4), 0.5), limits_kw, [0], soc=soc, sun_kw=sun_kw)
    run = run_day(day, RunOptions(horizon_h=4, mode="physical", outages=outages))
    assert run.pv.groupby("time")["curtailed_kw"].sum().max() > 1.0
    assert spent_kw(run) <= 5e-3
    assert served(run).all()
