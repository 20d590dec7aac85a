"""Which of plans that are worth the same is carried out, and what is kept for later."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.support.small_windows import DARK, OPEN, battery, two_buses
from vppres import RunOptions, run_day
from vppres.scenario.scenario import Scenario


def hours(limits_kw: list[float], load_kw: float = 3.0) -> Scenario:
    """Two customers of two tiers with a battery of 12 kVA that holds 6.65 kWh for them."""
    day = two_buses([[load_kw] * 2] * len(limits_kw), [1.0, 0.1], limits_kw)
    ranked = replace(day.customers, tier=["critical", "high"])
    b = battery(energy_kwh=10.0, p_max_kw=10.0, s_max_kva=12.0, soc=0.85)
    return replace(day, tiers=("critical", "high"), customers=ranked, batteries=b)


@pytest.mark.parametrize("priority", ["strict", "weights"])
@pytest.mark.parametrize("controller", ["mpc", "full-horizon"])
def test_nothing_is_kept_behind_an_outage_that_ends_with_the_run(
    priority: str, controller: str
) -> None:
    """Both need 6 kWh in the last hour; a tenth of 12 kVA for an hour more is not there."""
    day = hours([OPEN, OPEN, DARK])
    options = RunOptions(priority=priority, controller=controller, mode="physical")
    assert run_day(day, options).customers["served"].all()


@pytest.mark.parametrize(("outages", "served"), [("known", 2), ("none", 1)])
def test_only_who_knows_that_the_outage_ends_keeps_nothing(outages: str, served: int) -> None:
    run = run_day(hours([DARK]), RunOptions(priority="strict", mode="physical", outages=outages))
    assert run.customers["served"].sum() == served
