"""Whether a critical customer had to be let go, by hand: two hours without grid.

The hospital takes 62 and 64 kW of 47 and 50 kW of sun: 15.8 and 14.7 kWh have to be stored.
"""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from experiments.studies.shedding import Judge, Shed
from tests.support.live_service import NOON, decided, running
from vppres.scenario.scenario import Scenario

ONE = NOON + pd.Timedelta("1h")
OUTAGE = {"type": "outage", "start": "2026-11-21T13:00:00Z", "end": "2026-11-21T15:00:00Z"}


def hospital(plan: dict[str, Any], now: bool, later: bool) -> dict[str, Any]:
    """The plan with the hospital on or off in the two hours."""
    other = deepcopy(plan)
    for one in other["setpoints"]:
        if one["asset"] == "hospital":
            one["served"] = now
    other["ahead"]["served"]["hospital"][0] = later
    return other


@pytest.mark.parametrize(
    ("stored_kwh", "now", "later", "avoidable"),
    [
        (20.0, False, True, 0),  # enough for one hour of the two, in whichever
        (20.0, False, False, 1),
        (40.0, False, True, 1),  # enough for both
        (5.0, False, True, 0),  # for none; the sun of the first goes into the second
    ],
)
def test_it_had_to_be_where_what_was_known_allowed_no_more(
    tiny: Scenario, tmp_path: Path, stored_kwh: float, now: bool, later: bool, avoidable: int
) -> None:
    with running(tiny, tmp_path) as (http, clock, runner):
        http.put("/v1/events/storm", OUTAGE)
        plan = decided(http, clock, ONE, soc=0.15 + stored_kwh / 160.0)
        assert plan["ahead"]["grid_limit_kw"] == [0.0, None]
        judge = Judge(runner)
        judge.look(hospital(plan, now, later))
        assert [each.avoidable for each in judge.found] == [avoidable]
        # The plan itself lets nobody go whom it could keep.
        judge.found.clear()
        judge.look(plan)
        assert not sum(each.avoidable for each in judge.found)


def test_of_a_step_no_more_is_avoidable_than_are_off_in_it() -> None:
    assert [Shed(*each).avoidable for each in ((1, 3, 0), (2, 0, 1), (1, 0, 2))] == [1, 1, 0]
