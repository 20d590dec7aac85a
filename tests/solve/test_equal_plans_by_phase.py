"""Which of plans that are worth the same is carried out on a feeder with phases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.support.phased_feeder import phased_day
from vppres import RunOptions, run_day
from vppres.core.arrays import Floats
from vppres.day.trajectory import Trajectory
from vppres.scenario.scenario import Scenario

pytest.importorskip("opendssdirect")

STREET = """clear
new circuit.street basekv=0.4 pu=1.0 mvasc3=100 mvasc1=100
new linecode.three nphases=3 rmatrix=[0.4|0.15 0.41|0.15 0.15 0.4] basefreq=50
~ xmatrix=[0.3|0.1 0.3|0.1 0.1 0.3] units=km
new line.l1 bus1=sourcebus bus2=m linecode=three length=0.1 units=km
new line.l2 bus1=m bus2=n linecode=three length=0.1 units=km
new load.a bus1=m.1 phases=1 kv=0.2309 kw=3 kvar=0.5 model=1
new load.b bus1=n.2 phases=1 kv=0.2309 kw=3 kvar=0.5 model=1
new load.c bus1=n.3 phases=1 kv=0.2309 kw=3 kvar=0.5 model=1
new load.d bus1=n phases=3 kv=0.4 kw=3 kvar=0.5 model=1
set voltagebases=[0.4]
calcvoltagebases
"""
"""A customer on each phase and one on all three, whose battery forms the grid."""

NONE_KW = 1e-3
DARK, OPEN = 0.0, np.inf


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    file = tmp_path_factory.mktemp("street") / "street.dss"
    file.write_text(STREET)
    return phased_day(file)


def made(
    street: Scenario,
    load_kw: Floats,
    limits_kw: Sequence[float],
    first: Sequence[int],
    soc: float = 0.85,
    p_max_kw: float = 10.0,
    sun_kw: Sequence[float] = (),
) -> Scenario:
    """Hours of the street, ``first`` its customers of the highest tier; one battery of 10 kWh."""
    steps = len(load_kw)
    day = street.between(0, steps)
    b, pv = day.batteries, day.pv
    forms = b.id == "bd"
    batteries = replace(
        b,
        energy_kwh=np.where(forms, 10.0, 0.1),
        p_max_kw=np.where(forms, p_max_kw, 0.05),
        s_max_kva=np.where(forms, 36.0, 0.1),
        soc_initial=np.where(forms, soc, 0.15),
        grid_forming=forms,
    )
    pv_kw = np.zeros((steps, len(pv)))
    if len(sun_kw):
        pv_kw[:, 0] = sun_kw
    highest = np.isin(np.arange(4), first)
    customers = replace(
        day.customers,
        tier=np.where(highest, "critical", "low").astype(object),
        weight=np.where(highest, 1.0, 0.02),
    )
    return replace(
        day,
        customers=customers,
        batteries=batteries,
        pv=replace(pv, p_max_kw=np.full(len(pv), 50.0), s_max_kva=np.full(len(pv), 60.0)),
        load_kw=np.asarray(load_kw, dtype=float),
        pv_kw=pv_kw,
        grid_limit_kw=np.asarray(limits_kw, dtype=float),
        export_limit_kw=np.zeros(steps),
    )


def served(run: Trajectory) -> Floats:
    """Who is supplied, (T, C)."""
    return run.customers.pivot(index="time", columns="id", values="served").to_numpy(dtype=int)


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
    day = made(street, load_kw, [DARK] * 9, [who])
    headroom = {"headroom": 0.0} if priority == "weights" else {}
    options = RunOptions(
        horizon_h=5, mode="physical", outages=outages, priority=priority, **headroom
    )
    assert served(run_day(day, options))[:, who].tolist() == [1] * 3 + [0] * 6


@pytest.mark.parametrize("outages", ["known", "none"])
@pytest.mark.parametrize(
    ("limits_kw", "sun_kw", "soc"),
    [
        ([DARK] * 6, [8.0] * 6, 0.85),
        ([DARK] * 6, [8.0, 1.0] * 3, 0.6),
        ([OPEN, *[DARK] * 4, OPEN], [8.0] * 6, 0.85),
    ],
)
def test_nothing_stored_is_spent_beside_curtailed_sun(
    street: Scenario, limits_kw: list[float], sun_kw: list[float], soc: float, outages: str
) -> None:
    """The former gives a few watts of losses."""
    day = made(street, np.full((6, 4), 0.5), limits_kw, [0], soc=soc, sun_kw=sun_kw)
    run = run_day(day, RunOptions(horizon_h=4, mode="physical", outages=outages))
    powers = run.batteries.groupby("time")[["charge_kw", "discharge_kw"]].sum()
    curtailed_kw = run.pv.groupby("time")["curtailed_kw"].sum()
    given_kw = powers["discharge_kw"] - powers["charge_kw"]
    assert curtailed_kw.max() > 1.0
    assert np.minimum(given_kw, curtailed_kw).max() <= 5e-3
    assert served(run).all()


@pytest.mark.parametrize("priority", ["strict", "weights"])
def test_of_equal_customers_the_same_one_stays_on(street: Scenario, priority: str) -> None:
    """4 kW are enough for one of two customers of 3 kW, on different phases."""
    load_kw = np.tile([1.5, 1.5, NONE_KW, NONE_KW], (4, 1))
    day = made(street, load_kw, [OPEN, DARK, DARK, DARK], [0, 1], p_max_kw=2.0)
    options = RunOptions(horizon_h=1, mode="physical", outages="none", priority=priority)
    on = served(run_day(day, replace(options, headroom=0.0)))[1:, :2]
    assert on.sum(axis=1).tolist() == [1, 1, 1]
    assert (on == on[0]).all()
