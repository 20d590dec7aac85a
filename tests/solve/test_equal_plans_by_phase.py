"""Which of plans that are worth the same is carried out on a feeder with phases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.phased_feeder import DARK, NONE_KW, OPEN, STREET, phased_day, served, street_day
from vppres import RunOptions, run_day
from vppres.scenario.scenario import Scenario

pytest.importorskip("opendssdirect")


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    file = tmp_path_factory.mktemp("street") / "street.dss"
    file.write_text(STREET)
    return phased_day(file)


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


@pytest.mark.parametrize("outages", ["known", "none"])
@pytest.mark.parametrize(("limits_kw", "sun_kw", "soc"), [
    ([DARK] * 6, [8.0] * 6, 0.85),
    ([DARK] * 6, [8.0, 1.0] * 3, 0.6),
    ([OPEN, *[DARK] * 4, OPEN], [8.0] * 6, 0.85),
])  # fmt: skip
def test_nothing_stored_is_spent_beside_curtailed_sun(
    street: Scenario, limits_kw: list[float], sun_kw: list[float], soc: float, outages: str
) -> None:
    """The former gives a few watts of losses."""
    day = street_day(street, np.full((6, 4), 0.5), limits_kw, [0], soc=soc, sun_kw=sun_kw)
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
    day = street_day(street, load_kw, [OPEN, DARK, DARK, DARK], [0, 1], p_max_kw=2.0)
    options = RunOptions(horizon_h=1, mode="physical", outages="none", priority=priority)
    on = served(run_day(day, replace(options, headroom=0.0)))[1:, :2]
    assert on.sum(axis=1).tolist() == [1, 1, 1]
    assert (on == on[0]).all()
