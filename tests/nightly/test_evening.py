"""The evening of ``tests.support.evening`` on the tiny feeder; and that its judgement can fail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.evening import Moment, critical, evening
from tests.support.live_service import site
from tests.support.tiny_day import tiny_scenario
from vppres.day.options import RunOptions


@pytest.mark.nightly
def test_an_evening_of_outage_refusal_and_restart(tmp_path: Path) -> None:
    day = site(tiny_scenario())
    dear = replace(day, price_gbp_per_kwh=np.full(24, 0.3))  # nothing is sold before the outage
    found = evening(dear, RunOptions(horizon_h=1.0, isolate=False), tmp_path)
    assert [moment.line(dear) for moment in found if moment.wrong] == []
    assert [moment.plan["status"] for moment in found] == ["ok"] * 3 + ["manual"] + ["ok"] * 3
    assert [("anew" in moment.plan) for moment in found] == [False, *[True] * 4, False, True]
    # Beside the solver, from the change to the plan that knows it.
    assert max(moment.seconds for moment in found[1:4]) < 20.0


def test_a_moment_says_what_is_wrong() -> None:
    day = tiny_scenario()
    plan = {"status": "ok", "setpoints": [{"asset": "hospital", "served": False}]}
    moment = Moment("2026-11-21T18:13:00Z", "grid lost", 1.0, plan, ["nobody is on"])
    assert critical(day) == {"hospital"}
    assert moment.line(day) == (
        "2026-11-21T18:13:00Z grid lost: ok, 1 off, of the first tier 1, after 1.0 s, "
        "1.0 s of them beside the solver. WRONG: nobody is on"
    )
